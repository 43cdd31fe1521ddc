"""Every GPU kernel compiles to machine code, whether a GPU is there or not, and fits the GPUs that it is meant for."""

import json
import os
import subprocess
import sys

import pytest

from tests.conftest import REPOSITORY

# Bytes of shared memory a program may have: 99 KB on the smallest of compute capability 8.0 or newer.
SHARED = 99 * 1024


def compiled(folder, *arguments: str) -> list[dict]:
    pytest.importorskip("triton", reason="Triton is not installed")
    environment = os.environ | {"TRITON_INTERPRET": "0", "TRITON_CACHE_DIR": str(folder)}
    command = [sys.executable, "-m", "tests.stylerf.kernels.gpu.compile_all", *arguments]
    ran = subprocess.run(command, env=environment, cwd=REPOSITORY, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr[-3000:]
    return [json.loads(line) for line in ran.stdout.splitlines()]


def test_the_smallest_kernel_compiles_for_a_gpu_that_is_not_here(tmp_path):
    found = compiled(tmp_path, "adam", "90")
    assert [row["kernel"] for row in found] == ["adam.adam_kernel"] and found[0]["cubin"] > 1000


@pytest.mark.slow
@pytest.mark.parametrize("capability", ["80", "90"])
def test_all_kernels_compile_and_fit(tmp_path, capability):
    found = compiled(tmp_path, "", capability)
    kernels = {row["kernel"] for row in found}
    assert kernels == {
        "march.march_kernel", "tables.density_kernel", "tables.density_backward_kernel",
        "vm.smoothness_kernel", "hash_levels.smoothness_kernel", "voxel.smoothness_kernel",
        "color_heads.color_kernel", "color_heads.linear_backward_kernel", "color_heads.harmonic_backward_kernel",
        "color_heads.mlp_backward_kernel",
        "hash_color.color_kernel", "hash_color.color_backward_kernel", "hash_color.rows_kernel",
        "hash_color.rows_backward_kernel", "regions.color_kernel", "regions.color_backward_kernel",
        "regions.keep_kernel", "regions.mark_kernel", "regions.ends_kernel", "compositing.composite_kernel",
        "compositing.composite_backward_kernel", "compositing.distortion_backward_kernel",
        "compositing.surface_distance_kernel", "compositing.loss_kernel",
        "compositing.tuning_loss_kernel", "compositing.shade_backward_kernel", "adam.adam_kernel",
        "pixel_rays.draw_kernel", "pixel_rays.rays_kernel", "deformation.density_position_kernel",
        "deformation.vm_color_position_kernel", "deformation.hash_color_position_kernel",
        "deformation.displacement_backward_kernel", "deformation.displaced_cells_kernel",
    }  # fmt: skip
    assert all(row["shared"] <= SHARED for row in found), max(found, key=lambda row: row["shared"])
