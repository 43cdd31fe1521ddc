"""Exposure of photos: found again where they were taken with several, left alone where they were not."""

import numpy as np
import pytest

from stylerf.geometry.space_warp import SpaceWarp
from stylerf.srgb import decoded, exposed
from stylerf.training.common.ray_dataset import RayDataset
from stylerf.training.fit.exposure import FEWEST_PHOTOS, PLAINLY, Exposures, balanced
from stylerf.training.fit.fitter import Fitter
from stylerf.training.fit.settings import LEVELS, Trial
from tests.stylerf.training.running import resumed, run_until
from tests.stylerf.training.scenes import box_fitter, box_photo, dome, settings, wall_bank

STOPS = np.linspace(-0.6, 0.6, 8)[[3, 0, 6, 1, 7, 2, 5, 4]]
MORE_STOPS = np.random.default_rng(3).permutation(np.linspace(-0.6, 0.6, 14))


def uneven_bank(stops=STOPS, size: int = 24) -> RayDataset:
    """The box, dark enough for no photo to be clipped, each photo with an exposure of its own."""
    photos = [exposed(box_photo(c) / 255, -1.2) for c in dome(len(stops), 1, size)]
    bytes_ = [np.rint(255 * exposed(photo, one)).astype(np.uint8) for photo, one in zip(photos, stops)]
    return RayDataset(dome(len(stops), 1, size), bytes_)


def test_differences_are_balanced_whatever_a_few_of_them_say():
    truth, generator = np.array([0.5, -0.3, 0.1, -0.3, 0.0]), np.random.default_rng(0)
    first, second = generator.integers(0, 4, (2, 400))
    beyond = truth[first] - truth[second] + generator.normal(0, 0.05, 400)
    beyond[:80] += 3  # seen past an edge, say
    first, second, beyond = (a[first != second] for a in (first, second, beyond))
    found = balanced(5, first, second, beyond, np.zeros(5))
    np.testing.assert_allclose(found[:4] - found[0], truth[:4] - truth[0], atol=0.05)
    assert abs(found.mean()) < 1e-12
    # The fifth photo is in no pair: it stays in the middle of the others.
    assert abs(found[4] - found[:4].mean()) < 0.02
    again = balanced(5, first, second, beyond - (found[first] - found[second]), found)
    np.testing.assert_allclose(again, found, atol=0.02)


def test_true_surfaces_tell_the_exposures():
    bank = uneven_bank()

    def rendered(origins, directions):
        sides = np.stack([(side * 0.6 - origins) / directions for side in (-1.0, 1.0)])
        near, far = sides.min(0).max(1), sides.max(0).min(1)
        hit = (near < far) & (far > 0)
        return np.stack([*np.zeros((3, len(hit))), hit, np.where(hit, near, 0)], 1)

    found, left = Exposures(bank, 0).judged(rendered, np.zeros(len(STOPS)))
    np.testing.assert_allclose(found, STOPS - STOPS.mean(), atol=0.06)
    assert left < 0.2
    # Nothing solid anywhere: nothing is reported.
    nothing, left = Exposures(bank, 0).judged(lambda origins, _: np.zeros((len(origins), 5)), found)
    np.testing.assert_allclose(nothing, found, atol=1e-12)
    assert left == 1


def test_a_bank_takes_photos_for_what_they_would_have_shown():
    bank = uneven_bank()
    views, pixels = np.repeat(np.arange(8), 576), np.tile(np.arange(576), 8)
    raw = bank.at(views, pixels)[2]
    bank.expose(STOPS)
    now = bank.at(views, pixels)[2]
    light, before = (decoded(a[:, :3].astype(np.float64)) for a in (now, raw))
    np.testing.assert_allclose(light, np.minimum(before * 2.0 ** -STOPS[views][:, None], 1), atol=1e-6)
    assert np.array_equal(now[:, 3], raw[:, 3])
    bank.expose(np.zeros(8))
    assert np.array_equal(bank.at(views, pixels)[2], raw)


def uneven_wall() -> tuple[SpaceWarp, RayDataset]:
    """A wall at z = 3 whose colors wave, photos of several exposures."""
    space, bank = wall_bank(len(MORE_STOPS))
    photos = []
    for camera, stops in zip(bank.cameras, MORE_STOPS, strict=True):
        origins, directions = camera.rays()
        points = origins + directions * (3 - origins[:, 2:]) / directions[:, 2:]
        rgb = 0.4 + 0.15 * np.sin(points @ np.array([[3.0, 1, 0], [1, 4, 2], [0, 0, 0]]) + [0, 1, 2])
        photos.append(np.rint(255 * exposed(rgb, stops)).astype(np.uint8).reshape(camera.height, camera.width, 3))
    return space, RayDataset(bank.cameras, photos)


def test_a_fit_brings_photos_to_one_exposure_and_gains_by_it():
    reached = {}
    for exposure in ("off", "auto"):
        said: list[str] = []
        requested = settings(60, exposure=exposure, background="none")
        fitter = Fitter(*uneven_wall(), 2, requested, 0, 1, said.append)
        fitter.run()
        reached[exposure] = fitter.held_out_psnr()
    assert reached["auto"] > reached["off"] + 0.8
    found = np.array(fitter.state.stops)
    assert np.corrcoef(found, MORE_STOPS)[0, 1] > 0.98 and np.abs(found - MORE_STOPS).max() < 0.2
    assert fitter.state.rollbacks == 0
    assert any("photos differ in exposure by 0." in text for text in said)
    assert "corrected to one" in fitter.state.decisions[0]


@pytest.mark.parametrize("exposure", ["off", "auto"])
def test_photos_of_one_exposure_are_taken_as_they_are(exposure):
    photos = uneven_bank(np.zeros(FEWEST_PHOTOS))
    fitter = box_fitter(40, bank=photos, exposure=exposure)
    if fitter.exposures is not None:
        fitter.exposures.judged = lambda rendered, stops: (np.linspace(-1, 1, len(stops)) * PLAINLY, 0.1)
    fitter.run()
    assert fitter.state.stops == (None if exposure == "off" else [])
    plain = box_fitter(40, bank=photos)
    plain.run()
    assert np.array_equal(fitter.field.color.values, plain.field.color.values)


@pytest.mark.parametrize(("clear_at", "corrected"), [(0.0, True), (0.25, True), (0.35, False)])
def test_differences_that_no_exposures_explain_are_judged_again_until_depth_must_be_good_enough(clear_at, corrected):
    photos = uneven_bank(np.zeros(FEWEST_PHOTOS))
    fitter, looks = box_fitter(40, bank=photos, exposure="auto"), []

    def judged(rendered, stops):
        looks.append(fitter.progress)
        return np.linspace(-1, 1, len(stops)), 0.8 if fitter.progress < clear_at else 0.6

    fitter.exposures.judged = judged
    fitter.run()
    assert bool(fitter.state.stops) == corrected
    assert any("corrected to one" in decision for decision in fitter.state.decisions) == corrected
    if not corrected:
        assert len(looks) > 2 and looks[-2] < 0.3 <= looks[-1] < 0.35
        plain = box_fitter(40, bank=photos)
        plain.run()
        assert np.array_equal(fitter.field.color.values, plain.field.color.values)


def test_few_photos_are_judged_only_on_request():
    for exposure, judged in (("auto", False), ("on", True)):
        fitter = box_fitter(20, bank=uneven_bank(), exposure=exposure)
        fitter.run()
        assert bool(fitter.state.stops) == judged


def test_a_new_look_is_neither_a_fall_nor_a_gain():
    """Looks that contradict one another, as where depth is no good: what was best is measured on the new photos."""
    fitter, looks = box_fitter(60, bank=uneven_bank(), exposure="on"), iter(range(100))
    fitter.exposures.judged = lambda rendered, stops: (
        (-1.0) ** next(looks) * np.linspace(-1.5, 1.5, len(stops)),
        0.1,
    )
    fitter.run()
    assert next(looks) > 10 and fitter.state.rollbacks == 0


def test_every_figure_that_is_compared_moves_with_the_photos():
    fitter = box_fitter(40, bank=uneven_bank(), exposure="on")
    fitter.run()
    state, before = fitter.state, fitter.held_out_psnr()
    state.best, state.unpruned, state.trial = 30.0, 31.0, Trial(29.0, LEVELS[0], 1000, 0.4)
    fitter.exposures.judged = lambda rendered, stops: (stops + np.linspace(0, 2, len(stops)), 0.1)
    after = fitter.balance(fitter.exposures, before)
    assert after == pytest.approx(fitter.held_out_psnr()) and abs(after - before) > 0.1
    assert np.array([state.best - 30, state.unpruned - 31, state.trial.before - 29]) == pytest.approx(after - before)


def test_a_field_that_has_fallen_judges_no_photo():
    fitter = box_fitter(40, bank=uneven_bank(), exposure="on")
    run_until(fitter, 21)
    stops = list(fitter.state.stops)
    fitter.exposures.judged = lambda rendered, stops: 1 / 0
    for values in (fitter.field.density.values, fitter.field.color.values):
        values[:] = np.nan
    fitter._check()
    assert fitter.state.rollbacks == 1 and fitter.state.stops == stops and np.isfinite(fitter.state.best)


def test_a_resumed_fit_goes_on_with_the_exposures_it_had():
    def made():
        return box_fitter(40, bank=uneven_bank(), exposure="on")

    whole, stopped = made(), made()
    whole.run()
    run_until(stopped, 21)
    assert stopped.state.stops
    again = resumed(made(), stopped)
    assert np.array_equal(again.dataset.codes, stopped.dataset.codes)
    again.run()
    assert np.array_equal(again.field.color.values, whole.field.color.values)
