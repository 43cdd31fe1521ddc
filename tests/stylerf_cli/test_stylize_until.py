"""`stylize --until`: a run that ends early, at once if it was interrupted there; to the bits of one without a break."""

import pytest

from schemas.work_folder import WorkFolder
from stages.viewing.half_done import steps_done
from stylerf.training.stylize.trainer import StylizationTrainer
from stylerf_cli.main import main
from tests.stylerf_cli.conftest import STYLIZE

STEPS = 3  # of the style phase, of the 6 of its budget


@pytest.fixture
def steps(monkeypatch):
    """Takes note of the steps of the style phase."""
    taken, plain = [], StylizationTrainer.run

    def run(trainer, on_step=lambda trainer: None):
        def noted(now):
            taken.append((now.state.phase, now.state.step))
            on_step(now)
            if breaks and taken[-1] == ("style", STEPS):
                raise KeyboardInterrupt

        plain(trainer, noted)

    breaks: list[bool] = []
    monkeypatch.setattr(StylizationTrainer, "run", run)
    return taken, breaks


def stylized(work, name: str, *flags: str) -> int:
    style = work / "field" / "painting-arf" / "style.png"
    return main(["stylize", str(work), "--style", str(style), *STYLIZE, "--name", name, "--quiet", *flags])


def contents(work, name: str) -> dict[str, bytes]:
    folder = work / "field" / name
    return {one.name: one.read_bytes() for one in sorted(folder.iterdir()) if one.name != "manifest.json"}


def test_an_interrupted_run_is_kept_where_it_is_and_goes_on(work, steps, capsys):
    taken, breaks = steps
    assert stylized(work, "straight", "--until", str(STEPS)) == 0
    assert taken[-1] == ("style", STEPS)
    assert stylized(work, "whole") == 0 and taken[-1] == ("style", 6)
    breaks.append(True)
    for name in ("kept", "resumed"):
        assert stylized(work, name) == 130
    breaks.clear()
    folder = WorkFolder(work)
    assert steps_done(folder, "kept") == STEPS and steps_done(folder, "straight") is None

    assert stylized(work, "kept", "--until", str(STEPS - 1)) == 2
    assert f"has taken {STEPS} style steps, more than --until {STEPS - 1}" in capsys.readouterr().err
    taken.clear()
    assert stylized(work, "kept", "--until", str(STEPS)) == 0
    assert taken == [], "it ends at once"
    assert contents(work, "kept") == contents(work, "straight") != contents(work, "whole")
    assert folder.get("field", "kept").manifest.figures["steps"] == STEPS

    assert stylized(work, "resumed") == 0
    assert taken == [("style", step) for step in range(STEPS + 1, 7)]
    assert contents(work, "resumed") == contents(work, "whole")


def test_a_field_that_ended_early_is_not_taken_for_a_whole_one(work, steps):
    taken, _ = steps
    assert stylized(work, "early", "--until", str(STEPS)) == 0
    taken.clear()
    assert stylized(work, "early", "--until", str(STEPS)) == 0 and taken == []
    assert stylized(work, "early") == 0 and taken[-1] == ("style", 6)
    assert stylized(work, "early", "--until", "-1") == 2
