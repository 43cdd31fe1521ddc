"""Nearest style feature of every position, by cosine, within a memory bound.

Symbols: f content rows [n, c], s style rows [m, c] of unit length, j(i) = argmax_j <f_i, s_j> / |f_i|.
"""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from stylerf.errors import InvalidValue

NORM_FLOOR = 1e-8  # added to every norm (ARF): a dead position has cosine 0 with everything instead of NaN
STYLE_BLOCK = 4096  # style rows compared at once; with the running maximum the full matrix is never held


def unit_rows(rows: Tensor) -> Tensor:
    """[n, c] rows divided by their length + 1e-8; a zero row stays zero and has a zero gradient."""
    return rows / (torch.linalg.vector_norm(rows, dim=1, keepdim=True) + NORM_FLOOR)


@torch.no_grad()
def nearest(
    content: Tensor,  # [n, c]
    style: Tensor,  # [m, c] unit rows
    memory_mb: float = 64.0,
    half: bool = False,
) -> tuple[Tensor, Tensor]:
    """Index [n] of the style row of greatest cosine, and that cosine [n].

    Products are float32 (float64 for float64 rows); half: on CUDA the choice is made from features and products in
    float16, and the cosine returned is the rounded one. Rows of unit length need none of bfloat16's range, and its
    cosines would lie 0.004 apart, eight times as far. Of equals the first row wins. Never holds more than `memory_mb`
    of similarities. No gradient.
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
            better = value > best[part]
            best[part] = torch.where(better, value, best[part])
            index[part] = torch.where(better, place + first, index[part])
    return index, best.to(content.dtype)


@dataclass(frozen=True)
class StyleRows:
    """The painting's features at one block of the trunk: fixed, of unit length, computed once.

    rows: [m, c]. basis: None, or [c, r] orthonormal directions in which candidates are sought (see `with_basis`);
    short: rows @ basis, [m, r].
    """

    rows: Tensor
    basis: Tensor | None = None
    short: Tensor | None = None

    def match(self, content: Tensor, memory_mb: float = 64.0, half: bool = False) -> Tensor:  # [n] index
        """j(i) for content rows [n, c]: exact without a basis, else the best within the basis' directions."""
        if self.basis is None:
            return nearest(content, self.rows, memory_mb, half)[0]
        # The argument of the maximum does not depend on the query's length, so the short query needs no rescaling.
        return nearest(content.detach() @ self.basis, self.short, memory_mb, half)[0]

    def with_basis(self, rank: int) -> "StyleRows":
        """The same rows, matched through the `rank` leading directions of their second moment: c/rank times less work.

        <f, s> loses only the part of s outside these directions. `matching_error` tells what that costs.
        """
        if not 1 <= rank <= self.rows.shape[1]:
            raise InvalidValue(f"expected a rank from 1 to {self.rows.shape[1]}, found {rank}")
        moment = self.rows.double().T @ self.rows.double()
        basis = torch.linalg.eigh(moment).eigenvectors[:, -rank:].flip(1).to(self.rows.dtype).contiguous()
        return replace(self, basis=basis, short=(self.rows @ basis).contiguous())


def style_rows(features: Tensor, most: int | None = 4096, method: str = "sample", seed: int = 0) -> StyleRows:
    """Unit rows of a painting's features [c, h, w], at most `most` of them (None: all).

    method "sample" keeps a seeded random subset; "cluster" runs k-means on the sphere and keeps the member nearest to
    each center (a real feature: centers are blends that no stroke has).
    """
    rows = unit_rows(rows_of(features.detach()))
    if most is not None and rows.shape[0] > most:
        if method not in ("sample", "cluster"):
            raise InvalidValue(f"expected `sample` or `cluster`, found {method!r}")
        rows = sample(rows, most, seed) if method == "sample" else cluster(rows, most, seed)
    return StyleRows(rows.contiguous())


def rows_of(features: Tensor) -> Tensor:
    """[c, h, w] -> [h*w, c], row by row of the image."""
    return features.flatten(1).T


def sample(rows: Tensor, count: int, seed: int) -> Tensor:
    """`count` distinct rows of [m, c] drawn without replacement, in their order; drawn on the CPU on every device."""
    chosen = torch.randperm(rows.shape[0], generator=torch.Generator().manual_seed(seed))[:count].sort().values
    return rows[chosen.to(rows.device)]


def cluster(rows: Tensor, count: int, seed: int, rounds: int = 4) -> Tensor:
    """`count` members of the unit rows [m, c], each the nearest to a center of spherical k-means (`rounds` rounds).

    An emptied cluster takes the row worst served so far. Fewer than `count` rows come back only when members coincide.
    Runs on the CPU, where sums have one order; it is done once.
    """
    device, rows = rows.device, rows.cpu()
    centers = sample(rows, count, seed)
    for _ in range(rounds):
        owner, similarity = nearest(rows, centers)
        sums = torch.zeros_like(centers).index_add_(0, owner, rows)
        empty = torch.bincount(owner, minlength=count) == 0
        centers = unit_rows(sums)
        if empty.any():
            centers[empty] = rows[similarity.argsort()[: int(empty.sum())]]
    members = nearest(centers, rows)[0]
    return rows[members.unique()].to(device)


def matching_error(content: Tensor, full: StyleRows, reduced: StyleRows) -> dict[str, float]:
    """What matching content rows [n, c] against `reduced` instead of `full` costs.

    "distance": mean of 1 - cos against the full set; "excess": mean cosine lost by the reduced match (>= 0 up to
    rounding); "worst": the greatest single loss.
    """
    queries = unit_rows(content.detach())
    exact = (queries * full.rows[nearest(content, full.rows)[0]]).sum(dim=1)
    found = (queries * reduced.rows[reduced.match(content)]).sum(dim=1)
    lost = exact - found
    return {
        "distance": float(1 - exact.mean()),
        "excess": float(lost.mean()),
        "worst": float(lost.max()),
    }
