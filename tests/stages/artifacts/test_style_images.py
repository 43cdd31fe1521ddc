"""Stylized views: which view, which size, which digest; what a method asks of the options."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from schemas.errors import BadInput
from schemas.images import write_png
from stages.artifacts.style_images import chosen_view, digest_of, read_references, read_style_image, training_view
from stages.configs.stylize import CONFIGS, RefNprConfig, SnerfConfig
from stages.stylization.settings import coarse_layers, image_layers, image_loss, match_of, reference_layers, settings_of
from stylerf.style.feature_extractor import LAYERS, layers_of
from tests.stylerf.small import SPACES, field_of
from tests.stylerf.training.scenes import dome

WEIGHTS = {f"{layer}.weight": torch.zeros(1) for layer in LAYERS}


def scene(width: int = 40, height: int = 30) -> SimpleNamespace:
    """Four views, the second held out."""
    views = [SimpleNamespace(name=name) for name in ("a", "b", "7", "d")]
    cameras = [SimpleNamespace(width=width, height=height)] * 4
    return SimpleNamespace(views=views, cameras=cameras, splits={"train": [0, 2, 3], "test": [1]})


def test_views_go_by_name_and_else_by_number():
    assert [training_view(scene(), name, "--x") for name in ("a", "7", "d", "#0", "#3")] == [0, 1, 2, 0, 2]
    unknown = [(name, f"--x: view '{name}' not found") for name in ("0", "#4", "#-1", "#", "#\N{SUPERSCRIPT TWO}")]
    for name, words in (("b", "held out"), ("#1", "held out"), *unknown):
        with pytest.raises(BadInput, match=words):
            training_view(scene(), name, "--x")


def test_a_view_without_a_photo_is_no_reference():
    """However much more of the scene it shows."""
    wide = dome(3, 0)[0]
    cameras = [*[wide.zoomed_out(0.5)] * 3, wide]
    field, config = field_of(SPACES["contraction"], 3), RefNprConfig(method="refnpr", style="x")

    def chosen(train: list[int]) -> int:
        return chosen_view(SimpleNamespace(splits={"train": train}), field, cameras, config, 0.01, 1)

    assert chosen([0, 1, 2, 3]) == 3 and chosen([0, 1, 2]) < 3


def test_references_are_rescaled_but_other_aspect_ratios_are_refused(tmp_path):
    views = [SimpleNamespace(width=40, height=30)] * 3
    pixels = np.zeros((60, 80, 3), np.uint8)
    pixels[:, 40:] = 255
    write_png(tmp_path / "large.png", pixels)
    ((place, found),) = read_references(scene(80, 60), [f"d={tmp_path}/large.png"], views).items()
    assert place == 2 and found.shape == (30, 40, 3) and found.dtype == np.float32
    assert (found[:, :19] == 0).all() and (found[:, 21:] == 1).all()
    write_png(tmp_path / "wide.png", pixels[:50])
    with pytest.raises(BadInput, match="80x50, but view a is 40x30"):
        read_references(scene(), [f"a={tmp_path}/wide.png"], views)
    with pytest.raises(BadInput, match="already has a reference"):
        read_references(scene(), [f"a={tmp_path}/large.png", f"#0={tmp_path}/large.png"], views)


@pytest.mark.parametrize(("options", "matched"), [({}, "before"), ({"reference": ("a=x.png",)}, "none")])
def test_colors_over_the_fields_own_look_as_the_photos_do_from_the_start(options, matched):
    config = RefNprConfig(style="" if options else "x", refit_steps=70, **options)
    assert match_of(config) == matched
    assert settings_of(config, 300, True).refit_steps == 70
    assert settings_of(config, 300, True, region=True).refit_steps == (1 if matched == "none" else 70)


@pytest.mark.parametrize(("height", "width"), [(40, 1), (1, 40), (1, 1)])
def test_a_style_image_of_a_line_is_refused_by_its_size(tmp_path, height, width):
    write_png(tmp_path / "line.png", np.full((height, width, 3), 90, np.uint8))
    with pytest.raises(BadInput, match=f"line.png is {width}x{height}; a style image needs at least 16 pixels"):
        read_style_image(tmp_path / "line.png")


def test_the_digest_is_of_views_and_content(tmp_path):
    for name, level in (("one.png", 10), ("other.png", 20)):
        write_png(tmp_path / name, np.full((20, 20, 3), level, np.uint8))
    one, other = (f"a={tmp_path}/{name}" for name in ("one.png", "other.png"))
    assert digest_of([]) == "" and len({digest_of(d) for d in ([one], [other], [one, other], [other, one])}) == 4
    before = digest_of([one])
    assert digest_of([one.replace("a=", "b=")]) != before
    write_png(tmp_path / "copy.png", np.full((20, 20, 3), 10, np.uint8))
    assert digest_of([f"a={tmp_path}/copy.png"]) == before
    write_png(tmp_path / "one.png", np.full((20, 20, 3), 11, np.uint8))
    assert digest_of([one]) != before


TRANSPORTED = "conv2_1,conv3_1,conv4_1"


@pytest.mark.parametrize(
    ("options", "loss", "layers", "match"),
    [
        ({}, "transport", TRANSPORTED, "both"),
        ({"match_by": "nearest"}, "nnfm", "conv3", "both"),
        ({"method": "desrf", "layers": "conv2"}, "transport", "conv2", "both"),
        ({"method": "snerf"}, "gram", "conv2,conv3,conv4", "both"),
        ({"method": "snerf", "image_by": "features", "match": "none"}, "transport", TRANSPORTED, "none"),
        ({"method": "refnpr"}, "transport", TRANSPORTED, "before"),
        ({"method": "refnpr", "reference_by": "gram", "layers": "conv2"}, "gram", "conv2,conv3,conv4", "before"),
        ({"method": "refnpr", "reference_by": "adain"}, "transport", TRANSPORTED, "none"),
        ({"method": "refnpr", "reference": ("0=x.png",)}, "transport", TRANSPORTED, "none"),
        ({"method": "refnpr", "reference": ("0=x.png",), "match": "before"}, "transport", TRANSPORTED, "before"),
    ],
)
def test_loss_layers_and_matching_follow_from_the_method(options, loss, layers, match):
    method = CONFIGS[options.get("method", "arf")]
    config = method(**{"style": "" if "reference" in options else "x"} | options)
    found = image_loss(config), image_layers(config, WEIGHTS), match_of(config)
    wanted = ",".join(layers_of(layers)) if layers != config.layers or config.method == "refnpr" else layers
    assert found == (loss, wanted, match)


def test_a_painting_beside_references_must_have_a_say():
    with pytest.raises(ValueError, match="has no effect"):
        RefNprConfig(style="x", reference=("0=x.png",))
    for match in ("before", "after", "both"):
        RefNprConfig(style="x", reference=("0=x.png",), match=match)


def test_refnpr_uses_arfs_weights_for_the_refit_and_its_own_after():
    found = settings_of(RefNprConfig(style="x", style_weight=3.0), 200, True)
    assert (found.weights.style, found.weights.content, found.weights.color) == (1.0, 0.005, 1.0)
    weights = found.reference_feature_weights
    assert (weights.style, weights.content, weights.color) == (3.0, 0.1, 5.0)


def test_blocks_are_those_that_ref_npr_counts_from_zero():
    """By torchvision's places of ReLUs: 11, 13, 15 are its block 2; 18, 20, 22 its block 3; 25, 27, 29 its block 4."""
    places = dict(zip(LAYERS, (1, 3, 6, 8, 11, 13, 15, 18, 20, 22, 25, 27, 29), strict=True))
    config = RefNprConfig(style="x")
    assert [places[layer] for layer in layers_of(reference_layers(config, WEIGHTS))] == [11, 13, 15, 18, 20, 22]
    assert [places[layer] for layer in layers_of(coarse_layers(WEIGHTS))] == [25, 27, 29]
    gram = image_layers(SnerfConfig(style="x"), WEIGHTS)
    assert [places[layer] for layer in layers_of(gram)] == [6, 8, 11, 13, 15, 18, 20, 22]


def test_coarse_matches_are_found_by_the_last_block_or_the_deepest_layer():
    assert coarse_layers(WEIGHTS) == "conv5"
    assert coarse_layers({name: v for name, v in WEIGHTS.items() if "conv5" not in name}) == "conv4_3"
    assert coarse_layers({"conv1_1.weight": torch.zeros(1), "conv3_1.weight": torch.zeros(1)}) == "conv3_1"


def test_layers_absent_from_the_weights_are_dropped_from_defaults_only():
    short = {f"{layer}.weight": torch.zeros(1) for layer in LAYERS[:5]}  # to conv3_1
    config = RefNprConfig(style="x")
    assert image_layers(config, short) == "conv2_1,conv3_1" and reference_layers(config, short) == "conv3_1"
    assert reference_layers(replace(config, layers="conv3"), short) == "conv3"


def test_what_a_style_image_hides_is_not_read(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (40, 50, 4), np.uint8)
    pixels[..., 3] = 255
    pixels[5:20, 5:20, 3] = 0
    read = []
    for garbage in (0, 200):
        pixels[5:20, 5:20, :3] = garbage
        write_png(tmp_path / "cutout.png", pixels)
        read.append(read_style_image(tmp_path / "cutout.png"))
    assert read[0].shape == (4, 40, 50) and torch.equal(*read)
    pixels[..., 3] = 0
    write_png(tmp_path / "empty.png", pixels)
    with pytest.raises(BadInput, match=r"empty\.png: it is transparent everywhere"):
        read_style_image(tmp_path / "empty.png")


def test_a_frame_is_left_out_in_one_line_unless_it_is_to_be_kept(tmp_path):
    inside = np.random.default_rng(0).integers(0, 256, (40, 50, 3), np.uint8)
    framed = np.full((52, 60, 3), 255, np.uint8)
    framed[5:45, 4:54] = inside
    write_png(tmp_path / "scan.png", framed)
    said: list[str] = []
    found = read_style_image(tmp_path / "scan.png", say=said.append)
    assert np.array_equal(np.rint(found.permute(1, 2, 0).numpy() * 255), inside)
    assert said == [
        "scan.png: left out a frame of 4 px at the left, 5 px at the top, 6 px at the right, 7 px at the bottom; "
        "--keep-frame keeps it"
    ]
    for options in ({"keep_frame": True}, {"crop": (0, 0, 52)}):
        kept = read_style_image(tmp_path / "scan.png", say=said.append, **options)
        assert np.array_equal(np.rint(kept.permute(1, 2, 0).numpy() * 255), framed[:, : kept.shape[2]])
    assert len(said) == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"style": "x", "stroke": 5.0}, r"stroke must be in 0\.25\.\.4"),
        ({"style": "x", "method": "snerf", "rotations": True}, "--rotations has no effect with --image-by gram"),
        ({"method": "refnpr", "reference": ("0=x.png",), "stroke": 2.0}, "--stroke has no effect with --reference"),
        ({"method": "refnpr", "reference": ("0=x.png",), "stroke_by_depth": True}, "--stroke-by-depth has no effect"),
        ({"method": "refnpr", "reference": ("0=x.png",), "style_scale": 1.0}, "--style-scale has no effect"),
        ({"method": "refnpr", "reference": ("0=x.png",), "reference_steps": 9}, "no effect with --reference;"),
        ({"method": "refnpr", "reference": ("0=x.png",), "coarse": 0.5}, "--coarse has no effect with --reference;"),
        ({"method": "refnpr", "style": "x", "reference_by": "adain", "image_rate": 0.1}, "with --reference-by adain"),
        (
            {"method": "refnpr", "reference": ("0=x.png",), "keep_frame": True},
            "--keep-frame has no effect with --reference",
        ),
    ],
)
def test_options_of_the_style_image_that_would_do_nothing_are_refused(options, words):
    with pytest.raises(ValueError, match=words):
        CONFIGS[options.get("method", "arf")](**options)
