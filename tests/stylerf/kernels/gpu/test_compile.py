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
        "march.march_kernel", "vm.density_kernel", "vm.density_backward_kernel", "vm.color_kernel",
        "vm.color_backward_kernel", "vm.smoothness_kernel", "hash.color_kernel", "hash.color_backward_kernel",
        "composite.composite_kernel", "composite.composite_backward_kernel", "composite.loss_kernel",
        "composite.surface_distance_kernel",
        "density.density_kernel", "hash_density.density_backward_kernel", "hash_density.smoothness_kernel",
        "voxel.density_backward_kernel", "voxel.smoothness_kernel", "heads.linear_kernel",
        "heads.linear_backward_kernel", "heads.harmonic_kernel", "heads.harmonic_backward_kernel",
        "mlp_head.mlp_kernel", "mlp_head.mlp_backward_kernel",
        "composite.shade_backward_kernel", "adam.adam_kernel", "pixels.draw_kernel", "pixels.rays_kernel",
        "deform.density_position_kernel", "deform.vm_color_position_kernel", "deform.hash_color_position_kernel",
        "deform.displacement_backward_kernel", "deform.displaced_cells_kernel",
        "patch.color_kernel", "patch.color_backward_kernel", "regions.keep_kernel", "regions.ends_kernel",
        "composite.tuning_loss_kernel", "hash.rows_kernel", "hash.rows_backward_kernel",
    }  # fmt: skip
    assert all(row["shared"] <= SHARED for row in found), max(found, key=lambda row: row["shared"])
