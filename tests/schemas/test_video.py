"""Films: what a player reads back of them, by PyAV and, where that is not installed, by Pillow."""

import io

import numpy as np
import pytest
from PIL import Image

from schemas import video
from schemas.errors import BadInput
from schemas.images import write_png

HEIGHT, WIDTH, COUNT = 33, 47, 6


@pytest.fixture
def pictures(tmp_path):
    """Six frames of odd sides: a bright bar moves over a shaded ground."""
    paths = []
    rows, columns = np.mgrid[0:HEIGHT, 0:WIDTH]
    for number in range(COUNT):
        pixels = np.stack([40 + 2 * columns, 60 + 3 * rows, np.full_like(rows, 120)], -1).astype(np.uint8)
        pixels[:, 5 * number : 5 * number + 8] = 230, 200, 40
        paths.append(tmp_path / f"{number:04d}.png")
        write_png(paths[-1], pixels)
    return paths


def read(path) -> np.ndarray:
    return np.asarray(Image.open(path).convert("RGB"), np.float64)


@pytest.fixture
def without_av(monkeypatch):
    """As where the extra `video` is not installed."""
    found = video.find_spec
    monkeypatch.setattr(video, "find_spec", lambda name: None if name == "av" else found(name))


def test_without_the_extra_a_film_is_a_gif_and_says_how_to_get_mp4(pictures, tmp_path, without_av):
    path, how = video.write_video(tmp_path / "film", pictures, 25.0)
    assert path == tmp_path / "film.gif" and "pip install 'stylerf[video]'" in how
    with Image.open(path) as film:
        assert (film.n_frames, film.size, film.info["loop"]) == (COUNT, (WIDTH, HEIGHT), 0)
        for number, picture in enumerate(pictures):
            film.seek(number)
            assert film.info["duration"] == 40
            shown = np.asarray(film.convert("RGB"), np.float64)
            assert np.abs(shown - read(picture)).mean() < 6  # 256 colors for all frames
            bar = slice(5 * number + 2, 5 * number + 6)
            assert np.abs(shown[:, bar] - [230, 200, 40]).mean() < 12


def test_still_parts_of_a_gif_do_not_flicker(pictures, tmp_path, without_av):
    """One palette: what does not move keeps its color but for the dither."""
    path, _ = video.write_video(tmp_path / "film", pictures, 25.0)
    with Image.open(path) as film:
        shown = []
        for number in range(COUNT):
            film.seek(number)
            shown.append(np.asarray(film.convert("RGB"), np.float64)[:, -8:])
    assert np.abs(np.diff(shown, axis=0)).mean() < 4


@pytest.mark.parametrize(("fps", "duration"), [(60.0, 20), (240.0, 20), (10.0, 100), (0.5, 2000), (1 / 1001, 655_350)])
def test_frames_of_a_gif_are_shown_as_long_as_players_allow(pictures, tmp_path, without_av, fps, duration):
    path, _ = video.write_video(tmp_path / "film", pictures[:2], fps)
    with Image.open(path) as film:
        assert film.info["duration"] == duration


@pytest.mark.parametrize("fps", [24.0, 29.97, 0.5])
def test_mp4_holds_every_frame_at_its_time(pictures, tmp_path, fps):
    av = pytest.importorskip("av", reason="the extra `video` is not installed")
    path, how = video.write_video(tmp_path / "film", pictures, fps)
    assert path == tmp_path / "film.mp4" and "H.264" in how
    with av.open(str(path)) as film:
        stream = film.streams.video[0]
        assert (stream.width, stream.height) == (WIDTH - 1, HEIGHT - 1)  # halved color takes even sides
        reported = stream.codec_context
        assert (reported.colorspace, reported.color_primaries, reported.color_trc, reported.color_range) == (
            1,
            1,
            1,
            1,
        )  # BT.709, MPEG
        assert float(stream.average_rate) == pytest.approx(fps, rel=1e-3)
        frames = [(frame.time, frame.to_ndarray(format="rgb24")) for frame in film.decode(stream)]
    assert len(frames) == COUNT
    originals = [read(picture) for picture in pictures]
    for number, (moment, pixels) in enumerate(frames):
        assert moment == pytest.approx(number / fps, abs=1e-3)
        errors = [((pixels - original[: HEIGHT - 1, : WIDTH - 1]) ** 2).mean() for original in originals]
        assert np.argmin(errors) == number
        # Color is stored at half the size, which sharp edges between strong colors show.
        assert -10 * np.log10(errors[number] / 255**2) > 21


def test_the_same_frames_are_the_same_bytes_each_time():
    pytest.importorskip("av")
    ground = np.random.default_rng(0).integers(0, 255, (64, 64, 3))
    frames = [((ground * np.cos(at / 9) ** 2 + np.roll(ground, 3 * at, 1)) / 2).astype(np.uint8) for at in range(24)]
    films = set()
    for _ in range(30):
        film = io.BytesIO()
        video.encode(film, frames, 24.0)
        films.add(film.getvalue())
    assert len(films) == 1


def test_a_film_that_no_encoder_makes_is_refused_without_its_frames(monkeypatch):
    av = pytest.importorskip("av", reason="the extra `video` is not installed")
    video.try_video(WIDTH, HEIGHT, 24.0)
    video.try_video(2, 2, 1 / 1001)
    with pytest.raises(BadInput, match="cannot encode 1x33 pixels"):
        video.try_video(1, HEIGHT, 24.0)

    def unknown(*_, **__):
        raise av.codec.codec.UnknownCodecError("libx264")

    monkeypatch.setattr(av, "open", unknown)
    with pytest.raises(BadInput, match="libx264"):
        video.try_video(WIDTH, HEIGHT, 24.0)


def test_a_film_of_nothing_is_refused(tmp_path):
    with pytest.raises(BadInput, match="no frames to encode"):
        video.write_video(tmp_path / "film", [], 24.0)


def test_a_film_replaces_the_older_one_in_one_step(pictures, tmp_path, without_av, monkeypatch):
    path, _ = video.write_video(tmp_path / "film", pictures, 25.0)
    before = path.read_bytes()

    def fail(self, *arguments, **keywords):
        raise OSError("disk gone")

    monkeypatch.setattr(Image.Image, "save", fail)
    with pytest.raises(OSError, match="disk gone"):
        video.write_video(tmp_path / "film", pictures[:2], 25.0)
    assert path.read_bytes() == before
    assert sorted(item.name for item in tmp_path.iterdir()) == sorted([*(p.name for p in pictures), "film.gif"])
