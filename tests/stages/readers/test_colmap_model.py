"""COLMAP models as COLMAP, 3DGS and nerfstudio write and read them. Each case is a row of docs/import.md.

The capture is of white dots, whose places follow from the cameras by projection: what a case must come to is reported
by where the dots are in the imported pictures.
"""

import shutil
import struct
import unicodedata
from pathlib import Path

import numpy as np
import pytest

from schemas.errors import BadInput
from stages.readers import read_source
from tests.stages import dots
from tests.stages.importing import Said, imported, scene_of
from tests.stages.table import rows_of

NAMES = [f"{index:03d}.png" for index in range(6)]


@pytest.fixture
def capture(tmp_path) -> Path:
    """images/000.png to 005.png, without poses."""
    dots.write_photos(tmp_path / "capture" / "images", NAMES)
    return tmp_path / "capture"


def text(
    root: Path, names=NAMES, place="sparse/0", after="\n\n", head="# Image list\n", camera=None, change=None
) -> Path:
    """A text model by hand: `change` takes the fields of a photo's line."""
    folder = root / place
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cameras.txt").write_text(camera or f"1 PINHOLE {dots.WIDTH} {dots.HEIGHT} 150 150 80 60\n")
    (folder / "points3D.txt").write_text("")
    lines = head
    for index, (pose, name) in enumerate(zip(dots.poses(), names)):
        fields = [str(index + 1), *map(repr, dots.quaternion_and_shift(pose)), "1", name]
        lines += " ".join(change(index, fields) if change else fields) + after
    (folder / "images.txt").write_text(lines, encoding="utf-8")
    return folder


def binary(root: Path, place="sparse/0", names=NAMES, **options) -> Path:
    """The same by COLMAP itself."""
    import pycolmap

    staged = text(root / "as text", names, place, **options)
    model = pycolmap.Reconstruction(str(staged))
    folder = root / place
    folder.mkdir(parents=True, exist_ok=True)
    model.write_binary(str(folder))
    shutil.rmtree(root / "as text")
    return folder


def replaced(path: Path, old: str, new: str) -> None:
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")


# -- what is read ------------------------------------------------------------------------------------------------------


def rigs(root: Path) -> None:
    """COLMAP 3.12 and later writes rigs and frames beside the images, whose poses hold nevertheless."""
    assert {"rigs.bin", "frames.bin"} <= {path.name for path in binary(root).iterdir()}


def observations(root: Path) -> None:
    folder = text(root, after="\n10.5 20.25 -1 30 40 7\n")
    (folder / "points3D.txt").write_text("7 0 0 0 255 0 0 0.5 1 1\n")


def mixed_seconds(root: Path) -> None:
    """Of some photos the second line is there, of some it is empty, of some it is missing."""
    folder = text(root, after="\n")
    lines = (folder / "images.txt").read_text().splitlines()
    lines[2:2] = ["1.5 2.5 -1 0 0 -1 0 0 -1 0 0 -1"]
    lines[1:1] = [""]
    (folder / "images.txt").write_text("\n".join(lines))


def comments(root: Path) -> None:
    folder = text(root)
    for name in ("images.txt", "cameras.txt"):
        content = (folder / name).read_text()
        (folder / name).write_text(
            "# a comment\n\n" + content.replace("\n1 ", "\n# in between: 3\n1 ") + "# at the end"
        )


def layout(place: str, photos: str = "images", also: str = ""):
    def made(root: Path) -> None:
        text(root, place=place)
        (root / "images").rename(root / photos)
        if also:
            dots.write_photos(root / also, NAMES, blank=True)

    return made


def names_of(prefix: str, **options):
    return lambda root: text(root, [prefix + name for name in NAMES], **options) and None


def renamed(form):
    """The photos under other names on disk, and how the list has them."""

    def made(root: Path) -> None:
        listed = []
        for name in NAMES:
            on_disk, in_list = form(name)
            (root / "images" / on_disk).parent.mkdir(parents=True, exist_ok=True)
            (root / "images" / name).rename(root / "images" / on_disk)
            listed.append(in_list)
        text(root, listed)

    return made


def composed(kind: str, other: str):
    return renamed(
        lambda n: (unicodedata.normalize(kind, f"Café é/ü{n}"), unicodedata.normalize(other, f"Café é/ü{n}"))
    )


def unused_camera(root: Path) -> None:
    text(root, camera=f"1 PINHOLE {dots.WIDTH} {dots.HEIGHT} 150 150 80 60\n9 FOV 10 10 5 5 5 5 0.9\n")


def rounded(root: Path) -> None:
    """Quaternions by hand, 0.9 % too long: a rotation all the same."""
    text(root, change=lambda _, f: [f[0], *(repr(float(value) * 1.009) for value in f[1:5]), *f[5:]])


def without_points(root: Path) -> None:
    (text(root) / "points3D.txt").unlink()


READ = {
    "rigs-and-frames": rigs,
    "observations": observations,
    "no-second-lines": lambda root: text(root, after="\n"),
    "some-second-lines": mixed_seconds,
    "blank-lines": lambda root: text(root, head="# Image list\n\n", after="\n\n\n"),
    "comments-anywhere": comments,
    "count-in-the-head": lambda root: text(root, head="# Number of images: 12, mean observations per image: 0\n"),
    "crlf-tabs-and-spaces": lambda root: text(root, after=" \t\r\n\r\n", change=lambda _, f: ["\t".join(f)]),
    "byte-order-mark": lambda root: text(root, head="\ufeff# Image list\n"),
    "names-with-spaces": renamed(lambda name: (f"my photo  {name}",) * 2),
    "names-that-are-numbers": renamed(lambda name: (name, name[:3])),
    "names-in-folders": renamed(lambda name: (f"a/b/{name}",) * 2),
    "names-with-images": names_of("images/"),
    "absolute-names": names_of("/home/alice/scan/images/"),
    "names-of-windows": names_of("C:\\Users\\Alice\\scan\\images\\"),
    "names-that-leave-the-folder": names_of("..\\..\\scan\\images\\"),
    "name-alone": renamed(lambda name: (name, f"left/cam0/{name}")),
    "unicode-composed": composed("NFC", "NFD"),
    "unicode-decomposed": composed("NFD", "NFC"),
    "case-of-suffix": renamed(lambda name: (name.replace(".png", ".PNG"), name.replace(".png", ".Png"))),
    "unused-cameras": unused_camera,
    "rounded-quaternions": rounded,
    "no-points": without_points,
    "sparse/0": layout("sparse/0"),
    "sparse": layout("sparse"),
    "colmap/sparse/0": layout("colmap/sparse/0"),
    "distorted/sparse/0": layout("distorted/sparse/0", "input", also="images"),
    "input": layout("sparse/0", "input"),
    "model-beside-photos": layout("."),
}


@pytest.mark.parametrize("row", READ)
def test_read(capture, tmp_path, row):
    READ[row](capture)
    made = imported(capture, tmp_path / "work", test_every=0)
    assert len(scene_of(made).views) == len(NAMES)
    assert dots.error(made) < 0.15


# -- what is read, and said --------------------------------------------------------------------------------------------


def incomplete(root: Path) -> None:
    text(root)
    (root / "sparse/0/cameras.bin").write_bytes(struct.pack("<Q", 0))


def incomplete_beside_llff(root: Path) -> None:
    """COLMAP's files of which images.bin is missing, beside LLFF's poses."""
    binary(root).joinpath("images.bin").unlink()
    rows = []
    for pose in dots.poses():
        right, down, forward, center = pose[:3].T
        size = [dots.HEIGHT, dots.WIDTH, dots.FOCAL]
        rows.append([*np.column_stack([down, right, -forward, center, size]).ravel(), 1.0, 9.0])
    np.save(root / "poses_bounds.npy", np.array(rows))


def damaged_binary(root: Path) -> None:
    whole = binary(root) / "images.bin"
    whole.write_bytes(whole.read_bytes()[:-40])
    text(root)


def another_text(root: Path) -> None:
    binary(root)
    text(root, NAMES[:4])


def damaged_text(root: Path) -> None:
    binary(root)
    text(root, change=lambda index, f: f[:7] if index == 3 else f)


def two_models(root: Path) -> None:
    text(root)
    text(root, NAMES[:2], place="sparse/1")


def one_of_two(root: Path) -> None:
    text(root)
    text(root, place="sparse/1").joinpath("images.txt").write_text("1 1 0 0\n")


def rows_missing(root: Path) -> None:
    (root / "images" / NAMES[2]).unlink()
    text(root)


SAID = {
    "incomplete-beside-whole": (incomplete, "cameras.bin alone is not a model and is not used", 6),
    "incomplete-beside-llff": (incomplete_beside_llff, "sparse/0 lacks cameras or images and is not used", 6),
    "damaged-binary-beside-text": (damaged_binary, "images.bin is damaged (truncated at byte", 6),
    "another-text-beside-binary": (
        another_text,
        "its text files hold a different model (4 photos, 4 of them as in the binary",
        6,
    ),
    "damaged-text-beside-binary": (damaged_text, "line 8: expected a photo", 6),
    "several-models": (two_models, "found COLMAP model 0, of 6 photos (2 in 1; to import another, give its folder)", 6),
    "one-of-several-damaged": (one_of_two, "sparse/1/images.txt is damaged (line 1: expected a photo", 6),
    "photos-that-are-missing": (rows_missing, "1 of 6 listed photos have no image file: 002.png", 5),
    "names-of-another-folder": (
        names_of("/scan/"),
        "6 photos were found by the end of their listed paths (first: /scan/000.png",
        6,
    ),
    "count-in-the-head-said": (READ["count-in-the-head"], "its header declares 12 entries, found 6", 6),
}


@pytest.mark.parametrize("row", SAID)
def test_said(capture, tmp_path, row):
    make, words, count = SAID[row]
    make(capture)
    said = Said()
    made = imported(capture, tmp_path / "work", said, test_every=0)
    assert any(words in line for line in said.lines), said.lines
    assert len(scene_of(made).views) == count
    assert dots.error(made) < 0.15


def test_the_folder_of_images_replaces_that_of_the_listed_names(capture, tmp_path):
    """Where names begin with images/, a photo that --images lacks is missing: the one in images/ has another size."""
    names_of("images/")(capture)
    for name in NAMES[:5]:
        target = capture / "images_2" / name
        target.parent.mkdir(exist_ok=True)
        target.write_bytes((capture / "images" / name).read_bytes())
    found = read_source(capture, "colmap", "images_2")
    assert [one.image and one.image.parent.name for one in found.cameras] == ["images_2"] * 5 + [None]


# -- what is refused ---------------------------------------------------------------------------------------------------


def with_pose(index: int, start: int, *values: str):
    def change(at: int, fields: list[str]) -> list[str]:
        return fields[:start] + [*values] + fields[start + len(values) :] if at == index else fields

    return lambda root: text(root, change=change) and None


def counts_believed(root: Path) -> None:
    (binary(root) / "images.bin").write_bytes(struct.pack("<Q", 1 << 62) + b"\0" * 900)


def cut(root: Path) -> None:
    path = binary(root) / "cameras.bin"
    path.write_bytes(path.read_bytes()[:-3])


def too_long(root: Path) -> None:
    path = binary(root) / "images.bin"
    path.write_bytes(path.read_bytes() + b"\0")


def alone(root: Path) -> None:
    (binary(root) / "images.bin").unlink()


def latin(root: Path) -> None:
    path = text(root) / "images.txt"
    path.write_bytes(path.read_bytes().replace(b"003.png", b"caf\xe9.png"))


def two_of_one_number(root: Path) -> None:
    text(root, change=lambda index, f: ["1", *f[1:]] if index == 4 else f)


def two_in_one_place(root: Path) -> None:
    text(root, ["a/000.png", "b/000.png", *NAMES[2:]])


def observations_alone(root: Path) -> None:
    folder = text(root)
    replaced(folder / "images.txt", "\n\n", "\n1 2 -1\n1 2 -1\n")


def cameras_of_one_number(root: Path) -> None:
    camera = f"PINHOLE {dots.WIDTH} {dots.HEIGHT} 150 150"
    text(root, camera=f"1 {camera} 80 60\n1 {camera} 70 60\n")


def lens(model: str, count: int):
    return lambda root: text(root, camera=f"1 {model} {dots.WIDTH} {dots.HEIGHT} {' '.join(['60'] * count)}\n") and None


def pipe(root: Path) -> None:
    import os

    folder = text(root)
    (folder / "points3D.txt").unlink()
    os.mkfifo(folder / "points3D.txt")
    (folder / "images.txt").unlink()
    os.mkfifo(folder / "images.txt")


REFUSED = {
    "incomplete": (alone, "is incomplete: it has cameras.bin, points3D.bin, and needs both cameras and images"),
    "cut-short": (cut, "cameras.bin is damaged (truncated at byte"),
    "counts-beyond-the-file": (counts_believed, "images.bin is damaged (truncated at byte 8 of 908"),
    "bytes-left-over": (too_long, "images.bin is damaged (1 extra bytes"),
    "no-regular-file": (pipe, "is incomplete"),
    "zero-quaternion": (
        with_pose(3, 1, "0", "0", "0", "0"),
        "line 8: the pose of '003.png' is not a rotation: its quaternion has",
    ),
    "scaled-quaternion": (
        with_pose(3, 1, "1", "1", "0", "0"),
        "line 8: the pose of '003.png' is not a rotation: its quaternion has length 1.41",
    ),
    "nan": (with_pose(3, 5, "nan"), "line 8: the pose of '003.png' is not a rotation"),
    "words-for-numbers": (
        with_pose(3, 5, "far"),
        "line 8: expected a photo (number, quaternion, translation, camera, name)",
    ),
    "two-lines-of-observations": (observations_alone, "line 4: expected a photo"),
    "unknown-camera": (with_pose(3, 8, "5"), "003.png has camera 5, which is missing"),
    "photos-of-one-number": (two_of_one_number, "000.png and 004.png share the number 1"),
    "cameras-of-one-number": (cameras_of_one_number, "two cameras have number 1"),
    "photos-of-one-file": (two_in_one_place, "a/000.png and b/000.png would both be the photo"),
    "names-that-are-none": (names_of("../", change=lambda _, f: [*f[:9], ".."]), "its photo is ''"),
    "control-characters": (
        names_of("a\x1b[2J"),
        "its photo is 'a\\\\x1b[2J000.png', which contains control characters",
    ),
    "names-not-in-utf-8": (latin, "images.txt is not UTF-8 text"),
    "unknown-model": (lens("HOLOGRAM", 4), "camera 1 has unknown model HOLOGRAM"),
    "lens-EQUIRECTANGULAR": (
        lens("EQUIRECTANGULAR", 2),
        "000.png: its camera model EQUIRECTANGULAR is unknown; undistort the images first",
    ),
}


@pytest.mark.parametrize("row", REFUSED)
def test_refused(capture, tmp_path, row):
    make, words = REFUSED[row]
    make(capture)
    with pytest.raises(BadInput) as reported:
        imported(capture, tmp_path / "work", test_every=0)
    assert words in str(reported.value) and "\n" not in str(reported.value)


def damaged_beside_llff(root: Path) -> None:
    incomplete_beside_llff(root)
    counts_believed(root)


def test_a_damaged_model_beside_other_poses_names_the_format_that_works(capture, tmp_path):
    damaged_beside_llff(capture)
    with pytest.raises(BadInput, match=r"images\.bin is damaged.*or use the other poses found.*--format llff$"):
        imported(capture, tmp_path / "work")
    assert dots.error(imported(capture, tmp_path / "work", format="llff", test_every=0)) < 0.15


def test_escapes_in_a_model_do_not_reach_the_terminal(capture, tmp_path):
    text(capture, camera="1 PIN\x1b[2JHOLE 4 4 4 4 4 4\n")
    with pytest.raises(BadInput, match=r"unknown model PIN\\x1b\[2JHOLE"):
        imported(capture, tmp_path / "work")


# -- lists of splits ---------------------------------------------------------------------------------------------------


def listing(*lists: tuple[str, str]):
    def made(root: Path) -> None:
        text(root)
        for path, names in lists:
            (root / path).write_text(names)

    return made


LISTS = {
    "test.txt": (listing(("sparse/0/test.txt", "001.png\n004.png\n")), ["001", "004"], 6),
    "train_list.txt": (listing(("train_list.txt", "000.png\n002.png\n"), ("test_list.txt", "005.png\n")), ["005"], 3),
    "validation_list.txt": (
        listing(("train_list.txt", "000.png\n"), ("validation_list.txt", "images/005.png")),
        ["005"],
        2,
    ),
    "lists-of-other-files": (listing(("sparse/0/test.txt", "nobody.png\n")), ["000"], 6),
}


@pytest.mark.parametrize("row", LISTS)
def test_splits(capture, tmp_path, row):
    make, tests, count = LISTS[row]
    make(capture)
    said = Said()
    scene = scene_of(imported(capture, tmp_path / "work", said))
    assert [view.name for view in scene.views if view.split == "test"] == tests
    assert len(scene.views) == count and any("split by" in line or "names no photo" in line for line in said.lines)


@pytest.mark.parametrize(("model", "params"), dots.LENSES)
def test_lenses(tmp_path, model, params):
    """Photos through the lens, drawn with pycolmap's own projection."""
    dots.write_photos(tmp_path / "capture" / "images", NAMES, lens=(model, params))
    camera = f"1 {model} {dots.WIDTH} {dots.HEIGHT} {' '.join(map(str, params))}\n"
    text(tmp_path / "capture", camera=camera)
    assert dots.error(imported(tmp_path / "capture", tmp_path / "work", test_every=0)) < 0.25


def test_every_row_of_the_docs_has_a_test():
    tested = [*READ, *SAID, *REFUSED, *LISTS, *(f"lens-{model}" for model, _ in dots.LENSES)]
    assert len(set(tested)) == len(tested)
    assert rows_of("COLMAP models") == set(tested)
