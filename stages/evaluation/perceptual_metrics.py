"""The perceptual networks of an evaluation, and its style image."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from schemas.errors import BadInput
from schemas.work_folder import Artifact
from stages.artifacts.style_images import read_colors
from stages.configs.evaluate import SMALLEST_SIDE, EvaluateConfig
from stages.evaluation.perceptual_networks import PerceptualNetwork, StyleImage, perceptual_networks
from stages.evaluation.view_metrics import Score
from stages.run.progress import Context
from stylerf.metrics.consistency import PixelDistance
from stylerf.metrics.flow_consistency import ImageDistance

STYLE_IMAGE = "the style image"


@dataclass(frozen=True, eq=False)
class PerceptualMetrics:
    """Perceptual networks and the style image; each None if not wanted or not available."""

    st_lpips: PerceptualNetwork | None
    lpips: PerceptualNetwork | None
    style_image: StyleImage | None
    style_name: str
    style_label: str = STYLE_IMAGE

    @classmethod
    def load(cls, config: EvaluateConfig, field: Artifact | None, context: Context) -> "PerceptualMetrics":
        """Load what the config asks for and this machine has; report the feature network of the style distances."""
        st_lpips, lpips = perceptual_networks(context.device) if config.perceptual != "none" else (None, None)
        path = style_file(config, field)
        if path is None:
            return cls(st_lpips, lpips, None, "")
        style_image = StyleImage(read_colors(path), config.features, config.style_side, context.device)
        context.progress.say(f"style distances to {path.name} use the features of {style_image.network_name}")
        return cls(st_lpips, lpips, style_image, path.name, style_label(config, field))

    @property
    def pixel_name(self) -> str:
        """Name of the perceptual distance between pairs of frames."""
        if self.lpips is not None:
            return f"LPIPS ({self.lpips.name})"
        return f"ST-LPIPS ({self.st_lpips.name})" if self.st_lpips is not None else "perceptual"

    def large_enough(self, shape: tuple[int, ...]) -> bool:
        """Whether images of this height and width are large enough for the networks."""
        return min(shape[:2]) >= SMALLEST_SIDE

    def scores(self, shape: tuple[int, ...]) -> Mapping[str, Score]:
        """Distances of whole images by metric key."""
        nets = {"stlpips": self.st_lpips, "lpips": self.lpips}
        return {key: net.distance for key, net in nets.items() if net is not None and self.large_enough(shape)}

    def pixel_distance(self, shape: tuple[int, ...]) -> PixelDistance | None:
        """LPIPS, or else ST-LPIPS, as a map over pixels; None if neither is available."""
        net = self.lpips or self.st_lpips
        return net.pixels if net is not None and self.large_enough(shape) else None

    def image_distance(self, shape: tuple[int, ...]) -> ImageDistance | None:
        """The same distance of whole images."""
        net = self.lpips or self.st_lpips
        return net.distance if net is not None and self.large_enough(shape) else None


def style_label(config: EvaluateConfig, field: Artifact | None) -> str:
    """What labels call the style image: a field stylized by references alone is compared with the first of them."""
    made_with = {} if config.style or field is None else field.manifest.config
    return "the reference" if made_with.get("reference") and not made_with.get("style") else STYLE_IMAGE


def style_file(config: EvaluateConfig, field: Artifact | None) -> Path | None:
    """The style image: the one given, else `style.<extension>` in the field's folder, else the one its config names.

    Raises BadInput if one was given and does not exist.
    """
    if config.style:
        path = Path(config.style).expanduser()
        if not path.is_file():
            raise BadInput(f"--style {config.style}: no such file; give the style image to compare with")
        return path
    if field is None:
        return None
    kept = [record.path for record in field.manifest.files if Path(record.path).stem == "style"]
    pictures = [name for name in kept if Path(name).suffix.lower() in (".png", ".jpg", ".jpeg")]
    if pictures:
        return field.file(pictures[0])
    named = field.manifest.config.get("style")
    return Path(named) if isinstance(named, str) and named and Path(named).is_file() else None
