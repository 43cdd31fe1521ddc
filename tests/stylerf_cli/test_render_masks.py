"""`stylerf render` where the work folder holds regions: EXR channels as compositors read them, pictures, recipes."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from schemas import partial_artifact as partial
from schemas.frames import read_frames
from schemas.images import read_image
from schemas.work_folder import Artifact, Recipe, WorkFolder
from stages import render as stage
from stages.artifacts.field import load_field
from stages.artifacts.region import channels_of, save_region
from stylerf.editing.edit_grid import Region
from stylerf.geometry.cameras import Camera
from stylerf.kernels.cpu.ray_samples import Rays
from stylerf_cli.main import main

TEST = ("--of", "fit", "--path", "test")


def make_region(work: Path, name: str, edit: np.ndarray, stretch: float = 1.0) -> Artifact:
    """A region in the space of the field `fit`, or in one that reaches `stretch` times as far."""
    field, _ = load_field(WorkFolder(work).get("field", "fit"))
    partial = WorkFolder(work).begin("region", name, Recipe("select", 1, {"cells": int(edit.sum())}, [], 0))
    save_region(
        partial.path, Region(edit, np.zeros_like(edit)), replace(field.space, far=field.space.far * stretch), {}
    )
    return partial.commit()


@pytest.fixture
def regions(work) -> dict[str, np.ndarray]:
    made = {"low": np.indices((9,) * 3)[2] < 4, "all+": np.ones((6,) * 3, bool)}
    for name, edit in made.items():
        make_region(work, name, edit)
    return made


def rendered(work, capsys, *options, name: str = "new") -> tuple[Path, dict, str]:
    assert main(["render", str(work), *map(str, options), "--name", name, "--json"]) == 0
    out, err = capsys.readouterr()
    return work / "frames" / name, json.loads(out), err


def planes_of(path: Path) -> tuple[dict[str, str], dict[str, np.ndarray], oiio.ImageSpec]:
    source = oiio.ImageInput.open(str(path))
    spec = source.spec()
    pixels = source.read_image(oiio.FLOAT)
    kinds = dict(zip(spec.channelnames, map(str, spec.channelformats), strict=True))
    return kinds, {name: pixels[..., i] for i, name in enumerate(spec.channelnames)}, spec


def test_every_region_is_a_channel_of_every_frame(work, regions, capsys):
    bare, _, _ = rendered(work, capsys, *TEST, "--no-regions", name="bare")
    folder, result, _ = rendered(work, capsys, *TEST)
    frames = read_frames(folder)
    assert result["regions"] == ["all+", "low"] and frames.masks == {"all+": "all_", "low": "low"}
    field, _ = load_field(WorkFolder(work).get("field", "fit"))
    for frame in frames.views:
        kinds, planes, spec = planes_of(folder / frame.exr)
        without, same, _ = planes_of(bare / frame.exr)
        assert kinds == without | {"mask.low": "half", "mask.all_": "half"}
        assert all(np.array_equal(plane, planes[name]) for name, plane in same.items())
        assert np.array_equal(planes["mask.all_"], planes["A"]) and planes["A"].max() > 0.9
        low = WorkFolder(work).get("region", "low")
        assert spec.getattribute("stylerf:mask.low") == f"low {low.digest}"
        given = frame.camera
        view = Camera("", given.width, given.height, given.fx, given.fy, given.cx, given.cy,
                      np.array(given.world_from_camera))  # fmt: skip
        expected = slow_mask(field, view, regions["low"], every := 37)
        np.testing.assert_allclose(planes["mask.low"].reshape(-1)[::every], expected, atol=1e-3)  # half precision
        assert (expected > 0.3).any() and (expected < 0.01).any()


def slow_mask(field, view: Camera, marked: np.ndarray, every: int) -> np.ndarray:
    """Rays one by one: transmittance from the samples' own densities, cells by floor."""
    found = []
    origins, directions = view.rays()
    for at in range(0, len(origins), every):
        one = field.march(Rays.of(origins[at : at + 1], directions[at : at + 1], field.space.near), 512, 1e-3, 1)
        through, inside = 1.0, 0.0
        for k in range(one.starts[0], one.ends[0]):
            opacity = 1 - np.exp(-float(one.sigma[k]) * float(one.deltas[k]))
            inside += through * opacity * marked[tuple((one.x[k] * len(marked)).astype(int))]
            through *= 1 - opacity
        found.append(inside)
    return np.array(found)


def test_pictures_of_regions_hold_what_the_channels_hold(work, regions, capsys):
    folder, _, _ = rendered(work, capsys, *TEST, "--masks")
    for frame in read_frames(folder).views:
        _, planes, _ = planes_of(folder / frame.exr)
        for name, channel in channels_of(regions).items():
            picture = read_image(folder / "masks" / name / f"{frame.name}.png").pixels
            assert picture.shape[2] == 1 and np.abs(picture[..., 0] - planes[f"mask.{channel}"]).max() < 0.003
    without, result, _ = rendered(work, capsys, *TEST, "--no-exr", "--masks", name="pictures")
    assert result["regions"] == ["all+", "low"] and read_frames(without).masks == {}
    assert not (without / "exr").exists() and len(list((without / "masks" / "low").iterdir())) == 2


def test_a_changed_region_makes_frames_again_and_one_that_stands_does_not(work, regions, capsys):
    folder, _, _ = rendered(work, capsys, *TEST)
    first = Artifact(folder).manifest
    assert "is up to date" in rendered(work, capsys, *TEST)[2]
    assert Artifact(folder).manifest.created == first.created
    make_region(work, "low", ~regions["low"])
    assert "is up to date" not in rendered(work, capsys, *TEST)[2]
    assert {ref.role: ref.digest for ref in Artifact(folder).manifest.inputs}["region.low"] == (
        WorkFolder(work).get("region", "low").digest
    )
    # Regions that are not written take no part.
    plain, _, _ = rendered(work, capsys, *TEST, "--no-regions", name="plain")
    make_region(work, "low", regions["low"])
    assert "is up to date" in rendered(work, capsys, *TEST, "--no-regions", name="plain")[2]
    assert {ref.kind for ref in Artifact(plain).manifest.inputs} == {"scene", "field"}


def test_a_region_selected_since_does_not_cost_an_interrupted_render(work, regions, capsys, monkeypatch):
    monkeypatch.setattr(partial, "EXPENSIVE_SECONDS", 0.0)
    real, stopping = stage.render_view, True

    def stopped(*arguments, **options):
        if stopping:
            raise KeyboardInterrupt
        return real(*arguments, **options)

    monkeypatch.setattr(stage, "render_view", stopped)
    command = ["render", str(work), *TEST, "--name", "new", "--quiet"]
    assert main(command) == 130
    stopping = False
    (old := work / "region" / "low").rename(work.parent / "low")
    make_region(work, "high", ~regions["low"])
    capsys.readouterr()
    assert main(command) == 4
    err = capsys.readouterr().err
    assert "work with no region high, region low, would be lost" in err and "--force" in err
    shutil.rmtree(work / "region" / "high")
    (work.parent / "low").rename(old)
    assert main([*command[:-1]]) == 0
    assert "resuming the interrupted" in capsys.readouterr().err


def test_a_region_of_another_space_is_left_out_and_named(work, regions, capsys):
    make_region(work, "elsewhere", regions["low"], stretch=2)
    folder, result, notes = rendered(work, capsys, *TEST)
    assert result["regions"] == ["all+", "low"] and set(read_frames(folder).masks) == {"all+", "low"}
    (line,) = [line for line in notes.splitlines() if "elsewhere" in line]
    assert "space of a different field than fit" in line


def test_pictures_of_regions_without_regions_are_refused(work, capsys):
    assert main(["render", str(work), *TEST, "--masks", "--no-regions"]) == 2
    assert "no-regions" in capsys.readouterr().err


def test_a_damaged_region_is_one_line(work, regions, capsys):
    (work / "region" / "low" / "region.json").write_text("{}")
    assert main(["render", str(work), *TEST, "--quiet"]) == 4
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "region" in err


def test_channels_are_words_that_compositors_take():
    names = ["left.eye", "left_eye", "left-eye", "2nd", "cup", "Ä".replace("Ä", "A+")]
    assert channels_of(names) == {
        "A+": "A_", "cup": "cup", "left_eye": "left_eye", "2nd": "_2nd", "left-eye": "left_eye_2",
        "left.eye": "left_eye_3",
    }  # fmt: skip
    assert channels_of(["a.b", "a_b_2", "a_b"]) == {"a_b": "a_b", "a_b_2": "a_b_2", "a.b": "a_b_3"}


def test_cryptomatte_and_deep_frames_say_what_the_flat_frame_says(work, regions, capsys):
    folder, _, _ = rendered(work, capsys, *TEST, "--cryptomatte", "--deep")
    for frame in read_frames(folder).views:
        _, planes, spec = planes_of(folder / frame.exr)
        texts = {one.name: str(one.value) for one in spec.extra_attribs if one.name.startswith("cryptomatte/")}
        (manifest,) = [json.loads(text) for name, text in texts.items() if name.endswith("/manifest")]
        assert set(manifest) == set(regions)
        for name, mask in (("all+", "mask.all_"), ("low", "mask.low")):
            own = np.uint32(int(manifest[name], 16)).view(np.float32)
            pairs = [(planes[f"crypto_region0{layer}.{a}"], planes[f"crypto_region0{layer}.{b}"])
                     for layer in (0, 1) for a, b in ("RG", "BA") if f"crypto_region0{layer}.R" in planes]  # fmt: skip
            found = sum(np.where(ids == own, coverage, 0) for ids, coverage in pairs)
            np.testing.assert_allclose(found, planes[mask], atol=1e-3)
        flat = oiio.ImageBufAlgo.flatten(oiio.ImageBuf(str(folder / "deep" / Path(frame.exr).name)))
        names = flat.spec().channelnames
        pixels = flat.get_pixels(oiio.FLOAT)
        for channel in "RGBA":
            np.testing.assert_allclose(pixels[..., names.index(channel)], planes[channel], atol=4e-3)
