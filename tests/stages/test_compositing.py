"""Plates of imported scenes: the lens that import removed is kept, and its ST maps lead to the pictures it made."""

from dataclasses import replace

import numpy as np
import OpenImageIO as oiio
import pytest
from scipy.ndimage import map_coordinates

from schemas.errors import BadInput
from schemas.images import write_png
from stages.artifacts.scene import SceneData, load_scene
from stages.compositing import deep_samples, exr_view, map_files, plate_camera, write_st_maps
from stages.configs.render import RenderConfig
from stages.render import shots_of
from stylerf.fields.radiance_field import ColorMap
from stylerf.geometry.lens_camera import LensCamera
from stylerf.rendering.deep import DeepCollector
from stylerf.rendering.view import render_view
from tests.stages.importing import imported
from tests.stylerf.rendering.test_deep import CAMERA
from tests.stylerf.small import SPACES, field_of, vm_color
from tests.stylerf_cli import capture

LENS = {"k1": -0.2, "k2": 0.05, "p1": 0.003, "p2": -0.002}
SIZE = (capture.WIDTH, capture.HEIGHT)


@pytest.fixture
def scene(posed, tmp_path) -> SceneData:
    """Imported at half size from smooth photos with distortion."""
    rows, columns = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    waves = np.stack([np.sin(columns / 5), np.cos(rows / 4), np.sin((rows + columns) / 6)], -1)
    for path in (posed / "images").iterdir():
        write_png(path, (127 + 100 * waves).astype(np.uint8))
    capture.write_transforms(posed, capture.transforms() | LENS)
    return load_scene(imported(posed, tmp_path / "work", downscale=2, test_every=2))


def planes(path) -> dict[str, np.ndarray]:
    image = oiio.ImageBuf(str(path))
    pixels = image.get_pixels(oiio.FLOAT)
    return {name: pixels[..., index] for index, name in enumerate(image.spec().channelnames)}


def test_the_scene_keeps_the_size_and_lens_of_its_photos(scene):
    assert (scene.cameras[0].width, scene.cameras[0].height) == (SIZE[0] // 2, SIZE[1] // 2)
    plate = plate_camera(scene, 0)
    assert (plate.width, plate.height, plate.fx) == (*SIZE, capture.FOCAL)
    assert plate.distortion.radial[:2] == (LENS["k1"], LENS["k2"])
    assert plate.distortion.tangential == (LENS["p1"], LENS["p2"])
    assert np.array_equal(plate.world_from_camera, scene.cameras[0].world_from_camera)


def test_the_undistort_map_turns_the_photo_into_the_scene_s_picture(scene, posed, tmp_path):
    """Applied by scipy to the user's photo, then halved."""
    files = map_files(scene, range(len(scene.views)))
    assert len(set(files.values())) == 1 and list(files) == [0, 1, 2, 3]  # one lens
    write_st_maps(tmp_path, scene, files)
    assert len(list((tmp_path / "st_maps").iterdir())) == 2
    stored = planes(tmp_path / files[0].undistort)
    spec = oiio.ImageInput.open(str(tmp_path / files[0].undistort)).spec()
    assert spec.getattribute("colorInteropID") == "data" and str(spec.format) == "float"
    photo = oiio.ImageBuf(str(posed / scene.views[0].source)).get_pixels(oiio.FLOAT)
    assert photo.shape[:2] == stored["R"].shape == SIZE[::-1]
    x, y = stored["R"] * SIZE[0] - 0.5, (1 - stored["G"]) * SIZE[1] - 0.5
    straight = np.stack([map_coordinates(photo[..., a], [y, x], order=3, mode="nearest") for a in range(3)], -1)
    halved = straight.reshape(SIZE[1] // 2, 2, SIZE[0] // 2, 2, 3).mean((1, 3))
    np.testing.assert_allclose(scene.images(0)[..., :3], halved, atol=0.01)
    assert np.abs(photo - straight).max() > 0.1


def test_plates_are_rendered_of_the_scene_s_views_at_the_photos_size(scene):
    shots = shots_of(scene, RenderConfig(path="views", plate=True))
    assert len(shots) == 4 and all(isinstance(camera, LensCamera) and view is None for camera, view in shots)
    half = shots_of(scene, RenderConfig(path="test", plate=True, scale=0.5))
    assert {(camera.width, camera.height) for camera, _ in half} == {(SIZE[0] // 2, SIZE[1] // 2)}


def test_a_scene_without_lenses_is_told_to_be_imported_again(scene):
    views = tuple(replace(view, lens=None) for view in scene.views)
    older = replace(scene, scene=replace(scene.scene, views=views))
    with pytest.raises(BadInput, match="run `stylerf import` again"):
        plate_camera(older, 0)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"plate": True}, "--plate needs"),
        ({"st_map": True, "path": "spiral"}, "--st-map needs"),
        ({"cryptomatte": True, "exr": False}, "cryptomatte"),
        ({"cryptomatte": True, "regions": False}, "cryptomatte"),
        ({"colorspace": "acescg", "exr": False}, "colorspace"),
        ({"colorspace": "srgb"}, "colorspace"),
        ({"deep_samples": 4}, "without --deep"),
        ({"deep": True, "deep_samples": 0}, "deep-samples"),
    ],
)
def test_options_that_would_do_nothing_are_refused(options, word):
    with pytest.raises(ValueError, match=word):
        RenderConfig(**options)


@pytest.mark.parametrize("colorspace", ["lin_rec709", "acescg"])
@pytest.mark.parametrize("mapped", [False, True])
def test_deep_samples_add_up_to_the_flat_frame(scene, colorspace, mapped):
    """In linear light, also where a color map changes the field's colors."""
    import torch

    field = field_of(SPACES["contraction"], 1, vm_color(2))
    if mapped:
        matrix = torch.tensor([[0.9, 0.2, 0.0], [0.1, 0.7, 0.1], [0.0, 0.1, 1.1]])
        field.color_map = ColorMap(matrix, torch.tensor([0.05, -0.02, 0.0]))
    deep = DeepCollector(field, CAMERA, 6, 2)
    seen = render_view(field, CAMERA, threads=2, on_rendered=deep.add)
    flat = exr_view(seen, CAMERA, scene.bounds, {}, RenderConfig(colorspace=colorspace))
    found = deep_samples(deep.view(), flat)
    pixel = np.repeat(np.arange(found.counts.size), found.counts.ravel())
    for axis in range(3):
        total = np.bincount(pixel, found.rgb[:, axis], found.counts.size)
        np.testing.assert_allclose(total, flat.rgb[..., axis].ravel(), atol=1e-5)
    assert (found.rgb >= -1e-6).all()
