"""Stylizing: commands that the command line takes, and the one that keeps a stopped run."""

from types import SimpleNamespace

import pytest

from schemas.errors import UsageError
from stages.run.training_loop import save_checkpoint
from stages.viewing.styles import METHODS, Wish
from tests.stages.viewing.command_lines import config_of


@pytest.mark.parametrize("method", METHODS)
def test_a_stylization_is_one_that_the_command_line_takes(desk, method):
    args, config = config_of(desk.stylizer.command(Wish("a b.png", method, "", 2.0, 1.0, "30s", "x")))
    assert (args.of, args.name, config.method, config.style) == ("plain", "x", method, "a b.png")
    assert (config.style_weight, config.budget) == (2.0, "30s")
    args, config = config_of(desk.stylizer.command(Wish("a b.png", method, "thing", 2.0, 0.5, "30s", "x")))
    assert (args.region, config.style, config.stroke, config.style_weight) == ("thing", "a b.png", 0.5, 6.0)


def ended(arguments: list[str], code: int) -> SimpleNamespace:
    return SimpleNamespace(arguments=arguments, code=code)


def test_a_stopped_stylization_is_kept_by_the_same_command(desk):
    arguments = desk.stylizer.command(Wish("a.png", name="half"))
    for run in (None, ended(arguments, 0), ended(["render", "x"], 130), ended([*arguments, "--region", "a"], 130)):
        desk.runs.present = run
        with pytest.raises(UsageError, match="nothing to keep"):
            desk.stylizer.keep_command()
    desk.runs.present = ended(arguments, 130)
    with pytest.raises(UsageError, match="resume it"):
        desk.stylizer.keep_command()
    folder = desk.library.work.root / "field" / ".half.partial" / "checkpoint"
    folder.mkdir(parents=True)
    save_checkpoint(folder, {"state": {"phase": "refit", "step": 200}}, {})
    with pytest.raises(UsageError, match="resume it"):
        desk.stylizer.keep_command()
    save_checkpoint(folder, {"state": {"phase": "style", "step": 17}}, {})
    assert config_of(desk.stylizer.keep_command())[1].until == 17
    assert desk.stylizer.keep_command() == [*arguments, "--until", "17"]
    desk.runs.present = ended([*arguments, "--until", "30"], 130)
    assert desk.stylizer.keep_command() == [*arguments, "--until", "17"]


def test_a_stylization_needs_a_painting_and_a_name(desk):
    with pytest.raises(UsageError, match="choose one first"):
        desk.stylizer.command(Wish(""))
    with pytest.raises(UsageError, match="valid name"):
        desk.stylizer.command(Wish("a.png", name="../x"))
