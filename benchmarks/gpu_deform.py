"""Additional kernels of a trained deformation, for benchmarks/gpu.py: launches, and the minimum bytes they move."""

import torch

VERTICES = 32  # per side of the displacement grid
REACH = 4  # largest displacement, cells


def launches(kind: str, field, rays, rendered, of_sigma: torch.Tensor, of_colors: torch.Tensor) -> dict:
    """Return {kernel: (its launch, minimum bytes moved)} for a field's rays and the results of composite_backward.

    kind: vm, or stylized: then only its color's kernel, since the others are the same as for vm.
    """
    from stylerf.kernels.gpu import launch

    s, colors, named = rendered.samples, rendered.colors, "vm" if kind == "vm" else "hash sum"
    n, slopes, ways = s.capacity, torch.zeros_like(s.x), rays.directions
    grid = torch.zeros(3 * VERTICES**3, device=field.device)
    space = torch.from_numpy(field.space.packed()).to(field.device)
    calls = {
        f"{named} color slopes": (
            lambda: field.color.add_position_gradients(s, ways, colors, of_colors, slopes),
            n * 60 + field.color.values.nbytes,
        )
    }
    if kind != "vm":
        return calls
    return calls | {
        "vm density slopes": (
            lambda: field.density.add_position_gradients(s, of_sigma, slopes),
            n * 44 + field.density.values.nbytes,
        ),
        "displacement backward": (
            lambda: launch.displacement_backward(field.space.code, space, rays, s, slopes, VERTICES, grid),
            n * 36 + len(ways) * 24 + 2 * grid.nbytes,
        ),
        "displaced cells": (
            lambda: launch.displaced_cells(field.distances, field.cells, REACH, grid, VERTICES),
            2 * field.cells**3 + grid.nbytes,
        ),
    }
