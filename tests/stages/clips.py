"""Clips of the procedural room, encoded with PyAV: at any times, blurred where wanted, turned by their metadata."""

from fractions import Fraction
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter1d

from schemas.images import to_uint8
from tests.stages.photo_room import look_at, photo, textures

TICKS = 90_000


def orbit(angles, width=320, height=240, focal=300.0) -> list:
    """Cameras about the room's corner at these angles, radians."""
    return [look_at((3.2 * np.cos(a), 3.2 * np.sin(a), 1.4), (0.3, 0.3, 0.8), f"p{k:03d}", width, height, focal)
            for k, a in enumerate(angles)]  # fmt: skip


def pictures(cameras, seed: int = 0) -> list[np.ndarray]:
    """[h, w, 3] uint8 of each camera."""
    faces = textures(seed)
    return [to_uint8(photo(camera, faces)) for camera in cameras]


def smeared(picture: np.ndarray, pixels: int = 15) -> np.ndarray:
    """As a camera that turns by so many pixels during the exposure sees it."""
    return uniform_filter1d(picture.astype(np.float32), pixels, axis=1).round().astype(np.uint8)


def write_clip(
    path: Path, frames, times, turn: float | None = None, codec="libx264", form="yuv420p", title: str = "", **tags
) -> Path:
    """Write frames [h, w, 3] uint8 (or uint16 for 10 bit) at these times in seconds."""
    import av

    with av.open(str(path), "w") as video:
        if title:
            video.metadata["title"] = title
        stream = video.add_stream(codec, rate=30)
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt, stream.time_base = form, Fraction(1, TICKS)
        stream.codec_context.time_base = Fraction(1, TICKS)
        stream.options = {"crf": "12", "preset": "veryfast"} if codec == "libx264" else {}
        for name, value in tags.items():
            setattr(stream.codec_context, name, value)
        if turn is not None:
            stream.set_display_rotation(turn)
        for pixels, time in zip(frames, times, strict=True):
            kind = "rgb48le" if pixels.dtype == np.uint16 else "rgb24"
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels), format=kind)
            frame = frame.reformat(format=form, dst_colorspace=tags.get("colorspace"))
            frame.pts, frame.time_base = round(time * TICKS), Fraction(1, TICKS)
            for packet in stream.encode(frame):
                video.mux(packet)
        for packet in stream.encode():
            video.mux(packet)
    return path
