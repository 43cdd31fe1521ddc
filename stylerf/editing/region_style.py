"""A region's picture against a painting: Gram matrices of trunk features (LAENeRF's style loss)."""

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from stylerf.editing.edit_views import EditView
from stylerf.errors import InvalidValue
from stylerf.style.color_matching import match_colors
from stylerf.style.feature_extractor import FeatureExtractor
from stylerf.style.image_sizes import fitted
from stylerf.style.losses import gram_distance, gram_matrix, position_weights


def crop_of(painting: Tensor, x: int, y: int, size: int) -> Tensor:
    """The square of `size` pixels of a painting [3, h, w] whose upper left corner is at column x, row y."""
    height, width = painting.shape[1:]
    if size < 1 or x < 0 or y < 0 or x + size > width or y + size > height:
        raise InvalidValue(f"a crop of {size} pixels at {x},{y} does not fit into a painting of {width}x{height}")
    return painting[:, y : y + size, x : x + size].contiguous()


def in_colors_of(painting: Tensor, colors: np.ndarray) -> Tensor:
    """The painting [3, h, w] with the mean and covariance of colors [n, 3]: its strokes without its colors."""
    return match_colors(painting.flatten(1).T, torch.from_numpy(colors)).image(painting).float()


@dataclass(frozen=True, eq=False)
class Canvas:
    """Where a view's pixels lie in its window. places: [n]; height, width: of the window; coverage: at each tap."""

    places: Tensor
    height: int
    width: int
    coverage: list[Tensor]


class RegionStyle:
    """Style distance of what a view shows of the region. side: pixels of the longer side of what features see.

    LAENeRF squashes the region's bounding box to 256x256 and counts the black around the region as picture. Here
    proportions are kept, and a feature position counts by how much of the region it shows, so that a thin region is
    not mostly black. The distance is counted in units of the painting's own mean squared Gram entry, mean over taps:
    1 means as far from the painting as no picture at all, with any trunk.
    """

    def __init__(self, trunk: FeatureExtractor, painting: Tensor, side: int) -> None:
        if side < 4 * trunk.stride:
            raise InvalidValue(f"style pictures of {side} pixels are too small; {4 * trunk.stride} or more are needed")
        self.trunk, self.side = trunk, side
        with torch.no_grad():
            features = trunk(self._tall(fitted(painting.to(self.device), side))[None])
        self.grams = [gram_matrix(feature[0]) for feature in features]
        self.units = [float(gram.square().mean().clamp_min(1e-12)) for gram in self.grams]

    @property
    def device(self) -> torch.device:
        """The trunk's: colors must lie there."""
        return self.trunk.input_scale.device

    def _tall(self, picture: Tensor) -> Tensor:
        """A thin picture with black beside it, for the trunk needs some pixels a side."""
        least = 2 * self.trunk.stride
        height, width = picture.shape[-2:]
        return F.pad(picture, (0, max(0, least - width), 0, max(0, least - height)))

    def canvas(self, view: EditView) -> Canvas:
        """What `distance` needs to know of a view."""
        rows, columns = view.window
        height, width = int(rows.stop - rows.start), int(columns.stop - columns.start)
        row, column = np.divmod(view.pixels, view.width)
        places = torch.from_numpy((row - rows.start) * width + column - columns.start).to(self.device)
        alpha = torch.zeros(height * width, device=self.device).index_fill(0, places, 1.0).view(1, height, width)
        small = self._tall(fitted(alpha, self.side))
        with torch.no_grad():
            features = self.trunk(small.expand(3, -1, -1)[None])
        coverage = [position_weights(small[0], feature[0]) for feature in features]
        return Canvas(places, height, width, coverage)

    def picture(self, colors: Tensor, canvas: Canvas) -> Tensor:
        """[3, h', w']: colors [n, 3] in the window, black around them, the longer side `side` pixels."""
        whole = colors.new_zeros(canvas.height * canvas.width, 3).index_copy(0, canvas.places, colors)
        return self._tall(fitted(whole.T.reshape(3, canvas.height, canvas.width), self.side))

    def distance(self, colors: Tensor, canvas: Canvas) -> Tensor:
        """L_style, scalar: mean squared difference of the Gram matrices, in the painting's units."""
        features = self.trunk(self.picture(colors, canvas)[None])
        parts = [
            gram_distance(feature[0], gram, weights).mean() / unit
            for feature, gram, weights, unit in zip(features, self.grams, canvas.coverage, self.units)
        ]
        return torch.stack(parts).mean()
