"""`stylerf stress`: what it writes, what it does not do twice, how a baseline ends it; stand-ins run but in one."""

import csv
import json
import os
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from schemas.canonical_json import file_sha256
from schemas.errors import ArtifactDamaged, ArtifactStale, BadInput, OutOfResources, UsageError
from schemas.work_folder import WorkFolder
from stages.configs.faults import FAULTS, METHODS
from stages.configs.stress import StressConfig
from stages.run.progress import Context
from stages.stress import edit_trials, trials
from stages.stress.criteria import Verdict, ViewPair
from stylerf.errors import Diverged
from stylerf_cli.main import main
from tests.stages.stress_fixture import make_capture

FEW = ("--methods", "fit", "arf", "--faults", "seeds", "blur", "style-white", "--seeds", "3", "--budget", "10")


class Runs:
    """Stands in for scenes, fits and stylizations. made: what was asked for; answer: score by method and fault."""

    def __init__(self) -> None:
        self.made: list[tuple[str, str, int, bool]] = []
        self.answers = {("fit", "blur"): 9.0}
        self.raising: dict[tuple[str, str, int], BaseException] = {}
        self.during = lambda: None

    def scene(self, trial):
        self.during()
        if error := self.raising.get(("scene", trial.fault.name, trial.seed)):
            raise error

    def verdict(self, trial, scene):
        self.made.append((trial.method.name, trial.fault.name, trial.seed, trial.remedies))
        if error := self.raising.get((trial.method.name, trial.fault.name, trial.seed)):
            raise error
        score = self.answers.get((trial.method.name, trial.fault.name), 20.0) + 0.1 * trial.seed
        ok = score > 10
        return Verdict(ok, "" if ok else "too low", score, 0, {"psnr": score}), np.full((4, 8, 3), trial.seed / 9)


@pytest.fixture
def runs(monkeypatch):
    stand_in = Runs()
    monkeypatch.setattr(trials.Stress, "_scene", stand_in.scene)
    monkeypatch.setattr(trials.Stress, "_verdict", stand_in.verdict)
    monkeypatch.setattr(trials, "style_image_of", lambda fault, side, seed: np.full((16, 16, 3), 0.1 * seed))
    return stand_in


@pytest.fixture
def folder(tmp_path):
    make_capture(WorkFolder(tmp_path / "room"))
    return tmp_path / "room"


def stress(folder, *more) -> int:
    return main(["stress", str(folder), *FEW, *more])


def test_files_and_json_tell_the_same(folder, runs, capsys):
    before = (folder / "scene" / "main" / "manifest.json").stat().st_mtime_ns
    assert stress(folder, "--json") == 0
    result, out = json.loads(capsys.readouterr().out), folder / "stress"
    assert len(runs.made) == len({*runs.made}) == 3 * (2 + 2 + 1)  # a fit never sees a painting
    cells = {(cell["fault"], cell["method"]): cell for cell in result["cells"]}
    assert [*cells] == [
        ("seeds", "fit"), ("seeds", "arf"), ("blur", "fit"), ("blur", "arf"), ("style-white", "arf"),
    ]  # fmt: skip
    assert (cells["blur", "fit"]["successes"], cells["blur", "fit"]["count"]) == (0, 3)
    assert cells["blur", "fit"]["median"] == pytest.approx(9.1) and cells["seeds", "arf"]["rate"] == 1
    kept = json.loads((out / "stress.json").read_text())
    assert {key: result[key] for key in kept} == kept
    for name in ("stress.html", "charts/heat_map.svg", "charts/heat_map.png"):
        assert (out / name).is_file(), name
    assert {path.stem for path in (out / "worst").iterdir()} == {path.stem for path in (out / "runs").iterdir()}
    page = (out / "stress.html").read_text()
    assert page.count("data:image/png") == 5 and (out / "worst" / cells["blur", "fit"]["worst"]["picture"]).is_file()
    with open(out / "cells.csv", newline="") as stream:
        rows = {(row["fault"], row["method"]): row for row in csv.DictReader(stream)}
    assert rows["blur", "fit"]["rate"] == "0.0" and float(rows["seeds", "fit"]["median"]) == pytest.approx(20.1)
    with open(out / "runs.csv", newline="") as stream:
        assert len([*csv.DictReader(stream)]) == 15
    assert (folder / "scene" / "main" / "manifest.json").stat().st_mtime_ns == before
    assert main(["verify", str(folder), "--quiet"]) == 0  # what it writes is not an artifact of this work folder


def test_leftovers_of_a_killed_run_are_deleted(folder, runs):
    assert stress(folder) == 0
    out = folder / "stress"
    left = [out / name / ".heat_map.0a1b2c3d.tmp.svg" for name in ("", "charts", "runs", "styles", "worst")]
    for path in left:
        path.write_text("half")
    assert stress(folder) == 0
    assert not any(path.exists() for path in left) and (out / "charts" / "heat_map.svg").is_file()


def test_what_stands_is_not_run_again(folder, runs, capsys):
    runs.raising["arf", "blur", 1] = KeyboardInterrupt()
    assert stress(folder) == 130
    done = [*runs.made[:-1]]
    runs.raising.clear()
    assert stress(folder) == 0
    assert len(runs.made) == 1 + 15 and set(done).isdisjoint(runs.made[len(done) + 1 :])
    assert stress(folder) == 0 and len(runs.made) == 16
    assert stress(folder, "--only") == 0 and len(runs.made) == 16
    # Another budget is another key; so is another painting, but for the methods that see one.
    assert stress(folder, "--style-budget", "11") == 0 and len(runs.made) == 16 + 9
    assert stress(folder, "--style-budget", "11", "--force") == 0 and len(runs.made) == 25 + 15
    assert stress(folder, "--style-budget", "11", "--seed", "1") == 0 and len(runs.made) == 40 + 5  # seed 3 is new
    assert stress(folder) == 0 and len(runs.made) == 45  # what was run first is there still
    capsys.readouterr()


def test_a_second_stress_of_a_work_folder_is_refused_until_the_first_ends(folder, runs, capsys):
    codes: list[tuple[int, int]] = []

    def second() -> None:
        if len(runs.made) in (0, 14):
            runs.during = lambda: None
            codes.append((stress(folder), stress(folder, "--only")))
            runs.during = second

    runs.during = second
    assert stress(folder) == 0 and len(runs.made) == 15
    assert codes == [(5, 4), (5, 0)]  # nothing stood at first
    reported = f"stress runs is being written by another process ({os.getpid()} on "
    err = capsys.readouterr().err
    assert reported in err and "wait for it to finish, or add --only" in err
    runs.during = lambda: None
    assert stress(folder, "--force") == 0
    runs.raising["fit", "seeds", 0] = OutOfResources("no space")
    assert stress(folder, "--force") == 5 and "no space" in capsys.readouterr().err
    runs.raising.clear()
    assert stress(folder, "--force") == 0


def test_nothing_stands_and_nothing_faces(folder, runs, capsys):
    assert stress(folder, "--only") == 4 and runs.made == []
    assert not (folder / "stress").exists()  # not even a painting
    assert main(["stress", str(folder), "--methods", "fit", "--faults", "style-white"]) == 2
    assert main(["stress", str(folder), "--methods", "magic"]) == 2
    assert "choose from fit, fit-hash" in capsys.readouterr().err


def test_what_breaks_has_failed_and_what_the_machine_refuses_ends_it(folder, runs, capsys):
    runs.raising["fit", "seeds", 0] = Diverged("left the finite numbers")
    runs.raising["fit", "seeds", 1] = BadInput("no such thing")
    runs.raising["fit", "seeds", 2] = FloatingPointError("overflow")
    assert stress(folder, "--json") == 0
    cells = json.loads(capsys.readouterr().out)["cells"]
    assert cells[0]["successes"] == 0 and cells[0]["median"] is None and len(cells[0]["whys"]) == 3
    assert cells[0]["worst"]["picture"] == ""
    runs.raising = {("arf", "blur", 0): OutOfResources("no space")}
    assert stress(folder, "--force") == 5


@pytest.mark.parametrize("fault", [TypeError("no such argument"), AssertionError(), Exception("of a compiler")])
def test_whatever_a_method_raises_it_has_failed(folder, runs, capsys, fault):
    runs.raising["fit", "seeds", 1] = fault
    assert stress(folder, "--json") == 0
    cell = json.loads(capsys.readouterr().out)["cells"][0]
    assert (cell["successes"], cell["count"]) == (2, 3) and type(fault).__name__ in cell["whys"][0]


@pytest.mark.parametrize("fault", [UsageError("no network"), ArtifactDamaged("cut short"), ArtifactStale("gone")])
def test_what_is_not_of_a_method_ends_it_and_is_not_counted(folder, runs, capsys, fault):
    runs.raising["fit", "seeds", 1] = fault
    assert stress(folder) == fault.exit_code and str(fault) in capsys.readouterr().err
    assert [path.name.split("--")[2] for path in (folder / "stress" / "runs").glob("fit--seeds--*")] == ["0"]


def test_another_trunk_or_device_is_another_run_and_no_baseline(folder, runs, capsys, monkeypatch, tmp_path):
    baseline = str(tmp_path / "baseline.json")
    assert stress(folder, "--write-baseline", baseline) == 0 and len(runs.made) == 15
    other = {"features": "another-network", "features_digest": ""}
    monkeypatch.setattr(trials.resolve, "chosen", lambda features: other)
    assert stress(folder, "--baseline", baseline) == 2 and "now 'another-network'" in capsys.readouterr().err
    assert stress(folder) == 0 and len(runs.made) == 15 + 9  # a fit sees no painting
    monkeypatch.setattr(trials.resolve, "chosen", lambda features: (_ for _ in ()).throw(UsageError("none")))
    fits = ("--methods", "fit", "--faults", "seeds", "blur", "--seeds", "3", "--budget", "10")
    assert stress(folder) == 2 and main(["stress", str(folder), *fits]) == 0
    kept = str(tmp_path / "fits.json")  # of fits: whatever weights there are, they compare
    assert main(["stress", str(folder), *fits, "--write-baseline", kept]) == 0
    assert "features" not in (folder / "stress" / "stress.html").read_text()
    monkeypatch.setattr(trials.resolve, "found_extractor", lambda: "yet-another")
    assert main(["stress", str(folder), *fits, "--baseline", kept]) == 0
    assert main(["stress", str(folder), *fits, "--baseline", baseline]) == 0
    monkeypatch.setattr(trials.resolve, "chosen", lambda features: other)
    capsys.readouterr()
    assert stress(folder, "--baseline", kept) == 0 and "no cell of 2 compared" in capsys.readouterr().out
    monkeypatch.undo()
    config = StressConfig(methods=("fit",), faults=("seeds",))
    keys = []
    for device in ("cpu", "cuda"):
        one = trials.Stress(Context(device=device), config, WorkFolder(folder).get("scene", "main"), folder / "stress")
        keys.append(one.key_of(next(one.trials())))
        assert one.conditions["device"] == device and one.conditions["criteria"] == trials.criteria.REVISION
    assert keys[0] != keys[1]


def test_what_stands_is_found_without_its_painting(folder, runs, capsys):
    assert stress(folder) == 0
    shutil.rmtree(folder / "stress" / "styles")
    assert stress(folder, "--only") == 0 and len(runs.made) == 15
    assert not (folder / "stress" / "styles").exists()


def test_paintings_are_made_again_by_force_and_of_another_revision(folder, runs, capsys, monkeypatch, tmp_path):
    baseline, made = str(tmp_path / "baseline.json"), []

    def other(fault, side, seed):
        made.append((fault, seed))
        return np.full((16, 16, 3), 0.9)

    assert stress(folder, "--write-baseline", baseline) == 0
    before = {path.name: path.read_bytes() for path in (folder / "stress" / "styles").iterdir()}
    monkeypatch.setattr(trials, "style_image_of", other)
    assert stress(folder) == 0 and made == [] and len(runs.made) == 15
    assert stress(folder, "--force", "--only") == 4 and made == []
    assert stress(folder, "--force") == 0
    assert sorted(made) == [("", 0), ("", 1), ("", 2), *(("style-white", seed) for seed in range(3))]
    assert all((folder / "stress" / "styles" / name).read_bytes() != content for name, content in before.items())
    assert stress(folder, "--baseline", baseline) == 0  # who changes a painting tells by its revision
    monkeypatch.setattr(trials.style_images, "REVISION", 2)
    capsys.readouterr()
    assert stress(folder, "--baseline", baseline) == 2 and "paintings 1, now 2" in capsys.readouterr().err
    assert stress(folder) == 0 and len(made) == 12


def test_a_baseline_does_not_replace_itself(folder, runs, capsys, tmp_path):
    baseline = folder / "stress" / "baseline.json"
    assert stress(folder, "--write-baseline") == 0
    before = baseline.read_bytes()
    runs.answers["arf", "seeds"] = 5.0
    for named in (["--write-baseline"], ["--write-baseline", str(baseline)]):
        assert stress(folder, "--force", "--baseline", f"{folder}/stress/../stress/baseline.json", *named) == 2
        assert "name the same file" in capsys.readouterr().err
    assert baseline.read_bytes() == before


def test_what_a_killed_run_left_goes_once_all_of_it_stands(folder, runs, capsys):
    left, kept = (folder / "stress" / "works" / name for name in ("seeds-0", "seeds-1"))

    def leave() -> None:
        for place in (left, kept):
            (place / "field").mkdir(parents=True, exist_ok=True)
        (kept / trials.KEEP_MARKER).touch()

    leave()
    runs.raising["arf", "seeds", 0] = KeyboardInterrupt()
    assert stress(folder) == 130 and left.exists()
    runs.raising.clear()
    assert stress(folder) == 0 and kept.exists() and not left.exists()
    leave()
    assert stress(folder, "--only") == 0 and left.exists()
    assert stress(folder, "--keep") == 0 and left.exists()
    assert stress(folder) == 0 and not left.exists() and kept.exists()


class Stages:
    """Stands in for every stage that a stress executes: a folder and a second each. made: place, stage and seed."""

    def __init__(self) -> None:
        self.made: list[tuple[str, str, int]] = []
        self.raising: dict[str, Exception] = {}  # by stage

    def execute(self, spec, run, work, name, inputs, config, context):
        self.made.append((work.root.name, spec.stage, context.seed))
        (work.root / spec.writes).mkdir(parents=True, exist_ok=True)
        if error := self.raising.get(spec.stage):
            raise error
        return SimpleNamespace(manifest=SimpleNamespace(seconds=1.0)), False


@pytest.fixture
def stages(monkeypatch):
    stand_in, view = Stages(), ViewPair("v", np.zeros((4, 4, 3)), np.ones((4, 4, 3)))
    monkeypatch.setattr(trials, "execute", stand_in.execute)
    monkeypatch.setattr(trials, "view_pairs", lambda *_: [view])
    monkeypatch.setattr(trials.criteria, "judge_style", lambda *_: Verdict(True, "", 0.5, 0))
    monkeypatch.setattr(trials, "style_image_of", lambda *_: np.zeros((16, 16, 3)))
    return stand_in


def test_a_run_without_keep_leaves_what_another_kept(folder, stages, capsys):
    one = ("--faults", "seeds", "--seeds", "1", "--budget", "10")
    place = folder / "stress" / "works" / "seeds-0"
    assert main(["stress", str(folder), "--methods", "fit", *one]) == 0 and not place.exists()
    assert main(["stress", str(folder), "--methods", "arf", *one, "--keep"]) == 0 and (place / "field").is_dir()
    made = len(stages.made)
    assert main(["stress", str(folder), "--methods", "desrf", *one]) == 0
    assert len(stages.made) > made and (place / "field").is_dir()
    assert main(["stress", str(folder), "--methods", "desrf", *one, "--force"]) == 0 and not place.exists()


def test_a_fit_that_fails_is_not_run_again_for_what_would_be_made_of_it(folder, stages, capsys):
    stages.raising["nerf_fit"] = Diverged("left the finite numbers")
    methods = ("fit", "fit-hash", "arf", "desrf", "laenerf-recolor")
    more = ("--faults", "seeds", "blur", "style-white", "--seeds", "2", "--budget", "10", "--remedies", "both")
    assert main(["stress", str(folder), "--methods", *methods, *more, "--json"]) == 0
    fits = [place for place, stage, _ in stages.made if stage == "nerf_fit"]
    # Of each scene and seed: vm and hash, without remedies and with them.
    assert {place: fits.count(place) for place in fits} == dict.fromkeys(("seeds-0", "seeds-1", "blur-0", "blur-1"), 4)
    cells = json.loads(capsys.readouterr().out)["cells"]
    assert len(cells) == 2 * (5 + 5 + 2) and all(cell["successes"] == 0 for cell in cells)
    assert {why for cell in cells for why in cell["whys"]} == {"Diverged: left the finite numbers"}
    stages.raising.clear()
    assert main(["stress", str(folder), "--methods", *methods[:4], *more, "--force", "--json"]) == 0
    assert "Diverged" not in capsys.readouterr().out  # another command tries again


def test_a_fault_that_a_scene_cannot_have_is_left_out(folder, runs, capsys):
    runs.raising = {("scene", "blur", seed): BadInput("too small to blur") for seed in range(3)}
    assert stress(folder, "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert result["missing"] == [{"fault": "blur", "why": "too small to blur"}]
    assert {cell["fault"] for cell in result["cells"]} == {"seeds", "style-white"}
    runs.raising |= {
        ("scene", fault, seed): BadInput("none") for fault in ("seeds", "style-white") for seed in range(3)
    }
    assert stress(folder, "--force") == 3


def test_a_cell_that_is_worse_ends_with_one_and_all_is_written(folder, runs, capsys, tmp_path):
    baseline = str(tmp_path / "baseline.json")
    assert stress(folder, "--write-baseline", baseline) == 0
    assert stress(folder, "--baseline", baseline) == 0
    assert "no cell of 5 compared is worse" in capsys.readouterr().out  # read: the next begins with its JSON
    runs.answers["arf", "seeds"] = 5.0
    assert stress(folder, "--baseline", baseline, "--force", "--json") == 1
    reported = json.loads(capsys.readouterr().out)
    assert reported["exit_code"] == 1 and reported["error"].startswith("arf under seeds: 0 of 3 succeed, 3 of 3 did")
    assert len(reported["baseline"]["worse"]) == 1
    assert (
        json.loads((folder / "stress" / "stress.json").read_text())["baseline"]["worse"]
        == reported["baseline"]["worse"]
    )
    made = len(runs.made)
    assert main(["stress", str(folder), "--budget", "11", "--baseline", baseline]) == 2  # before anything is run
    assert main(["stress", str(folder), "--baseline", str(tmp_path / "none.json")]) == 3 and len(runs.made) == made
    assert stress(folder, "--write-baseline") == 0 and (folder / "stress" / "baseline.json").is_file()


def test_a_baseline_of_other_cells_passes_nothing(folder, runs, capsys, tmp_path):
    baseline = str(tmp_path / "baseline.json")
    assert stress(folder, "--write-baseline", baseline) == 0
    made = len(runs.made)

    def against(methods, faults, *more) -> int:
        few = ("--methods", *methods, "--faults", *faults, "--seeds", "3", "--budget", "10")
        return main(["stress", str(folder), *few, "--baseline", baseline, *more])

    for other in ((["snerf"], ["blur"]), (["fit"], ["jpeg"]), (["fit"], ["blur"], "--remedies", "on")):
        assert against(*other) == 2  # before anything is run
        assert "contains no cells for these methods" in capsys.readouterr().err
    assert len(runs.made) == made
    assert against(["fit"], ["blur", "jpeg"]) == 0
    out = capsys.readouterr().out
    assert "no cell of 1 compared is worse" in out
    assert "not compared: fit under jpeg: not in the baseline" in out
    assert "not compared: arf under blur: only in the baseline" in out
    runs.raising = {("scene", "blur", seed): BadInput("too small to blur") for seed in range(3)}
    assert against(["fit"], ["blur", "jpeg"], "--force") == 1
    assert "no cell could be compared" in capsys.readouterr().err


def test_a_stopped_stress_is_no_baseline_and_passes_none(folder, runs, capsys, tmp_path):
    baseline = tmp_path / "baseline.json"
    assert stress(folder, "--write-baseline", str(baseline)) == 0
    kept = baseline.read_bytes()
    for path in (folder / "stress" / "runs").iterdir():
        if path.name.split("--")[2] != "0":
            path.unlink()
    assert stress(folder, "--only", "--baseline", str(baseline)) == 1
    assert (
        "no cell could be compared" in (reported := capsys.readouterr().err) and "number of runs 1, was 3" in reported
    )
    assert stress(folder, "--only", "--write-baseline", str(baseline)) == 2
    assert "has 1 of 3 runs" in capsys.readouterr().err and baseline.read_bytes() == kept


def test_remedies_stand_beside_runs_without(folder, runs, capsys):
    assert stress(folder) == 0
    capsys.readouterr()
    assert stress(folder, "--remedies", "both", "--json") == 0
    result = json.loads(capsys.readouterr().out)
    assert [one[3] for one in runs.made] == [False] * 15 + [True] * 15
    methods = {cell["method"] for cell in result["cells"]}
    assert methods == {"fit", "arf", "fit + remedies", "arf + remedies"}


def test_remedies_are_options_of_their_stages():
    from stages.configs.deform import DeformConfig
    from stages.configs.fit import FitConfig
    from stages.configs.stylize import ArfConfig

    plain = FitConfig(), ArfConfig(style="a.png"), DeformConfig()
    requested = trials.REMEDIES_OF_FIT, trials.REMEDIES_OF_STYLE, trials.REMEDIES_OF_DEFORM
    for config, remedies in zip(plain, requested, strict=True):
        assert all(getattr(config, name) == 0 < value for name, value in remedies.items())


def test_an_edits_options_follow_its_fault(folder, runs, capsys):
    """A color for a palette, a painting for strokes; the key of a run tells them apart, and knows no folder."""
    methods = ("laenerf-recolor", "laenerf-paint", "palettenerf")
    faults = ("seeds", "style-wash", "palette-random", "palette-full")
    requested = ("--methods", *methods, "--faults", *faults, "--seeds", "1", "--remedies", "both")
    assert main(["stress", str(folder), *requested]) == 0
    capsys.readouterr()
    assert len(runs.made) == 2 * (3 + 1 + 1 + 2)
    keys = {json.loads(path.read_text())["key"] for path in (folder / "stress" / "runs").iterdir()}
    # Alike are, by their content: the two paintings of the stand-in, twice, and clusters where nothing is at random.
    assert len(keys) == len(runs.made) - 3

    def options(method, fault, remedies=False, quick=False, budget="25s"):
        conditions = {"quick": quick, "style_budget": budget}
        painting = None
        if METHODS[method].takes_style:
            file = folder / "stress" / "styles" / f"ordinary-256-0-r{trials.style_images.REVISION}.png"
            painting = {"style": str(file), "style_digest": file_sha256(file)}
        return edit_trials.options_of(METHODS[method], FAULTS[fault], remedies, conditions, painting)

    plain, begun = options("laenerf-recolor", "seeds"), options("laenerf-recolor", "palette-random")
    assert (plain.learning.start, begun.learning.start) == ("clusters", "random")
    assert options("laenerf-recolor", "palette-random", remedies=True) == plain
    assert plain.changes != options("palettenerf", "palette-full").changes == ("all=#00ff00",)
    painted = options("laenerf-paint", "seeds")
    assert painted.changes == () and painted.described()["learning"].style == "-" and painted.learning.style_digest
    assert options("palettenerf", "seeds").learning.budget == plain.finetune.budget == plain.learning.budget == "25s"
    assert options("palettenerf", "seeds", quick=True, budget="15").learning.budget == "60"
    stepped, quick = (options("laenerf-recolor", "seeds", quick=quick, budget="40") for quick in (False, True))
    assert (stepped.finetune.budget, quick.finetune.budget) == ("40", "60")
    assert stepped.learning.budget == quick.learning.budget == "1h"  # its steps decide
    assert options("laenerf-recolor", "seeds", quick=True).learning.budget == "25s"


def test_a_run_takes_as_long_as_all_that_it_is_made_of(folder, monkeypatch, capsys):
    """Scene and fit are shared; a stage that fails counts as long as it ran."""
    seconds = {"corrupt_scene": 1.0, "nerf_fit": 10.0, "stylize": 100.0}

    def execute(spec, run, work, name, inputs, config, context):
        if spec.stage == "stylize" and context.seed == 1:
            raise Diverged("left the finite numbers")
        return SimpleNamespace(manifest=SimpleNamespace(seconds=seconds[spec.stage])), False

    view = ViewPair("v", np.zeros((4, 4, 3)), np.ones((4, 4, 3)))
    monkeypatch.setattr(trials, "execute", execute)
    monkeypatch.setattr(trials, "view_pairs", lambda *_: [view])
    monkeypatch.setattr(trials.criteria, "judge_style", lambda *_: Verdict(True, "", 0.5, 0))
    monkeypatch.setattr(trials, "style_image_of", lambda *_: np.zeros((16, 16, 3)))
    few = ("--methods", "fit", "arf", "--faults", "seeds", "--seeds", "2", "--budget", "10")
    assert main(["stress", str(folder), *few, "--json"]) == 0
    capsys.readouterr()
    with open(folder / "stress" / "runs.csv", newline="") as stream:
        reported = {(row["method"], row["seed"]): float(row["seconds"]) for row in csv.DictReader(stream)}
    assert reported["fit", "0"] == reported["fit", "1"] == 11 and reported["arf", "0"] == 111
    assert reported["arf", "1"] == pytest.approx(11, abs=1)


@pytest.mark.slow
def test_real_runs_of_a_still_life(work, capsys):
    """The whole chain, tiny: a fit and a stylization of the clean scene, one of a white painting, a made scene."""
    options = ("--quick", "--side", "32", "--seeds", "1", "--budget", "150", "--style-budget", "4", "--keep")
    faults = ("seeds", "views-3", "textureless", "style-white")
    assert main(["stress", str(work), "--methods", "fit", "arf", "--faults", *faults, *options, "--json"]) == 0
    cells = {(one["fault"], one["method"]): one for one in json.loads(capsys.readouterr().out)["cells"]}
    assert len(cells) == 7 and all(cell["median"] is not None for cell in cells.values())
    assert cells["seeds", "fit"]["successes"] == 1 and cells["seeds", "fit"]["median"] > 15
    assert cells["style-white", "arf"]["median"] < cells["seeds", "arf"]["median"]
    kept = WorkFolder(work / "stress" / "works" / "seeds-0")
    assert {one.name for one in kept.artifacts("field")} == {"fit-vm", "seeds-arf", "style-white-arf"}


@pytest.mark.slow
def test_real_edits_of_a_still_life(work, capsys):
    """A fit, then a part of it recolored, painted, and recolored by a palette of the whole; tiny."""
    options = ("--quick", "--side", "48", "--seeds", "1", "--budget", "150", "--keep", "--json")
    methods = ("laenerf-recolor", "laenerf-paint", "palettenerf")
    assert main(["stress", str(work), "--methods", *methods, "--faults", "seeds", "palette-full", *options]) == 0
    cells = {(one["fault"], one["method"]): one for one in json.loads(capsys.readouterr().out)["cells"]}
    assert len(cells) == 5 and all(cell["median"] is not None for cell in cells.values())
    assert cells["seeds", "laenerf-recolor"]["successes"] == 1
    kept = WorkFolder(work / "stress" / "works" / "seeds-0")
    assert len(kept.artifacts("region")) == 1 and len(kept.artifacts("edit")) == 4
