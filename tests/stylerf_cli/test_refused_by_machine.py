"""No space, no permission, no memory: exit code 5, one line, the older artifact whole, and the same command goes on
when the machine gives way."""

import errno
import json
import os
import subprocess
from pathlib import Path

import pytest

from schemas.atomic_write import is_temporary
from schemas.work_folder import WorkFolder
from stylerf.training.fit import engine as fitting
from stylerf_cli.main import main
from tests.stylerf_cli.conftest import FIT
from tests.stylerf_cli.long_stages import IN_THE_GATE, assert_same

# Below the largest file of every stage, above that of a recipe.
SMALL_FILE = 12_000


def assert_refused(command, words: str) -> str:
    """Exit code 5 and one line of fault, the last; nothing but notes before it."""
    assert command.code == 5, command.err
    lines = command.err.splitlines()
    assert lines[-1].startswith("stylerf: error: ") and words in lines[-1]
    assert command.err.count("stylerf: error") == 1 and "Traceback" not in command.err
    return lines[-1]


def half_written(folder: Path) -> list[Path]:
    """Leftovers of writes. libjpeg ends the child of structure from motion where it stands: its own is left for the
    next run to delete."""
    found = [path for path in folder.rglob(".*") if is_temporary(path)]
    return [path for path in found if path.parent.name != "copies"]


@pytest.mark.parametrize("name", IN_THE_GATE)
def test_a_disk_that_takes_no_more_stops_a_stage_which_then_goes_on(long_stage, nursery, name):
    """A limit on the size of files, which the system meets with EFBIG as it meets a full disk with ENOSPC."""
    stage, work = long_stage(name)
    said = work.parent / "said"
    limited = nursery.run(said, *stage.command("limited"), limits={"RLIMIT_FSIZE": SMALL_FILE})
    assert "free some space and run the same command" in assert_refused(limited, "no space left to write")
    assert not (work / stage.kind / "limited").exists()
    assert half_written(work) == []
    for artifact in WorkFolder(work).artifacts():
        artifact.verify()
    last = nursery.run(said, *stage.command("limited"))
    assert last.code == 0 and "resuming the interrupted" in last.err, last.err
    assert_same(WorkFolder(work), stage, "limited")


def test_the_older_artifact_stands_while_its_successor_cannot_be_written(work, nursery):
    before = WorkFolder(work).get("field", "fit").digest
    again = ("fit", work, *FIT, "--seed", "1")
    assert_refused(nursery.run(work.parent / "said", *again, limits={"RLIMIT_FSIZE": SMALL_FILE}), "no space left")
    kept = WorkFolder(work).get("field", "fit")
    kept.verify()
    assert kept.digest == before
    assert nursery.run(work.parent / "said", *again).code == 0
    assert WorkFolder(work).get("field", "fit").digest != before


@pytest.fixture
def disk(tmp_path):
    """Mounts a tmpfs of so many kilobytes, and whatever else is asked; skips where that is not permitted."""
    folder = tmp_path / "disk"
    folder.mkdir()

    def mount(*options: str) -> Path:
        command = ["mount", "-t", "tmpfs", "-o", ",".join(options), "none", str(folder)]
        if os.geteuid() != 0 or subprocess.run(command, capture_output=True, check=False).returncode != 0:
            pytest.skip("mounting a tmpfs needs root; the limit on the size of files above takes the same way")
        return folder

    yield mount
    if os.path.ismount(folder):
        subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.parametrize(
    ("source", "kilobytes"),
    [
        ("photos", 100),
        ("room", 200),
        pytest.param("room", 60, marks=pytest.mark.slow),
        pytest.param("room", 900, marks=pytest.mark.slow),
    ],
)
def test_a_full_disk_stops_an_import_and_a_larger_one_lets_it_go_on(
    disk, nursery, tmp_path, source, kilobytes, request
):
    """With poses, and by structure from motion, whose child process meets the full disk first."""
    folder = disk(f"size={kilobytes}k")
    command = ("import", request.getfixturevalue(source), folder / "work")
    line = assert_refused(nursery.run(tmp_path / "said", *command), "no space left to write")
    assert str(folder) in line
    assert WorkFolder(folder / "work").artifacts() == []
    assert half_written(folder) == []
    subprocess.run(["mount", "-o", "remount,size=64m", str(folder)], check=True)
    assert nursery.run(tmp_path / "said", *command).code == 0
    WorkFolder(folder / "work").get("scene", "main").verify()


def test_a_read_only_disk_is_reported(disk, nursery, photos, tmp_path):
    folder = disk("size=16m")
    assert nursery.run(tmp_path / "said", "import", photos, folder / "work").code == 0
    subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
    line = assert_refused(nursery.run(tmp_path / "said", "fit", folder / "work", *FIT), "no permission")
    assert str(folder) in line
    assert nursery.run(tmp_path / "said", "verify", folder / "work").code == 0  # reading needs no permission to write


@pytest.mark.parametrize("place", ["closed", "under a file", "/proc", "/sys"])
def test_a_place_that_cannot_be_written_to_is_reported(photos, tmp_path, capsys, place):
    """/proc and /sys refuse root too."""
    if place == "closed":
        if os.geteuid() == 0:
            pytest.skip("root may write anywhere; /sys and the read-only disk refuse it as well")
        (tmp_path / "closed").mkdir(mode=0o500)
    if place == "under a file":
        (tmp_path / "under a file").write_text("")
    if place.startswith("/") and not os.path.isdir(place):
        pytest.skip(f"there is no {place}")
    work = Path(place, "stylerf-work") if place.startswith("/") else tmp_path / place / "work"
    assert main(["import", str(photos), str(work), "--quiet"]) == 5
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and str(work) in err and ("choose" in err or "free" in err)


def test_too_little_memory_is_reported(work, nursery, tmp_path):
    """A camera of 16,000 x 16,000 pixels in an address space of four gigabytes."""
    camera = {"world_from_camera": [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 4], [0, 0, 0, 1]], "width": 16_000,
              "height": 16_000, "fx": 16e3, "fy": 16e3, "cx": 8e3, "cy": 8e3}  # fmt: skip
    (tmp_path / "large.json").write_text(json.dumps([camera]))
    command = ("render", work, "--of", "fit", "--path", tmp_path / "large.json")
    line = assert_refused(
        nursery.run(tmp_path / "said", *command, limits={"RLIMIT_AS": 4_000_000_000}), "out of memory"
    )
    assert "smaller" in line and "rerun the same command" in line


def short_of_memory(times: int, real):
    """`real`, failing the first `times` times."""
    left = [times]

    def called(*arguments, **keywords):
        if left[0] > 0:
            left[0] -= 1
            raise MemoryError
        return real(*arguments, **keywords)

    return called


def test_a_batch_that_does_not_fit_is_worked_off_in_parts_which_is_said(work, capsys, monkeypatch):
    """The parts' gradients add up to the whole's, so the fit ends as good."""
    monkeypatch.setattr(fitting.CpuEngine, "warm_up", lambda *fields: None)  # its renders are not to be counted
    whole = json.loads(fitted(work, capsys, "whole")[0])["figures"]["curve"][-1]["psnr"]
    monkeypatch.setattr(fitting, "render_rays", short_of_memory(2, fitting.render_rays))
    out, err = fitted(work, capsys, "parts")
    assert "batches are now split into 2 parts" in err and "into 4 parts" in err
    assert json.loads(out)["figures"]["curve"][-1]["psnr"] == pytest.approx(whole, abs=0.1)


def test_not_even_a_part_that_fits_ends_with_5_and_keeps_the_run(work, capsys, monkeypatch):
    monkeypatch.setattr(fitting.CpuEngine, "warm_up", lambda *fields: None)
    monkeypatch.setattr(fitting, "render_rays", short_of_memory(1000, fitting.render_rays))
    assert main(["fit", str(work), *FIT, "--name", "small", "--quiet"]) == 5
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "out of memory" in err
    assert WorkFolder(work).unfinished() == [("field", "small")]


def fitted(work, capsys, name) -> tuple[str, str]:
    """The JSON object and the notes of a fit."""
    assert main(["fit", str(work), *FIT, "--name", name, "--json"]) == 0
    return capsys.readouterr()


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_a_disk_that_fills_at_the_end_leaves_nothing_half_written(work, capsys, monkeypatch, call):
    """ENOSPC from flush or rename, which is where delayed allocation and quotas show."""
    real = getattr(os, call)

    def full(*arguments, **keywords):
        if full.left == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        full.left -= 1
        return real(*arguments, **keywords)

    for left in (0, 3, 5):
        full.left = left
        with monkeypatch.context() as patch:
            patch.setattr(os, call, full)
            command = f"render {work} --of fit --path test --name late-{left} --quiet"
            code = main(command.split())
        err = capsys.readouterr().err
        assert code == 5 and err.count("\n") == 1 and "no space left" in err
        assert half_written(work) == []
        assert not (work / "frames" / f"late-{left}").exists()
