"""Paintings, camera files, option files and artifacts that cannot be used: the exit code of their kind and one line
that says what, where and what to do."""

import hashlib
import json
import math

import numpy as np
import OpenImageIO as oiio
import pytest

from schemas.images import write_png
from schemas.manifest import MANIFEST
from stages import render
from stylerf_cli.main import main

pytestmark = pytest.mark.filterwarnings("error")


def reported(capsys, code: int, *arguments) -> str:
    """The one line on stderr of a command that must end with `code`."""
    assert main([*map(str, arguments), "--quiet"]) == code, capsys.readouterr().err
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and err.startswith("stylerf: error: "), err
    return err


# -- paintings ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def paintings(tmp_path):
    """Files that are none, by name."""
    random = np.random.default_rng(0)
    sound = random.integers(0, 256, (64, 64, 3)).astype(np.uint8)
    write_png(tmp_path / "sound.png", sound)
    write_png(tmp_path / "narrow.png", sound[:, :3])
    (tmp_path / "text.png").write_text("Starry Night")
    (tmp_path / "empty.jpg").write_bytes(b"")
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "cut.png").write_bytes((tmp_path / "sound.png").read_bytes()[:6000])
    assert oiio.ImageBuf(sound).write(str(tmp_path / "whole.jpg"))
    (tmp_path / "cut.jpg").write_bytes((tmp_path / "whole.jpg").read_bytes()[:1500])
    damaged = np.ones((32, 32, 3), np.float32)
    damaged[3, 4] = math.nan
    assert oiio.ImageBuf(damaged).write(str(tmp_path / "nan.exr"), "half")
    return tmp_path


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("missing.jpg", "image not found"),
        ("folder.png", "image not found"),
        ("text.png", "is not a readable image"),
        ("empty.jpg", "is not a readable image"),
        ("cut.png", "cannot be read completely"),
        ("cut.jpg", "cannot be read completely"),
        ("nan.exr", "contains NaN"),
        ("narrow.png", "is 3x64; a style image needs at least 16 pixels per side"),
    ],
)
def test_paintings_that_are_none_are_refused_before_any_work(paintings, capsys, name, words):
    """The work folder does not even exist: hours of fitting must not come first."""
    line = reported(capsys, 3, "stylize", paintings / "work", "--style", paintings / name)
    assert words in line and name in line
    assert not (paintings / "work").exists()


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("--blur", "2"), "blur must be odd"), (("--blur", "-1"), "blur must be odd"),
        (("--margin", "-0.1"), "margin must be in 0..1"), (("--margin", "1.1"), "margin must be in 0..1"),
        (("--dilation", "0"), "dilation must be at least 1"), (("--budget", "soon"), "neither a time"),
        (("--finest", "8"), "16 to 4096 cells"), (("--style-scale", "0"), "style_scale > 0"),
        (("--style-rows", "0"), "style_rows at least 1"), (("--style-basis", "-1"), "style_basis must not be negative"),
        (("--rate", "0"), "rate > 0"), (("--refit-steps", "-1"), "refit_steps and"),
        (("--method", "desrf", "--displacement-vertices", "1"), "displacement_vertices 4 to 128"),
        (("--method", "desrf", "--deform-rate", "0"), "deform_rate must be > 0"),
    ],
)  # fmt: skip
def test_settings_of_a_stylization_that_mean_nothing(paintings, capsys, flags, words):
    assert words in reported(capsys, 2, "stylize", paintings / "work", "--style", paintings / "sound.png", *flags)
    assert not (paintings / "work").exists()


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        ((), "--style is required"),
        (("--style", "sound.png", "--reference", "0=sound.png"), "--reference is an option of --method refnpr"),
        (("--style", "sound.png", "--method", "snerf", "--reference-by", "gram"), "an option of --method refnpr"),
        (("--style", "sound.png", "--method", "refnpr", "--rounds", "2"), "--rounds is an option of --method snerf"),
        (("--style", "sound.png", "--method", "snerf", "--image-share", "1"), "image_share must be between 0 and 1"),
        (("--style", "sound.png", "--deform-rate", "0.1"), "--deform-rate is an option of --method desrf"),
        (("--style", "sound.png", "--displacement-weight", "1"), "an option of --method desrf; this is --method arf"),
        (("--style", "sound.png", "--method", "snerf", "--rays", "patch"), "--rays is an option of --method arf"),
        (("--style", "sound.png", "--method", "snerf", "--no-remember"), "--remember is an option of --method arf"),
        (("--style", "sound.png", "--match", "none", "--max-gain", "2"), "--max-gain limits color matching"),
        (("--style", "sound.png", "--method", "snerf", "--deform-rate", "1"), "an option of --method desrf"),
        (("--method", "refnpr", "--reference", "sound.png"), "written VIEW=FILE.png"),
        (("--method", "refnpr", "--reference", "0=sound.png", "0=sound.png"), "two references"),
        (("--method", "refnpr", "--reference", "0=sound.png", "--reference-view", "1"), "make one"),
        (("--method", "palettenerf", "--style", "sound.png"), "unrecognized arguments"),
        (("--method", "palettenerf", "--bases", "3"), "bases must be 4 to 16"),
        (("--method", "palettenerf", "--palette", "0=red"), "written I=#rrggbb"),
        (("--method=palettenerf", "--at", "0:1,1"), "say how with --palette"),
    ],
)
def test_methods_whose_options_do_not_go_together(paintings, capsys, monkeypatch, flags, words):
    monkeypatch.chdir(paintings)
    assert words in reported(capsys, 2, "stylize", paintings / "work", *flags)
    assert not (paintings / "work").exists()


@pytest.mark.parametrize(
    ("reference", "words"),
    [
        ("#0={}/missing.png", "image not found"),
        ("#0={}/cut.png", "cannot be read completely"),
        ("nobody={}/sound.png", "view 'nobody' not found; the nearest of the scene's 12 views are"),
        ("99={}/sound.png", "view '99' not found"),
        ("held out={}/sound.png", "is held out for evaluation; choose a training view"),
        ("#0={}/wide.png", "is 80x64, but view #0 is 32x32"),
        ("#0={}/narrow.png", "at least 16 pixels per side"),
    ],
)
def test_references_that_are_none(work, paintings, capsys, reference, words):
    """Reported before any work, even of the stages before."""
    write_png(paintings / "wide.png", np.zeros((64, 80, 3), np.uint8))
    views = json.loads((work / "scene/main/scene.json").read_text())["views"]
    held_out = next(view["name"] for view in views if view["split"] == "test")
    text = reference.format(paintings).replace("held out", held_out)
    assert words in reported(capsys, 3, "stylize", work, "--method", "refnpr", "--reference", text, "--name", "new")
    assert not (work / "field/new").exists()


def test_a_feed_forward_reference_without_weights_is_refused_in_a_line(work, photos, capsys, monkeypatch, tmp_path):
    monkeypatch.delenv("STYLERF_WEIGHTS", raising=False)
    monkeypatch.setenv("STYLERF_CACHE", str(tmp_path))
    command = ("stylize", work, "--style", photos / "painting.png", "--method", "refnpr", "--reference-by", "adain")
    assert "vgg19_decoder_conv3_1.pth" in reported(capsys, 2, *command)


def test_a_sound_painting_gets_past_that(paintings, capsys):
    assert "stylerf import" in reported(capsys, 4, "stylize", paintings / "work", "--style", paintings / "sound.png")


def test_a_painting_to_measure_against_that_is_none(work, paintings, capsys):
    for name, words in (
        ("missing.jpg", "no such file"),
        ("cut.png", "cannot be read completely"),
        ("text.png", "not a readable"),
    ):
        line = reported(capsys, 3, "eval", work, "--of", "fit", "--style", paintings / name, "--perceptual", "none")
        assert words in line and name in line


def test_a_painting_that_has_changed_is_measured_against_again(work, paintings, capsys):
    command = ["eval", str(work), "--of", "fit", "--style", str(paintings / "sound.png"), "--perceptual", "none"]
    palettes = []
    for spoil in (False, True, False):
        if spoil:
            write_png(paintings / "sound.png", np.full((64, 64, 3), 200, np.uint8))
        assert main([*command, "--json", "--quiet"]) == 0
        palettes.append(json.loads(capsys.readouterr().out)["figures"]["palette"])
    assert palettes[0] != palettes[1] == palettes[2]


# -- regions -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "flags", [("--box", "0", "0", "0", "1", "1", "1"), ("--at", "0:1,1", "--tolerance", "0"), ("--color", "#102030")]
)
def test_pixels_to_avoid_where_nothing_grows_by_color(tmp_path, capsys, flags):
    line = reported(capsys, 2, "select", tmp_path / "work", *flags, "--avoid", "0:9,9")
    assert "--avoid limits growth from --at or --scribble" in line


# -- cameras of a path -------------------------------------------------------------------------------------------------

SOUND = {"world_from_camera": [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 4], [0, 0, 0, 1]], "width": 16, "height": 16,
         "fx": 20, "fy": 20, "cx": 8, "cy": 8}  # fmt: skip
SCALED = [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 4], [0, 0, 0, 1]]
TRANSPOSED = np.array(SOUND["world_from_camera"]).T.tolist()
PATHS = {
    "no JSON": ("{", "is not valid JSON"),
    "binary": ("\x00\x01", "is not valid JSON"),
    "nested without end": ("[" * 100_000, "is nested too deeply"),
    "an object": (json.dumps(SOUND), "expected a list of cameras"),
    "nothing": ("[]", "the list of cameras is empty"),
    "numbers": ("[1, 2]", "camera 0 is invalid"),
    "no pose": (json.dumps([SOUND, {"width": 3}]), "camera 1 is invalid"),
    "NaN": (json.dumps([SOUND | {"world_from_camera": np.full((4, 4), math.nan).tolist()}]), "camera 0 is invalid"),
    "scaled": (json.dumps([SOUND | {"world_from_camera": SCALED}]), "not a rotation"),
    "huge": (json.dumps([SOUND | {"world_from_camera": (1e300 * np.eye(4)).tolist()}]), "camera 0"),
    "transposed": (json.dumps([SOUND | {"world_from_camera": TRANSPOSED}]), "the last row of its pose is not 0 0 0 1"),
    "an object of no list": (json.dumps({"views": SOUND}), "the list of cameras is empty"),
    "no camera": (json.dumps({"views": [{"camera": None}]}), "camera 0 is invalid"),
    "3x3": (json.dumps([SOUND | {"world_from_camera": np.eye(3).tolist()}]), "camera 0 is invalid"),
    "no size": (json.dumps([SOUND | {"width": 0}]), "camera 0 is invalid"),
    "endless": (json.dumps([SOUND | {"height": math.inf}]), "camera 0 is invalid"),
    "beyond numbers": (json.dumps([SOUND | {"fx": 10**400}]), "camera 0 is invalid"),
    "no focal length": (json.dumps([SOUND | {"fx": 0}]), "camera 0 is invalid"),
    "words": (json.dumps([SOUND | {"width": "wide"}]), "camera 0 is invalid"),
    "null": (json.dumps([SOUND | {"cx": None}]), "camera 0 is invalid"),
    "outside": (json.dumps([SOUND | {"width": 10**7, "height": 10**7}]), "camera 0"),
}


@pytest.mark.parametrize("name", PATHS)
def test_camera_files_that_are_none(work, tmp_path, capsys, recwarn, name):
    text, words = PATHS[name]
    (tmp_path / "cameras.json").write_text(text)
    line = reported(capsys, 3, "render", work, "--of", "fit", "--path", tmp_path / "cameras.json")
    assert not [one for one in recwarn if issubclass(one.category, RuntimeWarning)]  # numpy's would be further lines
    assert words in line and "cameras.json" in line
    assert not (work / "frames" / "fit-cameras").exists()


@pytest.mark.parametrize("flags", [("--scale", "0.04"), ("--fps", "0.0004")])
def test_a_film_that_cannot_be_is_refused_before_any_frame_is_rendered(work, capsys, monkeypatch, flags):
    pytest.importorskip("av", reason="the extra `video` is not installed")
    monkeypatch.setattr(render, "render_view", None)
    code, words = (2, "fps in [1/1001, 240]") if "--fps" in flags else (3, "--video: PyAV cannot encode")
    assert words in reported(capsys, code, "render", work, "--of", "fit", "--count", "2", "--video", *flags)


def test_a_video_of_frames_of_several_sizes_is_refused_before_rendering(work, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(render, "render_view", None)
    (tmp_path / "cameras.json").write_text(json.dumps([SOUND, SOUND | {"width": 24}, SOUND | {"width": 20}]))
    line = reported(capsys, 3, "render", work, "--of", "fit", "--path", tmp_path / "cameras.json", "--video")
    assert "--video" in line and "16x16 and 24x16" in line


def test_a_camera_file_is_rendered_again_only_when_it_changes(work, tmp_path, capsys):
    (tmp_path / "cameras.json").write_text(json.dumps([SOUND]))
    command = ["render", str(work), "--of", "fit", "--path", str(tmp_path / "cameras.json"), "--json", "--quiet"]
    frames = []
    for cameras in ([SOUND], [SOUND, SOUND], [SOUND, SOUND]):
        (tmp_path / "cameras.json").write_text(json.dumps(cameras))
        assert main(command) == 0
        result = json.loads(capsys.readouterr().out)
        frames.append((result["figures"]["frames"], (work / "frames/fit-cameras" / MANIFEST).read_bytes()))
    assert [count for count, _ in frames] == [1, 2, 2]
    assert frames[1][1] == frames[2][1]  # the same file is not rendered twice


@pytest.mark.parametrize(("file", "name"), [("my path.json", "fit-my_path"), ("cameras", "fit-cameras")])
def test_frames_of_a_camera_file_are_named_after_it_whatever_it_is_called(work, tmp_path, capsys, file, name):
    (tmp_path / file).write_text(json.dumps([SOUND]))
    assert main(["render", str(work), "--of", "fit", "--path", str(tmp_path / file), "--json", "--quiet"]) == 0
    assert json.loads(capsys.readouterr().out)["name"] == name


def test_an_empty_region_is_the_only_one_as_for_other_verbs(tmp_path, capsys):
    for command in (("stylize", "--recolor"), ("extract",)):
        verb, *flags = command
        assert "no region" in reported(capsys, 4, verb, tmp_path / "work", "--region", "", *flags)


# -- names -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["my edit", "", "../x"])
def test_a_name_that_is_none_is_refused_before_any_work(paintings, capsys, name):
    for command in (("fit",), ("stylize", "--style", paintings / "sound.png"), ("edit", "--recolor", "--at", "0:1,1")):
        verb, *flags = command
        assert "is not a valid name" in reported(capsys, 2, verb, paintings / "work", *flags, "--name", name)


# -- option files ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("bugdet = '60s'", "unknown option 'bugdet'; did you mean 'budget'"),
        ("budget = 60", "budget takes a text in quotes"),
        ("budget = 'soon'", "'soon' is neither a time"),
        ("samples = 'many'", "samples takes a whole number"),
        ("samples = 3.5", "samples takes a whole number"),
        ("background = 'green'", "white, black, random"),
        ("buffers = 'yes'", "true or false"),
        ("seed = 'seven'", "seed takes a value of type int"),
        ("[fti]\nbudget = '60s'", "unknown verb 'fti'; did you mean 'fit'"),
        ("budget = ", "is not valid TOML"),
        ("\x00", "is not valid TOML"),
    ],
)
def test_option_files_that_are_none(tmp_path, capsys, text, words):
    (tmp_path / "options.toml").write_text(text)
    line = reported(capsys, 2, "fit", tmp_path / "work", "--config", tmp_path / "options.toml")
    assert words in line and "options.toml" in line
    assert not (tmp_path / "work").exists()


# -- artifacts ---------------------------------------------------------------------------------------------------------

VERBS = (("fit", "scene/main"), ("deform", "field/fit"), ("stylize", "field/fit"), ("render", "field/fit"),
         ("eval", "frames/fit-test"))  # fmt: skip


def arguments_for(verb: str, work, photos) -> list:
    """A command that would make something of the artifact."""
    own = {
        "fit": ["--budget", "5", "--no-buffers", "--name", "new"],
        "deform": ["--of", "fit", "--name", "new"],
        "stylize": ["--of", "fit", "--style", photos / "painting.png", "--name", "new"],
        "render": ["--of", "fit", "--path", "test", "--name", "new"],
        "eval": ["--of", "fit", "--perceptual", "none", "--name", "new"],
    }
    return [verb, work, *own[verb]]


@pytest.mark.parametrize(("verb", "place"), VERBS)
@pytest.mark.parametrize("which", ["largest", "manifest"])
def test_a_flipped_byte_in_what_a_stage_reads_stops_it(work, photos, capsys, verb, place, which):
    folder = work / place
    files = [path for path in folder.rglob("*") if path.is_file() and path.name != MANIFEST]
    victim = max(files, key=lambda path: path.stat().st_size) if which == "largest" else folder / MANIFEST
    data = bytearray(victim.read_bytes())
    data[len(data) // 2] ^= 1
    victim.write_bytes(data)
    line = reported(capsys, 4, *arguments_for(verb, work, photos))
    assert victim.name in line and place.split("/")[1] in line
    assert not list(work.glob("*/new"))


@pytest.mark.parametrize(("verb", "place"), VERBS)
def test_an_artifact_of_a_newer_version_stops_a_stage(work, photos, capsys, verb, place):
    reseal(work / place, schema=99)
    line = reported(capsys, 4, *arguments_for(verb, work, photos))
    assert "newer stylerf" in line
    assert not list(work.glob("*/new"))


def reseal(folder, **changes) -> None:
    """Writes the manifest again as an honest writer of another version would (docs/artifacts.md)."""
    content = json.loads((folder / MANIFEST).read_text()) | changes
    content["self_sha256"] = "0" * 64
    text = json.dumps(content, indent=1, ensure_ascii=False) + "\n"
    seal = hashlib.sha256(text.encode()).hexdigest()
    (folder / MANIFEST).write_text(text.replace("0" * 64, seal))


def test_a_stage_without_its_input_names_the_command_that_makes_it(tmp_path, capsys):
    for verb in ("fit", "deform"):
        assert "stylerf import" in reported(capsys, 4, verb, tmp_path / "work")
    for verb in ("render", "eval"):
        assert "stylerf fit" in reported(capsys, 4, verb, tmp_path / "work")
    assert not (tmp_path / "work").exists()
