"""Commands of the stages that bring a region's edit into a field, one by one, and of a field's deformation."""

from pathlib import Path

from schemas.errors import UsageError
from stages.configs.edit import FinetuneConfig
from stages.viewing.commands import command


def extract_command(work: Path, region: str) -> list[str]:
    """Return the command that renders what the views show of a region, for its edit."""
    return command("extract", work, region=_given(region, "region"))


def distill_command(work: Path, edit: str) -> list[str]:
    """Return the command that paints an edit into the training photos."""
    return command("distill", work, edit=_given(edit, "edit"))


def finetune_command(work: Path, edit: str, seconds: int) -> list[str]:
    """Return the command that trains a field on an edit."""
    return command("finetune", work, FinetuneConfig(budget=f"{seconds}s"), edit=_given(edit, "edit"))


def deform_command(work: Path, field: str) -> list[str]:
    """Return the command that gives a field a deformation."""
    return command("deform", work, of=field)


def _given(name: str, kind: str) -> str:
    if not name:
        raise UsageError(f"no {kind} yet: create one first")
    return name
