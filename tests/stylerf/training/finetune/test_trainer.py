"""Fine-tuning: the edit is learned, the rest stays, depth acts, and a resumed run ends with the same bits."""

import numpy as np
import pytest

from stylerf.editing.edit_grid import march_view
from stylerf.fields.region_color import RegionColor
from stylerf.fields.vm import split_table
from stylerf.rendering.rays import alpha_inside
from stylerf.rendering.view import render_view
from stylerf.training.common.ray_dataset import RayDataset
from stylerf.training.finetune.trainer import EditedPixels, FineTuner, FineTuneSettings
from tests.stylerf.small import field_of, hash_color, wall_in_front
from tests.stylerf.training.scenes import SIDE, box_fitter, box_photo, dome, masked_wall

RED = np.uint8([230, 20, 30])


@pytest.fixture(scope="module")
def fitted():
    made = box_fitter(220, held_out=0)
    made.run()
    return made.field


def copy_of(field):
    from stylerf.fields.radiance_field import RadianceField

    return RadianceField.restore(field.describe(), {k: v.copy() for k, v in field.arrays().items()})


def heights(camera) -> np.ndarray:
    """z of the point where each pixel's ray enters the box, [24, 24]."""
    origins, directions = (a.astype(np.float64) for a in camera.rays())
    near = np.stack([(s * SIDE - origins) / directions for s in (-1, 1)]).min(0).max(1)
    return (origins + near[:, None] * directions)[:, 2].reshape(24, 24)


@pytest.fixture(scope="module")
def edited():
    """Photos of the box with its upper half, z > 0, in red."""
    cameras = dome(10, 1)
    photos, views, pixels = [], [], []
    for number, camera in enumerate(cameras):
        photo = box_photo(camera)
        chosen = (photo[..., 3] > 128) & (heights(camera) > 0)
        photo[chosen, :3] = RED
        photos.append(photo)
        found = np.flatnonzero(chosen.ravel())
        pixels.append(found)
        views.append(np.full(len(found), number))
    depth = np.full(sum(map(len, pixels)), 1.7, np.float32)
    beside = [np.flatnonzero(heights(camera).ravel() < 0) for camera in cameras]
    around = np.repeat(np.arange(10), [len(own) for own in beside]), np.concatenate(beside)
    return RayDataset(cameras, photos), EditedPixels(np.concatenate(views), np.concatenate(pixels), depth, around)


def tuner(fitted, edited, **more) -> FineTuner:
    settings = FineTuneSettings(**{"steps": 60, "rays": 512, "rate": 2e-2, "background": 1.0, **more})
    return FineTuner(copy_of(fitted), *edited, settings, 0, 1)


def test_what_masks_hide_in_a_closed_space_teaches_nothing():
    space, bank = masked_wall(24)
    nothing = np.empty(0, np.int64)
    edited = EditedPixels(nothing, nothing, np.empty(0, np.float32), (nothing, nothing))
    made = FineTuner(field_of(space, 1, hash_color(2)), bank, edited, FineTuneSettings(steps=3, rays=64), 0, 1)
    before = {name: array.copy() for name, array in made.field.arrays().items()}
    assert made.step()["outside"] == 0
    assert all(np.array_equal(array, before[name]) for name, array in made.field.arrays().items())


def test_light_through_a_surface_of_a_capture_is_no_depth_error():
    bank = masked_wall(0)[1]
    pixels, depth = np.arange(200, 300), np.full(100, 3.1, np.float32)
    edited = EditedPixels(np.zeros(100, np.int64), pixels, depth, (pixels[:0], pixels[:0]))
    made = FineTuner(wall_in_front(0.02), bank, edited, FineTuneSettings(steps=3, rays=64), 0, 1)
    assert made.step()["depth"] < 26 * 0.1**2


def test_pixels_without_a_depth_are_held_to_none():
    bank, pixels = masked_wall(0)[1], np.arange(200, 300)
    edited = EditedPixels(np.zeros(100, np.int64), pixels, np.zeros(100, np.float32), (pixels[:0], pixels[:0]))
    made = FineTuner(wall_in_front(0.02), bank, edited, FineTuneSettings(steps=3, rays=64), 0, 1)
    assert made.step()["depth"] == 0


def errors(field, bank) -> tuple[float, float]:
    """Mean squared error inside the red halves, and well below them, over all views."""
    inside, outside = [], []
    for number, camera in enumerate(bank.cameras):
        seen = render_view(field, camera, threads=1)
        shown = seen.rgb + 1 - seen.alpha[..., None]
        start = bank.starts[number]
        photo = bank.bytes[start : start + 24 * 24 * 4].reshape(24, 24, 4) / 255
        wanted = photo[..., :3] * photo[..., 3:] + 1 - photo[..., 3:]
        squares, red = np.square(shown - wanted), (photo[..., :3] * 255 == RED).all(-1)
        inside.append(squares[red].mean())
        # Sixteen cells a side draw no sharp seam: what lies below it by two of them must stay.
        outside.append(squares[~red & (heights(camera) < -0.2)].mean())
    return float(np.mean(inside)), float(np.mean(outside))


def test_the_edit_is_learned_and_the_rest_stays(fitted, edited):
    before = errors(fitted, edited[0])
    made = tuner(fitted, edited, steps=150)
    made.run()
    after = errors(made.field, edited[0])
    assert after[0] < 0.35 * before[0]
    assert after[1] < 1.3 * before[1]


def patched(fitted):
    """The field with colors of its own for the cube's upper half."""
    field = copy_of(fitted)
    marked = np.zeros((8,) * 3, bool)
    marked[:, :, 4:] = True
    field.color = RegionColor.create(field.color, marked, 16.0, table=256)
    return field


def test_a_patch_learns_the_edit_and_leaves_all_else_to_the_bit(fitted, edited):
    before = errors(fitted, edited[0])
    settings = FineTuneSettings(steps=150, rays=512, rate=3e-2, density_factor=0.0)
    made = FineTuner(patched(fitted), *edited, settings, 0, 1)
    made.run()
    after = errors(made.field, edited[0])
    assert after[0] < 0.2 * before[0]
    for camera in edited[0].cameras[:3]:
        plain, taught = (render_view(field, camera, threads=1) for field in (fitted, made.field))
        parts = march_view(fitted, camera, 1)
        free = np.concatenate([alpha_inside(made.field.color.marked, samples, 1) == 0 for _, samples in parts])
        assert free.sum() > 30
        np.testing.assert_array_equal(taught.rgb.reshape(-1, 3)[free], plain.rgb.reshape(-1, 3)[free])
        np.testing.assert_array_equal(taught.alpha, plain.alpha)
    np.testing.assert_array_equal(made.field.color.base.values, fitted.color.values)


def test_density_beside_a_patch_learns_within_its_cells_only(fitted, edited):
    settings = FineTuneSettings(steps=1, rays=512, rate=2e-2, density_factor=1.0)
    made = FineTuner(patched(fitted), *edited, settings, 0, 1)
    values = made.field.density.values
    made.step()
    changed = np.flatnonzero(values != fitted.density.values)
    assert len(changed)
    # Lines along z (the first table's line) of vertices well under the marked cells keep their values.
    size, rank = made.field.density.size, made.field.density.rank
    table = np.arange(len(values) - 1)
    _, lines = split_table(table, size, rank)
    under = lines[2][: int(0.4 * size[2])]
    assert not np.isin(under.ravel(), changed).any()
    assert np.isin(lines[2].ravel(), changed).any()


def test_frozen_density_keeps_every_value(fitted, edited):
    made = tuner(fitted, edited, density_factor=0.0, steps=5)
    made.run()
    np.testing.assert_array_equal(made.field.density.values, fitted.density.values)
    assert (made.field.color.values != fitted.color.values).any()


def test_the_depth_term_moves_the_density_by_its_own_gradient(fitted, edited):
    """With colors that are right already, only the depth term asks for anything of the density in the edit."""
    pulled, free = (tuner(fitted, edited, depth_weight=w, steps=1) for w in (10.0, 0.0))
    for made in (pulled, free):
        made.step()
    assert (pulled.field.density.values != free.field.density.values).any()
    far = EditedPixels(
        edited[1].views, edited[1].pixels, np.full(len(edited[1].pixels), 2.2, np.float32), edited[1].beside
    )
    made = tuner(fitted, (edited[0], far), depth_weight=3.0, steps=80, density_factor=1.0, inside=0.9)
    begun = made.step()["depth"]
    made.run()
    assert made.state.curve[-1]["depth"] < 0.8 * begun


def test_a_resumed_run_ends_with_the_same_bits(fitted, edited):
    whole = tuner(fitted, edited, steps=24)
    whole.run()
    first = tuner(fitted, edited, steps=24)

    class Stop(Exception):
        pass

    def stop(now):
        if now.state.step == 11:
            raise Stop

    with pytest.raises(Stop):
        first.run(stop)
    data, arrays = first.checkpoint()
    second = tuner(fitted, edited, steps=24)
    second.resume(data, arrays)
    second.run()
    for name, values in whole.field.arrays().items():
        np.testing.assert_array_equal(second.field.arrays()[name], values, err_msg=name)


def test_steps_that_a_device_has_not_reported_of_are_no_part_of_the_curve(fitted, edited):
    one = tuner(fitted, edited, steps=20)
    learn, requested = one.engine.learn, []

    def late(batch) -> dict[str, float]:
        requested.append(batch)
        found = learn(batch)
        return found if len(requested) > 12 else {}

    one.engine.learn = late
    one.run()
    assert [entry["step"] for entry in one.state.curve] == [20] and "inside" in one.state.curve[0]
