"""Videos of rendered frames: MP4 if PyAV is installed (extra `video`), else GIF."""

import io
from collections.abc import Iterable
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path
from typing import BinaryIO

import numpy as np

from schemas.atomic_write import replacing
from schemas.errors import BadInput
from schemas.images import read_image, to_uint8

BT709 = 1  # code of its primaries and its transfer function in ITU-T H.273
PALETTE_FRAMES = 12
SHORTEST_MS = 20  # players show shorter GIF frames for 100 ms
LONGEST_MS = 655_350  # 16 bits of 10 ms units


def write_video(path: Path, pictures: list[Path], fps: float) -> tuple[Path, str]:
    """Write `path` with .mp4 or .gif added, atomically; return the file, and the name of the encoder."""
    if not pictures:
        raise BadInput(f"{path}: no frames to encode")
    if find_spec("av") is not None:
        return _write_mp4(path.with_suffix(".mp4"), pictures, fps), "PyAV, H.264"
    return _write_gif(path.with_suffix(".gif"), pictures, fps), "GIF (pip install 'stylerf[video]' for MP4)"


def try_video(width: int, height: int, fps: float) -> None:
    """Encode a single black frame, so that unsupported sizes and rates raise BadInput before anything is rendered."""
    if find_spec("av") is None:
        return
    try:
        encode(io.BytesIO(), [np.zeros((height, width, 3), np.uint8)], fps)
    except Exception as error:
        if isinstance(error, MemoryError):
            raise
        raise BadInput(
            f"--video: PyAV cannot encode {width}x{height} pixels at {fps:g} frames a second ({error}); render "
            "without it, larger, or with an av that has libx264 (pip install 'stylerf[video]')"
        ) from error


def _frame(path: Path) -> np.ndarray:
    return to_uint8(read_image(path).pixels[..., :3])


def _write_mp4(path: Path, pictures: list[Path], fps: float) -> Path:
    with replacing(path) as temporary:
        encode(str(temporary), (_frame(picture) for picture in pictures), fps)
    return path


def encode(target: str | BinaryIO, frames: Iterable[np.ndarray], fps: float) -> None:
    """Encode frames [h, w, 3] uint8 as MP4; equal frames give equal bytes."""
    import av
    from av.video.reformatter import ColorRange, Colorspace

    with av.open(target, "w", format="mp4") as video:
        stream = video.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
        # Without macroblock-tree rate control, which occasionally encodes the same frames to different bytes (PyAV
        # 18.1, one encoding of 64x64 pixels in 40 to one in three; none of 700 without).
        stream.pix_fmt, stream.options = "yuv420p", {"crf": "18", "x264-params": "no-mbtree=1"}
        # Players assume BT.709 for large and BT.601 for small untagged videos.
        codec = stream.codec_context
        codec.colorspace, codec.color_range = Colorspace.ITU709, ColorRange.MPEG
        codec.color_primaries = codec.color_trc = BT709
        for number, pixels in enumerate(frames):
            if number == 0:
                # H.264 with subsampled chroma needs even sides.
                stream.height, stream.width = height, width = pixels.shape[0] // 2 * 2, pixels.shape[1] // 2 * 2
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(pixels[:height, :width]), format="rgb24")
            for packet in stream.encode(frame.reformat(format="yuv420p", dst_colorspace=Colorspace.ITU709)):
                video.mux(packet)
        for packet in stream.encode():
            video.mux(packet)


def _write_gif(path: Path, pictures: list[Path], fps: float) -> Path:
    """Write a GIF with one palette for all frames, so that static parts do not flicker."""
    from PIL import Image

    chosen = [
        pictures[i] for i in np.linspace(0, len(pictures) - 1, min(PALETTE_FRAMES, len(pictures))).round().astype(int)
    ]
    palette = Image.fromarray(np.concatenate([_frame(p) for p in chosen])).quantize(256, Image.Quantize.MEDIANCUT)
    frames = [
        Image.fromarray(_frame(p)).quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG) for p in pictures
    ]
    with replacing(path) as temporary:
        frames[0].save(
            temporary,
            format="GIF",
            save_all=True,
            append_images=frames[1:],
            loop=0,
            duration=min(max(SHORTEST_MS, round(1000 / fps)), LONGEST_MS),
        )
    return path
