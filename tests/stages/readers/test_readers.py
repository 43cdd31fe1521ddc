"""What readers make of posed sources: which photos they find, how those are turned, which masks belong to them."""

import os
import shutil
import unicodedata
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from schemas.errors import BadInput
from schemas.exr import ExrView, write_exr
from schemas.images import read_image, to_uint8, write_png
from schemas.manifest import Recipe
from schemas.work_folder import WorkFolder
from stages import region_select
from stages.artifacts.camera_files import digest_of_cameras
from stages.artifacts.scene import load_scene
from stages.artifacts.style_images import read_style_image
from stages.evaluation.region_masks import resized_mask
from stages.pipeline.prerequisites import import_config
from stages.pose_import import digest_of_source, import_scene
from stages.readers import read_source
from stages.readers.listed_photos import Folder
from stages.readers.photo_folder import photos_elsewhere, photos_of
from stages.readers.source import SourceCamera, find_image, natural, with_masks
from stages.run.progress import Context
from tests.stages.importing import Said, imported, scene_of
from tests.stages.photo_room import write_tagged
from tests.stylerf_cli import capture


def colors_of(photo: Path, **options) -> np.ndarray:
    return to_uint8(read_image(photo, **options).pixels)


# -- EXIF orientation --------------------------------------------------------------------------------------------------


def tagged(source: Path, orientation: int) -> Path:
    """images/p02.png with an orientation in its place."""
    path = source / "images" / "p02.png"
    write_tagged(path.with_suffix(".tif"), colors_of(path), orientation)
    path.unlink()
    return path.with_suffix(".tif")


@pytest.mark.parametrize("orientation", [3, 6])
@pytest.mark.parametrize("kind", ["transforms", "angle alone", "colmap", "llff"])
def test_poses_describe_photos_as_they_are_stored(source, tmp_path, kind, orientation):
    photo = tagged(source, orientation)
    masks = source / "masks"
    masks.mkdir()
    write_tagged(masks / "p02.png", np.where(np.arange(48) < 24, np.full((36, 48), 255), 0).astype(np.uint8), 1)
    if kind == "colmap":
        capture.write_colmap(source)
        listed = source / "sparse" / "0" / "images.txt"
        listed.write_text(listed.read_text().replace("p02.png", "p02.tif"))
    elif kind == "llff":
        np.save(source / "poses_bounds.npy", capture.llff())
    else:
        content = capture.transforms()
        content["frames"][2]["file_path"] = "images/p02.tif"
        if kind == "angle alone":
            content = {"camera_angle_x": 0.98, "frames": content["frames"]}
        capture.write_transforms(source, content)
    seen = to_uint8(load_scene(imported(source, tmp_path / "work")).images(2))
    np.testing.assert_array_equal(seen[:, :24, :3], colors_of(photo, upright=False)[:, :24])
    assert (seen[:, :24, 3] == 255).all() and (seen[:, 24:, 3] == 0).all()


def test_a_photo_that_only_turned_has_the_size_of_its_camera_is_turned(source, tmp_path):
    photo = tagged(source, 6)
    content = capture.transforms()
    content["frames"][2] |= {"file_path": "images/p02.tif", "w": 36, "h": 48, "cx": 18, "cy": 24}
    capture.write_transforms(source, content)
    data = load_scene(imported(source, tmp_path / "work"))
    np.testing.assert_array_equal(to_uint8(data.images(2)), colors_of(photo))
    assert data.images(2).shape[:2] == (48, 36) and data.images(1).shape[:2] == (36, 48)


# -- EXR ---------------------------------------------------------------------------------------------------------------


def test_light_in_photos_and_paintings_becomes_srgb(source, tmp_path):
    """Gray of code 0.5, half covered on the left, in a data window that leaves two columns out."""
    (source / "images" / "p02.png").unlink()
    photo = source / "images" / "p02.exr"
    alpha = np.where(np.arange(46) < 22, 0.5, 1)[None, :, None] * np.ones((36, 1, 1))
    spec = oiio.ImageSpec(46, 36, 4, oiio.FLOAT)
    spec.x, spec.full_width = 2, 48
    target = oiio.ImageOutput.create(str(photo))
    light = np.concatenate([0.21404114 * alpha.repeat(3, 2), alpha], 2).astype(np.float32)
    assert target.open(str(photo), spec) and target.write_image(light) and target.close()
    content = capture.transforms()
    content["frames"][2]["file_path"] = "images/p02.exr"
    capture.write_transforms(source, content)
    seen = to_uint8(load_scene(imported(source, tmp_path / "work")).images(2))
    assert seen.shape == (36, 48, 4) and set(seen[:, 2:, :3].ravel()) == {128}
    assert [set(seen[:, columns, 3].ravel()) for columns in (slice(2), slice(2, 24), slice(24, 48))] == [
        {0},
        {128},
        {255},
    ]
    painted = read_style_image(photo).numpy()
    # What is half covered or more counts as it is; the two columns outside the data window are cut off.
    assert painted.shape[1:] == (36, 46)
    np.testing.assert_allclose(painted[:3], 0.5, atol=1e-5)


# -- COLMAP ------------------------------------------------------------------------------------------------------------


def test_of_several_models_the_one_of_most_photos_is_taken_and_reported(source, tmp_path):
    capture.write_colmap(source)
    sparse = source / "sparse"
    (sparse / "0").rename(sparse / "10")
    for number in ("0", "2"):
        shutil.copytree(sparse / "10", sparse / number)
        listed = sparse / number / "images.txt"
        listed.write_text("\n".join(listed.read_text().splitlines()[:4]) + "\n")
    said = Said()
    scene = scene_of(imported(source, tmp_path / "work", said))
    assert len(scene.views) == 4
    assert "found COLMAP model 10, of 4 photos (2 in 0, 2 in 2; to import another, give its folder)" in said.lines
    assert len(scene_of(imported(sparse / "2", tmp_path / "other")).views) == 2


# -- names -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("listed", "there"), [("a.jpg", "a.JPG"), ("a.JPG", "a.jpg"), ("a", "a.PNG"), ("a.1", "a.1.png")]
)
def test_photos_are_found_by_another_case_of_their_suffix_or_none(tmp_path, listed, there):
    (tmp_path / there).touch()
    assert find_image(tmp_path / listed) == tmp_path / there
    assert find_image(tmp_path / "b.jpg") is None


def test_numbers_after_a_dot_are_no_suffixes(source, tmp_path):
    content = capture.transforms()
    for index, frame in enumerate(content["frames"]):
        (source / "images" / f"p{index:02d}.png").rename(source / "images" / f"frame.{index:04d}.png")
        frame["file_path"] = f"./images/frame.{index:04d}"
    capture.write_transforms(source, content)
    depth = ExrView(np.ones((36, 48, 3)), *np.ones((3, 36, 48)), np.eye(4), (45, 45, 24, 18), 0.1, 9)
    write_exr(source / "truth" / "depth_frame.0002.exr", depth)
    made = imported(source, tmp_path / "work")
    assert [view.name for view in scene_of(made).views] == [f"frame.{index:04d}" for index in range(4)]
    assert [load_scene(made).truth_depth(index) is not None for index in range(4)] == [False, False, True, False]


def test_photos_that_would_be_one_view_are_named_before_they_are_read(source, tmp_path):
    for number, folder in ((0, source / "images" / "b"), (1, source / "b")):
        folder.mkdir()
        (source / "images" / f"p{number:02d}.png").rename(folder / "p.png")
    (source / "images" / "p02.png").write_text("no picture")
    capture.write_colmap(source)
    listed = source / "sparse" / "0" / "images.txt"
    listed.write_text(listed.read_text().replace("p00.png", "b/p.png").replace("p01.png", "../b/p.png"))
    with pytest.raises(BadInput, match=r"\.\./b/p\.png and b/p\.png would both be the photo .*images/b/p.png"):
        imported(source, tmp_path / "work")


@pytest.mark.parametrize("below", ["images/", "", None])
def test_copies_of_photos_are_found_by_their_folders_or_their_names(source, tmp_path, below):
    """Two folders have photos of the same names, but where all lie in one."""
    content = capture.transforms()
    names = ("a/p0", "a/p1", "b/p2", "b/p3") if below is None else ("a/p0", "a/p1", "b/p0", "b/p1")
    for frame, name in zip(content["frames"], names, strict=True):
        copy = tmp_path / "small" / (f"{below}{name}.png" if below is not None else f"{name[2:]}.png")
        copy.parent.mkdir(parents=True, exist_ok=True)
        (source / frame["file_path"]).rename(copy)
        frame["file_path"] = f"../images/{name}.png"
    capture.write_transforms(source, content)
    scene = scene_of(imported(source, tmp_path / "work", images=str(tmp_path / "small")))
    assert [view.source for view in scene.views] == [f"../images/{name}.png" for name in names]


def test_accents_of_a_folder_above_may_be_composed_otherwise(tmp_path):
    for form, other in (("NFC", "NFD"), ("NFD", "NFC")):
        folder = tmp_path / unicodedata.normalize(form, "josé") / "capture"
        folder.mkdir(parents=True)
        photo = folder / unicodedata.normalize(other, "fotografía.png")
        photo.touch()
        assert find_image(folder / unicodedata.normalize(form, "fotografía.png")) == photo


# -- folders of photos -------------------------------------------------------------------------------------------------


def test_the_folder_of_most_photos_is_taken_and_the_others_are_named(posed, tmp_path):
    (posed / "transforms.json").unlink(missing_ok=True)
    for place in ("preview.png", "images/detail/p08.png", "masks/p00.png", "images_2/p00.png", ".trash/p07.png"):
        write_png(posed / place, np.full((36, 48, 3), 90, np.uint8))
    photos = photos_of(posed)
    assert {photo.parent for photo in photos} == {posed / "images"} and len(photos) == 4
    others = photos_elsewhere(posed, posed / "images")
    assert [one.relative_to(posed).as_posix() for one in others] == ["preview.png", "images/detail/p08.png"]


def test_photos_in_folders_below_are_named_where_none_is_found(tmp_path):
    write_png(tmp_path / "images" / "cam1" / "p.png", np.full((36, 48, 3), 90, np.uint8))
    with pytest.raises(BadInput, match=r"images contains no photos, but .*cam1 does; give --images images/cam1$"):
        photos_of(tmp_path)


# -- masks -------------------------------------------------------------------------------------------------------------


def cut_out(scene) -> list[str]:
    """Names of the views whose photos have a mask."""
    data = load_scene(scene)
    return [view.name for index, view in enumerate(data.views) if data.channels(index) == 4]


def write_mask(path: Path) -> None:
    write_png(path, np.where(np.arange(48) < 24, np.full((36, 48), 255), 0).astype(np.uint8))


def in_folders(source: Path) -> None:
    """images/a/p00.png, images/a/p01.png, images/b/p00.png, images/b/p03.png, in a COLMAP model."""
    capture.write_colmap(source)
    listed = source / "sparse" / "0" / "images.txt"
    text = listed.read_text()
    for old, new in (("p00", "a/p00"), ("p01", "a/p01"), ("p02", "b/p00"), ("p03", "b/p03")):
        (source / "images" / new).parent.mkdir(exist_ok=True)
        (source / "images" / f"{old}.png").rename(source / "images" / f"{new}.png")
        text = text.replace(f" {old}.png", f" {new}.png")
    listed.write_text(text)


@pytest.mark.parametrize(
    ("mask", "view"),
    [("a/p00.png", "a/p00"), ("a/p00.png.png", "a/p00"), ("images/b/p00.png", "b/p00"), ("b/p00.tif", "b/p00"),
     ("p03.png", "b/p03"), ("../images/b/p03_mask.png", "b/p03")],
)  # fmt: skip
def test_masks_lie_as_their_photos_do(source, tmp_path, mask, view):
    in_folders(source)
    write_mask(source / "masks" / "other.png")
    write_mask(tmp_path / "mask.png")
    (source / "masks" / mask).parent.mkdir(exist_ok=True, parents=True)
    shutil.copy(tmp_path / "mask.png", source / "masks" / mask)
    assert cut_out(imported(source, tmp_path / "work")) == [view]


def test_masks_of_photos_on_another_drive(tmp_path, monkeypatch):
    """Windows knows no relative path from one drive to another."""

    def relpath(path, start):
        raise ValueError("path is on mount 'D:', start on mount 'C:'")

    photo = tmp_path / "photos" / "images" / "1.png"
    write_mask(photo)
    write_mask(tmp_path / "scan" / "masks" / "1.png")
    monkeypatch.setattr(os.path, "relpath", relpath)
    [camera] = with_masks([SourceCamera("1", "1.png", photo, np.eye(4))], tmp_path / "scan")
    assert camera.mask == tmp_path / "scan" / "masks" / "1.png"


def test_names_near_the_limit_of_the_file_system(tmp_path):
    """Decomposed, 36 Korean letters take 324 bytes; as masks, names of 240 letters take more than 255."""
    names = ["\ud55c" * 36, "a" * 240]
    (tmp_path / "masks").mkdir()
    for name in names:
        write_mask(tmp_path / "images" / f"{name}.png")
    cameras = [SourceCamera(name, name, tmp_path / "images" / f"{name}.png", np.eye(4)) for name in names]
    assert [(one.mask, one.hides) for one in with_masks(cameras, tmp_path)] == [(None, None)] * 2
    listed = Folder(tmp_path)
    assert listed.photo(f"images/{names[0]}.png")[1] == tmp_path / "images" / f"{names[0]}.png"
    assert listed.photo("\ud55d" * 36 + ".jpg")[1] is None


def test_a_mask_that_could_be_of_either_of_two_photos_is_refused(source, tmp_path):
    in_folders(source)
    write_mask(source / "masks" / "p00.png")
    with pytest.raises(BadInput, match=r"masks/p00\.png could be the mask of .*a/p00\.png or of .*b/p00\.png; put"):
        imported(source, tmp_path / "work")
    write_mask(source / "masks" / "b" / "p00.png")
    assert cut_out(imported(source, tmp_path / "work")) == ["a/p00", "b/p00"]


@pytest.mark.parametrize("cut", ["by color", "by transparency", "by labels"])
def test_pictures_of_masks_mean_the_same_wherever_they_are_read(posed, tmp_path, cut):
    """White on black that is opaque all over; black on nothing; 1 and 0 in eight bits. The left half is kept."""
    kept = np.where(np.arange(48) < 24, np.full((36, 48), 255), 0).astype(np.uint8)
    opaque = np.full_like(kept, 255)
    color, alpha = (np.zeros_like(kept), kept) if cut == "by transparency" else (kept, opaque)
    color = color // 255 if cut == "by labels" else color
    mask = posed / "masks" / "p02.png"
    write_png(mask, np.dstack([color] * 3 + [alpha]))
    scene = load_scene(imported(posed, tmp_path / "work"))
    np.testing.assert_array_equal(to_uint8(scene.images(2))[..., 3], kept)
    sight = region_select.Sight(scene, None, 0.0, 0, 1, print)
    np.testing.assert_array_equal(to_uint8(sight.mask(f"p02={mask}")[1]), kept)
    np.testing.assert_array_equal(resized_mask(read_image(mask).pixels, kept.shape, mask), kept > 0)


def test_masks_that_transforms_name(source, tmp_path):
    content = capture.transforms()
    content["frames"][2]["mask_path"] = "cut\\p02.png"
    capture.write_transforms(source, content)
    with pytest.raises(BadInput, match=r"frame 2: its mask .*cut/p02\.png does not exist; restore it"):
        imported(source, tmp_path / "work")
    write_mask(source / "cut" / "p02.png")
    assert cut_out(imported(source, tmp_path / "work")) == ["p02"]


# -- identity ----------------------------------------------------------------------------------------------------------


def test_a_photo_that_changes_behind_a_link_is_noticed(source, tmp_path):
    (source / "images").rename(tmp_path / "elsewhere")
    (source / "images").symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere" / "round").symlink_to(source)
    before = digest_of_source(source)
    assert digest_of_source(source) == before
    write_mask(tmp_path / "elsewhere" / "p01.png")
    assert digest_of_source(source) != before


@pytest.mark.parametrize("kind", ["photos", "transforms", "colmap", "llff"])
def test_what_an_import_does_not_read_does_not_count(source, tmp_path, kind):
    if kind == "transforms":
        capture.write_transforms(source, capture.transforms())
    elif kind == "colmap":
        capture.write_colmap(source)
    elif kind == "llff":
        np.save(source / "poses_bounds.npy", capture.llff())
    before = digest_of_source(source)
    (source / "notes.txt").write_text("sunny")
    (source / "import.json").write_text("{}")
    write_mask(source / "painting.png" if kind == "photos" else source / "images" / "p01_other" / "x.png")
    shutil.copytree(source, tmp_path / "elsewhere", copy_function=shutil.copyfile)
    assert digest_of_source(tmp_path / "elsewhere", "auto" if kind != "photos" else kind, "images") == before
    write_mask(tmp_path / "elsewhere" / "masks" / "p01.png")
    masked = digest_of_source(tmp_path / "elsewhere", images="images")
    assert masked != before
    (tmp_path / "elsewhere" / "images" / "p00.png").write_bytes((source / "images" / "p01.png").read_bytes())
    assert digest_of_source(tmp_path / "elsewhere", images="images") not in (before, masked)


def test_a_dynamic_mask_counts_and_is_no_photo(posed):
    for kind in ("transforms", "photos"):
        (posed / "images" / "dynamic_mask_p01.png").unlink(missing_ok=True)
        before = digest_of_source(posed, kind)
        write_mask(posed / "images" / "dynamic_mask_p01.png")
        first = digest_of_source(posed, kind)
        write_png(posed / "images" / "dynamic_mask_p01.png", np.zeros((36, 48), np.uint8))
        assert len({before, first, digest_of_source(posed, kind)}) == 3
    assert [photo.stem for photo in photos_of(posed)] == ["p00", "p01", "p02", "p03"]


def test_a_source_whose_name_is_not_utf8_is_refused_and_such_a_file_beside_the_photos_is_not(tmp_path):
    named = tmp_path / "caf\udce9"
    named.mkdir()
    with pytest.raises(BadInput, match=r"caf\\xe9: its name is not UTF-8; rename it"):
        digest_of_source(named)
    (tmp_path / "caf\udce9.mp4").touch()
    with pytest.raises(BadInput, match=r"caf\\xe9\.mp4: its name is not UTF-8; rename it"):
        digest_of_source(tmp_path)
    with pytest.raises(BadInput, match=r"caf\\xe9\.json: its name is not UTF-8; rename it"):
        digest_of_cameras(tmp_path / "caf\udce9.json")


def test_photos_left_out_may_have_any_name(posed, tmp_path):
    source = replace(read_source(posed), skipped=(("caf\udce9.HEIC", "unsupported format"),))
    config = import_config(posed)
    partial = WorkFolder(tmp_path / "work").begin("scene", "main", Recipe("pose_import", 8, {}, []))
    figures = import_scene(source, config, partial, Context())
    made = partial.commit(figures=figures)
    assert [one.source for one in scene_of(made).skipped] == made.manifest.figures["skipped"] == ["caf\\udce9.HEIC"]


def test_radiance_pictures_are_photos(tmp_path):
    for name in ("a.hdr", "b.HDR", "c.exr"):
        (tmp_path / name).touch()
    assert [photo.name for photo in photos_of(tmp_path)] == ["a.hdr", "b.HDR", "c.exr"]
    assert find_image(tmp_path / "b") == tmp_path / "b.HDR"


def test_a_list_of_poses_counts(posed):
    before = digest_of_source(posed)
    content = capture.transforms()
    content["frames"][1]["transform_matrix"][0][3] += 0.01
    capture.write_transforms(posed, content)
    assert digest_of_source(posed) != before


def test_photos_in_a_folder_elsewhere_are_reported_by_its_name(source, tmp_path):
    np.save(source / "poses_bounds.npy", capture.llff())
    (source / "images").rename(tmp_path / "images_2")
    scene = scene_of(imported(source, tmp_path / "work", images=str(tmp_path / "images_2")))
    assert [view.source for view in scene.views] == [f"images_2/p0{i}.png" for i in range(4)]


@pytest.mark.parametrize("place", ["work", "", ".."])
def test_an_import_into_a_folder_of_its_source_stands(posed, place):
    config = import_config(posed)
    imported(posed, posed / place)
    assert import_config(posed) == config
    write_mask(posed / "images" / "p01.png")
    assert import_config(posed) != config


def test_rows_of_llff_are_of_photos_in_alphabetical_order(source, tmp_path):
    """As LLFF sorts names: 10 before 2, which people, and the other readers, count the other way."""
    for before, after in (("p00", "1"), ("p01", "10"), ("p02", "11"), ("p03", "2")):
        (source / "images" / f"{before}.png").rename(source / "images" / f"{after}.png")
    np.save(source / "poses_bounds.npy", capture.llff())
    scene = scene_of(imported(source, tmp_path / "work"))
    centers = {view.name: np.array(view.world_from_camera)[:3, 3] for view in scene.views}
    apart = {name: [np.linalg.norm(centers[name] - centers[other]) for other in centers] for name in centers}
    wanted = [one.world_from_camera[:3, 3] for one in capture.cameras()]
    for name, place in (("1", 0), ("10", 1), ("11", 2), ("2", 3)):
        expected = [np.linalg.norm(wanted[place] - wanted[("1", "10", "11", "2").index(other)]) for other in centers]
        ratio = np.array(apart[name])[np.array(expected) > 0] / np.array(expected)[np.array(expected) > 0]
        assert np.ptp(ratio) < 1e-3 * ratio.mean()  # a scene may be scaled as a whole


def test_names_sort_by_their_numbers_of_any_length():
    names = ["p10", "p9", "p007", "p" + "9" * 5000, "p8x", "p8"]
    assert sorted(names, key=natural) == ["p007", "p8", "p8x", "p9", "p10", "p" + "9" * 5000]
