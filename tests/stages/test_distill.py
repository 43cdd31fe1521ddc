"""What distill paints into a photo, and which pixels of it a fine-tuning is reported to learn from."""

from dataclasses import replace

import numpy as np
import pytest

from schemas.tensors import save_tensors
from schemas.work_folder import Artifact, WorkFolder
from stages import distill, finetune
from stages.artifacts.scene import EDIT_TARGETS, load_scene
from stages.configs.edit import DistillConfig
from stylerf.editing.extraction import EditView
from stylerf.fields.palette_edits import PaletteEdits
from tests.resealing import reseal
from tests.stages.stress_fixture import SIZE, make_capture

GREEN = np.float32([0.1, 0.9, 0.2])


class Green:
    """A palette module of one color."""

    def colors(self, x, directions, changes, fading, threads):
        return np.tile(GREEN, (len(x), 1))


def view_of(pixels, weight: float, inside: float) -> EditView:
    n = len(pixels)
    blank, ones = np.zeros((n, 3), np.float32), np.ones(n, np.float32)
    return EditView(1, SIZE, SIZE, np.array(pixels), blank, blank, blank, blank, weight * ones, inside * ones, ones,
                    2 * ones, 0 * ones, blank[:, :2])  # fmt: skip


@pytest.mark.parametrize(("channels", "weight", "share"), [(3, 1.0, 0.6), (4, 1.0, 0.6), (3, 0.8, 0.6), (4, 0.8, 0.75)])
def test_a_pixel_is_painted_as_far_as_the_region_covers_it(channels, weight, share):
    """With alpha in the photo, as far as it covers what is opaque there."""
    photo = np.random.default_rng(0).random((SIZE, SIZE, channels)).astype(np.float32)

    class Scene:
        def images(self, index):
            return photo

    view = view_of([5, 60], weight, 0.6)
    found, chosen = distill.edited_photo(Scene(), view, Green(), PaletteEdits(), DistillConfig(), 1)
    assert chosen.tolist() == [0, 1]
    wanted = photo.reshape(-1, channels).copy()
    wanted[[5, 60], :3] = share * GREEN + (1 - share) * wanted[[5, 60], :3]
    assert np.abs(found.reshape(-1, channels) / 255 - wanted).max() < 0.51 / 255


def test_rays_that_end_in_the_background_are_held_to_no_depth():
    view = replace(view_of([5, 60, 70], 1.0, 0.6), depth=np.float32([2, 0, 3]), through=np.float32([1.5, 1e-4, 3]))
    assert distill.held_depth(view).tolist() == [1.5, 0, 3]


def test_pixels_of_an_earlier_edit_train_the_whole_field_only(tmp_path):
    """Two edits beside each other, of which the second covers one pixel of the first."""
    scene = make_capture(WorkFolder(tmp_path))
    first = {"1.pixels": np.array([5, 6]), "1.depth": np.float32([1, 2]), "2.pixels": np.array([7]),
             "2.depth": np.float32([3])}  # fmt: skip
    save_tensors(scene.path / EDIT_TARGETS, first)
    reseal(scene.path)
    scene = Artifact(scene.path)
    second = {"1.pixels": np.array([6, 300]), "1.depth": np.float32([4, 5])}
    distill.keep_earlier_edits(load_scene(scene), second)
    save_tensors(scene.path / EDIT_TARGETS, second)
    reseal(scene.path)
    scene = Artifact(scene.path)
    own, all_of_them = (finetune.edited_pixels(load_scene(scene), [1, 2], earlier) for earlier in (False, True))
    assert (own.views.tolist(), own.pixels.tolist(), own.depth.tolist()) == ([0, 0], [6, 300], [4, 5])
    assert all_of_them.views.tolist() == [0, 0, 0, 1] and all_of_them.pixels.tolist() == [6, 300, 5, 7]
    assert all_of_them.depth.tolist() == [4, 5, 1, 3]
    third = {"2.pixels": np.array([300]), "2.depth": np.float32([6])}
    distill.keep_earlier_edits(load_scene(scene), third)
    assert third["1.earlier_pixels"].tolist() == [6, 300, 5] and third["2.earlier_depth"].tolist() == [3]
