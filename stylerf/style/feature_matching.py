"""Nearest-neighbor search for the style feature of every position, by cosine similarity, in bounded memory.

Symbols: f content rows [n, c], s style rows [m, c] of unit length, j(i) = argmax_j <f_i, s_j> / |f_i|.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from stylerf.errors import InvalidValue

NORM_FLOOR = 1e-8  # added to every norm (ARF), so that all-zero features have cosine 0 instead of NaN
STYLE_BLOCK = 4096  # style rows compared at once; a running maximum avoids the full matrix


def unit_rows(rows: Tensor) -> Tensor:
    """Return rows [n, c] divided by their norm + 1e-8; a zero row stays zero and has a zero gradient."""
    return rows / (torch.linalg.vector_norm(rows, dim=1, keepdim=True) + NORM_FLOOR)


@torch.no_grad()
def nearest(
    content: Tensor,  # [n, c]
    style: Tensor,  # [m, c] unit rows
    memory_mb: float = 64.0,
    half: bool = False,
) -> tuple[Tensor, Tensor]:
    """Find the style row with the largest cosine similarity, without gradients. Ties go to the first row.

    Args:
        style: Rows of unit length.
        memory_mb: Memory limit for similarities.
        half: On CUDA, compare in float16, whose spacing near 1 is an eighth of bfloat16's 0.004.

    Returns:
        Index [n] of the style row, and its cosine [n], which is rounded if `half`.
    """
    if content.dim() != 2 or style.dim() != 2 or content.shape[1] != style.shape[1] or style.shape[0] == 0:
        raise InvalidValue(
            f"expected rows [n, c] and at least one style row [m, c], found {tuple(content.shape)} and "
            f"{tuple(style.shape)}"
        )
    queries = unit_rows(content)
    if half and content.is_cuda:
        queries, style = queries.half(), style.half()
    best = torch.full((content.shape[0],), -torch.inf, dtype=queries.dtype, device=content.device)
    index = torch.zeros(content.shape[0], dtype=torch.long, device=content.device)
    block = min(STYLE_BLOCK, style.shape[0])
    rows = max(1, int(memory_mb * 2**20 / (block * queries.element_size())))
    for start in range(0, content.shape[0], rows):
        part = slice(start, start + rows)
        for first in range(0, style.shape[0], block):
            value, place = (queries[part] @ style[first : first + block].T).max(dim=1)
            # Strictly greater: ties go to the first row for any block size.
            better = value > best[part]
            best[part] = torch.where(better, value, best[part])
            index[part] = torch.where(better, place + first, index[part])
    return index, best.to(content.dtype)


@dataclass(frozen=True)
class StyleRows:
    """The style image's features of one block, normalized, computed once.

    Attributes:
        rows: [m, c].
        basis: [c, r], orthonormal directions to search in (see with_basis()), or None.
        short: rows @ basis, [m, r].
    """

    rows: Tensor
    basis: Tensor | None = None
    short: Tensor | None = None

    def match(self, content: Tensor, memory_mb: float = 64.0, half: bool = False) -> Tensor:  # [n] index
        """Return j(i) for content rows [n, c]: exact without a basis, else the best within its subspace."""
        if self.basis is None or self.short is None:
            return nearest(content, self.rows, memory_mb, half)[0]
        # The argmax is independent of the query's norm, so the projected query needs no rescaling.
        return nearest(content.detach() @ self.basis, self.short, memory_mb, half)[0]

    def with_basis(self, rank: int) -> "StyleRows":
        """Return these rows with a search in the `rank` leading directions of their second moment: c/rank times faster.

        <f, s> ignores the component of s outside this subspace.
        """
        if not 1 <= rank <= self.rows.shape[1]:
            raise InvalidValue(f"expected a rank from 1 to {self.rows.shape[1]}, found {rank}")
        # Uncentered, to preserve inner products rather than variances.
        moment = self.rows.double().T @ self.rows.double()
        basis = torch.linalg.eigh(moment).eigenvectors[:, -rank:].flip(1).to(self.rows.dtype).contiguous()
        return replace(self, basis=basis, short=(self.rows @ basis).contiguous())


def style_rows(features: Tensor, most: int | None = 4096, seed: int = 0) -> StyleRows:
    """Return unit rows of a style image's features [c, h, w]: a random subset of `most`, or all if None."""
    rows = unit_rows(rows_of(features.detach()))
    if most is not None and rows.shape[0] > most:
        rows = sample(rows, most, seed)
    return StyleRows(rows.contiguous())


def rows_of(features: Tensor) -> Tensor:
    """Reshape [c, h, w] to [h*w, c]."""
    return features.flatten(1).T


def sample(rows: Tensor, count: int, seed: int) -> Tensor:
    """Draw `count` rows of [m, c] without replacement, in order; always on the CPU, for identical results."""
    chosen = torch.randperm(rows.shape[0], generator=torch.Generator().manual_seed(seed))[:count].sort().values
    return rows[chosen.to(rows.device)]
