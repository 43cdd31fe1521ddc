"""`stylerf render`: shards, sizes, depth pictures, films, frames that are there already."""

import json
import os
import shlex
import shutil
from dataclasses import replace

import numpy as np
import pytest

from schemas import video
from schemas.exr import read_exr
from schemas.frames import read_frames
from schemas.images import read_image
from schemas.work_folder import Artifact, WorkFolder
from stages import render as stage
from stages.artifacts.scene import load_scene
from stages.configs.render import RenderConfig
from stylerf_cli.main import main
from tests.conftest import REPOSITORY

ORBIT = ("--of", "fit", "--path", "orbit", "--count", "5", "--depth")


def rendered(work, capsys, *options, name: str = "new"):
    """The folder of the frames, and what was noted."""
    assert main(["render", str(work), *map(str, options), "--name", name]) == 0
    return work / "frames" / name, capsys.readouterr().err


@pytest.mark.parametrize("path", ["orbit", "spiral", "interpolate", "test", "file"])
def test_shards_of_any_path_are_the_bytes_of_the_whole(work, tmp_path, capsys, path):
    options = ["--of", "fit", "--path", path, "--count", "4", "--depth", "--scale", "0.5"]
    if path == "file":
        views = read_frames(rendered(work, capsys, *ORBIT)[0]).views
        (tmp_path / "cameras.json").write_text(
            json.dumps([{"world_from_camera": one.camera.world_from_camera} for one in views[:4]])
        )
        options[3] = tmp_path / "cameras.json"
    whole, _ = rendered(work, capsys, *options, name="whole")
    count = len(read_frames(whole).views)
    shards = [
        rendered(work, capsys, *options, "--frames", span, name=f"shard-{span}")[0] for span in ("0", f"1-{count - 1}")
    ]
    views = [view for shard in shards for view in read_frames(shard).views]
    assert views == list(read_frames(whole).views) and count == (2 if path == "test" else 4)
    for view in views:
        shard = shards[0] if (shards[0] / view.png).exists() else shards[1]
        for relative in (view.png, view.exr, view.png.replace("png/", "depth/")):
            assert (shard / relative).read_bytes() == (whole / relative).read_bytes()


def refuse(*_, **__):
    raise OSError("refused")


@pytest.mark.parametrize("linked", [True, False])
def test_shards_are_put_together_and_filmed_without_rendering(work, capsys, monkeypatch, linked):
    whole, _ = rendered(work, capsys, *ORBIT, name="whole")
    kept = shutil.move(whole, work.parent / "whole")
    for span in ("0-1", "2-4"):
        rendered(work, capsys, *ORBIT, "--frames", span, name=f"shard-{span}")
    if not linked:
        monkeypatch.setattr(os, "link", refuse)
    monkeypatch.setattr(stage, "render_view", refuse)
    folder, notes = rendered(work, capsys, *ORBIT, "--video")
    assert "reusing 5 of 5 frames from shard-0-1, shard-2-4" in notes
    assert len(list(folder.glob("video.*"))) == 1 and len(list(folder.glob("depth/*"))) == 5
    for view in read_frames(folder).views:
        for relative in (view.png, view.exr, view.png.replace("png/", "depth/")):
            assert (folder / relative).read_bytes() == (kept / relative).read_bytes()
    assert Artifact(folder).manifest.figures["pixels"] == 0


def test_frames_of_other_options_or_that_were_altered_are_rendered(work, capsys, monkeypatch):
    rendered(work, capsys, *ORBIT[:-1], "--frames", "0-1", name="other")
    shard, _ = rendered(work, capsys, *ORBIT, "--frames", "2-4", name="shard")
    (shard / "exr" / "0003.exr").write_bytes(b"retouched")
    real, seen = stage.render_view, []
    monkeypatch.setattr(
        stage, "render_view", lambda field, camera, **more: seen.append(camera.name) or real(field, camera, **more)
    )
    _, notes = rendered(work, capsys, *ORBIT)
    assert seen == ["0000", "0001", "0003"] and "reusing 2 of 5 frames from shard" in notes
    rendered(work, capsys, *ORBIT, "--force")
    assert len(seen) == 8  # all of them


def test_a_film_that_fails_keeps_the_frames(work, capsys, monkeypatch):
    monkeypatch.setattr(stage, "write_video", refuse)
    command = ["render", str(work), *ORBIT, "--video", "--name", "new", "--quiet"]
    assert main(command) == 3
    err = capsys.readouterr().err
    assert "--video" in err and "OSError: refused" in err and "the same command" in err and err.count("\n") == 1
    assert len(read_frames(work / "frames" / ".new.partial" / "files").views) == 5
    monkeypatch.undo()
    monkeypatch.setattr(stage, "render_view", refuse)
    assert main(command) == 0


@pytest.mark.parametrize("damaged", ["exr/0003.exr", "png/0003.png"])
def test_a_frame_that_was_damaged_between_two_runs_is_rendered_again(work, capsys, monkeypatch, damaged):
    kept, _ = rendered(work, capsys, *ORBIT, name="kept")
    monkeypatch.setattr(stage, "write_video", refuse)
    command = ["render", str(work), *ORBIT, "--video", "--name", "new", "--quiet"]
    assert main(command) == 3
    monkeypatch.undo()
    file = work / "frames" / ".new.partial" / "files" / damaged
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    real, seen = stage.render_view, []
    monkeypatch.setattr(
        stage, "render_view", lambda field, camera, **more: seen.append(camera.name) or real(field, camera, **more)
    )
    assert main(command) == 0
    assert seen == ["0003"]
    assert (work / "frames" / "new" / damaged).read_bytes() == (kept / damaged).read_bytes()


def test_the_frames_of_a_render_are_a_path_of_cameras(work, capsys):
    orbit, _ = rendered(work, capsys, *ORBIT, name="orbit")
    again, _ = rendered(work, capsys, "--of", "fit", "--path", orbit / "frames.json")
    assert [one.camera for one in read_frames(again).views] == [one.camera for one in read_frames(orbit).views]


def test_the_example_of_a_file_of_cameras_is_one(work, capsys):
    folder, _ = rendered(work, capsys, "--of", "fit", "--path", REPOSITORY / "examples/cameras.json", "--scale", "0.05")
    for view in read_frames(folder).views:
        assert (view.camera.width, view.camera.height, view.camera.cx) == (32, 24, 16)
        assert read_exr(folder / view.exr).alpha.max() > 0.9  # it sees the still life


@pytest.mark.parametrize("name", ["camera_path.json", "transforms.json"])
def test_paths_of_other_tools_are_rendered(work, tmp_path, capsys, name):
    """The still life's scene keeps the frame of its source: the view is the scene's own."""
    first = load_scene(WorkFolder(work).get("scene", "main")).cameras[0]
    pose = first.world_from_camera @ np.diag([1, -1, -1, 1])
    angle = float(np.degrees(2 * np.arctan(16 / first.fy)))
    content = {
        "camera_path.json": {
            "render_width": 32,
            "render_height": 32,
            "camera_path": [{"camera_to_world": pose.ravel().tolist(), "fov": angle}],
        },
        "transforms.json": {
            "fl_x": first.fx,
            "w": 32,
            "h": 32,
            "frames": [{"file_path": "x", "transform_matrix": pose.tolist()}],
        },
    }
    (tmp_path / name).write_text(json.dumps(content[name]))
    folder, said = rendered(work, capsys, "--of", "fit", "--path", tmp_path / name)
    (view,) = read_frames(folder).views
    np.testing.assert_allclose(view.camera.world_from_camera, first.world_from_camera, atol=1e-9)
    assert ("frame of the scene's source" in said) == (name == "camera_path.json")


def test_cameras_of_a_file_take_what_they_lack_from_the_scenes_first(work, tmp_path):
    scene = load_scene(WorkFolder(work).get("scene", "main"))
    first = replace(scene.cameras[0], cx=15.0, fy=40.0)
    pose = {"world_from_camera": first.world_from_camera.tolist()}
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps([pose, pose | {"width": 64, "height": 64}, pose | {"fx": 50.0}, pose | {"fy": 60.0}]))
    scene = replace(scene, cameras=[first, *scene.cameras[1:]])
    cameras = [camera for camera, _ in stage.shots_of(scene, RenderConfig(path=str(path)))]
    for camera, wanted in zip(
        cameras,
        (first, first.scaled(2), replace(first, fx=50.0, fy=50.0), replace(first, fx=60.0, fy=60.0)),
        strict=True,
    ):
        assert camera_of(camera) == camera_of(wanted)


def camera_of(camera) -> tuple:
    return tuple(getattr(camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy"))


def test_scaled_views_keep_their_names(work, capsys, monkeypatch):
    names = ["1", "01"]

    def named(artifact):
        scene = load_scene(artifact)
        for place, name in zip(scene.splits["test"], names, strict=True):
            scene.cameras[place] = replace(scene.cameras[place], name=name)
        return scene

    monkeypatch.setattr(stage, "load_scene", named)
    folder, _ = rendered(work, capsys, "--of", "fit", "--path", "test", "--scale", "0.5")
    assert [view.name for view in read_frames(folder).views] == names
    assert sorted(item.stem for item in (folder / "png").iterdir()) == sorted(names)


def test_frames_that_fit_made_are_those_that_render_would_make(work, tmp_path, capsys):
    options = tmp_path / "options.toml"
    options.write_text("[render]\nvideo = true\n")
    fit = ("--budget", "3", "--capacity", "fixed:32x8x8", "--samples", "3000", "--name", "short")
    assert main(["fit", str(work), *fit, "--quiet"]) == 0
    assert main(["render", str(work), "--of", "short", "--path", "views"]) == 0
    assert "is up to date" in capsys.readouterr().err
    assert main(["fit", str(work), *fit, "--config", str(options), "--quiet"]) == 0  # photos in no order are not film
    assert not list((work / "frames" / "short-views").glob("video.*"))


def test_a_table_of_render_reaches_the_frames_that_other_verbs_make(work, tmp_path, capsys):
    """All but what their use does not leave open: the path, and that frames are whole."""
    options = tmp_path / "options.toml"
    options.write_text("[render]\npath = 'test'\ncount = 3\nscale = 0.5\nexr = false\nframes = '0'\ndepth = true\n")
    common = (str(work), "--config", str(options), "--quiet")
    fit = ("--budget", "3", "--capacity", "fixed:32x8x8", "--samples", "3000", "--name", "short")
    assert main(["fit", *common, *fit]) == 0
    assert main(["eval", *common, "--of", "fit", "--path", "spiral", "--perceptual", "none"]) == 0
    for name, path, count in (("short-views", "views", 12), ("fit-spiral", "spiral", 3)):
        folder = work / "frames" / name
        frames = read_frames(folder)
        assert frames.path == path and len(frames.views) == count
        assert all(len(list((folder / kind).iterdir())) == count for kind in ("exr", "depth"))
        assert read_image(folder / frames.views[0].png).pixels.shape[:2] == (32, 32)


@pytest.mark.parametrize(("path", "span"), [("orbit", "5-9"), ("test", "2"), ("spiral", "70-71")])
def test_a_span_beyond_the_path_is_refused(work, capsys, path, span):
    command = ["render", str(work), "--of", "fit", "--path", path, "--count", "5", "--frames", span, "--quiet"]
    assert main(command) == 3
    err = capsys.readouterr().err
    assert f"--frames {span}: the path {path} has" in err and err.count("\n") == 1


def test_a_scaled_view_is_the_same_view_in_more_pixels(work, capsys):
    small, _ = rendered(work, capsys, "--of", "fit", "--path", "test")
    large, _ = rendered(work, capsys, "--of", "fit", "--path", "test", "--scale", "2", name="large")
    for one, two in zip(read_frames(small).views, read_frames(large).views, strict=True):
        assert one.scene_view is not None and two.scene_view is None  # no photo has that size
        assert (two.camera.width, two.camera.fx) == (2 * one.camera.width, 2 * one.camera.fx)
        coarse, fine = read_exr(small / one.exr), read_exr(large / two.exr)
        halved = fine.alpha.reshape(32, 2, 32, 2).mean(axis=(1, 3))
        assert np.corrcoef(halved.ravel(), coarse.alpha.ravel())[0, 1] > 0.95


def test_exr_and_png_show_the_same(work, capsys):
    """PNG: over the background, sRGB. EXR: premultiplied, linear."""
    folder, _ = rendered(work, capsys, *ORBIT)
    for view in read_frames(folder).views:
        exr, png = read_exr(folder / view.exr), read_image(folder / view.png).pixels
        alpha = exr.alpha[..., None]
        light = np.where(alpha > 0.02, exr.rgb / np.maximum(alpha, 1e-6), 0)
        encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)
        expected = encoded * alpha + (1 - alpha)  # the still life is shown over white
        assert np.abs(expected - png)[alpha[..., 0] > 0.02].max() < 0.01
        assert read_image(folder / "depth" / f"{view.name}.png").size == (32, 32)


def test_depth_between_near_and_far_tells_the_object_apart(work, capsys):
    folder, _ = rendered(work, capsys, "--of", "fit", "--path", "test")
    for view in read_frames(folder).views:
        exr = read_exr(folder / view.exr)
        z = exr.z[exr.alpha > 0.5]
        ndc = exr.far / (exr.far - exr.near) * (1 - exr.near / z)
        assert np.ptp(ndc) > 0.1 and -0.05 < ndc.min() and ndc.max() < 1.05


def test_a_count_without_effect_is_reported(work, capsys):
    said = "--count has no effect: --path test has its own number of frames"
    assert said in rendered(work, capsys, "--of", "fit", "--path", "test", "--count", "3")[1]
    assert "no effect" not in rendered(work, capsys, "--of", "fit", "--path", "spiral", "--count", "2", name="few")[1]


def test_only_films_have_frames_a_second(work, capsys):
    wanted = ("--of", "fit", "--count", "2", "--path")
    assert read_frames(rendered(work, capsys, *wanted, "test")[0]).fps is None
    assert read_frames(rendered(work, capsys, *wanted, "orbit")[0]).fps == 24


def test_the_command_that_only_names_makes_what_was_missing(work, capsys):
    """Another seed than the default, a path of its own length: all that decides what `eval` asks for."""
    measured = ["eval", str(work), "--of", "fit", "--path", "interpolate", "--perceptual", "none", "--seed", "3"]
    assert main([*measured, "--only"]) == 4
    program, *command = shlex.split(capsys.readouterr().err.partition("; run: ")[2])
    assert program == "stylerf" and main([*command, "--quiet"]) == 0
    assert main([*measured, "--only"]) == 0


def test_no_exr_where_none_is_wanted(work, capsys):
    folder, _ = rendered(work, capsys, *ORBIT, "--no-exr")
    assert not (folder / "exr").exists() and [view.exr for view in read_frames(folder).views] == [""] * 5


def test_without_the_extra_a_film_is_a_gif_and_that_is_said(work, capsys, monkeypatch):
    found = video.find_spec
    monkeypatch.setattr(video, "find_spec", lambda name: None if name == "av" else found(name))
    folder, notes = rendered(work, capsys, *ORBIT, "--video", "--fps", "10")
    assert "video: video.gif, written by GIF (pip install 'stylerf[video]' for MP4)" in notes
    assert (folder / "video.gif").read_bytes()[:6] == b"GIF89a"
    assert read_frames(folder).fps == 10


def test_frames_that_are_there_are_not_rendered_again(work, capsys, monkeypatch):
    real, seen = stage.render_view, []

    def counted(field, camera, **options):
        if len(seen) == 2 and stopping:
            raise KeyboardInterrupt
        seen.append(camera.name)
        return real(field, camera, **options)

    monkeypatch.setattr(stage, "render_view", counted)
    stopping = True
    assert main(["render", str(work), *ORBIT, "--name", "new", "--quiet"]) == 130
    stopping = False
    rendered(work, capsys, *ORBIT)
    assert seen == ["0000", "0001", "0002", "0003", "0004"]
    rendered(work, capsys, *ORBIT)
    assert len(seen) == 5  # all stands
