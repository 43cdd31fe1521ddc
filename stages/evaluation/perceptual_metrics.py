"""What an evaluation looks through: the perceptual networks that are here, and the painting."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from schemas.errors import BadInput
from schemas.work_folder import Artifact
from stages.artifacts.style_images import read_colors
from stages.configs.evaluate import SMALLEST_SIDE, EvaluateConfig
from stages.evaluation.perceptual_networks import Painting, Perceptual, perceptual_distances
from stages.evaluation.view_metrics import Score
from stages.run.progress import Context
from stylerf.metrics.consistency import PixelDistance
from stylerf.metrics.flow_consistency import ImageDistance


@dataclass(frozen=True, eq=False)
class PerceptualMetrics:
    """Networks by use, None where not wanted or not here."""

    tolerant: Perceptual | None
    lpips: Perceptual | None
    painting: Painting | None
    painting_name: str
    style_words: str = "the painting"  # what that picture is

    @classmethod
    def found(cls, config: EvaluateConfig, field: Artifact | None, context: Context) -> "PerceptualMetrics":
        """Loads what the configuration wants and this machine has; says which features the style is judged by."""
        tolerant, lpips = perceptual_distances(context.device) if config.perceptual != "none" else (None, None)
        path = painting_file(config, field)
        if path is None:
            return cls(tolerant, lpips, None, "")
        painting = Painting(read_colors(path), config.features, config.style_side, context.device)
        context.progress.say(f"style distances to {path.name} by features of {painting.trunk_name}")
        return cls(tolerant, lpips, painting, path.name, style_words(config, field))

    @property
    def pixel_name(self) -> str:
        """The perceptual distance that pairs of views are measured by."""
        if self.lpips is not None:
            return f"LPIPS ({self.lpips.name})"
        return f"ST-LPIPS ({self.tolerant.name})" if self.tolerant is not None else "perceptual"

    def large_enough(self, shape: tuple[int, ...]) -> bool:
        """Whether the networks can see images of this height and width."""
        return min(shape[:2]) >= SMALLEST_SIDE

    def scores(self, shape: tuple[int, ...]) -> Mapping[str, Score]:
        """Perceptual scores of whole images by key."""
        nets = {"stlpips": self.tolerant, "lpips": self.lpips}
        return {key: net.distance for key, net in nets.items() if net is not None and self.large_enough(shape)}

    def pixel_distance(self, shape: tuple[int, ...]) -> PixelDistance | None:
        """LPIPS, else ST-LPIPS, as a map over pixels; None where neither can be had."""
        net = self.lpips or self.tolerant
        return net.pixels if net is not None and self.large_enough(shape) else None

    def whole_distance(self, shape: tuple[int, ...]) -> ImageDistance | None:
        """The same distance of whole images."""
        net = self.lpips or self.tolerant
        return net.distance if net is not None and self.large_enough(shape) else None


def style_words(config: EvaluateConfig, field: Artifact | None) -> str:
    """What the picture is that style is measured by: a field made after references alone keeps the first of them."""
    made_with = {} if config.style or field is None else field.manifest.config
    return "the reference" if made_with.get("reference") and not made_with.get("style") else "the painting"


def painting_file(config: EvaluateConfig, field: Artifact | None) -> Path | None:
    """The painting given, else the one kept in the field's folder as `style.<extension>`, else the one it names.

    BadInput when one was given and is not there.
    """
    if config.style:
        path = Path(config.style).expanduser()
        if not path.is_file():
            raise BadInput(f"--style {config.style}: no such file; give the painting to measure against")
        return path
    if field is None:
        return None
    kept = [record.path for record in field.manifest.files if Path(record.path).stem == "style"]
    pictures = [name for name in kept if Path(name).suffix.lower() in (".png", ".jpg", ".jpeg")]
    if pictures:
        return field.file(pictures[0])
    named = field.manifest.config.get("style")
    return Path(named) if isinstance(named, str) and named and Path(named).is_file() else None
