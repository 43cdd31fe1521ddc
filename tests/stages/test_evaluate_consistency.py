"""Consistency between views by each protocol, with the field's own flow and with flow from files."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from schemas.errors import BadInput
from schemas.work_folder import WorkFolder
from stages import evaluate
from stages.configs.evaluate import CONSISTENCY, EvaluateConfig
from stages.evaluate import pinned
from stages.evaluation.metric_definitions import BY_KEY
from stages.evaluation.path_consistency import METRICS, PathConsistency
from stages.evaluation.perceptual_metrics import PerceptualMetrics
from stages.evaluation.test_views import FrameViews
from stages.run.progress import Context
from stages.run.runner import execute
from stylerf.metrics.optical_flow import field_flow
from tests.stages import evaluation_fixture as made

PLACES = [0.05 * k for k in range(5)]  # the wall moves by 90 * 0.05 / 5 = 0.9 pixels a frame
QUIET = EvaluateConfig(perceptual="none", sheet=1, gap=3)
ALL = replace(QUIET, consistency="all")


def evaluated(work, inputs, config, name="report"):
    report, _ = execute(evaluate.SPEC, evaluate.run, work, name, inputs, config, Context(), force=True)
    return json.loads(report.file("report.json").read_text())


def metrics(report):
    return {item["key"]: item["mean"] for item in report["metrics"]}


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    """A film that turns brighter by 0.1 a frame."""
    work = WorkFolder(tmp_path_factory.mktemp("filmed"))
    scene = made.make_scene(work, [0.0], depth=False)
    field = made.make_field(work, "wall", "fit", {"scene": scene})
    still = made.camera(0.0, "test_0")
    frames = made.make_frames(work, "wall-test", "test", [still], [made.look(still)], field)
    cameras = [made.camera(x, f"path_{i}") for i, x in enumerate(PLACES)]
    seen = [made.look(camera) for camera in cameras]
    brighter = [replace(one, rgb=0.4 * one.rgb + 0.1 * i) for i, one in enumerate(seen)]
    film = made.make_frames(work, "wall-slide", "slide", cameras, brighter, field, matched=False)
    inputs = {"scene": scene, "frames": frames, "path_frames": film, "field": field}
    return work, inputs, evaluated(work, inputs, ALL)


def test_every_mode_has_its_parts():
    assert {*METRICS, "all"} == {*CONSISTENCY}
    for parts in METRICS.values():
        assert all(f"{label}_{part}" in BY_KEY for label in ("short", "long") for part in parts)


def test_each_protocol_measures_a_known_change(filmed):
    *_, report = filmed
    found = metrics(report)
    assert found["short_rmse"] == pytest.approx(0.1, abs=0.005)
    assert found["long_rmse"] == pytest.approx(0.3, abs=0.005)
    # Softmax splatting counts what the ball uncovers as well.
    assert found["short_stylerf_family_rmse"] == pytest.approx(0.1, abs=0.02)
    assert found["long_stylerf_family_rmse"] == pytest.approx(0.3, abs=0.03)
    # Summed over RGB and squared; the script flags all that moves by over half a pixel, and that is everything here.
    assert found["short_laenerf_script_flagged"] > 0.95
    assert 0.03 < found["short_laenerf_script_mse"] < 0.06
    assert 0.25 < found["long_laenerf_script_mse"] < 0.5
    labels = {item["key"]: item["label"] for item in report["metrics"]}
    assert "(correct)" in labels["short_rmse"] and "(laenerf-script)" in labels["long_laenerf_script_mse"]
    assert "(stylerf-family)" in labels["short_stylerf_family_share"]
    assert not any("{" in item["protocol"] + item["label"] for item in report["metrics"])
    assert len(report["pairs"]) == 4 + 2


def test_one_protocol_adds_no_keys_of_another(filmed):
    work, inputs, everything = filmed
    keys = {}
    for mode in METRICS:
        reported = metrics(evaluated(work, inputs, replace(QUIET, consistency=mode)))
        keys[mode] = {key for key in reported if key.startswith(("short_", "long_"))}
    for mode, found in keys.items():
        assert found == {f"{label}_{part}" for label in ("short", "long") for part in METRICS[mode][:2]}, mode
    assert set.union(*keys.values()) <= {*metrics(everything)}
    assert any("published" in note["what"] for note in evaluated(work, inputs, QUIET)["not_measured"])
    assert not any("published" in note["what"] for note in everything["not_measured"])


def write_flows(folder, film, suffix):
    """Every flow of the film, both ways, as another program would have written it."""
    folder.mkdir(exist_ok=True)
    views = list(FrameViews(film, 0.0))
    for i, first in enumerate(views):
        for j, second in enumerate(views):
            flow = field_flow(first.posed(), second.camera).astype(np.float32)
            path = folder / f"{i:04d}_to_{j:04d}{suffix}"
            if suffix == ".npy":
                np.save(path, flow)
            else:
                path.write_bytes(b"PIEH" + struct.pack("<ii", 96, 72) + flow.astype("<f4").tobytes())
    return folder


@pytest.mark.parametrize("suffix", [".npy", ".flo"])
def test_the_same_flow_from_files_gives_the_same_metrics(filmed, tmp_path, suffix):
    work, inputs, report = filmed
    folder = write_flows(tmp_path / "flows", inputs["path_frames"], suffix)
    again = evaluated(work, inputs, pinned(replace(ALL, flow=str(folder))), "files")
    for key, value in metrics(report).items():
        if "laenerf" in key or "stylerf" in key:
            assert metrics(again)[key] == pytest.approx(value, rel=1e-3), key
    # Without depth to test against, visible is what flows there and back.
    assert metrics(again)["short_rmse"] == pytest.approx(metrics(report)["short_rmse"], abs=0.01)
    protocols = {item["key"]: item["protocol"] for item in again["metrics"]}
    digest = pinned(replace(ALL, flow=str(folder))).flow_digest
    reported = f"files (flows {digest[:8]})"
    assert digest and all(reported in protocols[key] for key in ("short_rmse", "short_laenerf_script_mse"))
    assert "missing flow counts as 0" in protocols["short_laenerf_script_mse"]
    (folder / f"0000_to_0001{suffix}").unlink()
    with pytest.raises(BadInput, match=r"1 of 12 flows are missing \(0000_to_0001\)"):
        evaluated(work, inputs, replace(ALL, flow=str(folder)), "fewer")


def test_flow_warping_ignores_the_background(tmp_path):
    """A ball before nothing that brightens by 0.1 a frame: over all pixels it would be 0.1 of a small share."""
    work = WorkFolder(tmp_path)
    scene = made.make_scene(work, [0.0], background="alpha", depth=False)
    field = made.make_field(work, "ball", "fit", {"scene": scene})
    cameras = [made.camera(x, f"path_{i}") for i, x in enumerate((0.0, 0.02))]
    seen = [made.look(camera, wall=False) for camera in cameras]
    brighter = [replace(one, rgb=0.4 * one.rgb + 0.1 * i) for i, one in enumerate(seen)]
    film = made.make_frames(work, "ball-slide", "slide", cameras, brighter, field, matched=False)
    frames = made.make_frames(work, "ball-test", "test", cameras[:1], seen[:1], field)
    given = {"scene": scene, "frames": frames, "path_frames": film, "field": field}
    flows = write_flows(tmp_path / "flows", film, ".npy")
    found = metrics(evaluated(work, given, pinned(replace(QUIET, flow=str(flows))), "flow"))
    assert found["short_rmse"] == pytest.approx(0.1, abs=0.02) and 0.7 < found["short_share"] <= 1


def test_protocols_name_their_number_of_pairs(filmed):
    work, inputs, everything = filmed
    fewer = evaluated(work, inputs, replace(ALL, pairs=2))
    reported = [{item["key"]: item["protocol"] for item in report["metrics"]} for report in (everything, fewer)]
    for key in reported[0]:
        if key.startswith(("short_", "long_")):
            count = 4 if key.startswith("short_") else 2  # of five frames, 1 and 3 apart
            assert f"mean of {count} pairs" in reported[0][key] and "mean of 2 pairs" in reported[1][key], key
    film = PathConsistency(
        FrameViews(inputs["path_frames"], 0.0),
        replace(ALL, perceptual_pairs=1),
        PerceptualMetrics(*[None] * 3, ""),
        None,
    )
    assert (film.facts()["short_perceptual_pairs"], film.facts()["short_pairs"]) == (1, 4)


def test_flow_of_another_size_or_none_is_refused(filmed, tmp_path):
    work, inputs, _ = filmed
    folder = write_flows(tmp_path / "flows", inputs["path_frames"], ".npy")
    np.save(folder / "0001_to_0002.npy", np.zeros((36, 48, 2), np.float32))
    with pytest.raises(BadInput, match="48x36 but frame path_1 is 96x72"):
        evaluated(work, inputs, replace(ALL, flow=str(folder)), "small")
    (tmp_path / "empty").mkdir()
    with pytest.raises(BadInput, match="found none"):
        evaluated(work, inputs, replace(ALL, flow=str(tmp_path / "empty")), "none")
