"""Every figure that an evaluation knows and did not measure is named, with the reason."""

from dataclasses import replace

import pytest

from stages.report.notes import Inputs, not_measured

EVERYTHING = Inputs(
    stylized=False, style_image=True, st_lpips=True, lpips=True, perceptual_wanted=True, large_enough=True,
    true_depth=True, depth_sizes_differ=False, base=True, path="orbit", path_length=30, gap=7, field=True,
    consistency="all", reference=True, reference_field=True,
)  # fmt: skip
STYLIZED, EDITED = replace(EVERYTHING, stylized=True), replace(EVERYTHING, edited=True)
BLIND = {
    "Turned off by --perceptual none": {"perceptual_wanted": False},
    "smaller than 64 pixels": {"large_enough": False},
    "get the latter with: pip install stlpips_pytorch": {"lpips": False, "st_lpips": False},
}


def notes(have: Inputs) -> dict[str, str]:
    return {note["what"]: note["why"] for note in not_measured(have)}


def test_nothing_is_missing_where_everything_is_there():
    assert notes(EVERYTHING) == {}
    assert not {"Ref-LPIPS", "Robustness", "Consistency by a perceptual distance"} & {*notes(STYLIZED)}
    assert "Consistency within the region" not in notes(EDITED)


@pytest.mark.parametrize("why", BLIND)
@pytest.mark.parametrize(
    ("have", "what"),
    [
        (STYLIZED, "Ref-LPIPS"),
        (STYLIZED, "Consistency by a perceptual distance"),
        (EVERYTHING, "LPIPS and ST-LPIPS"),
    ],
)
def test_missing_perceptual_metrics_have_a_reason(have, what, why):
    assert why in notes(replace(have, **BLIND[why]))[what]


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"masks": True}, "use --region without --masks"),
        ({"consistency": "laenerf-script"}, "--consistency correct"),
        ({"consistency": "stylerf-family"}, "--consistency correct"),
    ],
)
def test_missing_consistency_in_the_region_has_a_reason(given, why):
    assert why in notes(replace(EDITED, **given))["Consistency within the region"]
    assert "Consistency within the region" not in notes(replace(EVERYTHING, **given))


def test_changed_palette_weights_have_a_note():
    assert "after training" in notes(replace(EDITED, weights_changed=True))["Palette sparsity and TV"]
