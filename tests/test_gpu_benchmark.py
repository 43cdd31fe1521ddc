"""benchmarks/gpu.py: every part of it runs, on tiny sizes and through Triton's interpreter; commands are understood."""

import importlib
import json
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from benchmarks import gpu
from stylerf.kernels.gpu import interpreted
from stylerf_cli.arguments import Parser, add_common, add_config
from stylerf_cli.verbs import VERBS


def understood(arguments: list[str]) -> None:
    """Parsed as main() does; a flag that is not known raises."""
    module, parser = importlib.import_module(VERBS[arguments[0]][0]), Parser(prog=arguments[0])
    module.add_arguments(parser)
    config = module.options_for(arguments[1:]) if hasattr(module, "options_for") else module.CONFIG
    if config is not None:
        add_config(parser, config)
    add_common(parser)
    parser.parse_args(arguments[1:])


@pytest.fixture
def commands(monkeypatch, tmp_path):
    """Instead of running stylerf: its arguments, checked by its own parser, and results of the right form."""
    seen = []

    def run(*arguments: str) -> dict:
        understood([*arguments, "--json"])
        seen.append(arguments)
        verb, work = arguments[:2]
        named = arguments[arguments.index("--name") + 1] if "--name" in arguments else verb
        if verb in ("fit", "stylize"):
            folder = tmp_path / work.split("/")[-1] / "field" / named
            folder.mkdir(parents=True, exist_ok=True)
            reported = {"device": "cuda", "seconds": 3.0, "peak_memory_mb": 900.0, "figures": {"gpu_memory_mb": 70}}
            (folder / "manifest.json").write_text(json.dumps(reported))
        budget = float(named.split("-")[1][:-1]) if named.startswith("fit-") else 1.0
        figures = {"train_seconds": budget, "steps": 9, "parameters": 5, "resolution": 64, "ssim": 0.9}
        figures |= {"features": {"name": "vgg16"}, "curve_style": [{"style": 0.5}]}
        figures["psnr"] = (
            28 + 2 * np.log2(float(seen[-2][seen[-2].index("--budget") + 1][:-1])) if verb == "eval" else 0
        )
        return {"figures": figures, "seconds": {"region": 1.0, "edit": 2.5}}

    monkeypatch.setattr(gpu, "stylerf", run)
    return seen


def test_commands_are_understood_and_become_rows(commands, tmp_path):
    report = {}
    for part in ("lego", "fern", "arf", "desrf", "edit"):
        gpu.measure(part, tmp_path, tmp_path, report, torch.device("cpu"))
    lego = report["lego"]
    # 28 + 2 log2(seconds): 31 dB after 2.8 s, 33 after 5.7: the first budgets beyond are 5 and 10 s.
    assert (lego["seconds_to_31_db"], lego["seconds_to_33_db"]) == (5.0, 10.0)
    assert [row["budget"] for row in lego["rows"]] == list(gpu.BUDGETS) and lego["rows"][0]["gpu_memory_mb"] == 70
    assert report["arf"]["method"] == "arf" and report["edit"]["sum"] == 3.5
    verbs = [arguments[0] for arguments in commands]
    assert {"import", "fit", "eval", "deform", "stylize", "edit"} == set(verbs)
    assert all("cuda" in arguments for arguments in commands if arguments[0] != "import")
    assert gpu.time_to([{"psnr": 20.0, "train_seconds": 1.0}]) == {"seconds_to_31_db": None, "seconds_to_33_db": None}


def test_ceilings_are_bytes_and_operations_over_seconds(monkeypatch):
    monkeypatch.setattr(gpu, "seconds_of", lambda call, device, repeats: (call(), (0.5, 0.0))[1])
    found = gpu.ceilings(torch.device("cpu"), megabytes=1, side=64)
    assert found["copy_gb_per_s"] == round(2 * 2**20 / 0.5 / 1e9, 1)
    assert found["matmul_float32_tflop_per_s"] == round(2 * 64**3 / 0.5 / 1e12, 2)


def test_the_time_of_a_call_is_its_median_and_half_the_middle_range(monkeypatch):
    """Twelve calls: five to warm up, then seven of 1 to 7 seconds, the middle half of which spans 2 to 6."""
    moments = iter([moment for call in range(12) for moment in (100.0 * call, 100.0 * call + max(call - 4, 0))])
    monkeypatch.setattr(gpu, "time", SimpleNamespace(perf_counter=lambda: next(moments)))
    assert gpu.seconds_of(lambda: None, torch.device("cpu"), 7) == (4.0, 2.0)
    assert next(moments, None) is None


@pytest.mark.slow
def test_kernels_and_frames_are_measured(monkeypatch):
    """Half a minute and more in the interpreter."""
    pytest.importorskip("triton", reason="Triton is not installed")
    from tests.stylerf.training.scenes import dome

    device = torch.device("cpu" if interpreted() else "cuda")
    monkeypatch.setattr(gpu, "seconds_of", lambda call, device, repeats: (call(), (2e-3, 1e-4))[1])
    rows = gpu.kernels(device, 100.0, rays=6, vertices=8, repeats=1)
    names = [row["kernel"] for row in rows]
    assert len(names) == len(set(names)) == 39
    assert {"march and hash density", "voxel density smoothness", "hash-mlp color backward", "loss"} < set(names)
    assert {"vm color slopes", "hash sum color slopes", "displacement backward"} < set(names)
    assert {"patch color", "ends of rays"} < set(names)
    for row in rows:
        assert row["gb_per_s"] == round(row["bound_bytes"] / 2e-3 / 1e9, 1) and row["samples"] > 0
    reported = gpu.frames(gpu.random_field(8, "stylized"), dome(1, 0, 4), device, repeats=1)
    assert reported["frames_per_s"] == 500 and reported["width"] == 4 and reported["half_precision"] in (True, False)


def test_without_a_gpu_nothing_is_written(tmp_path, monkeypatch):
    out = tmp_path / "out.json"
    if torch.cuda.is_available():
        pytest.skip("there is a GPU")
    for on in ("0", "1"):
        monkeypatch.setenv("TRITON_INTERPRET", on)
        with pytest.raises(SystemExit, match="no figures written"):
            gpu.main([str(tmp_path), str(out)])
    assert not out.exists()


def test_a_part_that_fails_is_reported_and_the_others_are_measured(tmp_path, monkeypatch):
    monkeypatch.setattr(gpu, "device_here", lambda: torch.device("cpu"))
    monkeypatch.setattr(gpu, "machine_of", lambda device: {"gpu": "none"})

    def measure(part, data, kept, report, device):
        if part == "lego":
            raise RuntimeError("out of memory")
        report[part] = {"well": 1}

    monkeypatch.setattr(gpu, "measure", measure)
    gpu.main([str(tmp_path), str(tmp_path / "out.json"), "ceilings", "lego", "fern"])
    report = json.loads((tmp_path / "out.json").read_text())
    assert report["fern"] == report["ceilings"] == {"well": 1} and "out of memory" in report["lego"]["failed"]
