"""The demo's data set: an ordinary one, which the ordinary import brings in with its cameras, pictures and truth."""

import json

import numpy as np
import OpenImageIO as oiio
import pytest

from schemas.exr import FAR_Z
from schemas.images import read_image
from stages.artifacts.scene import load_scene
from stages.pipeline import demo_scene
from stages.pipeline.demo_scene import ANGLE_X, PAINTING, write_demo
from stages.run.progress import Silent
from stylerf.procedural.still_life import StillLife, dome_cameras
from tests.stages.importing import imported

SIZE, TRAIN, TEST, SEED = 32, 4, 2, 3


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demo") / "photos"
    write_demo(folder, SIZE, TRAIN, TEST, SEED, 1, Silent())
    return folder


def cameras():
    """Those that the demo photographs with: the truth, not what was written of it."""
    return [
        *dome_cameras(TRAIN, SIZE, "train", SEED, angle_x=ANGLE_X),
        *dome_cameras(TEST, SIZE, "test", SEED + 1000, angle_x=ANGLE_X),
    ]


def test_the_ordinary_import_brings_the_cameras_back(photos, tmp_path):
    scene = load_scene(imported(photos, tmp_path / "work"))
    assert [view.split for view in scene.views] == ["train"] * TRAIN + ["test"] * TEST
    assert (scene.layout, scene.background) == ("object", "alpha")
    life = StillLife(SEED)
    for index, (found, true) in enumerate(zip(scene.cameras, cameras(), strict=True)):
        assert found.name == true.name
        np.testing.assert_allclose(found.world_from_camera, true.world_from_camera, atol=1e-9)
        np.testing.assert_allclose([found.fx, found.fy, found.cx, found.cy], [true.fx, true.fy, 16, 16], rtol=1e-9)
        seen = life.render(true)
        covered = seen.rgba[..., 3] > 0.1
        np.testing.assert_allclose(scene.images(index)[..., 3], seen.rgba[..., 3], atol=0.5 / 255 + 1e-6)
        np.testing.assert_allclose(scene.images(index)[covered, :3], seen.rgba[covered, :3], atol=0.03)
        hit = np.isfinite(seen.z)
        depth = scene.truth_depth(index)
        np.testing.assert_allclose(depth[hit], seen.z[hit], rtol=1e-6)
        assert (depth[~hit] >= FAR_Z).all()
    # The box holds what is seen of the still life.
    low, high = np.array(scene.bounds.aabb)
    assert (low < -1.1).any() and (low > -1.8).all() and (high > 1.0).any() and (high < 1.8).all()


@pytest.mark.parametrize("of", ["written", "imported"])
def test_written_depth_and_matrices_unproject_onto_the_still_life(photos, tmp_path, of):
    """What a compositor does: read with OpenImageIO, take Z, worldToCamera and worldToNDC, and nothing else."""
    folder = photos / "truth" if of == "written" else imported(photos, tmp_path / "work").path / "truth"
    files = sorted(folder.glob("*.exr"))
    assert len(files) == TRAIN + TEST
    life, points = StillLife(SEED), 0
    for path in files:
        picture = oiio.ImageInput.open(str(path))
        spec = picture.spec()
        planes = dict(zip(spec.channelnames, np.moveaxis(picture.read_image(oiio.FLOAT), -1, 0), strict=True))
        picture.close()
        to_camera, to_ndc = (np.array(spec.getattribute(f"worldTo{of}")).reshape(4, 4) for of in ("Camera", "NDC"))
        rows, columns = np.nonzero(planes["A"] > 0)
        z = planes["Z"][rows, columns].astype(np.float64)
        camera_to_ndc = np.linalg.inv(to_camera) @ to_ndc  # row vectors
        # Of (x, y, z, 1) in the camera to (u, v) times z, which gives x and y where Z is known.
        u, v = (columns + 0.5) / spec.width, (rows + 0.5) / spec.height
        x = (u - camera_to_ndc[2, 0]) * z / camera_to_ndc[0, 0]
        y = (v - camera_to_ndc[2, 1]) * z / camera_to_ndc[1, 1]
        world = (np.stack([x, y, z, np.ones_like(z)], -1) @ np.linalg.inv(to_camera))[:, :3]
        assert np.abs(life.distance(world)).max() < 5e-5  # float32 matrices, at four units from the camera
        center = np.linalg.inv(to_camera)[3, :3]
        np.testing.assert_allclose(
            planes["rayDistance.Z"][rows, columns], np.linalg.norm(world - center, axis=1), rtol=2e-5
        )
        assert (planes["Z"][planes["A"] == 0] == np.float32(FAR_Z)).all()
        points += len(z)
    assert points > 1500


def test_the_painting_is_there(photos):
    painting = read_image(photos / PAINTING)
    assert painting.size == (512, 512) and painting.channels == 3


def snapshot(folder) -> dict:
    return {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in folder.rglob("*") if path.is_file()}


def test_what_is_there_whole_is_left_as_it_is(photos):
    before = snapshot(photos)
    write_demo(photos, SIZE, TRAIN, TEST, SEED, 1, Silent())
    assert snapshot(photos) == before


def test_a_stop_while_other_photos_are_written_is_not_taken_for_whole(photos, tmp_path, monkeypatch):
    """Photos for other options had replaced some of the old ones when the process died; then the old are asked for."""
    folder = tmp_path / "photos"
    write_demo(folder, SIZE, TRAIN, TEST, SEED, 1, Silent())
    wanted = {path.relative_to(folder): data for path, (_, data) in snapshot(folder).items()}
    real, left = demo_scene.write_view, [2]

    def dying(*arguments):
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        real(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(demo_scene, "write_view", dying)
        with pytest.raises(KeyboardInterrupt):
            write_demo(folder, SIZE, TRAIN, TEST, SEED + 1, 1, Silent())
    assert json.loads((folder / "demo.json").read_text()) == {}
    write_demo(folder, SIZE, TRAIN, TEST, SEED, 1, Silent())
    assert {path.relative_to(folder): data for path, (_, data) in snapshot(folder).items()} == wanted
    assert json.loads((folder / "demo.json").read_text())["seed"] == SEED
