"""The judge of a stylization is another network than those that stylized; if there is none, it says so."""

import numpy as np
import pytest

from schemas.errors import UsageError
from schemas.work_folder import WorkFolder
from stages.evaluation import judge
from stages.evaluation.judge import LAYER, LAYER_OF_ONLY_NETWORK, judge_beside, networks_that_stylized
from stages.evaluation.perceptual_metrics import StyleImage, available_networks
from stages.weights import resolve
from tests.stages import evaluation_fixture as made


def weights(name: str) -> resolve.ResolvedExtractor:
    return resolve.ResolvedExtractor(name, f"digest of {name}", None, "made up", {}, "vgg16")


@pytest.fixture
def installed(monkeypatch):
    """Names of the networks that are here; a test may take some away."""
    there = {"st-vgg16", "hed-vgg16"}

    def found(name):
        if name not in there:
            raise UsageError(f"{name} is not here")
        return weights(name)

    monkeypatch.setattr(judge.resolve, "resolve", found)
    return there


def test_the_judge_is_a_network_that_did_not_stylize(installed):
    for stylized, judging in (("hed-vgg16", "st-vgg16"), ("st-vgg16", "hed-vgg16"), ("my-vgg", "st-vgg16")):
        found = judge_beside({f"digest of {stylized}"}, weights(stylized))
        assert (found.network.name, found.layer, found.independent) == (judging, LAYER, True)
        assert found.description == f"{judging}, {LAYER}"


def test_without_another_network_an_unmatched_layer_judges_and_says_so(installed):
    installed.remove("hed-vgg16")
    found = judge_beside({"digest of st-vgg16"}, weights("st-vgg16"))
    assert (found.network.name, found.layer) == ("st-vgg16", LAYER_OF_ONLY_NETWORK) and not found.independent
    assert found.description.endswith("which also stylized")


def test_a_network_of_the_users_own_judges_if_all_others_stylized(installed):
    used = {"digest of st-vgg16", "digest of hed-vgg16"}
    found = judge_beside(used, weights("mine"))
    assert (found.network.name, found.layer, found.independent) == ("mine", LAYER, True)


def stylized_by(work: WorkFolder, name: str, source, digest: str):
    figures = {"features": {"name": "a", "digest": digest}}
    return made.make_field(work, name, "stylize", {"field": source}, figures=figures)


def test_networks_of_all_stylizations_behind_a_field_are_known(tmp_path):
    work = WorkFolder(tmp_path)
    scene = made.make_scene(work, [0.0], depth=False)
    plain = made.make_field(work, "plain", "nerf_fit", {"scene": scene})
    once = stylized_by(work, "once", plain, "1" * 64)
    twice = stylized_by(work, "twice", once, "2" * 64)
    assert networks_that_stylized(None) == networks_that_stylized(plain) == frozenset()
    assert networks_that_stylized(twice) == {"1" * 64, "2" * 64}
    edit = made.commit(
        work, "edit", "cup", "edit_learn", {"field": plain}, lambda at: (at / "a").write_text("a"),
        figures={"features": {"digest": "3" * 64}},
    )  # fmt: skip
    painted = made.commit(work, "scene", "painted", "distill", {"scene": scene, "edit": edit},
                          lambda at: (at / "a").write_text("a"))  # fmt: skip
    edited = made.make_field(work, "edited", "finetune", {"scene": painted, "field": plain})
    assert networks_that_stylized(edited) == {"3" * 64}


def test_eval_judges_by_what_the_field_was_stylized_with(tmp_path):
    """Not by what the evaluation itself measures with: a field may have been made with any network."""
    both = [row["name"] for row in resolve.describe() if row["found"] and row["name"] in judge.JUDGES]
    if len(both) < 2:
        pytest.skip("needs two feature networks")
    work, image = WorkFolder(tmp_path), np.full((32, 32, 3), 0.5, np.float32)
    plain = made.make_field(work, "plain", "nerf_fit", {})
    for name in both:
        digest = resolve.resolve(name).digest
        field = stylized_by(work, f"by-{name}", plain, digest)
        for measured_with in both:
            style = StyleImage(image, measured_with, 64, "cpu", field)
            assert style.judge.independent and style.judge.network.digest != digest
            assert style.judge.network.name in available_networks(False, True, measured_with, field)
