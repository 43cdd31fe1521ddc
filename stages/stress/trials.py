"""Trials: a scene with a fault, a fit, a stylization or edit, and a verdict. Each outcome is stored on disk.

Trials run in work folders below WORK/stress/works, one per scene and seed, never in WORK itself: a scene with a fault
must not be mistaken for the user's.
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
from stages.artifacts.style_images import read_style_image
from stages.configs.deform import DeformConfig
from stages.configs.faults import CLEAN, FAULTS, METHODS, ORDINARY_STYLE, STYLE, CorruptSceneConfig, Fault, Method
from stages.configs.fit import FitConfig
from stages.configs.stress import StressConfig
from stages.configs.stylize import CONFIGS, StylizeConfig
from stages.run.progress import Context, Silent
from stages.run.runner import execute
from stages.stress import criteria, edit_trials
from stages.stress.outcomes import REMEDIED, REMEDIED_FILE, Outcome, load_outcome, run_name, save_outcome
from stages.stress.test_views import side_by_side, view_pairs, view_pairs_of_edit
from stages.weights import resolve
from stylerf.corruption import style_images

WORST = "worst"
KEEP_MARKER = "kept"  # marks a work folder kept by --keep
# Errors of the command, the work folder or the machine, which say nothing about a method.
NOT_A_METHODS_FAULT = (UsageError, ArtifactDamaged, ArtifactStale, OutOfResources, MemoryError, OSError)
QUICK_CAPACITY, QUICK_SAMPLES = "fixed:64x8x16", 20_000
QUICK_REFIT, QUICK_DEFORM, DEFORM_STEPS = 60, 40, 400
# Options of --remedies on.
REMEDIES_OF_FIT: dict[str, Any] = {"opacity_weight": 5e-3, "gradient_clip": 4.0}
REMEDIES_OF_DEFORM: dict[str, Any] = {"gate": 0.05}
REMEDIES_OF_STYLE: dict[str, Any] = {"rollbacks": 3, "gradient_clip": 4.0, "min_spread": 0.16}


@dataclass(frozen=True)
class Trial:
    """One method under one fault with one seed."""

    method: Method
    fault: Fault
    seed: int
    remedies: bool

    @property
    def origin(self) -> str:
        """The fault of its scene; faults of style images and palettes use the scene without one."""
        return self.fault.name if self.fault.of_scene else CLEAN

    @property
    def cell(self) -> tuple[str, str]:
        """Method and fault of its cell."""
        return self.method.name + (REMEDIED if self.remedies else ""), self.fault.name

    @property
    def label(self) -> str:
        """Part of the names of its field and files."""
        return f"{self.method.name}{REMEDIED_FILE if self.remedies else ''}"


class FitFailed(Exception):
    """A fit that failed earlier in this command. The message is that of the first failure."""


class Stress:
    """Runs the trials of a config.

    conditions: what all trials share, and a baseline must share with them. Features and style images are empty if no
    method takes a style image. missing: faults that the scene cannot have, with reasons.
    """

    def __init__(self, context: Context, config: StressConfig, source: Artifact, root: Path) -> None:
        """Find the features that methods need.

        Args:
            root: WORK/stress.

        Raises:
            UsageError: a method needs features and no weights are installed.
        """
        self.context, self.config, self.source, self.root = context, config, source, root
        needed = any(METHODS[name].takes_style for name in config.chosen_methods)
        self.features: dict[str, Any] = resolve.chosen("") if needed else {"features": ""}
        self.scale = config.conditions
        self.conditions: dict[str, object] = {
            **self.scale,
            "features": self.features["features"],
            "device": context.device,
            "criteria": criteria.REVISION,
            "paintings": style_images.REVISION if needed else "",
        }
        self.missing: dict[str, str] = {}
        self._used: set[Path] = set()
        self._digests: dict[Path, str] = {}  # of style images
        self._failed: dict[tuple[Path, FitConfig], tuple[str, float]] = {}  # reason and seconds
        self._seconds = 0.0  # for everything that the current trial consists of
        self._force, self._only = False, False

    def trials(self) -> Iterator[Trial]:
        """Yield the trials, those that share scenes and fits together: by seed, scene, style image, method."""
        first = self.context.seed
        remedies = {"off": (False,), "on": (True,), "both": (False, True)}[self.config.remedies]
        faults = [FAULTS[name] for name in self.config.chosen_faults]
        faults.sort(key=lambda fault: fault.of_scene and fault.name != CLEAN)  # stable: the clean scene first
        for seed in range(first, first + self.scale["seeds"]):
            for fault in faults:
                for method in (METHODS[name] for name in self.config.chosen_methods):
                    for remedied in remedies if method.faces(fault) else ():
                        yield Trial(method, fault, seed, remedied)

    def run(self, only: bool, force: bool) -> list[Outcome]:
        """Return all outcomes, loaded or run. only: load, run nothing. force: run all, load nothing."""
        trials, self._force, self._only = list(self.trials()), force, only
        complete: dict[Path, bool] = {}  # whether all trials of a work folder have outcomes
        found: list[Outcome] = []
        progress = self.context.progress
        progress.start("stress", len(trials), "run")
        for number, trial in enumerate(trials):
            key = self.key_of(trial)
            outcome = None if force else load_outcome(self.root, self._name(trial, key), key)
            if outcome is None and not only and trial.fault.name not in self.missing:
                outcome = self._run_trial(trial, key)
            if outcome is not None:
                found.append(outcome)
            place = self._work_folder(trial).root
            complete[place] = complete.get(place, True) and outcome is not None
            following = trials[number + 1] if number + 1 < len(trials) else None
            if following is None or self._work_folder(following).root != place:
                self._clean_up(place, complete[place])
            progress.update(number + 1, f"{sum(not one.ok for one in found)} failed")
        progress.finish()
        return found

    # -- what affects a trial ----------------------------------------------------------------------------------------

    def key_of(self, trial: Trial) -> str:
        """Return the digest of everything that affects a result: scene, fault, options, seed, revisions."""
        method, style, edit = trial.method, None, {}
        if method.style:
            style = replace(self.style_config(trial), style="-")  # known by its digest; a work folder may move
        specs = [corrupt_scene.SPEC, nerf_fit.SPEC, deform_init.SPEC, stylize.SPEC]
        if method.edit:
            edit = {"edit": self.edit_options(trial).described()}
            specs += edit_trials.SPECS
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
        """Return the config of a trial's scene."""
        fault, scale = FAULTS[trial.origin], self.scale
        config = CorruptSceneConfig(
            fault=fault.name, amount=fault.amount, side=scale["side"], views=scale["views"], tests=scale["tests"]
        )
        if fault.of == "made":
            return config
        return replace(config, source=str(self.source.path.resolve()), source_digest=self.source.digest)

    def fit_config(self, trial: Trial) -> FitConfig:
        """Return the config of a trial's fit."""
        config = FitConfig(budget=self.scale["budget"], field=trial.method.field, buffers=False)
        if self.scale["quick"]:
            config = replace(config, capacity=QUICK_CAPACITY, samples=QUICK_SAMPLES)
        return replace(config, **REMEDIES_OF_FIT) if trial.remedies else config

    def deform_config(self, trial: Trial) -> DeformConfig:
        """Return the config of the deformation that desrf starts from."""
        config = DeformConfig(steps=QUICK_DEFORM if self.scale["quick"] else DEFORM_STEPS)
        return replace(config, **REMEDIES_OF_DEFORM) if trial.remedies else config

    def style_config(self, trial: Trial) -> StylizeConfig:
        """Return the config of a trial's stylization."""
        style, digest = self.style_image(trial)
        config = CONFIGS[trial.method.style](
            style=str(style.resolve()),
            style_digest=digest,
            budget=self.scale["style_budget"],
            **self.features,
        )
        if self.scale["quick"]:
            config = replace(config, refit_steps=QUICK_REFIT)
        return replace(config, **REMEDIES_OF_STYLE) if trial.remedies else config

    def edit_options(self, trial: Trial) -> edit_trials.EditOptions:
        """Return the options of a trial's local edit."""
        look = None
        if trial.method.takes_style:
            style, digest = self.style_image(trial)
            look = {"style": str(style.resolve()), "style_digest": digest, **self.features}
        return edit_trials.options_of(trial.method, trial.fault, trial.remedies, self.scale, look)

    def style_image(self, trial: Trial) -> tuple[Path, str]:
        """Return a trial's style image, made if it is missing (with --force, in any case), and its digest.

        With --only it is made in a temporary folder, for its digest.
        """
        fault = trial.fault if trial.fault.of == STYLE else None
        side = int(fault.amount) if fault else ORDINARY_STYLE
        if self.scale["quick"] and fault and fault.name == "style-huge":
            side //= 4
        name = f"{fault.name if fault else 'ordinary'}-{side}-{trial.seed}-r{style_images.REVISION}.png"
        path = self.root / "styles" / name
        if path not in self._digests:
            with TemporaryDirectory() as aside:
                file = Path(aside) / name if self._only and not path.is_file() else path
                if not file.is_file() or (self._force and not self._only):
                    write_png(file, to_uint8(style_image_of(fault.name if fault else "", side, trial.seed)))
                self._digests[path] = file_sha256(file)
        return path, self._digests[path]

    # -- a trial ------------------------------------------------------------------------------------------------------

    def _name(self, trial: Trial, key: str) -> str:
        return run_name(trial.label, trial.fault.name, trial.seed, key)

    def _run_trial(self, trial: Trial, key: str) -> Outcome | None:
        self._seconds = 0.0
        try:
            scene = self._scene(trial)
        except BadInput as error:
            self.missing[trial.fault.name] = str(error)
            self.context.progress.say(f"{trial.fault.name} left out: {error}")
            return None
        picture = f"{self._name(trial, key)}.png"
        try:
            verdict, worst = self._verdict(trial, scene)
        except NOT_A_METHODS_FAULT:
            raise
        except Exception as error:
            # A method that breaks in any way has failed; that is what is counted.
            verdict = criteria.Verdict(False, reason_of(error), None, 0)
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
        save_outcome(self.root, outcome)
        return outcome

    def _work_folder(self, trial: Trial) -> WorkFolder:
        return WorkFolder(self.root / "works" / f"{trial.origin}-{trial.seed}")

    def _execute(self, trial: Trial, stage: Any, inputs: dict, config: Any, name: str) -> Artifact:
        context = replace(self.context, seed=trial.seed, progress=Silent())
        place = self._work_folder(trial)
        if self._force and place.root not in self._used:
            shutil.rmtree(place.root, ignore_errors=True)  # --keep may have left files of other code
        self._used.add(place.root)
        if self.config.keep:
            make_folder(place.root)
            (place.root / KEEP_MARKER).touch()
        started, made = time.monotonic(), None
        try:
            made, _ = execute(stage.SPEC, stage.run, place, name, inputs, config, context)
            return made
        finally:
            # A shared stage counts for each trial that uses it. A failed stage left no manifest.
            self._seconds += made.manifest.seconds if made else time.monotonic() - started

    def _scene(self, trial: Trial) -> Artifact:
        return self._execute(trial, corrupt_scene, {}, self.fault_config(trial), "main")

    def _fitted(self, trial: Trial, scene: Artifact, name: str) -> Artifact:
        """Return a trial's fit. A fit that failed fails at once for the other trials that share it."""
        config = self.fit_config(trial)
        recipe = self._work_folder(trial).root, config
        if recipe in self._failed:
            why, seconds = self._failed[recipe]
            self._seconds += seconds
            raise FitFailed(why)
        before = self._seconds
        try:
            return self._execute(trial, nerf_fit, {"scene": scene}, config, name)
        except NOT_A_METHODS_FAULT:
            raise
        except Exception as error:
            self._failed[recipe] = reason_of(error), self._seconds - before
            raise

    def _verdict(self, trial: Trial, scene: Artifact) -> tuple[criteria.Verdict, np.ndarray]:
        """Run a trial; return its verdict and a picture of the worst view."""
        method, threads = trial.method, self.context.threads
        fit_name = f"fit-{method.field}{REMEDIED_FILE if trial.remedies else ''}"
        field = self._fitted(trial, scene, fit_name)
        if method.edit:
            chain, options = partial(self._execute, trial), self.edit_options(trial)
            after, region = edit_trials.edited(chain, scene, field, options, threads)
            views = view_pairs_of_edit(scene, field, after, region, threads)
            verdict = criteria.judge_edit(views)
            return verdict, side_by_side(views[verdict.worst])
        if method.style == "desrf":
            inputs = {"scene": scene, "field": field}
            field = self._execute(trial, deform_init, inputs, self.deform_config(trial), f"{fit_name}-deformed")
        if method.style:
            inputs, config = {"scene": scene, "field": field}, self.style_config(trial)
            field = self._execute(trial, stylize, inputs, config, f"{trial.fault.name}-{trial.label}")
        views = view_pairs(scene, field, threads)
        if method.style:
            style = read_style_image(self.style_image(trial)[0])[:3].permute(1, 2, 0).numpy()
            verdict = criteria.judge_style(views, style)
        else:
            verdict = criteria.judge_fit(views)
        return verdict, side_by_side(views[verdict.worst])

    def _clean_up(self, place: Path, complete: bool) -> None:
        """Delete a work folder that no further trial needs, even one left by a killed run, unless --keep is set."""
        if self.config.keep or (place / KEEP_MARKER).exists():
            return
        if place in self._used or (complete and not self._only):
            shutil.rmtree(place, ignore_errors=True)


def reason_of(error: Exception) -> str:
    """Return the reason for a failed trial."""
    return str(error) if isinstance(error, FitFailed) else f"{type(error).__name__}: {error}"[:300]


def style_image_of(fault: str, side: int, seed: int) -> np.ndarray:
    """Return the style image [side, side, 3] of a fault; of the ordinary one for an empty name."""
    if fault == "style-white":
        return style_images.white(side)
    makers = {
        "style-tiny": style_images.tiny,
        "style-huge": style_images.huge,
        "style-wash": style_images.weak_geometry,
        "style-extreme": style_images.extreme_palette,
    }
    return makers.get(fault, style_images.ordinary)(side, seed)
