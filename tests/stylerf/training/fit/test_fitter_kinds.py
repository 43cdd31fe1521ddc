"""Fits of every kind of field on a colored box: they learn, grow, stop and go on; a wall stays small."""

import numpy as np
import pytest

from stylerf.rendering.view import render_view
from stylerf.training.fit.fitter import Fitter
from stylerf.training.fit.settings import CapacityLevel, Kinds
from tests.stylerf.training.running import assert_same_bits, result_of, resumed, run_until
from tests.stylerf.training.scenes import box_fitter, box_photo, dome

LEVELS = tuple(CapacityLevel(n, cells=8, table_bits=10) for n in (8, 16))
KINDS = {
    "hash": Kinds("hash", "hash"),
    "voxel": Kinds("voxel", "voxel"),
    "voxel+hash-mlp": Kinds("voxel", "hash", "mlp"),
}


@pytest.fixture(params=KINDS)
def kinds(request) -> Kinds:
    return KINDS[request.param]


def fitter_of(kinds: Kinds, steps: int = 300, **more) -> Fitter:
    return box_fitter(steps, kinds=kinds, levels=LEVELS, level_ends=(0.4,), force_growth=True, **more)


def seen_psnr(fitter: Fitter) -> float:
    """Over views that no fit has had, on white."""
    error = []
    for camera in dome(4, 99):
        photo = box_photo(camera).astype(np.float64) / 255
        seen = render_view(fitter.field, camera, threads=1)
        over = seen.rgb + (1 - seen.alpha[..., None])
        error.append((over - photo[..., :3] * photo[..., 3:] - (1 - photo[..., 3:])) ** 2)
    return -10 * np.log10(np.mean(error))


def test_it_learns_and_grows_and_goes_on_as_if_never_stopped(kinds):
    fitter = fitter_of(kinds, smoothness=(1e-4, 1e-4))
    before = seen_psnr(fitter)
    fitter.run()
    assert seen_psnr(fitter) > max(before + 6, 18)
    sizes = [entry["parameters"] for entry in fitter.state.curve]
    assert fitter.state.level == 1 and sizes[-1] > sizes[0]
    stopped = run_until(fitter_of(kinds, smoothness=(1e-4, 1e-4)), 200)
    again = resumed(fitter_of(kinds, smoothness=(1e-4, 1e-4)), stopped)
    again.run()
    assert result_of(again)[0] == result_of(fitter)[0]
    assert_same_bits(result_of(again)[1], result_of(fitter)[1])


def test_growing_holds_the_same_picture(kinds):
    fitter = run_until(fitter_of(kinds), 100)
    step, before = fitter.field.step, fitter.held_out_psnr()
    fitter.resize(LEVELS[1])
    assert fitter.field.step == step / 2
    fitter.field.step = step
    # Sixteen vertices do not hold eight exactly; hash levels do.
    assert fitter.held_out_psnr() == pytest.approx(before, abs=0.01 if kinds.density == "hash" else 0.5)
