"""The style loss for a region: Gram matrices of features (LAENeRF)."""

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from stylerf.editing.extraction import EditView
from stylerf.errors import InvalidValue
from stylerf.style.feature_extractor import FeatureExtractor, fitted
from stylerf.style.style_features import stroke_picture
from stylerf.style.style_loss import gram_distance, gram_matrix, position_weights
from stylerf.style.transparency import shown_positions


def crop_of(style_image: Tensor, x: int, y: int, size: int) -> Tensor:
    """Crop a square of `size` pixels from a style image [c, h, w], with its top left corner at column x, row y."""
    height, width = style_image.shape[1:]
    if size < 1 or x < 0 or y < 0 or x + size > width or y + size > height:
        raise InvalidValue(f"a crop of {size} pixels at {x},{y} does not fit in a style image of {width}x{height}")
    return style_image[:, y : y + size, x : x + size].contiguous()


@dataclass(frozen=True, eq=False)
class Canvas:
    """The window of a view. places: [n], pixel indices in it. height, width: pixels. coverage: for each layer."""

    places: Tensor
    height: int
    width: int
    coverage: list[Tensor]


class RegionStyle:
    """The style distance of a region's pixels in a view.

    LAENeRF resizes the region's bounding box to 256x256, including the black around the region. Here the aspect ratio
    is preserved and feature positions are weighted by coverage, so that thin regions are not mostly black. The distance
    is relative to the mean squared entry of the style image's Gram matrix, averaged over layers: an empty image has
    distance 1 for any feature extractor.

    Args:
        extractor: Its layers are compared.
        style_image: [3 or 4, h, w]; a fourth channel is alpha, and hidden parts do not count.
        side: Longer side of the images that features are extracted from, pixels.
        stroke: Size of the style image's strokes, relative to scaling both images to that size.
    """

    def __init__(self, extractor: FeatureExtractor, style_image: Tensor, side: int, stroke: float = 1.0) -> None:
        if side < 4 * extractor.stride:
            raise InvalidValue(f"style images of {side} pixels are too small; expected at least {4 * extractor.stride}")
        self.extractor, self.side = extractor, side
        picture = self._padded(stroke_picture(style_image.to(self.device), side, stroke))
        with torch.no_grad():
            features = extractor(picture[None, :3])
            shown = [self._shown(layer, picture, feature) for layer, feature in zip(extractor.layers, features)]
            self.grams = [gram_matrix(feature[0], weights) for feature, weights in zip(features, shown)]
        self.units = [float(gram.square().mean().clamp_min(1e-12)) for gram in self.grams]

    @property
    def device(self) -> torch.device:
        """The feature extractor's device, where colors must be."""
        return self.extractor.input_scale.device

    def _shown(self, layer: str, picture: Tensor, feature: Tensor) -> Tensor | None:
        """Return the weights [h', w'] of the style image's features, or None for 1."""
        if picture.shape[0] == 3:
            return None
        shown = shown_positions(picture[3], (feature.shape[2], feature.shape[3]), self.extractor.radius_of(layer))
        if not bool(shown.any()):
            raise InvalidValue(
                f"the style image's opaque parts are smaller than {layer}'s receptive field; give it a background"
            )
        return shown.float()

    def _padded(self, picture: Tensor) -> Tensor:
        """Pad a thin image with black to the minimum side that the extractor accepts."""
        smallest = 2 * self.extractor.stride
        height, width = picture.shape[-2:]
        return F.pad(picture, (0, max(0, smallest - width), 0, max(0, smallest - height)))

    def canvas(self, view: EditView) -> Canvas:
        """Return what distance() needs to know about a view."""
        rows, columns = view.window
        height, width = int(rows.stop - rows.start), int(columns.stop - columns.start)
        row, column = np.divmod(view.pixels, view.width)
        places = torch.from_numpy((row - rows.start) * width + column - columns.start).to(self.device)  # in the window
        alpha = torch.zeros(height * width, device=self.device).index_fill(0, places, 1.0).view(1, height, width)
        small = self._padded(fitted(alpha, self.side))
        with torch.no_grad():
            features = self.extractor(small.expand(3, -1, -1)[None])
        coverage = [position_weights(small[0], feature[0]) for feature in features]
        return Canvas(places, height, width, coverage)

    def picture(self, colors: Tensor, canvas: Canvas) -> Tensor:
        """Draw colors [n, 3] into the window, on black, and resize its longer side to `side`: [3, h', w']."""
        whole = colors.new_zeros(canvas.height * canvas.width, 3).index_copy(0, canvas.places, colors)
        return self._padded(fitted(whole.T.reshape(3, canvas.height, canvas.width), self.side))

    def distance(self, colors: Tensor, canvas: Canvas) -> Tensor:
        """Return L_style, a scalar: the relative mean squared difference of the Gram matrices."""
        features = self.extractor(self.picture(colors, canvas)[None])
        parts = [
            gram_distance(feature[0], gram, weights).mean() / unit
            for feature, gram, weights, unit in zip(features, self.grams, canvas.coverage, self.units)
        ]
        return torch.stack(parts).mean()
