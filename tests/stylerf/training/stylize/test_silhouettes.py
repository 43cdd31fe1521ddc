"""Objects are compared with the style image without their background."""

import numpy as np
import pytest
import torch

from stylerf.fields.deformation import Deformation
from stylerf.training.stylize.silhouettes import mirror_pixels, object_colors, over
from tests.stylerf.style.small_trunk import picture
from tests.stylerf.training.stylizing import GRAY, HEIGHT, WIDTH, arf


def box(height: int, width: int) -> np.ndarray:
    """An object that fills rows 2 to 5 and columns 3 to 8."""
    alpha = np.zeros((height, width), np.float32)
    alpha[2:6, 3:9] = 1
    return alpha


def test_a_pixel_outside_mirrors_one_as_deep_inside():
    mirror = mirror_pixels(box(9, 14))
    rows, columns = np.divmod(mirror, 14)
    assert (rows[4], columns[4])[0].tolist() == [4] * 14
    assert columns[4].tolist() == [6, 5, 4, 3, 4, 5, 6, 7, 8, 7, 6, 5, 4, 3]
    assert rows[:, 5].tolist() == [4, 3, 2, 3, 4, 5, 4, 3, 2]


def test_where_the_mirror_is_outside_too_the_nearest_inside_is_taken():
    alpha = np.zeros((3, 9), np.float32)
    alpha[1, 4] = 1  # one pixel wide: any mirrored one is outside
    assert (mirror_pixels(alpha) == 1 * 9 + 4).all()
    assert np.array_equal(mirror_pixels(np.zeros((3, 9), np.float32)), np.arange(27).reshape(3, 9))


def test_the_background_never_shows():
    alpha, colors = torch.from_numpy(box(9, 14)), picture(9, 14, 1)
    alpha[2, 3:9] = 0.75
    seen = {}
    for background in (0.0, 1.0):
        image = alpha * colors + (1 - alpha) * background
        found = object_colors(image, alpha, torch.from_numpy(mirror_pixels(alpha.numpy())), background)
        seen[background] = over(image, alpha, background, found)
        inside = alpha > 0
        assert torch.allclose(found[:, inside], colors[:, inside], atol=1e-6)
    assert torch.allclose(seen[0.0], seen[1.0], atol=1e-6)


def test_the_style_loss_of_an_object_does_not_depend_on_the_background():
    losses = []
    for shift in (0.0, 0.2):
        made = arf(match="none")
        made.scene.background = np.float32(GRAY + shift)
        alpha = made.scene.geometry.alpha(1)
        straight = picture(HEIGHT, WIDTH, 4)
        photo = made.scene.photos[1] - (1 - alpha[..., None]) * GRAY  # as if it showed that much of the gray
        made.scene.photos = [photo + (1 - alpha[..., None]) * (GRAY + shift)] * 3
        image = torch.from_numpy(alpha) * straight + (1 - torch.from_numpy(alpha)) * (GRAY + shift)
        losses.append(float(made.method.loss.of_view(1)(image)[0]))
    assert losses[0] == pytest.approx(losses[1], rel=1e-4)


def test_what_grows_beyond_the_silhouette_learns_the_objects_colors():
    made = arf({"deformation": Deformation.create(np.random.default_rng(0))}, match="none")
    loss, photo = made.method.loss, np.full((HEIGHT, WIDTH, 3), 0.2, np.float32)
    at_rest = made.scene.fixed.alpha(0)
    made.scene.photos = [at_rest[..., None] * photo + (1 - at_rest[..., None]) * GRAY] * 3
    made.next_phase()
    made.scene.geometry.alphas[0] = np.ones(HEIGHT * WIDTH, np.float32)  # it has grown over the whole view
    content = loss.moved(0, loss.content(0))
    solid = at_rest.max() >= 0.5
    assert solid and torch.allclose(content.colors, torch.full_like(content.colors, 0.2), atol=1e-3)
    assert content.edges.abs().max() < 1e-3
