"""Exported cameras come back as they were: by `import`, by `render --path`, and by the tools' own readers."""

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from schemas.scene import Scene, read_scene, write_scene
from schemas.work_folder import Artifact, Recipe, WorkFolder
from stages import render
from stages.artifacts.camera_files import read_cameras
from stages.artifacts.scene import SceneData, load_scene
from stages.artifacts.world_axes import file_from_scene
from stages.configs.render import RenderConfig
from stages.exporting import camera_lists
from stylerf.geometry.cameras import Camera
from stylerf.geometry.scene_normalization import moved
from tests.stages.exporting.fixture import exported
from tests.stages.importing import Said, imported

FILES = {"transforms": "transforms.json", "colmap": "sparse/0", "colmap-text": "sparse_text/0", "usd": "cameras.usda",
         "camera-path": "camera_path.json", "3dgs": "cameras.json", "chan": "cameras.chan"}  # fmt: skip
WITH_LENS = ("transforms", "colmap", "colmap-text", "usd")  # formats with a principal point and two focal lengths


@pytest.fixture
def scene(posed, tmp_path) -> Artifact:
    """Four views in a frame that import has turned, moved and scaled."""
    return imported(posed, tmp_path / "work", test_every=2)


@pytest.fixture
def bent(scene, tmp_path) -> Artifact:
    """The scene with lenses whose pixels are not square and whose principal points are off the middle."""
    content = read_scene(scene.path)
    views = [
        replace(view, fx=view.fx * (1 + 0.1 * index), cx=view.cx + 3.25, cy=view.cy - 1.5)
        for index, view in enumerate(content.views)
    ]
    return rewritten(scene, replace(content, views=tuple(views)), tmp_path / "bent")


def rewritten(scene: Artifact, content: Scene, root: Path) -> Artifact:
    """The scene with other content, in a work folder of its own."""
    begun = WorkFolder(root).begin("scene", "main", Recipe("pose_import", 1, {}, []))
    for view in content.views:
        (begun.path / view.image).parent.mkdir(exist_ok=True)
        (begun.path / view.image).write_bytes((scene.path / view.image).read_bytes())
    write_scene(begun.path, content)
    return begun.commit()


def lens(camera) -> list[float]:
    return [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]


def in_source(scene: SceneData) -> list[np.ndarray]:
    return [moved(one.world_from_camera, file_from_scene(scene, "source")) for one in scene.cameras]


@pytest.mark.parametrize("format", FILES)
def test_render_reads_every_format_back_to_the_scenes_own_cameras(scene, tmp_path, format):
    made = exported(tmp_path / "work", {"scene": scene}, kind="cameras", formats=format)
    data = load_scene(scene)
    found = read_cameras(made.path / FILES[format], data).cameras
    assert len(found) == len(data.cameras) == 4
    for one, own in zip(found, data.cameras, strict=True):
        np.testing.assert_allclose(one.world_from_camera, own.world_from_camera, atol=1e-5)
        np.testing.assert_allclose(lens(one), lens(own), rtol=1e-6)


@pytest.mark.parametrize("format", WITH_LENS)
def test_lenses_off_the_middle_come_back(bent, tmp_path, format):
    made = exported(tmp_path / "bent", {"scene": bent}, kind="cameras", formats=format)
    data = load_scene(bent)
    for one, own in zip(read_cameras(made.path / FILES[format], data).cameras, data.cameras, strict=True):
        np.testing.assert_allclose(one.world_from_camera, own.world_from_camera, atol=1e-5)
        if format != "usd" or own is data.cameras[0]:  # its settings have one pixel aspect, that of the first
            np.testing.assert_allclose(lens(one), lens(own), rtol=1e-6)


@pytest.mark.parametrize("format", ["camera-path", "3dgs", "chan"])
def test_what_a_format_cannot_hold_is_said(bent, tmp_path, format):
    said = Said()
    exported(tmp_path / "bent", {"scene": bent}, said, kind="cameras", formats=format)
    # Pixels are up to 30 % wider than high, principal points 3.25 pixels off.
    off = "3.2 pixels" if format == "3dgs" else "14 pixels"
    assert any("no principal point" in line and off in line for line in said.lines)


@pytest.mark.parametrize("format", ["camera-path", "chan"])
def test_one_size_for_views_of_several_is_said(scene, tmp_path, format):
    content = read_scene(scene.path)
    views = (replace(content.views[0], width=36, height=48), *content.views[1:])
    made = rewritten(scene, replace(content, views=views), tmp_path / "sizes")
    for one, lines in ((scene, 0), (made, 1)):
        said = Said()
        exported(tmp_path / format / str(lines), {"scene": one}, said, kind="cameras", formats=format)
        assert sum("cannot store different sizes" in line for line in said.lines) == lines


@pytest.mark.parametrize("format", ["transforms", "colmap"])
def test_import_of_an_export_has_the_same_cameras_and_photos(scene, tmp_path, format):
    made = exported(tmp_path / "work", {"scene": scene}, kind="cameras", formats=format)
    again, data = load_scene(imported(made.path, tmp_path / "again", test_every=2)), load_scene(scene)
    assert [view.name for view in again.views] == [view.name for view in data.views]
    for ours, theirs, one, own in zip(in_source(again), in_source(data), again.cameras, data.cameras, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-5)
        np.testing.assert_allclose(lens(one), lens(own), rtol=1e-6)
    np.testing.assert_array_equal(again.images(1), data.images(1))
    if format == "transforms":
        assert [view.split for view in again.views] == [view.split for view in data.views]


def test_pycolmap_reads_the_model_and_projects_as_the_scene_does(bent, tmp_path):
    made = exported(tmp_path / "bent", {"scene": bent}, kind="cameras", formats="colmap")
    model, data = pycolmap.Reconstruction(made.path / "sparse/0"), load_scene(bent)
    to_source = file_from_scene(data, "source")
    point = data.cameras[0].unproject(np.array([[7.0, 9.0]]), np.array([2.0]))
    assert len(model.images) == len(data.cameras)
    for image in model.images.values():
        own = next(one for one in data.cameras if f"{one.name}.png" == image.name)
        pixel = image.project_point(to_source[:3, :3] @ point[0] + to_source[:3, 3])
        np.testing.assert_allclose(pixel, own.project(point)[0][0], atol=1e-4)


def test_the_usd_camera_projects_as_the_scene_does(bent, tmp_path):
    """By USD's own frustum: its window at distance 1 is -1..1 in normalized device coordinates."""
    from pxr import Gf, Usd, UsdGeom

    made = exported(tmp_path / "bent", {"scene": bent}, kind="cameras", formats="usd")
    stage, data = Usd.Stage.Open(str(made.path / "cameras.usda")), load_scene(bent)
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    to_file = file_from_scene(data, "source", "y")
    scale = np.cbrt(np.linalg.det(to_file[:3, :3]))
    near, far = UsdGeom.Camera(stage.GetPrimAtPath("/shot/camera")).GetClippingRangeAttr().Get()
    assert near < 0.1 * data.bounds.near * scale and far > 20 * data.bounds.far * scale  # splats of a background too
    point = data.cameras[0].unproject(np.array([[7.0, 9.0]]), np.array([2.0]))
    for time, own in enumerate(data.cameras, start=1):
        frustum = UsdGeom.Camera(stage.GetPrimAtPath("/shot/camera")).GetCamera(time).frustum
        device = (frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()).Transform(
            Gf.Vec3d(*(to_file[:3, :3] @ point[0] + to_file[:3, 3]))
        )
        pixel = (device[0] + 1) / 2 * own.width, (1 - device[1]) / 2 * own.height
        np.testing.assert_allclose(pixel, own.project(point)[0][0], atol=1e-3)


def test_chan_turns_about_z_then_x_then_y(scene, tmp_path):
    made = exported(tmp_path / "work", {"scene": scene}, kind="cameras", formats="chan")
    data = load_scene(scene)
    for line, own in zip((made.path / "cameras.chan").read_text().splitlines(), data.cameras, strict=True):
        x, y, z, rx, ry, rz, fov = np.array(line.split()[1:], float)
        turns = [np.radians(angle) for angle in (rx, ry, rz)]
        (cx, cy, cz), (sx, sy, sz) = np.cos(turns), np.sin(turns)
        about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
        about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
        about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
        pose = moved(own.world_from_camera, file_from_scene(data, "source", "y"))
        np.testing.assert_allclose(about_y @ about_x @ about_z, pose[:3, :3] @ np.diag([1, -1, -1]), atol=1e-9)
        np.testing.assert_allclose([x, y, z], pose[:3, 3], rtol=1e-9)
        assert np.tan(np.radians(fov / 2)) == pytest.approx(own.height / 2 / own.fy)


def test_chan_angles_never_jump_around_an_orbit_or_straight_down(tmp_path):
    def camera(*turns: float) -> Camera:
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_euler("YXZ", turns, degrees=True).as_matrix() @ np.diag([1, -1, -1])
        return Camera("one", 64, 48, 60.0, 60.0, 32.0, 24.0, pose)

    around = [camera(angle, -20, 0) for angle in range(0, 720, 30)]
    over = [camera(10, angle, 5) for angle in range(-75, 285, 30)]  # the angles of a rotation have rx in -90..90
    for cameras in (around, over):
        camera_lists.write_chan(tmp_path / "orbit.chan", cameras)
        angles = np.loadtxt(tmp_path / "orbit.chan")[:, 4:7]
        np.testing.assert_allclose(np.abs(np.diff(angles, axis=0)).max(1), 30, atol=1e-9)
        for (rx, ry, rz), one in zip(angles, cameras, strict=True):
            rotation = Rotation.from_euler("YXZ", [ry, rx, rz], degrees=True).as_matrix()
            np.testing.assert_allclose(rotation, camera_lists.opengl_pose(one)[:3, :3], atol=1e-9)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        camera_lists.write_chan(tmp_path / "down.chan", [camera(0, -90, 0)])


def test_a_path_has_its_cameras_and_no_photos(scene, tmp_path):
    options = {"kind": "cameras", "path": "orbit", "count": 5}
    made = exported(tmp_path / "work", {"scene": scene}, formats="transforms,colmap", **options)
    assert not (made.path / "images").exists()
    wanted = [one for one, _ in render.shots_of(load_scene(scene), RenderConfig(path="orbit", count=5))]
    found = read_cameras(made.path / "sparse/0", load_scene(scene)).cameras
    np.testing.assert_allclose([one.center for one in found], [one.center for one in wanted], atol=1e-5)


def test_scene_units_leave_the_cameras_as_the_scene_has_them(scene, tmp_path):
    made = exported(tmp_path / "work", {"scene": scene}, kind="cameras", formats="3dgs", units="scene")
    entries = json.loads((made.path / "cameras.json").read_text())
    for entry, own in zip(entries, load_scene(scene).cameras, strict=True):
        np.testing.assert_allclose(entry["position"], own.center)
        np.testing.assert_allclose(entry["rotation"], own.world_from_camera[:3, :3])


def test_the_same_export_has_the_same_bytes(scene, tmp_path):
    options = {"kind": "cameras", "formats": ",".join(FILES)}
    one = exported(tmp_path / "work", {"scene": scene}, **options).manifest
    two = exported(tmp_path / "work", {"scene": scene}, **options).manifest
    assert one.files == two.files
