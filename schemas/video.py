"""Films of rendered frames: MP4 where PyAV is installed (extra `video`), else GIF."""

from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from schemas.atomic import replacing
from schemas.errors import BadInput
from schemas.images import read_image, to_uint8

BT709 = 1  # its primaries and its transfer, by ITU-T H.273
PALETTE_FRAMES = 12
SHORTEST_MS = 20  # players show a GIF's frame of less than this for a tenth of a second


def write_video(path: Path, pictures: list[Path], fps: float) -> tuple[Path, str]:
    """Writes `path` with .mp4 or .gif added, as one step; returns where, and what made it."""
    if not pictures:
        raise BadInput(f"{path}: there is no frame to make a film of")
    if find_spec("av") is not None:
        return _write_mp4(path.with_suffix(".mp4"), pictures, fps), "PyAV, H.264"
    return _write_gif(path.with_suffix(".gif"), pictures, fps), "GIF (pip install 'stylerf[video]' for MP4)"


def _frame(path: Path) -> np.ndarray:
    return to_uint8(read_image(path).pixels[..., :3])


def _write_mp4(path: Path, pictures: list[Path], fps: float) -> Path:
    import av
    from av.video.reformatter import ColorRange, Colorspace

    first = _frame(pictures[0])
    # H.264 with halved colour takes even sides only.
    height, width = first.shape[0] // 2 * 2, first.shape[1] // 2 * 2
    with replacing(path) as temporary, av.open(str(temporary), "w", format="mp4") as film:
        stream = film.add_stream("libx264", rate=Fraction(fps).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.options = {"crf": "18"}
        # Said and done: without a word players take large films for BT.709 and small ones for BT.601.
        told = stream.codec_context
        told.colorspace, told.color_range = Colorspace.ITU709, ColorRange.MPEG
        told.color_primaries = told.color_trc = BT709
        for picture in pictures:
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(_frame(picture)[:height, :width]), format="rgb24")
            for packet in stream.encode(frame.reformat(format="yuv420p", dst_colorspace=Colorspace.ITU709)):
                film.mux(packet)
        for packet in stream.encode():
            film.mux(packet)
    return path


def _write_gif(path: Path, pictures: list[Path], fps: float) -> Path:
    """One palette for all frames, so that still parts do not flicker."""
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
            duration=max(SHORTEST_MS, round(1000 / fps)),
        )
    return path
