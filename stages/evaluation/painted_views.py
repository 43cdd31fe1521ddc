"""Views painted in 2D by the loss of a stylization, shown next to its renders as an upper bound."""

from dataclasses import fields
from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from schemas.work_folder import Artifact, sources_of
from stages.artifacts.style_images import read_style_image
from stages.configs.stylize import ArfConfig, DesrfConfig, SnerfConfig, StylizeConfig
from stages.evaluation.test_views import Photo
from stages.stylization.settings import image_layers, settings_of
from stages.weights.resolve import resolve
from stylerf.errors import InvalidValue
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.training.stylize.painted_photo import painted_photo
from stylerf.training.stylize.settings import ImageStyleSettings

# Options that concern images, and the methods with their own defaults for them; the others paint as ARF does.
OF_IMAGES = {item.name for item in fields(StylizeConfig)} | {"image_by"}
OF_IMAGES -= {"method", "style", "style_digest", "features_digest", "budget"}
PAINTERS: dict[str, type[StylizeConfig]] = {"desrf": DesrfConfig, "snerf": SnerfConfig}


class PaintedViews:
    """Paints photos of a scene as the field was stylized, as far as its options concern images."""

    def __init__(self, field: Artifact | None, style: Path, features: str, seed: int, device: str) -> None:
        """features: a feature network, or empty for the one that stylized the field."""
        self.config = options_of(field, style)
        resolved = resolve(features or self.config.features or None)
        self.extractor = FeatureExtractor(resolved.state, image_layers(self.config, resolved.state), resolved.kind)
        self.extractor.to(device)
        self.style_image, self.seed = read_style_image(style, self.config.keep_frame), seed

    def painted(self, photo: Photo, background: float, steps: int) -> np.ndarray:
        """A photo painted in `steps` steps, [h, w, 3] sRGB; BadInput if it is too small."""
        opaque_background = photo.mask is None
        settings: ImageStyleSettings = settings_of(self.config, max(photo.image.shape[:2]), opaque_background)
        try:
            return painted_photo(
                photo.image, photo.mask, background, self.style_image, settings, self.extractor, steps, self.seed
            )
        except InvalidValue as error:
            raise BadInput(f"--ceiling: {error}") from error


def options_of(field: Artifact | None, style: Path) -> StylizeConfig:
    """Return the image options of the last stylization of a field; the defaults if none is known."""
    behind = [] if field is None else [field, *sources_of(field, ("field",))]
    made = next((one for one in behind if one.manifest.stage == "stylize"), None)
    config = {} if made is None else made.manifest.config
    try:
        painter = PAINTERS.get(config.get("method", ""), ArfConfig)
        own = OF_IMAGES & {item.name for item in fields(painter)}
        return painter(style=str(style), **{key: value for key, value in config.items() if key in own})
    except (TypeError, ValueError):  # options of another version, or for references
        return ArfConfig(style=str(style))
