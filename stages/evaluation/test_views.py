"""Rendered frames, photos and true depths, brought to one size and one background."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from skimage.transform import resize

from schemas.errors import ArtifactDamaged, BadInput
from schemas.exr import read_channels
from schemas.frames import FRAMES_FILE, Frame, Frames, read_frames
from schemas.images import srgb_from_linear
from schemas.work_folder import Artifact
from stages.artifacts.scene import load_scene, view_index
from stylerf.errors import InvalidValue
from stylerf.geometry.cameras import Camera
from stylerf.metrics.consistency import PosedView
from stylerf.training.common.ray_dataset import HIDDEN

BACKGROUNDS = {"alpha": 1.0, "white": 1.0, "black": 0.0, "none": 0.0}


@dataclass(frozen=True, eq=False)
class Render:
    """One frame of a field: image [h, w, 3] sRGB over the background, clipped to 0..1; alpha, z [h, w].

    spoiled: pixels with a color, alpha or (where opaque) depth that is not finite; they stay so in the arrays.
    """

    name: str
    camera: Camera
    image: np.ndarray
    alpha: np.ndarray
    z: np.ndarray
    spoiled: int
    scene_view: int | None

    def posed(self) -> PosedView:
        """As the consistency metric takes it."""
        return PosedView(self.camera, self.image, self.alpha, self.z)


@dataclass(frozen=True, eq=False)
class Photo:
    """What was really seen: image [h, w, 3] sRGB over the background; object mask [h, w] or None; true z or None.

    shown: of a capture's photo, the pixels [h, w] that no mask hides; None: all of them.
    resized, depth_unfit: the photo was stored at another size; so was a depth, which is then left out.
    """

    image: np.ndarray
    mask: np.ndarray | None
    depth: np.ndarray | None
    resized: bool
    depth_unfit: bool
    shown: np.ndarray | None = None

    def beside(self, image: np.ndarray) -> np.ndarray:
        """The photo with what it hides taken from an image of its size."""
        return self.image if self.shown is None else np.where(self.shown[..., None], self.image, image)


class SceneViews:
    """The photos of a scene, read one at a time."""

    def __init__(self, artifact: Artifact) -> None:
        self._data = load_scene(artifact)
        self.background = BACKGROUNDS[self._data.background]

    def __len__(self) -> int:
        return len(self._data.views)

    @property
    def background_words(self) -> str:
        """How a protocol tells what stands behind transparent pixels."""
        return {
            "alpha": "(both composited on white)"
            if self._data.layout == "object"
            else "(where its mask shows the scene; distances by networks see the render where it does not)",
            "white": "(photo as stored, on white; render composited on white)",
            "black": "(photo as stored, on black; render composited on black)",
            "none": "(render composited on black where it is not opaque)",
        }[self._data.background]

    def photo(self, index: int, width: int, height: int) -> Photo:
        """View `index` at the given size; averaged down (or interpolated up) where it is stored at another.

        A depth of another size is left out: depths cannot be averaged.
        """
        pixels = self._data.images(index)
        other_size = pixels.shape[:2] != (height, width)
        premultiplied = _premultiplied(pixels)
        if other_size:
            premultiplied = resize(premultiplied, (height, width, pixels.shape[2]), anti_aliasing=True)
        color, mask, shown = premultiplied[..., :3], None, None
        if premultiplied.shape[2] == 4:
            alpha = premultiplied[..., 3:]
            if self._data.layout == "object":
                mask = alpha[..., 0] > 0.5
                color = color + (1 - alpha) * self.background
            else:  # nothing of a capture is transparent: masks hide passers-by
                shown = alpha[..., 0] > HIDDEN
                color = np.where(shown[..., None], color / np.maximum(alpha, HIDDEN), self.background)
        depth = self._data.truth_depth(index)
        unfit = depth is not None and depth.shape != (height, width)
        image = np.clip(color, 0, 1).astype(np.float32)
        return Photo(image, mask, None if unfit else depth, other_size, unfit, shown)

    def center_of(self, name: str) -> np.ndarray:
        """Camera center [3] of a view by its name, or else by its number; BadInput where there is none."""
        return self._data.cameras[view_index(self._data, name, "--reference")].center

    @property
    def has_depth(self) -> bool:
        """Whether true depths belong to this scene."""
        return self._data.scene.truth.depth is not None


class FrameViews:
    """The frames of a `frames` artifact over one background, read one at a time."""

    def __init__(self, artifact: Artifact, background: float) -> None:
        self.artifact, self.background = artifact, background
        self.frames: Frames = read_frames(artifact.file(FRAMES_FILE).parent)
        if not self.frames.views:
            raise BadInput(f"frames {artifact.name} hold no view; render them again")

    def __len__(self) -> int:
        return len(self.frames.views)

    def __iter__(self) -> Iterator[Render]:
        return (self.render(i) for i in range(len(self)))

    def showing(self, scene_view: int | None) -> int | None:
        """Index of the frame that repeats this view of the scene, None where none does."""
        if scene_view is None:
            return None
        return next((i for i, view in enumerate(self.frames.views) if view.scene_view == scene_view), None)

    def mask(self, index: int, region: str, digest: str) -> np.ndarray | None:
        """Coverage [h, w] that frame `index` holds of this very region, None where it holds none."""
        own = {ref.name: ref.digest for ref in self.artifact.manifest.inputs if ref.kind == "region"}
        if own.get(region) != digest or region not in self.frames.masks:
            return None
        channel = f"mask.{self.frames.masks[region]}"
        path = self.artifact.file(self.frames.views[index].exr)
        try:
            return read_channels(path, (channel,))[0][channel].astype(np.float32)
        except BadInput as error:
            raise ArtifactDamaged(f"frames {self.artifact.name}: {error}") from error

    def render(self, index: int) -> Render:
        """Frame `index`. Values that are not finite are kept and counted, not refused: an evaluation has to tell them.

        ArtifactDamaged where the file is missing, cannot be read, or has another size than its camera.
        """
        frame = self.frames.views[index]
        path = self.artifact.file(frame.exr)
        try:
            channels, _ = read_channels(path, ("R", "G", "B", "A", "Z"))
        except BadInput as error:
            raise ArtifactDamaged(f"frame {frame.name} of {self.artifact.name}: {error}") from error
        camera = _camera(frame, self.artifact)
        planes = {name: channels[name].astype(np.float32) for name in ("R", "G", "B", "A", "Z")}
        if planes["A"].shape != (camera.height, camera.width):
            height, width = planes["A"].shape
            raise ArtifactDamaged(f"{path} is {width}x{height} where its camera has {camera.width}x{camera.height}")
        linear = np.stack([planes["R"], planes["G"], planes["B"]], axis=-1)
        alpha, z = planes["A"], planes["Z"]
        bad = ~np.isfinite(linear).all(axis=-1) | ~np.isfinite(alpha) | ((alpha > 0.5) & ~np.isfinite(z))
        image = np.where(bad[..., None], np.nan, composite(linear, alpha, self.background))
        return Render(frame.name, camera, image.astype(np.float32), alpha, z, int(bad.sum()), frame.scene_view)


def composite(linear: np.ndarray, alpha: np.ndarray, background: float) -> np.ndarray:
    """Premultiplied linear colors [h, w, 3] over a gray `background` -> sRGB-encoded [h, w, 3], clipped to 0..1.

    Fields blend sRGB-encoded colors, so the blend with the background is of encoded values too: the straight color
    linear / alpha is encoded, then mixed by alpha.
    """
    with np.errstate(invalid="ignore"):
        straight = linear / np.maximum(alpha, 1e-6)[..., None]
        encoded = srgb_from_linear(np.clip(straight, 0, None))
        mixed = encoded * alpha[..., None] + (1 - alpha[..., None]) * background
    return np.clip(mixed, 0, 1)


def _premultiplied(pixels: np.ndarray) -> np.ndarray:
    if pixels.shape[2] != 4:
        return pixels
    return np.concatenate([pixels[..., :3] * pixels[..., 3:], pixels[..., 3:]], axis=-1)


def _camera(frame: Frame, artifact: Artifact) -> Camera:
    given = frame.camera
    try:
        return Camera(frame.name, given.width, given.height, given.fx, given.fy, given.cx, given.cy,
                      np.array(given.world_from_camera))  # fmt: skip
    except InvalidValue as error:
        raise ArtifactDamaged(f"frames {artifact.name}: {error}; render them again") from error
