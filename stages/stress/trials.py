"""One run of a stress after another: a scene with its fault, a fit, a stylization, a verdict; each kept on disk.

Everything lies in work folders below WORK/stress/works, one a scene and seed, apart from WORK: a scene with a fault
must never be taken for the scene.
"""

import shutil
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from schemas.atomic_write import make_folder
from schemas.canonical_json import digest_of, file_sha256
from schemas.errors import ArtifactDamaged, ArtifactStale, BadInput, OutOfResources, UsageError
from schemas.images import to_uint8, write_png
from schemas.work_folder import Artifact, WorkFolder
from stages import corrupt_scene, deform_init, nerf_fit, stylize
from stages.artifacts.style_images import read_painting
from stages.configs.corrupt_scene import CorruptSceneConfig
from stages.configs.deform import DeformConfig
from stages.configs.faults import CLEAN, FAULTS, METHODS, ORDINARY_STYLE, STYLE, Fault, Method
from stages.configs.fit import FitConfig
from stages.configs.stress import StressConfig
from stages.configs.stylize import CONFIGS, StylizeConfig
from stages.run.progress import Context, Silent
from stages.run.runner import execute
from stages.stress import criteria, edit_trials
from stages.stress.outcomes import keep_outcome, kept_outcome
from stages.stress.success_rates import REMEDIED, REMEDIED_FILE, Outcome, run_name
from stages.stress.test_views import seen_from_tests, seen_of_edit, shown_beside
from stages.weights import resolve
from stylerf.corruption import style_images

WORST = "worst"
KEPT = "kept"  # the file that marks a work folder as one of --keep
# What is wrong with the command, the work folder or the machine says nothing about a method.
NOT_OF_A_METHOD = (UsageError, ArtifactDamaged, ArtifactStale, OutOfResources, MemoryError, OSError)
QUICK_CAPACITY, QUICK_SAMPLES = "fixed:64x8x16", 20_000
QUICK_REFIT, QUICK_DEFORM, DEFORM_STEPS = 60, 40, 400
# What --remedies on runs with.
REMEDIES_OF_FIT = {"opacity_weight": 5e-3, "gradient_clip": 4.0}
REMEDIES_OF_DEFORM = {"gate": 0.05}
REMEDIES_OF_STYLE = {"rollbacks": 3, "gradient_clip": 4.0, "min_spread": 0.16}


@dataclass(frozen=True)
class Trial:
    """One run to be made."""

    method: Method
    fault: Fault
    seed: int
    remedies: bool

    @property
    def origin(self) -> str:
        """Whose scene it takes place in: paintings and palettes with faults are put on the scene without."""
        return self.fault.name if self.fault.of_scene else CLEAN

    @property
    def cell(self) -> tuple[str, str]:
        """Method and fault of the cell that it counts in."""
        return self.method.name + (REMEDIED if self.remedies else ""), self.fault.name

    @property
    def label(self) -> str:
        """Of its field and its files."""
        return f"{self.method.name}{REMEDIED_FILE if self.remedies else ''}"


class FitFailed(Exception):
    """A fit that failed earlier in this command; told in the words of its fault."""


class Stress:
    """Makes the runs of a config that do not stand yet. root: WORK/stress. source: the scene to be spoiled.

    conditions: what all runs share and a baseline must share with them, here with trunk, device, criteria and
    paintings; trunk and paintings are empty where no method sees one.
    """

    def __init__(self, context: Context, config: StressConfig, source: Artifact, root: Path) -> None:
        self.context, self.config, self.source, self.root = context, config, source, root
        # UsageError without any trunk, where a method needs one.
        needed = any(METHODS[name].sees_painting for name in config.chosen_methods)
        self.features = resolve.chosen("") if needed else {"features": ""}
        self.conditions = config.conditions | {
            "features": self.features["features"],
            "device": context.device,
            "criteria": criteria.REVISION,
            "paintings": style_images.REVISION if needed else "",
        }
        self.missing: dict[str, str] = {}
        self._worked_in: set[Path] = set()
        self._digests: dict[Path, str] = {}  # of paintings
        self._failed: dict[tuple[Path, FitConfig], tuple[str, float]] = {}  # fits: why, and seconds
        self._seconds = 0.0  # of all that the run in progress is made of
        self._afresh, self._only = False, False

    def trials(self) -> Iterator[Trial]:
        """In the order in which scenes and fits are shared: by seed, then scene, then painting, then method."""
        first = self.context.seed
        remedies = {"off": (False,), "on": (True,), "both": (False, True)}[self.config.remedies]
        faults = [FAULTS[name] for name in self.config.chosen_faults]
        faults.sort(key=lambda fault: fault.of_scene and fault.name != CLEAN)  # stable: the clean scene's first
        for seed in range(first, first + self.conditions["seeds"]):
            for fault in faults:
                for method in (METHODS[name] for name in self.config.chosen_methods):
                    for remedied in remedies if method.faces(fault) else ():
                        yield Trial(method, fault, seed, remedied)

    def run(self, only: bool, force: bool) -> list[Outcome]:
        """All outcomes, kept or made. only: those that stand. force: every one made anew."""
        trials, self._afresh, self._only = list(self.trials()), force, only
        standing: dict[Path, bool] = {}  # whether all runs of a work folder do
        found: list[Outcome] = []
        progress = self.context.progress
        progress.start("stress", len(trials), "run")
        for number, trial in enumerate(trials):
            key = self.key_of(trial)
            outcome = None if force else kept_outcome(self.root, self._name(trial, key), key)
            if outcome is None and not only and trial.fault.name not in self.missing:
                outcome = self._made(trial, key)
            if outcome is not None:
                found.append(outcome)
            place = self._place(trial).root
            standing[place] = standing.get(place, True) and outcome is not None
            following = trials[number + 1] if number + 1 < len(trials) else None
            if following is None or self._place(following).root != place:
                self._tidy(place, standing[place])
            progress.update(number + 1, f"{sum(not one.ok for one in found)} failed")
        progress.finish()
        return found

    # -- what decides a run -----------------------------------------------------------------------------------------

    def key_of(self, trial: Trial) -> str:
        """Digest of all that decides its result: scene, fault, options, seed, revisions of stages and criteria."""
        method, style, edit = trial.method, None, {}
        if method.style:
            style = replace(self.style_config(trial), style="-")  # by its digest: a work folder may be moved
        specs = (corrupt_scene.SPEC, nerf_fit.SPEC, deform_init.SPEC, stylize.SPEC)
        if method.edit:
            edit, specs = {"edit": self.edit_options(trial).described()}, (*specs, *edit_trials.SPECS)
        return digest_of(
            {
                **edit,
                "scene": replace(self.fault_config(trial), source=""),
                "fit": self.fit_config(trial),
                "deform": self.deform_config(trial) if method.style == "desrf" else None,
                "style": style,
                "seed": trial.seed,
                "device": self.conditions["device"],
                "revisions": {spec.stage: spec.revision for spec in specs} | {"criteria": criteria.REVISION},
            }
        )

    def fault_config(self, trial: Trial) -> CorruptSceneConfig:
        """Of the scene that a trial takes place in."""
        fault, conditions = FAULTS[trial.origin], self.conditions
        given = {"side": conditions["side"], "views": conditions["views"], "tests": conditions["tests"]}
        if fault.of == "made":
            return CorruptSceneConfig(fault=fault.name, amount=fault.amount, **given)
        source = {"source": str(self.source.path.resolve()), "source_digest": self.source.digest}
        return CorruptSceneConfig(fault=fault.name, amount=fault.amount, **given, **source)

    def fit_config(self, trial: Trial) -> FitConfig:
        """Of its fit, buffers left out."""
        config = FitConfig(budget=self.conditions["budget"], field=trial.method.field, buffers=False)
        if self.conditions["quick"]:
            config = replace(config, capacity=QUICK_CAPACITY, samples=QUICK_SAMPLES)
        return replace(config, **REMEDIES_OF_FIT) if trial.remedies else config

    def deform_config(self, trial: Trial) -> DeformConfig:
        """Of what desrf begins with."""
        config = DeformConfig(steps=QUICK_DEFORM if self.conditions["quick"] else DEFORM_STEPS)
        return replace(config, **REMEDIES_OF_DEFORM) if trial.remedies else config

    def style_config(self, trial: Trial) -> StylizeConfig:
        """Of its stylization, with the digest of its painting."""
        painting, digest = self.painting(trial)
        config = CONFIGS[trial.method.style](
            style=str(painting.resolve()),
            style_digest=digest,
            budget=self.conditions["style_budget"],
            **self.features,
        )
        if self.conditions["quick"]:
            config = replace(config, refit_steps=QUICK_REFIT)
        return replace(config, **REMEDIES_OF_STYLE) if trial.remedies else config

    def edit_options(self, trial: Trial) -> edit_trials.EditOptions:
        """Of its local edit."""
        look = None
        if trial.method.sees_painting:
            painting, digest = self.painting(trial)
            look = {"style": str(painting.resolve()), "style_digest": digest, **self.features}
        return edit_trials.options_of(trial.method, trial.fault, trial.remedies, self.conditions, look)

    def painting(self, trial: Trial) -> tuple[Path, str]:
        """The painting of a trial, the fault's or the ordinary one, and its digest.

        It is made where it is missing, with --force once anew; where nothing is to be run, for its digest alone.
        """
        fault = trial.fault if trial.fault.of == STYLE else None
        side = int(fault.amount) if fault else ORDINARY_STYLE
        if self.conditions["quick"] and fault and fault.name == "style-huge":
            side //= 4
        name = f"{fault.name if fault else 'ordinary'}-{side}-{trial.seed}-r{style_images.REVISION}.png"
        path = self.root / "styles" / name
        if path not in self._digests:
            with TemporaryDirectory() as aside:
                file = Path(aside) / name if self._only and not path.is_file() else path
                if not file.is_file() or (self._afresh and not self._only):
                    write_png(file, to_uint8(painted(fault.name if fault else "", side, trial.seed)))
                self._digests[path] = file_sha256(file)
        return path, self._digests[path]

    # -- a run ------------------------------------------------------------------------------------------------------

    def _name(self, trial: Trial, key: str) -> str:
        return run_name(trial.label, trial.fault.name, trial.seed, key)

    def _made(self, trial: Trial, key: str) -> Outcome | None:
        self._seconds = 0.0
        try:
            scene = self._scene(trial)
        except BadInput as error:
            self.missing[trial.fault.name] = str(error)
            self.context.progress.say(f"{trial.fault.name} is left out: {error}")
            return None
        picture = f"{self._name(trial, key)}.png"
        try:
            verdict, worst = self._verdict(trial, scene)
        except NOT_OF_A_METHOD:
            raise
        except Exception as error:
            # A method that breaks has failed, however it breaks: that is what is counted here.
            verdict = criteria.Verdict(False, why_of(error), None, 0)
            (self.root / WORST / picture).unlink(missing_ok=True)
            picture = ""
        else:
            write_png(self.root / WORST / picture, to_uint8(worst))
        outcome = Outcome(
            key=key,
            method=trial.method.name,
            fault=trial.fault.name,
            seed=trial.seed,
            remedies=trial.remedies,
            ok=verdict.ok,
            why=verdict.why,
            score=verdict.score,
            figures=verdict.figures,
            seconds=round(self._seconds, 2),
            picture=picture,
        )
        keep_outcome(self.root, outcome)
        return outcome

    def _place(self, trial: Trial) -> WorkFolder:
        return WorkFolder(self.root / "works" / f"{trial.origin}-{trial.seed}")

    def _execute(self, trial: Trial, stage: Any, inputs: dict, config: Any, name: str) -> Artifact:
        context = replace(self.context, seed=trial.seed, progress=Silent())
        place = self._place(trial)
        if self._afresh and place.root not in self._worked_in:
            shutil.rmtree(place.root, ignore_errors=True)  # what --keep left there may be of other code
        self._worked_in.add(place.root)
        if self.config.keep:
            make_folder(place.root)
            (place.root / KEPT).touch()
        begun, made = time.monotonic(), None
        try:
            made, _ = execute(stage.SPEC, stage.run, place, name, inputs, config, context)
            return made
        finally:
            # What runs share counts with each of them, whichever came first; a stage that failed left no manifest.
            self._seconds += made.manifest.seconds if made else time.monotonic() - begun

    def _scene(self, trial: Trial) -> Artifact:
        return self._execute(trial, corrupt_scene, {}, self.fault_config(trial), "main")

    def _fitted(self, trial: Trial, scene: Artifact, name: str) -> Artifact:
        """Its fit. One that has failed fails at once for all that would be made of it: it would fail again."""
        config = self.fit_config(trial)
        recipe = self._place(trial).root, config
        if recipe in self._failed:
            why, seconds = self._failed[recipe]
            self._seconds += seconds
            raise FitFailed(why)
        before = self._seconds
        try:
            return self._execute(trial, nerf_fit, {"scene": scene}, config, name)
        except NOT_OF_A_METHOD:
            raise
        except Exception as error:
            self._failed[recipe] = why_of(error), self._seconds - before
            raise

    def _verdict(self, trial: Trial, scene: Artifact) -> tuple[criteria.Verdict, np.ndarray]:
        """And the picture of the worst view."""
        method, threads = trial.method, self.context.threads
        fit_name = f"fit-{method.field}{REMEDIED_FILE if trial.remedies else ''}"
        field = self._fitted(trial, scene, fit_name)
        if method.edit:
            chain, options = partial(self._execute, trial), self.edit_options(trial)
            after, region = edit_trials.edited(chain, scene, field, options, threads)
            views = seen_of_edit(scene, field, after, region, threads)
            verdict = criteria.judged_edit(views)
            return verdict, shown_beside(views[verdict.worst])
        if method.style == "desrf":
            inputs = {"scene": scene, "field": field}
            field = self._execute(trial, deform_init, inputs, self.deform_config(trial), f"{fit_name}-deformed")
        if method.style:
            inputs, config = {"scene": scene, "field": field}, self.style_config(trial)
            field = self._execute(trial, stylize, inputs, config, f"{trial.fault.name}-{trial.label}")
        views = seen_from_tests(scene, field, threads)
        if method.style:
            painting = read_painting(self.painting(trial)[0]).permute(1, 2, 0).numpy()
            verdict = criteria.judged_style(views, painting)
        else:
            verdict = criteria.judged_fit(views)
        return verdict, shown_beside(views[verdict.worst])

    def _tidy(self, place: Path, all_stand: bool) -> None:
        """Scenes and fields go when nothing more is made of them, also those that a killed run has left; not what is
        to be kept, or was. Outcomes stay."""
        if self.config.keep or (place / KEPT).exists():
            return
        if place in self._worked_in or (all_stand and not self._only):
            shutil.rmtree(place, ignore_errors=True)


def why_of(error: Exception) -> str:
    """What an outcome tells of a fault."""
    return str(error) if isinstance(error, FitFailed) else f"{type(error).__name__}: {error}"[:300]


def painted(fault: str, side: int, seed: int) -> np.ndarray:
    """The painting [side, side, 3] of a fault's name; empty: the ordinary one."""
    if fault == "style-white":
        return style_images.white(side)
    makers = {
        "style-tiny": style_images.tiny,
        "style-huge": style_images.huge,
        "style-wash": style_images.weak_geometry,
        "style-extreme": style_images.extreme_palette,
    }
    return makers.get(fault, style_images.ordinary)(side, seed)
