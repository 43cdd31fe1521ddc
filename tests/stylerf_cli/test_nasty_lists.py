"""Whatever stands in a transforms.json: it is taken, or refused in words, but never met with a crash."""

import copy
import math
from collections.abc import Iterator

import pytest

from stylerf_cli.main import main
from tests.stylerf_cli import capture

pytestmark = pytest.mark.filterwarnings("error")

NASTY = (
    None,
    True,
    "",
    "x",
    0,
    -1,
    1e308,
    10**400,
    math.nan,
    math.inf,
    -math.inf,
    [],
    {},
    [[]],
    "\0",
    "../../../etc/passwd",
    [None] * 4,
)
KEYS = ("w", "h", "fl_x", "fl_y", "cx", "cy", "k1", "p2", "is_fisheye", "camera_model", "applied_transform",
        "camera_angle_x", "val_filenames", "train_filenames", "frames", "aabb_scale")  # fmt: skip
FRAME_KEYS = ("file_path", "transform_matrix", "mask_path", "w", "fl_x", "k2")


def damaged_everywhere() -> Iterator[tuple[str, object]]:
    """What was done, and the content."""
    for value in NASTY:
        for key in KEYS:
            yield f"{key} = {value!r:.30}", capture.transforms() | {key: value}
        for key in FRAME_KEYS:
            content = copy.deepcopy(capture.transforms())
            content["frames"][1][key] = value
            yield f"frames[1].{key} = {value!r:.30}", content
        content = capture.transforms()
        yield f"a frame is {value!r:.30}", content | {"frames": [value, *content["frames"]]}
        yield f"all is {value!r:.30}", value


def test_whatever_stands_in_transforms_json_there_is_no_crash(source, tmp_path, capsys):
    """Taken as it is, or refused in words: an unexpected exception would end with exit code 1."""
    refused, crashed = 0, []
    for number, (name, content) in enumerate(damaged_everywhere()):
        capture.write_transforms(source, content)
        code = main(["import", str(source), str(tmp_path / f"{number}"), "--quiet", "--format", "transforms"])
        err = capsys.readouterr().err
        refused += code == 3
        if code not in (0, 3) or err.count("\n") != (code == 3):
            crashed.append(f"{name}: {err}")
    assert not crashed, "\n".join(crashed)
    assert refused > 100
