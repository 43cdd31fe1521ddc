"""What the kernels compute, in plain torch: any dtype, gradients by autograd. Slow; the kernels are tested against it.

Samples are packed, ray after ray: `rays` [n] holds each sample's ray, in order. Shapes and formulas are those of the
kernels' own docstrings; nothing here is shared with them but the unit of density and the layout of the value arrays.
"""

import math

import torch
from torch import Tensor

from stylerf.geometry.space_warp import SpaceWarp
from stylerf.kernels.cpu import march

OPTICAL_SCALE = float(march.OPTICAL_SCALE)
EXPONENT_MIN, EXPONENT_MAX = -15.0, 12.0


# -- space ----------------------------------------------------------------------------------------------------------


def warp_open(space: SpaceWarp, points: Tensor) -> Tensor:
    """World points [n, 3] to the cube, not clamped to it."""
    p = torch.tensor(space.parameters, dtype=points.dtype)
    if space.kind == "frustum":
        z = points[:, 2].clamp(min=float(p[2]) / 2)
        x, y = (0.5 + 0.5 * points[:, a] / (z * p[a]) for a in (0, 1))
        return torch.stack([x, y, 1 - p[2] / z], 1)
    local = (points - p[:3]) * p[3:6]
    if space.kind == "box":
        return local
    largest = local.abs().amax(1, keepdim=True).clamp(min=1)
    return 0.5 + 0.25 * local * (2 - 1 / largest) / largest


def warp(space: SpaceWarp, points: Tensor) -> Tensor:
    """World points [n, 3] to the unit cube."""
    return warp_open(space, points).clamp(0, 1)


def speed(space: SpaceWarp, points: Tensor, directions: Tensor) -> Tensor:
    """Largest coordinate's velocity in the cube, [n], of points moving with unit speed along `directions`."""
    velocity = torch.func.jvp(lambda x: warp_open(space, x), (points,), (directions,))[1]
    return velocity.abs().amax(1)


def density_jacobian(space: SpaceWarp, points: Tensor) -> Tensor:
    """Cube units per scene unit, [n]: turns distance along the ray into delta."""
    p = torch.tensor(space.parameters, dtype=points.dtype)
    if space.kind == "frustum":
        return p[2] / points[:, 2].clamp(min=float(p[2]) / 2) ** 2
    if space.kind == "box":
        return p[6].expand(len(points))
    largest = ((points - p[:3]) * p[3:6]).abs().amax(1).clamp(min=1)
    return 0.25 * p[6] / largest**2


# -- interpolation --------------------------------------------------------------------------------------------------


def _cell(x: Tensor, vertices: int) -> tuple[Tensor, Tensor]:
    """Lower vertex and position in the cell of x in 0..1 on `vertices` vertices."""
    place = x * (vertices - 1)
    low = place.detach().long().clamp(0, vertices - 2)
    return low, place - low


def trilinear(grid: Tensor, x: Tensor) -> Tensor:
    """grid [a, b, c, f] on vertices of the unit cube, at x [n, 3] -> [n, f]."""
    (i, fx), (j, fy), (k, fz) = (_cell(x[:, a], grid.shape[a]) for a in range(3))
    total = torch.zeros(len(x), grid.shape[3], dtype=grid.dtype)
    for di in (0, 1):
        for dj in (0, 1):
            for dk in (0, 1):
                weight = (fx if di else 1 - fx) * (fy if dj else 1 - fy) * (fz if dk else 1 - fz)
                total = total + weight[:, None] * grid[i + di, j + dj, k + dk]
    return total


def displaced(grid: Tensor, x: Tensor) -> Tensor:
    """x + trilinear(grid, x), clamped to the cube; grid [m, m, m, 3]."""
    return (x + trilinear(grid, x)).clamp(0, 1)


# -- fields ---------------------------------------------------------------------------------------------------------


def vm_features(table: Tensor, size: list[int], rank: int, x: Tensor) -> Tensor:
    """[n, 3 rank]: bilinear plane times linear line, plane by plane (TensoRF, Chen et al. 2022, eq. 7)."""
    planes, lines, at = [], [], 0
    for m in range(3):
        a, b = (m + 1) % 3, (m + 2) % 3
        planes.append(table[at : at + size[a] * size[b] * rank].reshape(size[a], size[b], rank))
        at += size[a] * size[b] * rank
    for m in range(3):
        lines.append(table[at : at + size[m] * rank].reshape(size[m], rank))
        at += size[m] * rank
    features = []
    for m in range(3):
        (i, u), (j, v), (k, w) = (_cell(x[:, c % 3], size[c % 3]) for c in (m + 1, m + 2, m))
        u, v, w, plane, line = u[:, None], v[:, None], w[:, None], planes[m], lines[m]
        left = (1 - v) * plane[i, j] + v * plane[i, j + 1]
        right = (1 - v) * plane[i + 1, j] + v * plane[i + 1, j + 1]
        features.append(((1 - u) * left + u * right) * ((1 - w) * line[k] + w * line[k + 1]))
    return torch.cat(features, 1)


def raw_density(exponent: Tensor) -> Tensor:
    """Raw density of its logarithm. The exponent's clamp lets gradients pass, as the kernels' does."""
    return torch.exp(exponent + (exponent.clamp(EXPONENT_MIN, EXPONENT_MAX) - exponent).detach())


def vm_density(values: Tensor, size: list[int], rank: int, x: Tensor) -> Tensor:
    """Raw density [n]; values: table, shift."""
    return raw_density(values[-1] + vm_features(values[:-1], size, rank, x).sum(1))


def vm_color(values: Tensor, size: list[int], rank: int, basis: Tensor, x: Tensor) -> Tensor:
    """Color [n, 3]; basis [n, bands]: spherical harmonics of each sample's ray; values: table, head, bias."""
    bands = basis.shape[1]
    head = values[len(values) - 3 - 9 * bands * rank : -3].reshape(3, bands, 3 * rank)
    features = vm_features(values[: len(values) - 3 - head.numel()], size, rank, x)
    return torch.sigmoid(values[-3:] + torch.einsum("nb,jbf,nf->nj", basis, head, features))


def hash_levels(
    values: Tensor, levels: int, base: int, finest: int, table: int, x: Tensor, width: int = 4, active: int = 32
) -> Tensor:
    """Rows [n, levels, width] of a multi-resolution hash grid (Mueller et al. 2022, eqs. 2 to 4).

    Levels from `active` on hold one row, which is the same everywhere.
    """
    rows_of_levels, at = [], 0
    for level in range(levels):
        total = torch.zeros(len(x), width, dtype=values.dtype)
        if level >= active:
            rows_of_levels.append(total + values[at : at + width])
            at += width
            continue
        cells = round(base * math.exp(math.log(finest / base) / max(levels - 1, 1) * level))
        entries = min((cells + 1) ** 3, table)
        rows = values[at : at + width * entries].reshape(entries, width)
        at += width * entries
        (i, fx), (j, fy), (k, fz) = (_cell(x[:, a], cells + 1) for a in range(3))
        for corner in range(8):
            di, dj, dk = corner // 4, corner // 2 % 2, corner % 2
            if entries == (cells + 1) ** 3:
                index = ((i + di) * (cells + 1) + j + dj) * (cells + 1) + k + dk
            else:
                index = ((i + di) * 805459861 ^ (j + dj) * 2654435761 ^ (k + dk)) % entries
            weight = (fx if di else 1 - fx) * (fy if dj else 1 - fy) * (fz if dk else 1 - fz)
            total = total + weight[:, None] * rows[index]
        rows_of_levels.append(total)
    return torch.stack(rows_of_levels, 1)


def hash_color(values: Tensor, levels: int, base: int, finest: int, table: int, x: Tensor) -> Tensor:
    """Color [n, 3] of a hash grid whose levels are added up."""
    total = hash_levels(values, levels, base, finest, table, x).sum(1)
    return torch.sigmoid(total[:, :3] + total[:, 3:])


def linear_head(numbers: Tensor, phi: Tensor, basis: Tensor) -> Tensor:
    """Color [n, 3] of features phi [n, f] and spherical harmonics basis [n, bands]; numbers: head, bias."""
    head = numbers[:-3].reshape(3, basis.shape[1], phi.shape[1])
    return torch.sigmoid(numbers[-3:] + torch.einsum("nb,jbf,nf->nj", basis, head, phi))


def harmonic_head(numbers: Tensor, phi: Tensor, basis: Tensor) -> Tensor:
    """Color [n, 3] of coefficients phi [n, 3 bands]; numbers: none."""
    return torch.sigmoid(torch.einsum("nb,njb->nj", basis, phi.reshape(len(phi), 3, -1)))


def mlp_head(numbers: Tensor, phi: Tensor, basis: Tensor) -> Tensor:
    """Color [n, 3]; numbers: W1 [f + bands, h], b1 [h], W2 [3, h], b2 [3]."""
    inputs = torch.cat([phi, basis], 1)
    h = (len(numbers) - 3) // (inputs.shape[1] + 4)
    first, bias, second = numbers[:-3].split([inputs.shape[1] * h, h, 3 * h])
    return torch.sigmoid(torch.relu(inputs @ first.reshape(-1, h) + bias) @ second.reshape(3, h).T + numbers[-3:])


def voxel_rows(table: Tensor, kept: Tensor, size: list[int], width: int, x: Tensor) -> Tensor:
    """[n, width]: a sparse grid's rows, interpolated; kept [blocks of 4^3] bool.

    The first block of `table` stands for all that are not allocated.
    """
    blocks = table.reshape(-1, 4, 4, 4, width)
    numbers = torch.where(kept, torch.cumsum(kept.flatten().long(), 0).reshape(kept.shape), 0)
    a, b, c = kept.shape
    dense = blocks[numbers.flatten()].reshape(a, b, c, 4, 4, 4, width).permute(0, 3, 1, 4, 2, 5, 6)
    return trilinear(dense.reshape(4 * a, 4 * b, 4 * c, width)[: size[0], : size[1], : size[2]], x)


# -- volume rendering -----------------------------------------------------------------------------------------------


def weights(sigma: Tensor, deltas: Tensor, rays: Tensor, background: Tensor) -> tuple[Tensor, Tensor]:
    """Weights T_k (1 - exp(-sigma_k delta_k)) [n], T_k = exp(-sum of the ray's sigma delta before k), and T_k [n].

    background [n] bool: samples that take all the light that is left.
    """
    depth = sigma * deltas
    before = torch.cumsum(depth, 0) - depth
    first = torch.ones_like(rays, dtype=torch.bool)
    first[1:] = rays[1:] != rays[:-1]
    start = before[first][torch.cumsum(first, 0) - 1]
    transmittance = torch.exp(-(before - start))
    return transmittance * torch.where(background, torch.ones_like(depth), -torch.expm1(-depth)), transmittance


def composite(w: Tensor, colors: Tensor, colored: Tensor, t: Tensor, rays: Tensor, count: int) -> Tensor:
    """[count, 5]: sum w c, sum w, sum w t. Samples that are not `colored` [n] take the others' mean, as a constant."""
    kept = torch.where(colored, w, torch.zeros_like(w))

    def per_ray(values: Tensor) -> Tensor:
        return torch.zeros(count, *values.shape[1:], dtype=w.dtype).index_add(0, rays, values)

    own, colored_weight = per_ray(kept[:, None] * torch.where(colored[:, None], colors, 0)), per_ray(kept)
    mean = torch.where(colored_weight[:, None] > 0, own / colored_weight[:, None].clamp(min=1e-30), 0).detach()
    rgb = own + mean * per_ray(w - kept)[:, None]
    return torch.cat([rgb, per_ray(w)[:, None], per_ray(w * t)[:, None]], 1)
