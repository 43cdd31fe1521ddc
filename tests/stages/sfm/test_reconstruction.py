"""Structure from motion on procedural photos whose cameras are known: poses, refusals, interruption, repetition."""

import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from schemas.canonical_json import file_sha256
from schemas.errors import BadInput, OutOfResources
from schemas.images import read_image, to_uint8, write_png
from stages.artifacts.scene import load_scene
from stages.run.progress import Context, Silent
from stages.sfm import colmap_database, photo_copies, quality, reconstruction
from stages.sfm.colmap_database import keypoints, matched_pairs
from stages.sfm.job import Job, JobProgress
from tests.conftest import REPOSITORY
from tests.stages.importing import Said, imported, psnr, scene_of
from tests.stages.photo_room import aligned, look_at, walk, write_photos, write_tagged

CAMERAS = walk(8, (0.45, 1.1), width=240, height=180, focal=230.0)


@pytest.fixture(scope="session")
def room(tmp_path_factory) -> Path:
    """Eight photos of the corner of a room, 240 x 180."""
    folder = tmp_path_factory.mktemp("room")
    write_photos(folder, CAMERAS)
    return folder


@pytest.fixture(scope="session")
def finished(room, tmp_path_factory) -> Path:
    """The folder of an undisturbed run of the child process."""
    folder = tmp_path_factory.mktemp("finished")
    reconstruction.run_child(job_in(folder, room), Context())
    return folder


def job_in(folder: Path, photos: Path, **options) -> Path:
    job = Job(str(folder), tuple(map(str, sorted(photos.glob("*.png")))), **options)
    job.write(folder / "job.json")
    return folder / "job.json"


def model_digests(folder: Path) -> dict[str, str]:
    return {path.name: file_sha256(path) for path in sorted((folder / "model").iterdir())}


def test_the_poses_of_the_room(room, tmp_path):
    source = tmp_path / "s"
    source.mkdir()
    for photo in room.iterdir():
        (source / photo.name).write_bytes(photo.read_bytes())
    taken = to_uint8(read_image(source / "p02.png").pixels)
    write_tagged(source / "p02.tif", taken[::-1, ::-1], 3)  # as a camera held upside down stores it
    (source / "p02.png").unlink()
    (source / "p90.png").write_bytes((room / "p01.png").read_bytes())
    write_png(source / "p91.png", np.zeros((180, 240, 3), np.uint8))
    for name in ("p92.HEIC", "p01.cr2", "._p93.HEIC"):
        (source / name).touch()
    said = Said()
    artifact = imported(source, tmp_path / "w", said)
    scene = scene_of(artifact)
    assert [view.name for view in scene.views] == [camera.name for camera in CAMERAS]
    assert [(one.source, one.reason) for one in scene.skipped] == [
        ("p90.png", "it is identical to p01.png"), ("p91.png", "it is black"),
        ("p92.HEIC", "unsupported format; convert it to JPEG or PNG"),
    ]  # fmt: skip
    assert psnr(load_scene(artifact).images(2), taken / 255) > 25  # a little undistorted
    found = np.array([view.world_from_camera for view in scene.views])
    angles, distances = aligned(found, np.array([camera.world_from_camera for camera in CAMERAS]))
    assert angles.max() < 0.5 and distances.max() < 0.01
    assert abs(scene.views[0].fx / 230 - 1) < 0.02
    assert scene.sfm["registered"] == 8 and scene.sfm["error_px"] < 0.5 and scene.sfm["agreement"] == 1
    assert "1 more photos cannot be read (.HEIC)" in said.lines[0]
    assert any("structure from motion: 8 of 8 photos placed" in line for line in said.lines)
    # Points lie on the faces of the room: one coordinate is 0 in the room's own frame.
    points = load_scene(artifact).points.xyz
    onto = similarity(found[:, :3, 3], np.array([camera.center for camera in CAMERAS]))
    inside = points @ onto[:3, :3].T + onto[:3, 3]
    assert np.median(np.abs(inside).min(axis=1)) < 0.01 and len(points) > 300


def similarity(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """[4, 4] that brings points p [n, 3] onto q, by pycolmap."""
    found = pycolmap.estimate_sim3d(p, q)
    matrix = np.eye(4)
    matrix[:3] = found.matrix()
    return matrix


def test_two_runs_give_the_same_bytes_whatever_the_threads(finished, room, tmp_path):
    reconstruction.run_child(job_in(tmp_path, room, threads=1), Context())
    assert model_digests(tmp_path) == model_digests(finished)


def killed_runs(room, folder, moments):
    """Starts the child, kills it after so many of its events, and so on; then lets it finish."""
    for moment in moments:
        job = job_in(folder, room)
        with subprocess.Popen(
            [sys.executable, "-m", "stages.sfm.child", str(job)], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, cwd=REPOSITORY,
        ) as child:  # fmt: skip
            for _ in range(moment):
                if not child.stdout.readline():
                    break
            time.sleep(0.01 * (moment % 7))
            child.kill()
    reconstruction.run_child(job_in(folder, room), Context())


def test_a_run_killed_in_every_step_ends_with_the_same_bytes(finished, room, tmp_path):
    killed_runs(room, tmp_path, (5, 3, 4, 5))
    assert model_digests(tmp_path) == model_digests(finished)


@pytest.mark.slow
def test_a_run_killed_at_twenty_random_moments_ends_with_the_same_bytes(finished, room, tmp_path):
    random = np.random.default_rng(0)
    for trial in range(20):
        folder = tmp_path / str(trial)
        folder.mkdir()
        killed_runs(room, folder, random.integers(1, 25, 2).tolist())
        assert model_digests(folder) == model_digests(finished), trial


def processes_of(folder: Path) -> list[int]:
    """Processes whose command line names the folder."""
    found = []
    for item in Path("/proc").glob("[0-9]*"):
        try:
            if str(folder) in (item / "cmdline").read_text():
                found.append(int(item.name))
        except OSError:
            continue
    return found


def command(room, work):
    return subprocess.Popen(
        [sys.executable, "-m", "stylerf_cli.main", "import", str(room), str(work)], cwd=REPOSITORY,
        stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, start_new_session=True,
    )  # fmt: skip


def wait_for(condition, seconds=30.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited too long"
        time.sleep(0.02)


@pytest.mark.parametrize(
    "sign",
    [
        "matching",
        "models",
        pytest.param("copies/00003.jpg", marks=pytest.mark.slow),
        pytest.param("registered", marks=pytest.mark.slow),
    ],
)
def test_ctrl_c_ends_it_within_ten_seconds_and_leaves_what_is_done(room, tmp_path, sign):
    """As soon as the file `sign` shows that a step has begun, the terminal's signal comes."""
    work = tmp_path / "w"
    step = work / "scene" / ".main.partial" / "checkpoint" / "sfm"
    with command(room, work) as running:
        wait_for((step / sign).exists)
        requested = time.monotonic()
        running.send_signal(signal.SIGINT)
        _, errors = running.communicate(timeout=15)
        assert time.monotonic() - requested < 10
    assert running.returncode == 130 and "interrupted" in errors
    assert processes_of(work) == [] and (step / sign).exists()


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks at /proc")
def test_the_child_dies_with_its_parent(room, tmp_path):
    work = tmp_path / "w"
    with command(room, work) as running:
        wait_for((work / "scene" / ".main.partial" / "checkpoint" / "sfm" / "copies").exists)
        assert len(processes_of(work)) > 1  # there is a child to die
        running.kill()
    wait_for(lambda: not processes_of(work), 10)


def test_an_interrupted_import_goes_on(finished, room, tmp_path):
    """KeyboardInterrupt out of the progress callback, in the midst of matching; then the photos are moved.

    The second run ends as an undisturbed one does.
    """

    class Stopping(Silent):
        label = ""

        def start(self, label, total=None, unit="step"):
            self.label = label

        def update(self, done, note=""):
            if self.label == "reconstructing":
                raise KeyboardInterrupt

    shutil.copytree(room, tmp_path / "here")
    with pytest.raises(KeyboardInterrupt):
        imported(tmp_path / "here", tmp_path / "w", Stopping())
    (tmp_path / "here").rename(tmp_path / "there")
    said = Said()
    scene = scene_of(imported(tmp_path / "there", tmp_path / "w", said))
    assert any("resuming" in line for line in said.lines)
    result = json.loads((finished / "result.json").read_text())["figures"]
    assert scene.sfm == result


def refused(source, tmp_path, **options) -> str:
    with pytest.raises(BadInput) as caught:
        imported(source, tmp_path / "w", **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("count", [1, 2])
def test_too_few_photos(room, tmp_path, count):
    for number in range(count):
        name = f"p0{number}.png"
        (tmp_path / name).write_bytes((room / name).read_bytes())
    assert f"{count} of {count} photos can be used; structure from motion needs at least 3" in refused(
        tmp_path, tmp_path
    )


def test_black_photos(tmp_path):
    for number in range(4):
        write_png(tmp_path / f"{number}.png", np.zeros((60, 80, 3), np.uint8))
    assert "0 of 4 photos can be used (0.png: it is black)" in refused(tmp_path, tmp_path)


def test_copies_of_one_photo(room, tmp_path):
    for number in range(4):
        (tmp_path / f"{number}.png").write_bytes((room / "p00.png").read_bytes())
    assert "1 of 4 photos can be used (1.png: it is identical to 0.png)" in refused(tmp_path, tmp_path)


def test_photos_of_noise(tmp_path):
    random = np.random.default_rng(0)
    for number in range(4):
        write_png(tmp_path / f"{number}.png", random.integers(0, 256, (90, 120, 3)).astype(np.uint8))
    assert "found no poses: too few matches" in refused(tmp_path, tmp_path)


def test_a_truncated_photo(room, tmp_path):
    for photo in room.iterdir():
        data = photo.read_bytes()
        (tmp_path / photo.name).write_bytes(data[: len(data) // 2] if photo.name == "p03.png" else data)
    assert "p03.png cannot be read completely" in refused(tmp_path, tmp_path)


def test_photos_turned_on_the_spot(tmp_path):
    """No baseline: COLMAP may still end quietly, with points anywhere."""
    cameras = [
        look_at((2.2, 2.2, 1.2), (0.3 + 0.1 * k, 0.3 - 0.1 * k, 0.9), f"t{k}", 200, 150, 190.0) for k in range(6)
    ]
    write_photos(tmp_path, cameras)
    line = refused(tmp_path, tmp_path)
    assert "turns in place" in line or "parallax" in line or "placed only" in line


def test_poses_that_contradict_the_photos_are_found_out(finished):
    """Two photos' poses are exchanged: their pairs disagree, all others still agree."""
    model = pycolmap.Reconstruction(finished / "model")
    pairs, points = matched_pairs(finished / "database.db"), keypoints(finished / "database.db")
    assert all(quality.pair_agreements(model, pairs, points))
    images = {model.images[number].name: model.images[number] for number in model.reg_image_ids()}
    one, two = images["00001.jpg"], images["00005.jpg"]
    poses = one.cam_from_world(), two.cam_from_world()
    one.frame.set_cam_from_world(one.camera_id, poses[1])
    two.frame.set_cam_from_world(two.camera_id, poses[0])
    agreeing = dict(zip([pair[:2] for pair in pairs], quality.pair_agreements(model, pairs, points), strict=True))
    for names, agrees in agreeing.items():
        touched = {"00001.jpg", "00005.jpg"} & set(names)
        assert agrees == (not touched) or len(touched) == 2, names


def test_photos_side_by_side_without_matches_are_found_out(finished):
    """As in a fold, the two halves of the walk see one corner and share no matches."""
    model = pycolmap.Reconstruction(finished / "model")
    pairs = matched_pairs(finished / "database.db")
    names = [f"{number:05d}.jpg" for number in range(8)]
    compared = {(a, b) for a in names for b in names if a < b}
    sound = quality.expected(model, pairs, compared)
    assert sound.silent == () and sound.count >= 8
    halves = [pair for pair in pairs if (pair[0] < "00004.jpg") == (pair[1] < "00004.jpg")]
    folded = quality.expected(model, halves, compared)
    assert set(folded.silent) == {(a, b) for a, b in sound.matched if a < "00004.jpg" <= b}
    # Pairs that nobody compared tell nothing.
    assert quality.expected(model, halves, {pair[:2] for pair in halves}).silent == ()
    reported = {"photos": 8, "registered": 8, "points": 900, "error_px": 0.4, "track_length": 4.0, "parallax_deg": 20.0}
    reported |= {"agreement": 1.0, "pairs_checked": 28, "flat_share": 0.0, "turned_share": 0.0, "models": (8,)}
    for must in (sound, folded):
        found = quality.Quality(**reported, refined=False, silent_share=must.silent_share, pairs_expected=must.count)
        assert ("fold the scene" in quality.verdict(found)[0]) == (must is folded)


def test_masked_features_are_dropped_and_unmasked_photos_keep_all(room, tmp_path):
    photos = sorted(room.glob("*.png"))[:4]
    gray = read_image(photos[2]).pixels.mean(axis=2)
    photos[2] = tmp_path / "gray.png"
    write_png(photos[2], to_uint8(gray))
    mask = np.full((180, 240), 255, np.uint8)
    mask[:, :120] = 0
    write_png(tmp_path / "half.png", mask)
    write_png(tmp_path / "none.png", np.zeros((180, 240), np.uint8))
    half, none = str(tmp_path / "half.png"), str(tmp_path / "none.png")
    masks = ((half, ""), ("", ""), (half, ""), (none, ""))
    job = Job(str(tmp_path), tuple(map(str, photos)), masks)
    tell = JobProgress(io.StringIO())
    every = photo_copies.make_copies(job, tell)
    assert [one.unusable for one in every] == ["", "", "", "it is fully masked"]
    used = photo_copies.usable(every, 3)
    path = colmap_database.register(job, used, tell)
    colmap_database.extract(job, path, used, tell)
    found = keypoints(path)
    for name in ("00000.jpg", "00002.jpg"):
        assert len(found[name]) > 20 and (found[name][:, 0] >= 119).all()
    assert (found["00001.jpg"][:, 0] < 119).sum() > 20


def test_a_mask_of_another_size(room, tmp_path):
    shutil.copytree(room, tmp_path / "images")
    write_png(tmp_path / "masks" / "p03.png", np.full((90, 90), 255, np.uint8))
    assert "p03.png is 90x90, but its photo is 240x180; make them the same size" in refused(tmp_path, tmp_path / "o")


def lego(data_dir, count: int) -> list[np.ndarray]:
    """RGBA of 400 pixels of photos from the side, in order around the object."""
    frames = [one for one in lego_frames(data_dir) if 0.8 < one["transform_matrix"][2][3] < 3.2]
    return [lego_photo(data_dir, one) for one in in_order_around(frames)[:count]]


def lego_frames(data_dir) -> list[dict]:
    return json.loads((data_dir / "lego" / "transforms_train.json").read_text())["frames"]


def in_order_around(frames: list[dict]) -> list[dict]:
    return sorted(frames, key=lambda one: np.arctan2(one["transform_matrix"][1][3], one["transform_matrix"][0][3]))


def lego_photo(data_dir, frame: dict) -> np.ndarray:
    pixels = read_image(data_dir / "lego" / f"{frame['file_path']}.png").pixels
    return pixels.reshape(400, 2, 400, 2, 4).mean(axis=(1, 3))


@pytest.mark.realdata
@pytest.mark.slow
def test_a_folded_lego_is_refused(data_dir, tmp_path):
    """Its sides look alike: a third of the cameras stand 180 degrees off, and every matched pair agrees."""
    for index, pixels in enumerate(lego(data_dir, 60)):
        write_png(tmp_path / "images" / f"{index:03d}.png", to_uint8(pixels))
    assert "the poses fold the scene onto itself" in refused(tmp_path, tmp_path / "o")


@pytest.mark.realdata
@pytest.mark.slow
def test_silhouettes_reject_isolated_wrong_cameras(data_dir, tmp_path):
    """Of 40 photos 28 are placed, two of them more than 100 degrees off."""
    frames = in_order_around(lego_frames(data_dir)[:40])
    for index, frame in enumerate(frames):
        pixels = read_image(data_dir / "lego" / f"{frame['file_path']}.png").pixels
        pixels[..., :3] *= pixels[..., 3:]
        small = pixels.reshape(400, 2, 400, 2, 4).mean(axis=(1, 3))
        small[..., :3] /= np.maximum(small[..., 3:], 1e-6)
        write_png(tmp_path / "images" / f"{index:03d}.png", to_uint8(small))
    scene = scene_of(imported(tmp_path, tmp_path / "o"))
    assert len(scene.views) >= 24
    known = np.array([frames[int(view.name)]["transform_matrix"] for view in scene.views]) @ np.diag([1, -1, -1, 1])
    angles, _ = aligned(np.array([view.world_from_camera for view in scene.views]), known)
    assert angles.max() < 2


@pytest.mark.realdata
@pytest.mark.slow
def test_an_object_before_a_still_background_by_its_masks(data_dir, tmp_path):
    random = np.random.default_rng(0)
    still = sum(np.kron(random.uniform(0, 1, (400 // n, 400 // n, 3)), np.ones((n, n, 1))) for n in (4, 8, 20, 50)) / 4
    for index, pixels in enumerate(lego(data_dir, 14)):
        alpha = pixels[..., 3:]
        write_png(tmp_path / "images" / f"{index:03d}.png", to_uint8(pixels[..., :3] * alpha + still * (1 - alpha)))
        write_png(tmp_path / "masks" / f"{index:03d}.png", to_uint8(alpha[..., 0]))
    scene = scene_of(imported(tmp_path, tmp_path / "o"))
    assert scene.sfm["registered"] == 14 and scene.background == "alpha"


@pytest.mark.realdata
@pytest.mark.slow
def test_the_castle(data_dir, tmp_path):
    """Eleven real photos whose focal length K.txt tells: 2905.88 pixels at 2832 x 2128."""
    artifact = imported(data_dir / "castle", tmp_path / "w", sfm_side=800, sfm_features=1500, max_side=300)
    scene = scene_of(artifact)
    assert scene.sfm["registered"] == 11 and scene.sfm["error_px"] < 0.8 and scene.sfm["agreement"] > 0.9
    model = tmp_path / "w"
    assert model.is_dir() and scene.layout == "unbounded" and len(scene.split("test")) == 2
    # The walk along the facade: neighbors in the file names are neighbors in space.
    centers = np.array([view.world_from_camera for view in scene.views])[:, :3, 3]
    gaps = np.linalg.norm(centers[:, None] - centers[None], axis=-1) + 10 * np.eye(11)
    assert all(abs(int(np.argmin(row)) - index) <= 2 for index, row in enumerate(gaps))


@pytest.mark.realdata
@pytest.mark.slow
def test_the_fox_from_photos_alone_stands_as_its_file_tells(data_dir, tmp_path):
    photos = imported(data_dir / "fox" / "images", tmp_path / "p", downscale=8)
    reported = imported(data_dir / "fox", tmp_path / "t", downscale=8)
    one = {view.name: view.world_from_camera for view in scene_of(photos).views}
    two = {view.name: view.world_from_camera for view in scene_of(reported).views}
    names = sorted(one.keys() & two.keys())
    assert len(names) == 50
    angles, distances = aligned(np.array([one[name] for name in names]), np.array([two[name] for name in names]))
    assert angles.mean() < 0.3 and distances.mean() < 0.002


@pytest.mark.realdata
@pytest.mark.slow
def test_photos_that_all_face_forward_stand_as_their_file_tells(data_dir, tmp_path):
    photos = imported(data_dir / "flower" / "images_8", tmp_path / "p", downscale=4)
    reported = imported(data_dir / "flower", tmp_path / "t", format="llff", images="images_8", downscale=4)
    one = {view.name: view.world_from_camera for view in scene_of(photos).views}
    two = {view.name: view.world_from_camera for view in scene_of(reported).views}
    assert len(one) == 34
    names = sorted(one)
    angles, distances = aligned(np.array([one[name] for name in names]), np.array([two[name] for name in names]))
    assert angles.max() < 0.5 and distances.max() < 0.01


def test_a_child_without_its_libraries_is_not_blamed_on_the_photos(tmp_path, room, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "pycolmap.py").write_text("raise ImportError('libcolmap.so: Input/output error')")
    with pytest.raises(OutOfResources, match=r"could not start .*Input/output error"):
        reconstruction.run_child(job_in(tmp_path, room), Context())


def test_a_child_that_dies_is_reported(tmp_path, room, monkeypatch):
    """An end without a word, as a crash inside COLMAP would be."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "sitecustomize.py").write_text(
        "import os, sys, signal\nif 'stages.sfm.child' in ' '.join(sys.orig_argv): os.kill(os.getpid(), signal.SIGABRT)"
    )
    with pytest.raises(BadInput, match="signal 6"):
        reconstruction.run_child(job_in(tmp_path, room), Context())
    assert os.environ["PYTHONPATH"] == str(tmp_path)
