"""frames.json: written and read, and those of before masks still read."""

import json

import pytest

from schemas.errors import ArtifactDamaged
from schemas.frames import Frame, FrameCamera, Frames, read_frames, write_frames

EYE = tuple(tuple(float(i == j) for j in range(4)) for i in range(4))
FRAMES = Frames("fit", "test", (Frame("a", "exr/a.exr", "png/a.png", FrameCamera(4, 3, 5.0, 5.0, 2.0, 1.5, EYE), 1),))


def test_masks_are_kept_by_region(tmp_path):
    reported = Frames(FRAMES.field, FRAMES.path, FRAMES.views, 24.0, {"left.eye": "left_eye"})
    write_frames(tmp_path, reported)
    assert read_frames(tmp_path) == reported
    assert json.loads((tmp_path / "frames.json").read_text())["masks"] == {"left.eye": "left_eye"}


def test_frames_of_before_masks_show_none(tmp_path):
    write_frames(tmp_path, FRAMES)
    old = json.loads((tmp_path / "frames.json").read_text())
    del old["masks"]
    (tmp_path / "frames.json").write_text(json.dumps(old))
    assert read_frames(tmp_path) == FRAMES and read_frames(tmp_path).masks == {}


def test_masks_of_another_form_are_damage(tmp_path):
    write_frames(tmp_path, FRAMES)
    old = json.loads((tmp_path / "frames.json").read_text())
    (tmp_path / "frames.json").write_text(json.dumps({**old, "masks": ["left"]}))
    with pytest.raises(ArtifactDamaged, match="stylerf render"):
        read_frames(tmp_path)
