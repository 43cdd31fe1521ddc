"""Frames of video: times, orientation, colors, pixel aspect and dynamic range, each against known values."""

from fractions import Fraction

import numpy as np
import pytest

pytest.importorskip("av")

from av.video.reformatter import Colorspace

from schemas.errors import BadInput, OutOfResources
from schemas.safe_reading import set_allowance
from schemas.video_reading import HLG, PQ, compressed, frames_of, light_of_hlg, light_of_pq
from tests.stages.clips import write_clip

CORNERS = ((200, 40, 90), (20, 180, 60), (90, 90, 220), (230, 220, 40))  # top left, top right, bottom left, right


def quarters(height=96, width=128) -> np.ndarray:
    picture = np.zeros((height, width, 3), np.uint8)
    for k, color in enumerate(CORNERS):
        picture[k // 2 * height // 2 :, k % 2 * width // 2 :][: height // 2, : width // 2] = color
    return picture


def corners_of(pixels: np.ndarray) -> list[tuple]:
    height, width = pixels.shape[:2]
    return [tuple(map(int, pixels[y, x])) for y in (height // 4, 3 * height // 4) for x in (width // 4, 3 * width // 4)]


def test_times_are_those_of_presentation_not_of_a_constant_rate(tmp_path):
    times = [0.0, 0.02, 0.1, 0.13, 0.5, 0.51]
    clip = write_clip(tmp_path / "a.mp4", [quarters()] * 6, times)
    assert [frame.time for frame in frames_of(clip)] == pytest.approx(times, abs=1e-4)
    later = write_clip(tmp_path / "b.mkv", [quarters()] * 6, [time + 3 for time in times])
    assert [frame.time for frame in frames_of(later)] == pytest.approx(times, abs=2e-3)  # Matroska counts milliseconds


def test_a_title_that_is_not_utf_8_is_no_fault(tmp_path):
    clip = write_clip(tmp_path / "a.mp4", [quarters()] * 2, [0, 0.1], title="TITLE")
    clip.write_bytes(clip.read_bytes().replace(b"TITLE", b"\xff\xfe\xc0\xaf!"))
    assert b"\xff\xfe\xc0\xaf!" in clip.read_bytes()
    assert [frame.time for frame in frames_of(clip)] == pytest.approx([0, 0.1], abs=1e-4)


# Counterclockwise turn by the display matrix, and which stored corners are then shown from top left on.
TURNS = [(0, (0, 1, 2, 3)), (90, (1, 3, 0, 2)), (180, (3, 2, 1, 0)), (-90, (2, 0, 3, 1))]


@pytest.mark.parametrize("turn, shown", TURNS)
def test_frames_are_upright(tmp_path, turn, shown):
    clip = write_clip(tmp_path / "a.mp4", [quarters()] * 2, [0, 0.1], turn=turn)
    pixels = next(frames_of(clip)).pixels()
    assert pixels.shape == ((96, 128, 3) if turn % 180 == 0 else (128, 96, 3))
    for found, corner in zip(corners_of(pixels), shown, strict=True):
        assert np.abs(np.subtract(found, CORNERS[corner])).max() <= 4


@pytest.mark.parametrize("space", [Colorspace.ITU709, Colorspace.ITU601])
def test_colors_follow_the_tagged_matrix(tmp_path, space):
    clip = write_clip(tmp_path / "a.mp4", [quarters()] * 2, [0, 0.1], colorspace=space)
    for found, known in zip(corners_of(next(frames_of(clip)).pixels()), CORNERS, strict=True):
        assert np.abs(np.subtract(found, known)).max() <= 4


def test_ten_bits_become_eight(tmp_path):
    deep = quarters().astype(np.uint16) * 257
    clip = write_clip(tmp_path / "a.mkv", [deep] * 2, [0, 0.1], codec="ffv1", form="yuv444p10le",
                      colorspace=Colorspace.ITU709)  # fmt: skip
    pixels = next(frames_of(clip)).pixels()
    assert pixels.dtype == np.uint8
    for found, known in zip(corners_of(pixels), CORNERS, strict=True):
        assert np.abs(np.subtract(found, known)).max() <= 2


def test_hdr_transfers_meet_published_values():
    # ST 2084: code 0.5081 is 100 cd/m2, 0.7518 is 1000; BT.2408: HLG 0.75 is the reference white of 203 cd/m2.
    assert light_of_pq(np.array([0.0, 0.5081, 0.7518, 1.0])) == pytest.approx([0, 100, 1000, 10_000], rel=2e-3)
    assert light_of_hlg(np.full((1, 3), 0.75)) == pytest.approx(203, rel=5e-3)
    assert light_of_hlg(np.ones((1, 3))) == pytest.approx(1000, rel=1e-3)
    light = np.linspace(0, 1000 / 203, 200)
    assert compressed(light[light < 0.75]) == pytest.approx(light[light < 0.75])
    assert (np.diff(compressed(light)) > 0).all() and compressed(light[-1:]) == pytest.approx(1)


@pytest.mark.parametrize("transfer, code", [(PQ, 0.4895), (HLG, 0.5415)])
def test_hdr_gray_has_the_brightness_of_sdr_gray(tmp_path, transfer, code):
    """A gray of 83 cd/m2 is 0.41 of the reference white of 203, that is sRGB 171; HLG's code of it by its inverse."""
    if transfer == HLG:
        codes = np.linspace(0, 1, 4001)
        code = codes[np.abs(light_of_hlg(np.repeat(codes[:, None], 3, 1))[:, 0] - 83).argmin()]
    gray = np.full((96, 128, 3), round(code * 65535), np.uint16)
    clip = write_clip(tmp_path / "a.mkv", [gray] * 2, [0, 0.1], codec="ffv1", form="yuv444p10le",
                      colorspace=Colorspace.BT2020, color_trc=transfer)  # fmt: skip
    pixels = next(frames_of(clip)).pixels()
    assert np.ptp(pixels) <= 1 and pixels[0, 0, 0] == pytest.approx(171, abs=2)


def test_pixels_that_are_not_square_are_made_square(tmp_path):
    clip = write_clip(tmp_path / "a.mkv", [quarters()] * 2, [0, 0.1], sample_aspect_ratio=Fraction(3, 2))
    assert next(frames_of(clip)).pixels().shape == (96, 192, 3)


def test_a_limit_skips_frames_evenly(tmp_path):
    clip = write_clip(tmp_path / "a.mp4", [quarters()] * 30, np.arange(30) / 30)
    assert [frame.number for frame in frames_of(clip, 10)] == list(range(0, 30, 3))


def audio_only(path):
    import av

    with av.open(str(path), "w") as sound:
        stream = sound.add_stream("aac", rate=48_000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), format="fltp", layout="mono")
        frame.sample_rate = 48_000
        for packet in [*stream.encode(frame), *stream.encode()]:
            sound.mux(packet)


def playlist(path):
    (path.parent / "secret.mp4").write_bytes(b"")
    path.write_text("#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:10,\nfile:///etc/hostname\n#EXT-X-ENDLIST\n")


def concat(path):
    path.write_text("ffconcat version 1.0\nfile '/etc/hostname'\n")


def cut(path):
    write_clip(path, [quarters()] * 20, np.arange(20) / 30)
    path.write_bytes(path.read_bytes()[:900])


def text(path):
    path.write_text("this is not a video")


def garbled(path):
    """The index is whole, the pictures are not."""
    write_clip(path, [quarters()] * 20, np.arange(20) / 30)
    data = bytearray(path.read_bytes())
    start = data.index(b"mdat") + 4
    end = data.index(b"moov") - 8
    data[start:end] = bytes(np.random.default_rng(0).integers(0, 256, end - start, dtype=np.uint8))
    path.write_bytes(data)


@pytest.mark.parametrize(
    "make, why",
    [(audio_only, "has no video stream, only audio"), (playlist, "not a readable video"),
     (concat, "not a readable video"), (cut, "not a readable video"), (text, "not a readable video"),
     (lambda path: path.touch(), "not a readable"), (garbled, "damaged|no frame")],
)  # fmt: skip
def test_what_is_no_whole_clip_is_refused_in_one_line(tmp_path, make, why):
    make(tmp_path / "clip.mp4")
    with pytest.raises(BadInput, match=why) as refused:
        list(frames_of(tmp_path / "clip.mp4"))
    assert "\n" not in str(refused.value) and "clip.mp4" in str(refused.value)


def test_a_frame_larger_than_memory_is_refused(tmp_path):
    clip = write_clip(tmp_path / "a.mp4", [np.zeros((3000, 4200, 3), np.uint8)], [0])
    set_allowance(lambda: 1)
    try:
        with pytest.raises(OutOfResources, match="4200x3000"):
            list(frames_of(clip))
    finally:
        set_allowance(None)
