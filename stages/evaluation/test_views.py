"""Rendered frames, photos and true depth, at one size and over one background."""

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
    """One frame of a field.

    Attributes:
        image: [h, w, 3] sRGB over the background, clipped to 0..1.
        alpha: [h, w].
        z: planar depth [h, w].
        nonfinite: number of pixels with NaN or infinite color, alpha or (where opaque) depth; their image is NaN.
        scene_view: index of the scene's view that the frame repeats, or None.
    """

    name: str
    camera: Camera
    image: np.ndarray
    alpha: np.ndarray
    z: np.ndarray
    nonfinite: int
    scene_view: int | None

    def posed(self) -> PosedView:
        """The frame as input of the consistency metrics."""
        return PosedView(self.camera, self.image, self.alpha, self.z)


@dataclass(frozen=True, eq=False)
class Photo:
    """The ground truth of a view.

    Attributes:
        image: [h, w, 3] sRGB over the background.
        mask: the object's pixels [h, w], or None.
        depth: true planar depth [h, w], or None.
        resized: whether the photo was stored at another size.
        depth_size_differs: whether the true depth is left out because its size differs.
        visible: pixels [h, w] of a capture's photo that no mask hides; None if all are.
    """

    image: np.ndarray
    mask: np.ndarray | None
    depth: np.ndarray | None
    resized: bool
    depth_size_differs: bool
    visible: np.ndarray | None = None

    def filled_from(self, image: np.ndarray) -> np.ndarray:
        """The photo with its hidden pixels replaced by those of an image of the same size."""
        return self.image if self.visible is None else np.where(self.visible[..., None], self.image, image)


class SceneViews:
    """Photos of a scene, read one at a time."""

    def __init__(self, artifact: Artifact) -> None:
        self._data = load_scene(artifact)
        self.background = BACKGROUNDS[self._data.background]

    def __len__(self) -> int:
        return len(self._data.views)

    @property
    def background_description(self) -> str:
        """The background of transparent pixels, for protocols."""
        return {
            "alpha": "(both composited on white)"
            if self._data.layout == "object"
            else "(where its mask shows the scene; for perceptual networks, masked pixels show the render)",
            "white": "(photo as stored, on white; render composited on white)",
            "black": "(photo as stored, on black; render composited on black)",
            "none": "(render composited on black where it is not opaque)",
        }[self._data.background]

    def photo(self, index: int, width: int, height: int) -> Photo:
        """Read view `index` at the given size, resampled if it is stored at another.

        True depth of another size is left out: averaged depths would lie between surfaces.
        """
        pixels = self._data.images(index)
        other_size = pixels.shape[:2] != (height, width)
        premultiplied = _premultiplied(pixels)
        if other_size:
            premultiplied = resize(premultiplied, (height, width, pixels.shape[2]), anti_aliasing=True)
        color, mask, visible = premultiplied[..., :3], None, None
        if premultiplied.shape[2] == 4:
            alpha = premultiplied[..., 3:]
            if self._data.layout == "object":
                mask = alpha[..., 0] > 0.5
                color = color + (1 - alpha) * self.background
            else:  # a capture's alpha is not transparency: its masks hide passers-by
                visible = alpha[..., 0] > HIDDEN
                color = np.where(visible[..., None], color / np.maximum(alpha, HIDDEN), self.background)
        depth = self._data.truth_depth(index)
        size_differs = depth is not None and depth.shape != (height, width)
        image = np.clip(color, 0, 1).astype(np.float32)
        return Photo(image, mask, None if size_differs else depth, other_size, size_differs, visible)

    def center_of(self, name: str) -> np.ndarray:
        """Return the camera center [3] of a view given by name or number; BadInput if it does not exist."""
        return self._data.cameras[view_index(self._data, name, "--reference")].center

    @property
    def has_depth(self) -> bool:
        """Whether the scene has true depth."""
        return self._data.scene.truth.depth is not None


class FrameViews:
    """Frames of a `frames` artifact over one background, read one at a time."""

    def __init__(self, artifact: Artifact, background: float) -> None:
        self.artifact, self.background = artifact, background
        self.frames: Frames = read_frames(artifact.file(FRAMES_FILE).parent)
        if not self.frames.views:
            raise BadInput(f"frames {artifact.name} are empty; render them again")

    def __len__(self) -> int:
        return len(self.frames.views)

    def __iter__(self) -> Iterator[Render]:
        return (self.render(i) for i in range(len(self)))

    def index_of(self, scene_view: int | None) -> int | None:
        """Index of the frame that repeats this view of the scene; None if there is none."""
        if scene_view is None:
            return None
        return next((i for i, view in enumerate(self.frames.views) if view.scene_view == scene_view), None)

    def same_view(self, render: Render) -> Render | None:
        """The frame that repeats the same view of the scene as `render`; None if there is none."""
        index = self.index_of(render.scene_view)
        return None if index is None else self.render(index)

    def mask(self, index: int, region: str, digest: str) -> np.ndarray | None:
        """Coverage [h, w] of exactly this region stored in frame `index`; None if there is none."""
        digests = {ref.name: ref.digest for ref in self.artifact.manifest.inputs if ref.kind == "region"}
        if digests.get(region) != digest or region not in self.frames.masks:
            return None
        channel = f"mask.{self.frames.masks[region]}"
        path = self.artifact.file(self.frames.views[index].exr)
        try:
            return read_channels(path, (channel,))[0][channel].astype(np.float32)
        except BadInput as error:
            raise ArtifactDamaged(f"frames {self.artifact.name}: {error}") from error

    def render(self, index: int) -> Render:
        """Read frame `index`. NaN and infinite values are kept and counted, since the report must show them.

        Raises ArtifactDamaged if the file is missing, unreadable, or differs in size from its camera.
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
            raise ArtifactDamaged(f"{path} is {width}x{height} but its camera is {camera.width}x{camera.height}")
        linear = np.stack([planes["R"], planes["G"], planes["B"]], axis=-1)
        alpha, z = planes["A"], planes["Z"]
        bad = ~np.isfinite(linear).all(axis=-1) | ~np.isfinite(alpha) | ((alpha > 0.5) & ~np.isfinite(z))
        image = np.where(bad[..., None], np.nan, composite(linear, alpha, self.background))
        return Render(frame.name, camera, image.astype(np.float32), alpha, z, int(bad.sum()), frame.scene_view)


def composite(linear: np.ndarray, alpha: np.ndarray, background: float) -> np.ndarray:
    """Composite premultiplied linear colors [h, w, 3] over a gray `background`, as sRGB [h, w, 3] clipped to 0..1.

    Fields blend sRGB-encoded colors, so the background is blended in sRGB too: the straight color linear / alpha is
    encoded, then mixed by alpha.
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
    stored = frame.camera
    try:
        return Camera(frame.name, stored.width, stored.height, stored.fx, stored.fy, stored.cx, stored.cy,
                      np.array(stored.world_from_camera))  # fmt: skip
    except InvalidValue as error:
        raise ArtifactDamaged(f"frames {artifact.name}: {error}; render them again") from error
