"""Features of a style image's visible parts, with a chosen stroke size, at up to four rotations, in bounded memory."""

from collections.abc import Iterator
from math import ceil, sqrt

import torch
from torch import Tensor

from stylerf.errors import InvalidValue
from stylerf.style.feature_extractor import FeatureExtractor, by_block, features, fitted
from stylerf.style.transparency import shown_positions

PART_SIDE = 768  # approximate side, pixels, of the parts that an enlarged image is processed in
MOST_PIXELS = 1 << 22  # of all parts: an enlarged image has no more strokes
MOST_POSITIONS = 65536  # kept per block
TURNS = 4  # of 90 degrees

Parts = list[tuple[slice, slice]]  # along a side: pixels to extract features from, and those of them to keep


def stroke_picture(style_image: Tensor, long_side: int, stroke: float = 1.0) -> Tensor:
    """Scale a style image [3 or 4, h, w] so that strokes are `stroke` times as large as for a longer side `long_side`.

    A smaller image is extended by mirroring to the size of stroke 1: features along its border see nothing beyond it,
    and a small image is mostly border.
    """
    picture = fitted(style_image, max(1, round(long_side * stroke)))
    if stroke >= 1:
        return picture
    height, width = (max(1, round(side * long_side / max(style_image.shape[1:]))) for side in style_image.shape[1:])
    return mirrored(picture, max(height, picture.shape[1]), max(width, picture.shape[2]))


def mirrored(image: Tensor, height: int, width: int) -> Tensor:
    """Extend an image [c, h, w] to the right and downwards by mirroring; [c, height, width]."""

    def places(side: int, count: int) -> Tensor:
        wave = torch.arange(count, device=image.device) % (2 * side)
        return torch.where(wave < side, wave, 2 * side - 1 - wave)

    return image[:, places(image.shape[1], height)][:, :, places(image.shape[2], width)]


@torch.no_grad()
def style_features(
    extractor: FeatureExtractor,
    picture: Tensor,
    half: torch.dtype | None = None,
    rotations: bool = False,
    in_parts: bool = False,
    limited: bool = True,
    seed: int = 0,
) -> dict[str, Tensor]:
    """Return the features of a style image by block.

    Args:
        extractor: Determines the layers.
        picture: [3 or 4, h, w], scaled, on the extractor's device; a fourth channel is alpha.
        half: See feature_extractor.features().
        rotations: Also return features of the image rotated by 90, 180 and 270 degrees.
        in_parts: Extract from parts of about PART_SIDE pixels, spread over the image, MOST_PIXELS in total. Features
            are the same as for the whole image.
        limited: Keep at most MOST_POSITIONS per block, unless the result is a whole, fully visible image.
        seed: For the choice of these.

    Returns:
        [c, h', w'] for a whole, fully visible image; else [c, 1, n] at the positions that show the style (see
        transparency.shown_positions), without blocks that have none.

    Raises:
        InvalidValue: No position of any block shows the style.
    """
    pictures = [picture.rot90(turn, (1, 2)) for turn in range(TURNS if rotations else 1)]
    if len(pictures) == 1 and not in_parts and picture.shape[0] == 3:
        return by_block(extractor.layers, features(extractor, picture[None], half))
    margin = ceil(extractor.radius / extractor.stride) * extractor.stride
    windows = [(turned, *part) for turned in pictures for part in _parts_of(turned, extractor.stride, margin, in_parts)]
    most = max(1, MOST_POSITIONS // len(windows))
    kept: dict[str, list[Tensor]] = {}
    generator = torch.Generator().manual_seed(seed)
    for turned, outer, inner in windows:
        for block, rows in _kept_rows(extractor, turned[:, *outer], inner, half).items():
            if limited and rows.shape[1] > most:
                rows = rows[:, torch.randperm(rows.shape[1], generator=generator)[:most].sort().values.to(rows.device)]
            kept.setdefault(block, []).append(rows)
    found = {block: torch.cat(parts, dim=1)[:, None] for block, parts in kept.items()}
    found = {block: feature for block, feature in found.items() if feature.shape[2]}
    if not found:
        raise InvalidValue(
            f"the style image's opaque parts are smaller than {next(iter(kept))}'s receptive field at this size; give "
            "it a background"
        )
    return found


def _kept_rows(
    extractor: FeatureExtractor, part: Tensor, inner: tuple[slice, slice], half: torch.dtype | None
) -> dict[str, Tensor]:
    """Return features by block, [c, n], of a part [3 or 4, h, w] at visible positions within the pixels `inner`."""
    kept = {}
    for block, feature in by_block(extractor.layers, features(extractor, part[None, :3], half)).items():
        size = (feature.shape[1], feature.shape[2])
        where = torch.ones(size, dtype=torch.bool, device=part.device)
        if part.shape[0] == 4:
            deepest = [layer for layer in extractor.layers if layer.startswith(block)][-1]
            where = shown_positions(part[3], size, extractor.radius_of(deepest))
        counts = torch.zeros_like(where)
        counts[tuple(_scaled(one, n, of) for one, n, of in zip(inner, size, part.shape[1:]))] = True
        kept[block] = feature[:, where & counts]
    return kept


def _scaled(pixels: slice, positions: int, of: int) -> slice:
    """Return which of `positions`, spread over `of` pixels, are within a slice of pixels."""
    return slice(ceil(pixels.start * positions / of), int(pixels.stop * positions / of))


def _parts_of(
    picture: Tensor, stride: int, margin: int, in_parts: bool
) -> Iterator[tuple[tuple[slice, slice], tuple[slice, slice]]]:
    """Yield windows of an image, each with the part to keep, relative to the window."""
    height, width = picture.shape[1:]
    if not in_parts:
        yield (slice(0, height), slice(0, width)), (slice(0, height), slice(0, width))
        return
    share = min(1.0, sqrt(MOST_PIXELS / (height * width)))
    rows, columns = (_parts_of_side(side, share, stride, margin) for side in (height, width))
    for outer_rows, inner_rows in rows:
        for outer_columns, inner_columns in columns:
            yield (outer_rows, outer_columns), (inner_rows, inner_columns)


def _parts_of_side(side: int, share: float, stride: int, margin: int) -> Parts:
    """Divide a side into equal cells and take the middle `share` of each, with `margin` around it.

    Cuts are at multiples of the stride, so that pooling is aligned with the whole image's.
    """
    count, parts = max(1, round(side / PART_SIDE)), []
    for at in range(count):
        unused = (1 - share) * side / count / 2
        first = int((side * at / count + unused) / stride) * stride
        last = side if share == 1 and at + 1 == count else int((side * (at + 1) / count - unused) / stride) * stride
        start, stop = max(0, first - margin), min(side, last + margin)
        parts.append((slice(start, stop), slice(first - start, last - start)))
    return parts
