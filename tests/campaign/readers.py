"""Every reader of stylerf as a case: which file is damaged, which command reads it, and which results are valid."""

import hashlib
import json
import os
import re
import shutil
import signal
import struct
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from random import Random

from tests.campaign.captures import write_captures, write_loose, write_paths
from tests.campaign.ground import FEW, Ground, done
from tests.campaign.mutants import damaged_png, mutant
from tests.stylerf_cli.nursery import Nursery

BOUNDED = ("--quiet", "--threads", "1", "--memory", "1G")
TINY_FIT = ("--budget", "2", "--no-buffers", "--capacity", "fixed:16x8x8", "--samples", "1000")
RESUMED = ("fit", "work", "--budget", "25", "--no-buffers", "--capacity", "fixed:24x8x8", "--samples", "1000",
           "--checkpoint-every-seconds", "0.01", "--name", "resumed")  # fmt: skip


@dataclass(frozen=True)
class Case:
    """share: of all mutants. base: a folder, copied for each mutant. pattern: its files of which one is damaged.

    commands: one of them is run in the copy; `{name}` stands for the damaged artifact's name. sealed: the digests of a
    manifest cover the file, so that it must be refused. resealed: the digests are made to fit the damage. alone: the
    reader is called with the file, rather than a command. same: the artifact that must come out as undisturbed.
    refuses: what is not damaged is refused too, for another reason.
    """

    name: str
    share: int
    base: str
    pattern: str
    commands: tuple[tuple[object, ...], ...] = ()
    sealed: bool = False
    resealed: bool = False
    alone: str = ""
    same: str = ""
    leave_out: str = "(?!)"
    refuses: bool = False

    def files(self, root: Path) -> list[Path]:
        """Return the files relative to the base, in order."""
        base = root / self.base
        found = sorted(path.relative_to(base) for path in base.glob(self.pattern) if path.is_file())
        return [path for path in found if not re.search(self.leave_out, path.as_posix())]


IMPORT = (("import", "source", "work"),)
AS_FIELD = (("render", "work", "--of", "{name}", "--path", "path.json", "--name", "seen"),)
OF_A_REGION = ("stylize", "work", "--region", "all", "--recolor", *FEW, "--name", "again")
AGAIN = ("stylize", "work", "--region", "all", "--recolor", "--palette", "0=#ff0000", *FEW, "--name", "again")
EVAL = ("eval", "work", "--of", "fit", "--perceptual", "none")

CASES = (
    Case("photo, PNG", 700, "captures/photo png", "source/images/p01.png", IMPORT),
    Case("photo, JPEG", 500, "captures/photo jpg", "source/images/p01.jpg", IMPORT),
    Case("photo, TIFF", 400, "captures/photo tif", "source/images/p01.tif", IMPORT),
    Case("photo, EXR", 400, "captures/photo exr", "source/images/p01.exr", IMPORT),
    Case("photo without poses", 60, "captures/alone", "source/images/p01.png", IMPORT, refuses=True),
    Case("mask", 250, "captures/beside", "source/masks/*", IMPORT),
    Case("true depth, EXR", 250, "captures/beside", "source/truth/*", IMPORT),
    Case("transforms.json of instant-ngp", 600, "captures/instant-ngp", "source/transforms.json", IMPORT),
    Case("transforms.json of nerfstudio", 500, "captures/nerfstudio", "source/transforms.json", IMPORT),
    Case("transforms.json of Blender", 250, "captures/Blender", "source/transforms.json", IMPORT),
    Case("COLMAP, binary", 700, "captures/COLMAP binary", "source/sparse/0/*", IMPORT),
    Case("COLMAP, text", 600, "captures/COLMAP text", "source/sparse/0/*", IMPORT),
    Case("poses_bounds.npy", 350, "captures/LLFF", "source/poses_bounds.npy", IMPORT),
    Case("config, TOML", 300, "captures/config", "source/options.toml",
         (("import", "source", "work", "--config", "source/options.toml"),)),
    Case("camera path", 250, "fields", "path.json", (("render", "work", "--of", "fit", "--path", "path.json"),)),
    Case("camera path of nerfstudio", 150, "fields", "studio.json",
         (("render", "work", "--of", "fit", "--path", "studio.json"),), refuses=True),
    Case("painting", 250, "loose", "painting.*", alone="painting"),
    Case("flow", 250, "loose", "flow.*", alone="flow"),
    Case("weights", 200, "loose", "weights.*", alone="weights"),
    Case("artifact", 900, "made", "work/*/*/**/*", (("verify", "work"),), sealed=True),
    Case("artifact that a stage reads", 150, "fields", "work/field/fit/field.*", AS_FIELD, sealed=True),
    Case("scene that a stage reads", 100, "scene", "work/scene/main/**/*", (("fit", "work", *TINY_FIT),), sealed=True),
    Case("manifest", 250, "made", "work/*/*/manifest.json", (("show", "work"), ("verify", "work")), sealed=True),
    Case("manifest, resealed", 300, "fields", "work/*/*/manifest.json",
         (("show", "work"), ("verify", "work"), ("compare", "work"),
          ("render", "work", "--of", "fit", "--path", "path.json", "--name", "seen")), resealed=True),
    Case("scene.json, resealed", 350, "scene", "work/scene/main/scene.json",
         (("fit", "work", *TINY_FIT), ("show", "work/scene/main")), resealed=True),
    Case("scene's other files, resealed", 150, "scene", "work/scene/main/**/*", (("fit", "work", *TINY_FIT),),
         resealed=True, leave_out="json$"),
    Case("field.json, resealed", 450, "fields", "work/field/*/field.json", AS_FIELD, resealed=True),
    Case("field.safetensors, resealed", 450, "fields", "work/field/*/field.safetensors", AS_FIELD, resealed=True),
    Case("frames.json, resealed", 150, "made", "work/frames/fit-test/frames.json", (EVAL,), resealed=True),
    Case("frames, resealed", 100, "made", "work/frames/fit-test/*/*", (EVAL,), resealed=True),
    Case("region, resealed", 200, "edit", "work/region/all/region.*",
         (("extract", "work", "--region", "all", "--name", "again"),), resealed=True),
    Case("edit dataset, resealed", 150, "edit", "work/edit-dataset/*/*", (OF_A_REGION,), resealed=True),
    Case("edit, resealed", 250, "edit", "work/edit/*/*",
         (AGAIN, ("distill", "work", "--edit", "gray", "--name", "again")), resealed=True,
         leave_out="png$|manifest.json$"),
    Case("report, resealed", 120, "made", "work/report/*/*.json", (("compare", "work"), ("show", "work")),
         resealed=True),
    Case("checkpoint", 200, "resumed", "work/field/.resumed.partial/checkpoint/*", (RESUMED,), same="field/resumed"),
    Case("run in progress", 60, "resumed", "work/field/.resumed.partial/*.json", (RESUMED,), same="field/resumed"),
)  # fmt: skip
BY_NAME = {case.name: case for case in CASES}


# -- what cases start from ---------------------------------------------------------------------------------------------


def plain(names: Sequence[str]) -> bool:
    """Return whether the cases of these names need only a scene."""
    return bool(names) and all(BY_NAME[name].base.partition("/")[0] in ("captures", "loose", "scene") for name in names)


def prepare(ground: Ground, nursery: Nursery, names: Sequence[str] = ()) -> Path:
    """Make the folder with the base of each case. names: of the cases to prepare, all if empty."""
    root = ground.folder / "readers"
    wanted = {case.base.partition("/")[0] for case in CASES if not names or case.name in names}
    write_captures(root / "captures")
    write_loose(root / "loose", ground.painting)
    shutil.copytree(ground.made, root / "made" / "work")
    (root / "scene" / "work").mkdir(parents=True)
    shutil.copytree(ground.made / "scene" / "main", root / "scene" / "work" / "scene" / "main")
    if "edit" in wanted:
        shutil.copytree(ground.made, root / "edit" / "work", ignore=shutil.ignore_patterns("frames", "report"))
    if "fields" in wanted:
        _make_fields(ground, nursery, root / "fields")
    if "resumed" in wanted:
        _interrupt(root, nursery)
    return root


def _make_fields(ground: Ground, nursery: Nursery, folder: Path) -> None:
    """Make every kind of field, and camera paths for rendering them."""
    work, said = folder / "work", ground.folder / "said"
    shutil.copytree(ground.made, work)
    quick = ("fit", work, "--budget", "15", "--no-buffers", "--samples", "2000")
    done(nursery, said, *quick, "--field", "hash", "--capacity", "fixed:1000", "--name", "hash", *BOUNDED)
    voxel = ("--field", "voxel", "--capacity", "fixed:16", "--head", "mlp", "--name", "voxel")
    done(nursery, said, *quick, *voxel, *BOUNDED)
    learned = ("finetune", work, "--edit", "gray", "--budget", "5", "--rays", "256", "--name", "edited")
    done(nursery, said, *learned, *BOUNDED)
    for kind in ("frames", "report", "edit", "edit-dataset"):
        shutil.rmtree(work / kind)
    write_paths(folder)


def _interrupt(root: Path, nursery: Nursery) -> None:
    """Kill a fit after a checkpoint, retrying until it is hit midway."""
    work = root / "resumed" / "work"
    shutil.copytree(root / "scene" / "work", work)
    command = (*(work if one == "work" else one for one in RESUMED), *BOUNDED)
    checkpoint = work / "field" / ".resumed.partial" / "checkpoint"
    for _ in range(20):
        running = nursery.start(root / "said", *command)
        while running.poll(0.001) is None and not (checkpoint.is_dir() and any(checkpoint.iterdir())):
            pass
        running.poll(0.05)
        running.send(signal.SIGKILL)
        assert running.wait() in (0, -signal.SIGKILL), running.err
        if checkpoint.is_dir() and any(not path.name.startswith(".") for path in checkpoint.iterdir()):
            return
        shutil.rmtree(work / "field", ignore_errors=True)
    raise AssertionError("twenty fits ended before they could be killed with a checkpoint")


# -- one mutant --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Placed:
    """A mutant in place: the copy of the case's base, the damaged file, the changes, and the command."""

    folder: Path
    file: Path
    operators: str
    command: tuple[str, ...]


def place(root: Path, case: Case, number: int, seed: int, folder: Path) -> Placed:
    """Make the mutant `number` of a case in `folder`, which must not exist. Negative numbers are undamaged, one for
    each command."""
    chance = Random(f"{seed}/{case.name}/{number}")
    files = case.files(root)
    relative = chance.choice(files)
    base = root / case.base
    data = (base / relative).read_bytes()
    others = [(base / one).read_bytes() for one in files if one.suffix == relative.suffix][:8]
    damaged, operators = (data, "") if number < 0 else mutant(data, relative.suffix, chance, others)
    shutil.copytree(base, folder, copy_function=_linked)
    (folder / relative).unlink()
    (folder / relative).write_bytes(damaged)
    if case.resealed:
        reseal(folder / Path(*relative.parts[:3]), relative)
    name = relative.parts[2] if len(relative.parts) > 3 else ""
    chosen = ()
    if case.commands:
        chosen = case.commands[-1 - number] if number < 0 else chance.choice(case.commands)
    words = (str(word).replace("{name}", name) for word in chosen)
    command = tuple(str(folder / one) if one == "work" or (base / one).exists() else one for one in words)
    command += BOUNDED if chosen else ()
    return Placed(folder, folder / relative, operators, command)


def _linked(source: str, target: str) -> None:
    """Copy a file; link it unless it is a lock, the only kind written in place."""
    (shutil.copyfile if source.endswith(".lock") else os.link)(source, target)


def reseal(artifact: Path, relative: Path) -> None:
    """Update the manifest of the artifact to the current digests of its files, and its own."""
    path = artifact / "manifest.json"
    try:
        text = path.read_bytes()
        if relative.name != "manifest.json":
            content = json.loads(text)
            for record in content["files"]:
                there = (artifact / record["path"]).read_bytes()
                record |= {"bytes": len(there), "sha256": hashlib.sha256(there).hexdigest()}
            text = (json.dumps(content, indent=1, ensure_ascii=False) + "\n").encode()
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return
    seals = list(re.finditer(rb'"self_sha256": "[^"]*"', text))
    if seals:
        head, tail = text[: seals[-1].start()], text[seals[-1].end() :]
        blank = head + b'"self_sha256": "' + b"0" * 64 + b'"' + tail
        seal = hashlib.sha256(blank).hexdigest().encode()
        path.unlink()  # other names of the file keep what it is
        path.write_bytes(head + b'"self_sha256": "' + seal + b'"' + tail)


def must_be_refused(case: Case, placed: Placed) -> str:
    """Return why a reader must not accept the mutant; empty if it may."""
    if not placed.operators:
        return ""
    if case.sealed:
        return "the manifest's digests tell that it is damaged"
    if placed.file.suffix == ".png" and case.name != "photo without poses" and not case.resealed:
        return "its own check sums tell that it is damaged" if damaged_png(placed.file.read_bytes()) else ""
    if case.name == "field.safetensors, resealed" and _not_finite(placed.file.read_bytes()):
        return "it holds NaN or infinity"
    return ""


def _not_finite(data: bytes) -> bool:
    """Return whether a valid safetensors file holds a NaN or an infinity (but an unseen cell's density is infinite)."""
    import numpy as np

    length = struct.unpack("<Q", data[:8])[0] if len(data) >= 8 else 0
    with suppress(ValueError, KeyError, TypeError, AttributeError, RecursionError), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        head = json.loads(data[8 : 8 + length])
        for name, one in head.items():
            kind = {"F32": "<f4", "F16": "<f2", "F64": "<f8"}.get(one.get("dtype")) if name != "__metadata__" else None
            begin, end = one.get("data_offsets", (0, 0))
            if not kind:
                continue
            values = np.frombuffer(data[8 + length + begin : 8 + length + end], kind)
            if (np.isnan(values) if name == "occupancy.highest" else ~np.isfinite(values)).any():
                return True
    return False


def alone(name: str) -> Callable[[Path], object]:
    """Readers that no single command isolates."""
    if name == "painting":
        from stages.artifacts.style_images import read_style_image

        return read_style_image
    if name == "flow":
        from schemas.flow_files import read_flow

        return read_flow
    from stages.weights.resolve import resolve

    return lambda path: resolve(str(path))


def sound(names: Sequence[str] = ()) -> list[tuple[str, int]]:
    """Return case and number of every undamaged mutant, which must be read."""
    cases = [case for case in CASES if (not names or case.name in names) and not case.refuses]
    return [(case.name, -1 - at) for case in cases for at in range(len(case.commands) or 1)]


def numbers(total: int, names: Sequence[str] = ()) -> Iterator[tuple[str, int]]:
    """Return case and number of `total` mutants, cases interleaved by their shares."""
    cases = [case for case in CASES if not names or case.name in names]
    shares = sum(case.share for case in cases)
    counts = {case.name: max(1, round(total * case.share / shares)) for case in cases}
    counts[cases[0].name] += total - sum(counts.values())
    longest = max(counts.values())
    # Spread evenly, so that a run that is cut short has seen every reader.
    places = sorted((at * longest / count, name, at) for name, count in counts.items() for at in range(count))
    return ((name, at) for _, name, at in places)
