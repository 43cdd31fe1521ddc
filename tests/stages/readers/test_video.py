"""Video as a source: the chosen frames avoid blur, are even in motion, upright and of the right times."""

import json

import numpy as np
import pytest

pytest.importorskip("av")

from schemas.errors import BadInput
from schemas.images import read_image, write_png
from stages.readers import found_in
from stages.readers.video import _name, clips_of, frames_as_photos
from stages.run.progress import Context
from stages.sfm.colmap_database import KEY_FRAME_EVERY, OVERLAP, chosen_matching, pairs
from tests.stages.clips import orbit, pictures, smeared, write_clip
from tests.stages.importing import Said, imported, scene_of
from tests.stages.photo_room import write_photos

COUNT, BLUR = 60, range(27, 33)
# Slow at first, then faster, as a hand moves.
ANGLES = 0.4 + 0.7 * np.linspace(0, 1, COUNT) ** 1.5
TIMES = np.cumsum(np.where(np.arange(COUNT) % 3 == 0, 0.05, 0.02))


@pytest.fixture(scope="module")
def walk():
    return pictures(orbit(ANGLES, 240, 180, 225.0))


@pytest.fixture(scope="module")
def clip(walk, tmp_path_factory):
    shown = [np.rot90(smeared(one) if k in BLUR else one) for k, one in enumerate(walk)]
    return write_clip(tmp_path_factory.mktemp("clip") / "walk.mp4", shown, TIMES, turn=-90)


@pytest.fixture(scope="module")
def chosen(clip, tmp_path_factory):
    folder = tmp_path_factory.mktemp("frames")
    said = Said()
    return frames_as_photos([clip], 15, folder, Context(progress=said)), folder, said


def numbers(folder) -> list[int]:
    return [number for _, number, _ in json.loads((folder / "choice.json").read_text())["frames"]]


def test_chosen_frames_are_sharp_and_even_in_motion(chosen):
    _, folder, said = chosen
    kept = numbers(folder)
    assert not set(kept) & set(BLUR) and 12 <= len(kept) <= 15
    # In the room the picture moves by the angle; where the blurred stretch lies, a gap is left.
    gaps = np.diff(ANGLES[kept])
    across = [k for k in range(len(gaps)) if kept[k] < BLUR[0] <= kept[k + 1]]
    gaps = np.delete(gaps, across)
    assert gaps.std() < 0.5 * gaps.mean() and gaps.max() < 2.2 * gaps.mean()
    assert gaps.std() / gaps.mean() < np.diff(ANGLES).std() / np.diff(ANGLES).mean() + 0.1
    assert f"chose {len(kept)} of 60 frames, sharp ones at even steps of motion" in said.lines[-1]


def test_chosen_frames_are_upright_and_named_by_their_times(chosen, walk):
    photos, folder, _ = chosen
    for (path, clip_number), number in zip(photos, numbers(folder), strict=True):
        assert clip_number == 0
        time = float(path.stem.removeprefix("walk-").removesuffix("s"))
        assert time == pytest.approx(TIMES[number] - TIMES[0], abs=1e-3)
        pixels = read_image(path).pixels
        assert pixels.shape == (180, 240, 3)
        # H.264 keeps a quarter of the colors, so the brightness is compared.
        assert np.abs((pixels - walk[number] / 255).mean(axis=2)).mean() < 0.02


def test_interrupted_choosing_goes_on_with_the_same_bytes(chosen, clip, tmp_path):
    photos, folder, _ = chosen
    whole = {one.name: one.read_bytes() for one in folder.iterdir()}
    for one in folder.iterdir():
        (tmp_path / one.name).write_bytes(one.read_bytes())
    (tmp_path / photos[3][0].name).unlink()
    (tmp_path / photos[5][0].name).write_bytes(b"cut short")
    again = frames_as_photos([clip], 15, tmp_path, Context())
    assert [one.name for one, _ in again] == [one.name for one, _ in photos]
    assert all(path.read_bytes() == whole[path.name] for path, _ in again)


def test_frames_of_a_clip_with_a_long_name_can_be_written(tmp_path):
    path = tmp_path / ("\u6620" * 80 + ".mp4")  # 244 bytes
    name = _name(path, 11, 2, 12, 1.5)
    write_png(tmp_path / name, np.zeros((2, 2, 3), np.uint8))
    assert name == "11-" + "\u6620" * 26 + "-00001.500000s.png"
    assert _name(tmp_path / ("a" * 90 + ".mp4"), 0, 1, 1, 1.5) == "a" * 80 + "-00001.500000s.png"


def test_a_still_clip_is_refused(walk, tmp_path):
    clip = write_clip(tmp_path / "still.mp4", [walk[0]] * 10, np.arange(10) / 30)
    with pytest.raises(BadInput, match=r"still.mp4: the picture moves by 0\.\d% .* if the camera moves"):
        frames_as_photos([clip], 5, tmp_path / "frames", Context())


def test_video_is_found_where_there_are_no_photos(clip, walk, tmp_path):
    assert found_in(clip).kind == "video" and found_in(clip.parent).kind == "video"
    write_photos(tmp_path, orbit([0.5], 32, 24, 30.0))
    (tmp_path / "b10.mp4").write_bytes(clip.read_bytes())
    (tmp_path / "b2.MOV").write_bytes(clip.read_bytes())
    found = found_in(tmp_path)
    assert found.kind == "photos"
    assert found.remarks == ("video is ignored because there are photos (b2.MOV, b10.mp4); --format video imports it",)
    assert [one.name for one in clips_of(tmp_path)] == ["b2.MOV", "b10.mp4"]


@pytest.mark.parametrize(
    "options, why",
    [({"images": "x"}, "--images names a folder of photos"), ({"format": "photos"}, "is a file; give the folder")],
)
def test_options_that_video_does_not_take(clip, tmp_path, options, why):
    with pytest.raises(BadInput, match=why):
        imported(clip, tmp_path / "w", **options)


def test_frames_of_photos_are_refused(tmp_path):
    write_photos(tmp_path / "p", orbit([0.5, 0.6, 0.7], 32, 24, 30.0))
    with pytest.raises(BadInput, match="--frames is for video"):
        imported(tmp_path / "p", tmp_path / "w", frames=20)


def test_frames_follow_each_other_and_clips_are_joined_by_key_frames():
    assert chosen_matching("auto", ["a"] * 200, video=True)[0] == "sequential"
    first = pairs(80, "sequential", [0] * 50 + [1] * 30)
    assert len(set(first)) == len(first) and all(i < j for i, j in first)
    near = {(i, j) for i, j in first if j - i <= OVERLAP}
    assert all((i, i + 1) in near for i in range(79) if i != 49)
    across = {(i, j) for i, j in first if i < 50 <= j}
    keys = range(0, 80, KEY_FRAME_EVERY // 2)
    assert across == {(i, j) for i in keys for j in keys if i < 50 <= j}
    assert pairs(80, "sequential") == pairs(80, "sequential", [0] * 80)


def test_two_clips_become_one_scene(walk, tmp_path):
    source = tmp_path / "clips"
    source.mkdir()
    write_clip(source / "a.mp4", walk[:36], TIMES[:36])
    write_clip(source / "b.mp4", walk[24:], TIMES[24:])
    said = Said()
    scene = scene_of(imported(source, tmp_path / "w", said, frames=16))
    assert any("structure from motion of 16 frames" in line for line in said.lines)
    assert len(scene.views) >= 14
    assert {view.source[:4] for view in scene.views} == {"0-a-", "1-b-"}
