"""The official TensoRF code on the same views: `python -m benchmarks.tensorf CHECKOUT LEGO OUT.json NAME ITERATIONS`.

CHECKOUT: a clone of github.com/apchenstu/TensoRF, which is run but never modified; LEGO: the data folder.

Protocol: its own train.py and configs/lego.txt on lego's training photos at 200x200, on the CPU. NAME `shipped` runs
its schedule unchanged, for the first ITERATIONS steps; any other name divides each number of its schedule (steps, grid
growth, masks) by 30,000 / ITERATIONS. Every LOOK steps, VIEWS test views are rendered and measured, which is excluded
from its seconds. Freed memory is kept for the next step (see the glibc settings below): every step needs gigabytes, and
when they were returned to the system, clearing them again took more than half of the time.
"""

import json
import os
import resource
import runpy
import sys
import tempfile
import time
import types
from pathlib import Path

import numpy as np

from benchmarks.conditions import here_and_now

SIDE, LOOK, VIEWS = 200, 50, 3
SHIPPED = 30000
KEEPING = {"MALLOC_MMAP_MAX_": "0", "MALLOC_TRIM_THRESHOLD_": str(1 << 40), "MALLOC_TOP_PAD_": str(1 << 28)}
SCHEDULE = {"upsamp_list": (2000, 3000, 4000, 5500, 7000), "update_AlphaMask_list": (2000, 4000)}


def stand_in(name: str, **members) -> None:
    """Install a stand-in module that has only `members`."""
    module = types.ModuleType(name)
    for member, value in members.items():
        setattr(module, member, value)
    sys.modules[name] = module


def stand_ins() -> None:
    """Install stand-ins for modules that the code imports but that a CPU run on lego hardly needs."""
    import torch

    def to_tensor(image):
        return torch.from_numpy(np.asarray(image, np.float32) / 255).permute(2, 0, 1)

    def meshgrid(height, width, normalized_coordinates=True):
        y, x = torch.meshgrid(torch.arange(height).float(), torch.arange(width).float(), indexing="ij")
        return torch.stack([x, y], -1)[None]

    transforms = types.SimpleNamespace(ToTensor=lambda: to_tensor)
    stand_in("torchvision", transforms=transforms)
    stand_in("torchvision.transforms", ToTensor=lambda: to_tensor)
    stand_in("kornia", create_meshgrid=meshgrid)
    writer = type("Writer", (), {"__init__": lambda s, *a, **k: None, "add_scalar": lambda s, *a, **k: None})
    stand_in("torch.utils.tensorboard", SummaryWriter=writer)
    for name in ("cv2", "plyfile", "lpips", "imageio"):
        stand_in(name)
    sys.modules["plyfile"].PlyData = sys.modules["plyfile"].PlyElement = None
    sys.modules["cv2"].COLORMAP_JET = 0


def small_photos(data: Path, folder: Path) -> None:
    """Write photos of SIDE pixels, averaged premultiplied as in `stylerf import`, since its loader does not resize."""
    from PIL import Image

    for split in ("train", "test"):
        meta = json.loads((data / f"transforms_{split}.json").read_text())
        for frame in meta["frames"]:
            rgba = np.asarray(Image.open(data / f"{frame['file_path']}.png"), np.float64) / 255
            rgba[..., :3] *= rgba[..., 3:]
            by = rgba.shape[0] // SIDE
            mean = rgba.reshape(SIDE, by, SIDE, by, 4).mean((1, 3))
            mean[..., :3] /= np.maximum(mean[..., 3:], 1e-9)
            to = folder / f"{frame['file_path']}.png"
            to.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray((mean * 255 + 0.5).clip(0, 255).astype(np.uint8)).save(to)
        (folder / f"transforms_{split}.json").write_text(json.dumps(meta))


def looked_at(count: int) -> list[int]:
    """Return the indices of VIEWS out of `count` test views, evenly spaced."""
    return np.linspace(0, count - 1, VIEWS).round().astype(int).tolist()


class Looks:
    """Replaces its `evaluation`: measures the PSNR of a few test views with the clock stopped."""

    def __init__(self, out: Path, head: dict) -> None:
        self.out, self.report = out, head | {"curve": []}
        self.begun, self.away, self.steps = None, 0.0, 0

    def start(self) -> None:
        self.begun = time.perf_counter()

    def __call__(self, dataset, field, args, renderer, *_, N_samples=-1, white_bg=True, device="cpu", **__):
        import torch

        at, found = time.perf_counter(), []
        self.steps += LOOK
        with torch.no_grad():
            for view in looked_at(len(dataset.all_rays)):
                rays = dataset.all_rays[view]
                rgb = renderer(rays, field, chunk=4096, N_samples=N_samples, white_bg=white_bg, device="cpu")[0]
                error = rgb.clamp(0, 1).reshape(-1, 3) - dataset.all_rgbs[view].reshape(-1, 3)
                found.append(-10 * np.log10(float(error.square().mean())))
        seconds = at - self.begun - self.away
        parameters = sum(p.numel() for group in field.get_optparam_groups() for p in group["params"])
        self.report["curve"].append(
            {"step": self.steps, "seconds": round(seconds, 1), "psnr": round(float(np.mean(found)), 3)}
        )
        self.report |= {
            "seconds_a_step": round(seconds / self.steps, 3),
            "parameters": parameters,
            "peak_memory_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3),
        }
        self.out.write_text(json.dumps(self.report, indent=1) + "\n")
        print(self.report["curve"][-1], flush=True)
        self.away += time.perf_counter() - at
        return found


def main() -> None:
    if not os.environ.keys() >= KEEPING.keys():  # glibc reads them when the process starts
        command = [sys.executable, "-m", "benchmarks.tensorf", *sys.argv[1:]]
        os.execve(sys.executable, command, {**os.environ, **KEEPING})
    checkout, data, out, name, iterations = *map(Path, sys.argv[1:4]), sys.argv[4], int(sys.argv[5])
    stand_ins()
    sys.path.insert(0, str(checkout))
    import renderer
    from tqdm import tqdm

    head = {
        "command": f"python -m benchmarks.tensorf CHECKOUT LEGO OUT.json {name} {iterations}",
        "protocol": __doc__.split("Protocol: ")[1],
        **here_and_now(),
        "name": name,
    }
    looks = Looks(out, head)
    renderer.evaluation = looks
    scale = 1.0 if name == "shipped" else iterations / SHIPPED
    with tempfile.TemporaryDirectory() as folder:
        small_photos(data, Path(folder) / "lego")
        options = {"datadir": Path(folder) / "lego", "basedir": Path(folder) / "log", "downsample_train": 800 / SIDE,
                   "n_iters": SHIPPED if name == "shipped" else iterations,
                   "vis_every": LOOK, "render_test": 0}  # fmt: skip
        arguments = ["train.py", "--config", str(checkout / "configs" / "lego.txt")]
        arguments += [f"--{key}={value}" for key, value in options.items()]
        for key, steps in SCHEDULE.items():
            for step in steps:
                arguments += [f"--{key}", str(max(1, round(step * scale)))]
        sys.argv = arguments
        # Its loop starts with the first iteration of the progress bar.
        ask = tqdm.__iter__

        def requested(bar):
            if bar.total == options["n_iters"]:
                looks.start()
            for number in ask(bar):
                if number >= iterations:
                    return
                yield number

        tqdm.__iter__ = requested
        os.chdir(folder)
        runpy.run_path(str(checkout / "train.py"), run_name="__main__")


if __name__ == "__main__":
    main()
