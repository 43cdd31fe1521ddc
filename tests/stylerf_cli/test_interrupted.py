"""Ctrl-C in the midst of every long stage: a quick end with one line, and the same command goes on."""

import json
import os
import random
import shlex
import shutil
import signal
import time

import pytest

from schemas.work_folder import WorkFolder
from stylerf.training.stylize.scene import StyledScene
from stylerf_cli.main import main
from tests.stylerf_cli.long_stages import FOLLOWED_EVERY_SECONDS, IN_THE_GATE, assert_same, digests, stopped

LONGEST_SECONDS = 10


@pytest.mark.parametrize("name", IN_THE_GATE)
def test_ctrl_c_ends_a_stage_within_ten_seconds_and_the_next_run_goes_on(long_stage, nursery, name):
    stage, work = long_stage(name)
    chance = random.Random(3)
    for missed in range(6):  # each that came too late makes the next come earlier
        command, seconds = interrupted(nursery, stage, work, 0.7**missed * chance.random())
        if (work / stage.kind / "stopped").exists():  # the signal came when all was done
            shutil.rmtree(work / stage.kind / "stopped")
            continue
        assert seconds < LONGEST_SECONDS
        assert command.code == 130 and "Traceback" not in command.err, command.err
        line = shlex.join(map(str, stage.command("stopped")))  # ready to be pasted: its work folder has a space
        said = f"stylerf: error: interrupted; rerun to resume: stylerf {line}"
        assert command.err.splitlines()[-1] == said and command.err.count("stylerf: error") == 1
        assert command.out == ""
        break
    else:
        raise AssertionError("six runs ended before they could be interrupted")
    last = nursery.run(work.parent / "said", *stage.command("stopped"))
    assert last.code == 0 and "resuming the interrupted" in last.err, last.err
    assert_same(WorkFolder(work), stage, "stopped")


def interrupted(nursery, stage, work, moment):
    """The command after Ctrl-C at that share of its time, and the seconds it then took to end.

    Where other jobs keep the machine busy the processor time counts; one that hangs is given up after a minute.
    """
    command = stopped(nursery, stage, work, "stopped", signal.SIGINT, moment)
    requested, begun = time.monotonic(), command.cpu_seconds()
    used = begun
    while command.poll(FOLLOWED_EVERY_SECONDS) is None and time.monotonic() - requested < 60:
        used = max(used, command.cpu_seconds())
    command.wait(0)
    wall = time.monotonic() - requested
    return command, wall if os.getloadavg()[0] < 2 * (os.cpu_count() or 1) else used - begun


def test_ctrl_c_while_the_last_colors_are_matched_loses_nothing(long_stage, capsys, monkeypatch):
    """All style steps are done then, but the color map that ends a stylization is not."""
    stage, work = long_stage("stylize")
    command = [*map(str, stage.command("matched")), "--quiet"]

    def stop(stylizer):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(StyledScene, "match_renders", stop)
        assert main(command) == 130
    assert stage.partial(work, "matched").is_dir()
    assert main(command) == 0
    # Undisturbed in this same process: `whole` comes from another one, whose rounding the style steps amplify.
    assert main([*map(str, stage.command("undisturbed")), "--quiet"]) == 0
    matched, undisturbed = (WorkFolder(work).get("field", name) for name in ("matched", "undisturbed"))
    assert json.loads(matched.file("field.json").read_text())["color_map"] is not None
    assert digests(matched) == digests(undisturbed)
