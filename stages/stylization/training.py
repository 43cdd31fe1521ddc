"""Training the colors of a field by any method, with progress phase by phase."""

from collections.abc import Mapping

from schemas.work_folder import PartialArtifact
from stages.configs.decompose import DecomposeConfig
from stages.configs.fit import budget_of
from stages.configs.stylize import StylizeConfig
from stages.run.progress import Context
from stages.run.training_loop import run_training
from stylerf.training.stylize.trainer import StylizationTrainer


def train(
    trainer: StylizationTrainer,
    what: str,
    config: StylizeConfig | DecomposeConfig,
    partial: PartialArtifact,
    context: Context,
    labels: Mapping[str, str],
) -> None:
    """Train to the end. what: its name in errors. labels: of phases, where they are not the phases' names."""
    shown = ""
    seconds, _ = budget_of(config.budget)

    def report(now: StylizationTrainer) -> None:
        nonlocal shown
        state, total = now.state, now.scene.budget.steps
        if state.phase != shown:
            shown = state.phase
            context.progress.start(labels.get(shown, shown), total or seconds, "step" if total else "s")
        last, note = state.curve[-1] if state.curve else {}, ""
        if last:
            note = f"style distance {last['style']:.3f}" if "style" in last else f"squared error {last['mse']:.4f}"
        context.progress.update(state.step if total else min(state.seconds, now.settings.seconds), note)

    run_training(trainer, what, config.checkpoint_every_seconds, partial, context, report)
