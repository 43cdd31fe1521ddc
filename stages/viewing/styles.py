"""A stylization requested on the page, as the command that makes it."""

from dataclasses import dataclass
from pathlib import Path

from schemas.errors import UsageError
from schemas.work_folder import valid_name
from stages.configs.edit import RegionConfig
from stages.configs.stylize import CONFIGS
from stages.viewing.commands import command

METHODS = tuple(CONFIGS)
CHECKPOINT_SECONDS = 5.0  # between pictures of a run in progress


@dataclass(frozen=True)
class Wish:
    """A stylization.

    Attributes:
        style: File of the style image.
        method: One of METHODS; regions have their own method.
        region: Empty for the whole scene.
        strength: Factor of the style distance's weight.
        stroke: Relative size of strokes.
        budget: Time such as 60s, or a number of style steps.
        name: Of the result, empty for the default.
    """

    style: str
    method: str = "arf"
    region: str = ""
    strength: float = 1.0
    stroke: float = 1.0
    budget: str = "60s"
    name: str = ""

    def command(self, work: Path | str, field: str) -> list[str]:
        """Return the command.

        Raises:
            UsageError: there is no style image, or the name is invalid.
            ValueError: options that the stage rejects.
        """
        if not self.style:
            raise UsageError("no painting selected: choose one first")
        named = self.name and valid_name(self.name)
        if self.region:
            learned = RegionConfig(
                style=self.style,
                stroke=self.stroke,
                style_weight=RegionConfig.style_weight * self.strength,
                budget=self.budget,
                checkpoint_every_seconds=CHECKPOINT_SECONDS,
            )
            return command("stylize", work, learned, region=self.region, name=named)
        config = CONFIGS[self.method](
            method=self.method, style=self.style, stroke=self.stroke, style_weight=self.strength,
            budget=self.budget, checkpoint_every_seconds=CHECKPOINT_SECONDS,
        )  # fmt: skip
        made = command("stylize", work, config, of=field, name=named)
        return made if "--method" in made else [*made, "--method", self.method]
