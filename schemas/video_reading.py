"""Videos read frame by frame: upright, in 8-bit sRGB, each frame with its time. Needs PyAV (extra `video`).

A clip is untrusted: it is opened as a regular file by self-contained containers only (a playlist would make FFmpeg open
other files and addresses), and every frame is checked before it is converted.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from schemas.errors import BadInput, OutOfResources
from schemas.images import srgb_from_linear, to_uint8
from schemas.native_output import native_output_silenced
from schemas.safe_names import printable
from schemas.safe_reading import check_allowance, opened

CONTAINERS = ("mov,mp4,m4a,3gp,3g2,mj2", "matroska,webm", "avi")
MOST_FRAMES = 100_000  # 55 minutes at 30 frames a second
BYTES_A_PIXEL = 24  # the decoder's reference frames, and a frame of HDR as floats
HD_ROWS = 720  # untagged video of at least so many rows is BT.709, smaller BT.601
_UNTAGGED, _BT709, _BT601, _BT2020 = 2, 1, 5, 9  # matrix coefficients of ITU-T H.273; PyAV's Colorspace has the same
_LIKE_601 = (4, 5, 6)
_IDENTITY = (1, 0, 0, 1)
PQ, HLG = 16, 18  # transfer characteristics of ITU-T H.273
REFERENCE_WHITE = 203.0  # cd/m2 of a white page in HDR, ITU-R BT.2408
PEAK = 1000.0  # cd/m2 that is mapped to 1
KNEE = 0.75  # of the reference white: linear below, compressed above
# Linear BT.2020 to linear BT.709, ITU-R BT.2087.
_709_FROM_2020 = np.array(
    [[1.660491, -0.587641, -0.072850], [-0.124550, 1.132900, -0.008349], [-0.018151, -0.100579, 1.118730]], np.float32
)


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """A decoded frame. time: seconds since the clip began, by its presentation time; number: in decoding order."""

    number: int
    time: float
    _decoded: Any
    _turn: tuple[int, int, int, int]
    _size: tuple[int, int]

    def gray(self, longest: int) -> np.ndarray:
        """Return [h, w] uint8, as stored (not turned), the longer side at most `longest` pixels."""
        width, height = self._size
        factor = min(1.0, longest / max(width, height))
        size = {"width": max(1, round(width * factor)), "height": max(1, round(height * factor))}
        small: np.ndarray = self._decoded.reformat(format="gray", interpolation="AREA", **size).to_ndarray()
        return small

    def pixels(self) -> np.ndarray:
        """Return [height, width, 3] uint8 sRGB, upright and with square pixels. HDR is mapped to SDR."""
        (width, height), decoded = self._size, self._decoded
        matrix = int(decoded.colorspace)
        if matrix == _UNTAGGED:
            matrix = _BT709 if decoded.height >= HD_ROWS else _BT601
        hdr = int(decoded.color_trc) in (PQ, HLG)
        colors = {"src_colorspace": _BT601 if matrix in _LIKE_601 else matrix if matrix in (_BT709, _BT2020) else None}
        form = "rgb48le" if hdr else "rgb24"
        found: np.ndarray = decoded.reformat(
            width=width, height=height, format=form, interpolation="BICUBIC", **colors
        ).to_ndarray()
        if hdr:
            found = sdr_from_hdr(found, int(decoded.color_trc))
        return np.ascontiguousarray(_turned(found, self._turn))


def frames_of(path: Path, most: int = 0) -> Iterator[VideoFrame]:
    """Decode the frames of a clip in the order of their times; each is valid until the next is requested.

    Args:
        path: The clip.
        most: Yield every second, third ... frame, so that there are about this many, up to twice as many; 0: all.

    Raises:
        BadInput: The container is unknown, or the video is damaged, empty, of changing size or too long.
        OutOfResources: PyAV is not installed, or a frame would need more memory than allowed.
    """
    shown = printable(str(path))
    with _video(path, shown) as (container, stream):
        last, first, size = -np.inf, None, None
        pixel = stream.sample_aspect_ratio
        ratio = float(pixel) if pixel and 0.1 < pixel < 10 else 1.0
        every = max(1, _declared(container, stream) // most) if most else 1
        check_allowance(path, stream.width, stream.height, BYTES_A_PIXEL * stream.width * stream.height)
        for number, decoded in enumerate(_decoded(container, stream, shown)):
            if number >= MOST_FRAMES:
                raise BadInput(f"{shown} has more than {MOST_FRAMES} frames; cut it into shorter clips")
            size = size or (decoded.width, decoded.height)
            if (decoded.width, decoded.height) != size:
                raise BadInput(
                    f"{shown}: frame {number} is {decoded.width}x{decoded.height}, but the first is "
                    f"{size[0]}x{size[1]}; cut the clip where its size changes"
                )
            time = _time(decoded, stream, number)
            first = time if first is None else first
            # Damaged frames are predicted from lost ones; a repeated time would be the same frame twice.
            if decoded.is_corrupt or not time > last:
                continue
            last = time
            if number % every:
                continue
            across = (round(size[0] * ratio), size[1]) if ratio >= 1 else (size[0], round(size[1] / ratio))
            yield VideoFrame(number, time - first, decoded, _orientation(decoded), across)
        if first is None:
            raise BadInput(f"{shown} contains no frame that can be decoded; export the clip again")


@contextmanager
def _video(path: Path, shown: str) -> Iterator[tuple[Any, Any]]:
    if find_spec("av") is None:
        raise OutOfResources(f"{shown}: reading video needs PyAV; pip install 'stylerf[video]'")
    import av

    # Titles need not be UTF-8 and are not read: PyAV before 19 raises by default, later versions never do.
    lenient: dict[str, Any] = {} if int(av.__version__.partition(".")[0]) >= 19 else {"metadata_errors": "replace"}
    try:
        with opened(path) as stream:
            try:
                with native_output_silenced():
                    options = {"format_whitelist": ",".join(CONTAINERS), "protocol_whitelist": "file"}
                    container = av.open(stream, "r", options=options, **lenient)
            except (av.error.FFmpegError, ValueError, OSError) as error:
                raise BadInput(
                    f"{shown} is not a readable video ({_reason(error)}); give an MP4, MOV, MKV, WebM or AVI file"
                ) from error
            with container:
                if not container.streams.video:
                    raise BadInput(f"{shown} has no video stream, only {_others(container)}; give a video")
                video = container.streams.video[0]
                if video.codec_context is None:
                    raise BadInput(f"{shown}: this PyAV does not support its codec; convert the clip to H.264")
                video.thread_type = "AUTO"
                yield container, video
    except FileNotFoundError:
        raise BadInput(f"{shown}: video not found") from None


def _decoded(container: Any, stream: Any, shown: str) -> Iterator[Any]:
    """Yield the stream's frames, with FFmpeg's errors as BadInput."""
    import av

    frames = container.decode(stream)
    while True:
        try:
            with native_output_silenced():
                frame = next(frames, None)
        except (av.error.FFmpegError, ValueError, OSError) as error:
            raise BadInput(f"{shown} is damaged ({_reason(error)}); export the clip again") from error
        if frame is None:
            return
        yield frame


def _reason(error: Exception) -> str:
    return printable(str(getattr(error, "strerror", None) or error)[:200])


def _others(container: Any) -> str:
    return ", ".join(sorted({one.type or "unknown data" for one in container.streams})) or "an empty container"


def _declared(container: Any, stream: Any) -> int:
    """Return the approximate number of frames according to the clip's headers; 0 if unknown."""
    if stream.frames > 0:
        return min(int(stream.frames), MOST_FRAMES)
    seconds = (container.duration or 0) / 1e6
    return int(min(max(seconds, 0) * float(stream.average_rate or 30), MOST_FRAMES))


def _time(decoded: Any, stream: Any, number: int) -> float:
    """Return the frame's presentation time in seconds; AVI files may have none, and then a constant rate."""
    if decoded.time is not None:
        return float(decoded.time)
    return number / float(stream.average_rate or 30)


def _orientation(decoded: Any) -> tuple[int, int, int, int]:
    """Return the signs (a, b, c, d) of the display matrix: (x, y) is shown at (a x + c y, b x + d y)."""
    from av.sidedata.sidedata import Type

    stored = decoded.side_data.get(Type.DISPLAYMATRIX)  # by key: iteration yields values before PyAV 19, keys since
    values = np.frombuffer(b"" if stored is None else bytes(stored), np.int32)
    if len(values) < 9:
        return _IDENTITY
    a, b, c, d = (int(values[place]) for place in (0, 1, 3, 4))
    # The nearest quarter turn, mirrored or not.
    if abs(a) + abs(d) >= abs(b) + abs(c):
        return (-1 if a < 0 else 1, 0, 0, -1 if d < 0 else 1)
    return (0, -1 if b < 0 else 1, -1 if c < 0 else 1, 0)


def _turned(pixels: np.ndarray, turn: tuple[int, int, int, int]) -> np.ndarray:
    a, b, c, d = turn
    if b:
        pixels = pixels.swapaxes(0, 1)
    across, down = (c, b) if b else (a, d)
    return pixels[::down, ::across]


def sdr_from_hdr(coded: np.ndarray, transfer: int) -> np.ndarray:
    """Convert BT.2020 code values to sRGB by one fixed curve, so that all frames of a clip are treated alike.

    Light relative to the reference white is kept up to KNEE; above, its largest channel is compressed to 1 at PEAK, and
    all channels by the same factor, which keeps hues.

    Args:
        coded: [h, w, 3] uint16, full range, in BT.2020 primaries.
        transfer: PQ or HLG.

    Returns:
        [h, w, 3] uint8, sRGB.
    """
    values = coded.astype(np.float32) / 65535
    light = (light_of_pq(values) if transfer == PQ else light_of_hlg(values)) / REFERENCE_WHITE
    light = np.maximum(light @ _709_FROM_2020.T, 0)
    largest = light.max(axis=-1, keepdims=True)
    light *= compressed(largest) / np.maximum(largest, 1e-6)
    return to_uint8(srgb_from_linear(light).clip(0, 1))


def light_of_pq(coded: np.ndarray) -> np.ndarray:
    """Return the light, cd/m2, of PQ code values 0..1 (SMPTE ST 2084)."""
    m1, m2, c1, c2, c3 = 1305 / 8192, 2523 / 32, 107 / 128, 2413 / 128, 2392 / 128
    powered = np.maximum(coded, 0) ** (1 / m2)
    light: np.ndarray = 10_000 * (np.maximum(powered - c1, 0) / (c2 - c3 * powered)) ** (1 / m1)
    return light


def light_of_hlg(coded: np.ndarray) -> np.ndarray:
    """Return the light, cd/m2, of HLG code values [..., 3], 0..1, on a display of PEAK (ITU-R BT.2100, gamma 1.2)."""
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    scene = np.where(coded <= 0.5, coded * coded / 3, (np.exp((coded - c) / a) + b) / 12)
    luminance = scene @ np.array([0.2627, 0.6780, 0.0593], np.float32)
    light: np.ndarray = PEAK * scene * np.maximum(luminance, 1e-9)[..., None] ** 0.2
    return light


def compressed(light: np.ndarray) -> np.ndarray:
    """Return light, relative to the reference white, mapped to 0..1: slope 1 up to KNEE, 1 at PEAK and beyond."""
    most = (PEAK / REFERENCE_WHITE - KNEE) / (1 - KNEE)
    over = np.clip((light - KNEE) / (1 - KNEE), 0, most)
    # Reinhard et al. 2002, equation 4, of what exceeds the knee.
    found: np.ndarray = np.minimum(light, KNEE) + (1 - KNEE) * over * (1 + over / most**2) / (1 + over)
    return found
