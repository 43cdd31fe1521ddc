"""A scene artifact becomes cameras and images, and whatever does not fit together is damage."""

import dataclasses
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from schemas.errors import ArtifactDamaged, BadInput
from schemas.exr import ExrView, write_exr
from schemas.images import read_image, write_png
from schemas.scene import Bounds, Scene, Truth, View, as_matrix, write_scene
from schemas.tensors import save_tensors
from schemas.work_folder import Artifact, Recipe, WorkFolder
from stages import distill, finetune
from stages.artifacts.scene import EDIT_TARGETS, EXPOSURE_STOPS, FOCUS, load_scene, space_of, view_index
from stylerf.geometry.cameras import Camera
from stylerf.srgb import exposed
from tests.resealing import reseal
from tests.stages.evaluation_fixture import commit
from tests.stages.stress_fixture import make_capture

POSE = np.array([[0, 0, 1, 2], [-1, 0, 0, 3], [0, -1, 0, 4], [0, 0, 0, 1]], float)


def build(root, change_view=None, points=None, size=(6, 8), channels=4):
    """A scene of three views whose pixel (0, 0) holds the view's index."""
    begun = WorkFolder(root).begin("scene", "toy", Recipe("pose_import", 1, {}, []))
    views = []
    for index in range(3):
        pixels = np.full((*size, channels), index, np.uint8)
        write_png(begun.path / f"images/{index:03d}.png", pixels)
        split = "test" if index == 0 else "train"
        view = View(f"v{index}", f"images/{index:03d}.png", split, 8, 6, 9, 10, 4, 3, as_matrix(POSE))
        views.append(dataclasses.replace(view, **(change_view or {})))
    depth = np.full((6, 8), 2.5)
    truth = ExrView(np.ones((6, 8, 3)), np.ones((6, 8)), depth, depth, POSE, (9, 10, 4, 3), 1, 5)
    write_exr(begun.path / "truth/depth_001.exr", truth)
    bounds = Bounds(((-1, -1, -1), (1, 1, 1)), 1, 5)
    scene = Scene(tuple(views), "object", "given", bounds, "alpha", as_matrix(np.eye(4)))
    scene = dataclasses.replace(scene, truth=Truth("truth/depth_000.exr"))
    write_scene(begun.path, scene)
    if points is not None:
        save_tensors(begun.path / "points.safetensors", points)
    return begun.commit()


def test_cameras_images_points_and_truth(tmp_path):
    points = {"xyz": np.ones((5, 3), np.float32), "rgb": np.ones((5, 3), np.uint8), "error": np.ones(5, np.float32)}
    data = load_scene(build(tmp_path, points=points))
    assert data.splits == {"train": [1, 2], "test": [0]}
    assert (data.layout, data.background, data.bounds.far) == ("object", "alpha", 5)
    camera = data.cameras[2]
    assert (camera.name, camera.width, camera.height, camera.fx, camera.fy) == ("v2", 8, 6, 9, 10)
    np.testing.assert_array_equal(camera.world_from_camera, POSE)
    image = data.images(2)
    assert image.dtype == np.float32 and image.shape == (6, 8, 4)
    np.testing.assert_array_equal(image, np.float32(2) / np.float32(255))
    np.testing.assert_array_equal(data.truth_depth(1), np.full((6, 8), 2.5, np.float32))
    assert data.truth_depth(0) is None
    assert len(data.points.xyz) == 5


def test_gray_images_become_rgb_and_points_may_be_absent(tmp_path):
    data = load_scene(build(tmp_path, channels=1))
    assert data.images(1).shape == (6, 8, 3) and data.points is None


def test_an_image_of_another_size_than_its_camera_is_damage(tmp_path):
    data = load_scene(build(tmp_path, size=(6, 7)))
    with pytest.raises(ArtifactDamaged, match="7x6, but its camera expects 8x6"):
        data.images(0)


def test_missing_and_cut_images_are_damage(tmp_path):
    artifact = build(tmp_path)
    data = load_scene(artifact)
    path = artifact.file("images/001.png")
    path.write_bytes(path.read_bytes()[:60])
    with pytest.raises(ArtifactDamaged, match=r"001\.png.*import"):
        data.images(1)
    with pytest.raises(ArtifactDamaged, match="60 bytes"):
        load_scene(artifact)
    path.unlink()
    with pytest.raises(ArtifactDamaged, match=r"lacks images/001\.png"):
        load_scene(artifact)


def test_a_view_whose_image_is_not_in_the_artifact_is_damage(tmp_path):
    with pytest.raises(ArtifactDamaged, match="other"):
        load_scene(build(tmp_path, {"image": "images/other.png"}))


@pytest.mark.parametrize("drop", ["xyz", "error", "shape"])
def test_unsound_points_are_damage(tmp_path, drop):
    points = {"xyz": np.ones((5, 3), np.float32), "rgb": np.ones((5, 3), np.uint8), "error": np.ones(5, np.float32)}
    if drop == "shape":
        points["rgb"] = points["rgb"][:4]
    else:
        del points[drop]
    with pytest.raises(ArtifactDamaged, match="points"):
        load_scene(build(tmp_path, points=points))


def test_photos_are_seen_at_the_exposure_of_the_fit(tmp_path):
    scene, work = make_capture(WorkFolder(tmp_path)), WorkFolder(tmp_path)
    stops = {"train_001": 1.0, "train_002": -0.5}

    def made_of(name: str, inputs: dict, **more):
        return commit(work, "field", name, "nerf_fit", inputs, lambda folder: None, **more)

    fit = made_of("fit", {"scene": scene}, figures={EXPOSURE_STOPS: stops})
    painted = made_of("painted", {"scene": scene, "field": fit})
    plain = load_scene(scene)
    for seen in (load_scene(scene, fit), load_scene(scene, painted)):
        for index, name in ((1, "train_001"), (2, "train_002")):
            wanted = exposed(plain.images(index), -stops[name])
            assert np.array_equal(seen.images(index), wanted) and not np.array_equal(wanted, plain.images(index))
        assert np.array_equal(seen.images(3), plain.images(3))
    alike = made_of("alike", {"scene": scene}, figures={EXPOSURE_STOPS: {}})
    assert np.array_equal(load_scene(scene, alike).images(1), plain.images(1))
    assert load_scene(scene, fit).exposure_figures == {EXPOSURE_STOPS: stops}
    # What was taught those photos tells it, whatever becomes of the fit.
    reported = load_scene(scene, fit).exposure_figures
    bent = made_of("bent", {"scene": scene, "field": fit}, figures=reported)
    made_of("fit", {"scene": scene}, figures={EXPOSURE_STOPS: {}})
    assert load_scene(scene, bent).stops == stops and load_scene(scene, painted).stops == {}
    # Photos that carry an edit already are at that exposure: distill has put the edit on what `seen_by` gives.
    (scene.path / EDIT_TARGETS).parent.mkdir()
    save_tensors(scene.path / EDIT_TARGETS, {"1.pixels": np.array([5]), "1.depth": np.ones(1, np.float32)})
    reseal(scene.path)
    scene = Artifact(scene.path)
    assert np.array_equal(load_scene(scene, bent).images(1), plain.images(1))
    assert load_scene(scene, bent).exposure_figures == {}


def test_a_distilled_scene_holds_photos_of_one_exposure(tmp_path):
    scene = make_capture(WorkFolder(tmp_path))
    seen = dataclasses.replace(load_scene(scene), stops={"train_001": 1.0, "train_002": -0.5})
    copy = tmp_path / "copy"
    shutil.copytree(scene.path, copy)
    distill.write_unedited_photos(seen, {1}, copy)
    for index, wanted in ((1, load_scene(scene).images(1)), (2, seen.images(2)), (3, load_scene(scene).images(3))):
        assert np.abs(read_image(copy / seen.views[index].image).pixels - wanted).max() < 0.51 / 255


def test_a_view_without_an_edited_pixel_carries_no_edit(tmp_path):
    made = make_capture(WorkFolder(tmp_path))
    some = {"2.pixels": np.array([5, 6]), "2.depth": np.ones(2, np.float32)}
    none = {"1.pixels": np.empty(0, np.int64), "1.depth": np.empty(0, np.float32)}
    save_tensors(made.path / EDIT_TARGETS, none | some)
    reseal(made.path)
    scene = load_scene(Artifact(made.path))
    found = finetune.edited_pixels(scene, [1, 2, 3], earlier=False)
    assert found.views.tolist() == [1, 1] and found.pixels.tolist() == [5, 6]
    save_tensors(made.path / EDIT_TARGETS, none)
    reseal(made.path)
    scene = load_scene(Artifact(made.path))
    with pytest.raises(BadInput, match="no training view shows the edit"):
        finetune.edited_pixels(scene, [1, 2, 3], earlier=False)


def test_a_number_that_is_no_views_name_is_no_views_place_either():
    names = [f"{number:04d}" for number in range(1, 22) if number != 12]
    scene = SimpleNamespace(views=[SimpleNamespace(name=name) for name in names])
    assert view_index(scene, "0013", "--at") == 11 and view_index(scene, "#12", "--at") == 12
    with pytest.raises(
        BadInput, match=r"--at: view '0012' not found; the nearest of the scene's 20 views are .*0011, 0013"
    ):
        view_index(scene, "0012", "--at")
    with pytest.raises(BadInput, match="view '12' not found"):
        view_index(scene, "12", "--at")


def scene(layout: str, centers, box=((-1, -1, -1), (1, 1, 1)), near: float = 0.5) -> SimpleNamespace:
    cameras = []
    for place, center in enumerate(centers):
        pose = np.eye(4)
        pose[:3, 3] = center
        cameras.append(Camera(f"c{place}", 40, 30, 40.0, 40.0, 20.0, 15.0, pose))
    about = SimpleNamespace(layout_reason="made up")
    return SimpleNamespace(layout=layout, scene=about, cameras=cameras, bounds=Bounds(box, near, 10.0))


def test_half_the_cube_of_an_unbounded_scene_covers_the_cameras_focus():
    space, _ = space_of(scene("unbounded", [(0, 0, -1), (1, 0, 0)]), "auto")
    assert space.kind == "contraction" and 0 < FOCUS < 1
    np.testing.assert_allclose(space.warp([[FOCUS, 0, 0], [-FOCUS, 0, FOCUS]]), [[0.75, 0.5, 0.5], [0.25, 0.5, 0.75]])


def test_an_object_contracted_keeps_its_whole_box():
    space, _ = space_of(scene("object", [(0, 0, -3)], ((-2, -1, -1), (2, 1, 1))), "contraction")
    np.testing.assert_allclose(space.warp([[2, 0, 0], [0, 1, 0]]), [[0.75, 0.5, 0.5], [0.5, 0.75, 0.5]])


def test_a_frustum_knows_how_far_its_views_are_apart():
    space, _ = space_of(scene("forward", [(-0.1, 0, 0), (0.2, 0.1, 0.7)]), "auto")
    assert space.kind == "frustum" and space.parameters[3] == pytest.approx(0.3 / 0.5)
