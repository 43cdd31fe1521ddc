"""Ray strategies compared on one scene: `python -m benchmarks.strategies WORK STYLE OUT.json [STEPS [METHOD]]`.

Protocol: the field in WORK is stylized with each strategy in a separate process, one after another, with the same
seed, refit and settings (METHOD arf or desrf, dilation 2, no blur; dilated also with the paper's 3x3 blur, and without
reusing the last render).
`full` runs STEPS steps, which take T seconds; all others run until they have done STEPS steps and used T seconds. Style
distance (exact nearest neighbors, conv3) and content distance are means over the held-out views and over LOOKS
evaluations two steps apart, the first at equal steps or at equal time, since they fluctuate by a tenth between steps.
Field seconds: rendering the image and backpropagating its gradient; the rest of a step is the feature extractor, the
matching and the optimizers. Field memory: maximum resident memory at the end of rendering and of backpropagation, minus
that before the step; without the feature extractor, and in a separate process that immediately returns freed memory.
"""

import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.conditions import here_and_now

LOOKS = 5
# For glibc: arrays of 64 KiB and more are returned to the system when freed. Otherwise, freed memory may stay resident
# by chance: the same step was measured as 142 MB and as 221 MB.
GIVEN_BACK = {"MALLOC_MMAP_THRESHOLD_": "65536"}
CASES = {
    "full": {"strategy": "full"},
    "dilated": {"strategy": "dilated"},
    "dilated, blur 3": {"strategy": "dilated", "blur": 3},
    "dilated, others re-rendered": {"strategy": "dilated", "remember": False},
    "deferred": {"strategy": "deferred"},
    "random": {"strategy": "random"},
    "patch": {"strategy": "patch"},
}


def peak_mb() -> float:
    """Return the peak resident memory so far, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3


def resident_mb() -> float:
    """Return the current resident memory, MB (Linux)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() / 1e6


def stylizer_for(work: str, style: str, method: str, case: str):
    """Return the trainer of a case, its held-out views with their photos, and the background level."""
    import numpy as np

    from schemas.work_folder import WorkFolder
    from stages.artifacts.field import load_field
    from stages.artifacts.photos import level_of, photo_over
    from stages.artifacts.scene import load_scene
    from stages.artifacts.style_images import read_style_image
    from stages.configs.stylize import CONFIGS
    from stages.stylization.settings import image_layers, new_color, settings_of
    from stages.weights.resolve import resolve
    from stylerf.fields.deformation import Deformation
    from stylerf.kernels.cpu.compiling import set_threads
    from stylerf.style.feature_extractor import FeatureExtractor
    from stylerf.training.stylize.arf import Arf
    from stylerf.training.stylize.scene import StyledScene, StyleProblem
    from stylerf.training.stylize.trainer import StylizationTrainer

    threads, store = set_threads(os.cpu_count() or 1), WorkFolder(Path(work))
    scene = load_scene(store.artifacts("scene")[0])
    field, background = load_field(next(f for f in store.artifacts("field") if f.manifest.stage == "nerf_fit"))
    options = {"rays" if k == "strategy" else k: v for k, v in CASES[case].items()}
    config = CONFIGS[method](style=style, budget="100000", **options)
    level, found = level_of(background), resolve(None)
    views, style_image = scene.splits["train"], read_style_image(Path(style))
    extractor = FeatureExtractor(found.state, image_layers(config, found.state), found.kind)
    long_side = max(max(c.width, c.height) for c in scene.cameras)
    problem = StyleProblem(
        field,
        [scene.cameras[i] for i in views],
        [photo_over(scene, i, level) for i in views],
        level,
        settings_of(config, long_side, field.opaque_background, style_image=style_image),
        0,
        threads,
        style_image,
        Deformation.create(np.random.default_rng([0, 8])) if method == "desrf" else None,
    )
    styled = StyledScene(problem, lambda generator, made: new_color(config, generator, made.pixel_cells()))
    made = StylizationTrainer(Arf(styled, extractor))
    held_out = [(scene.cameras[i], photo_over(scene, i, level)) for i in scene.splits["test"]]
    return made, held_out, level


def distances(made, held_out, level) -> dict[str, float]:
    """Return the mean style and content distance of the held-out views."""
    import numpy as np
    import torch

    from stylerf.rendering.view import render_view
    from stylerf.style.style_loss import StyleObjective

    styled, s = made.scene, made.settings
    size, style_image = (styled.cameras[0].height, styled.cameras[0].width), styled.problem.style_image
    extractor = made.method.loss.extractor
    exact = StyleObjective(extractor, style_image, size, s.weights, s.feature_scale, 100000, 0, s.style_scale)
    sums = {"style": 0.0, "content": 0.0}
    for camera, photo in held_out:
        seen = render_view(styled.field, camera, threads=styled.problem.threads)
        rgb = np.clip(seen.rgb + (1 - seen.alpha[..., None]) * np.float32(level), 0, 1)
        picture, wanted = (torch.from_numpy(np.ascontiguousarray(i)).permute(2, 0, 1) for i in (rgb, photo))
        with torch.no_grad():
            alpha = None if styled.field.opaque_background else torch.from_numpy(seen.alpha)
            parts = exact(picture, exact.content_of(wanted), alpha)[1]
        for name in sums:
            sums[name] += parts[name] / len(held_out)
    return {name: round(value, 5) for name, value in sums.items()}


@dataclass
class Mark:
    """LOOKS evaluations of the held-out views, two steps apart; step and seconds are those of the first."""

    looks: list[dict[str, float]] = field(default_factory=list)
    step: int = 0
    seconds: float = 0.0

    def due(self, step: int) -> bool:
        return not self.looks or (len(self.looks) < LOOKS and step >= self.step + 2 * len(self.looks))

    def take(self, look: dict[str, float], step: int, seconds: float) -> None:
        if not self.looks:
            self.step, self.seconds = step, seconds
        self.looks.append(look)

    def mean(self) -> dict[str, float]:
        return {name: round(sum(look[name] for look in self.looks) / len(self.looks), 5) for name in self.looks[0]}


def watched(made) -> dict:
    """Track the cost of rendering and backpropagation from now on: seconds, and peak resident memory, MB."""
    spent = {"seconds": 0.0, "peak": 0.0, "inside": 0}

    def timed(function):
        def call(*arguments):
            begun = time.perf_counter()
            spent["inside"] += 1
            result = function(*arguments)
            spent["inside"] -= 1
            if not spent["inside"]:  # rendering an image calls rendering of its parts
                spent["seconds"] += time.perf_counter() - begun
            spent["peak"] = max(spent["peak"], resident_mb())
            return result

        return call

    step, geometry = made.method.view_step, made.scene.geometry
    step.image, geometry.learn = timed(step.image), timed(geometry.learn)
    geometry.paint = timed(geometry.paint)  # `deferred` marches its rays again
    return spent


def ready(work: str, style: str, method: str, case: str) -> tuple:
    """Return (trainer at its first style step, held-out views, background level, tracked cost)."""
    made, held_out, level = stylizer_for(work, style, method, case)
    scene = made.scene
    while scene.budget.progress < 1:
        scene.refit_step()
        made.state.step += 1
    made.next_phase()
    _ = made.method.loss.objective  # compute the style image's features here, not in the first step
    spent = watched(made)
    for view in range(len(scene.cameras)):  # caches that are filled on a view's first visit, not part of a step
        scene.geometry.alpha(view)
        if made.settings.strategy not in ("full", "deferred"):
            made.method.view_step.last_renders[view] = scene.render(view)
    return made, held_out, level, spent


def field_memory(work: str, style: str, method: str, case: str) -> float:
    """Return the field's memory, MB: of a step with a zero image gradient, before the feature extractor has run."""
    import numpy as np

    made, _, _, spent = ready(work, style, method, case)
    before, camera = resident_mb(), made.scene.cameras[0]
    spent["peak"] = 0.0
    made.method.view_step.gradient = lambda view, picture: (
        np.zeros((camera.height, camera.width, 3), np.float32), {"style": 0.0})  # fmt: skip
    made.scene.adam.step = lambda rate: None
    made.method.step()
    return round(max(spent["peak"] - before, 0.0), 1)


def measure(work: str, style: str, method: str, case: str, steps: int, seconds: float) -> dict:
    """Run one case in this process; return its row. seconds 0: as long as `steps` steps take."""
    made, held_out, level, spent = ready(work, style, method, case)
    row: dict = {"case": case}
    made.method.step()  # the first one is slower
    made.state.step, spent["seconds"], used = 1, 0.0, 0.0
    marks = {"at_equal_steps": Mark()} | ({"at_equal_time": Mark()} if seconds else {})
    while any(len(mark.looks) < LOOKS for mark in marks.values()):
        begun = time.perf_counter()
        made.method.step()
        used += time.perf_counter() - begun
        made.state.step += 1
        done = made.state.step - 1
        reached = {"at_equal_steps": done >= steps, "at_equal_time": used >= seconds}
        if due := [mark for name, mark in marks.items() if reached[name] and mark.due(done)]:
            now = distances(made, held_out, level)
            for mark in due:
                mark.take(now, done, used)
    row |= {name: mark.mean() for name, mark in marks.items()}
    row["seconds_at_equal_steps"] = round(marks["at_equal_steps"].seconds, 2)
    row |= {"steps": done, "step_seconds": round(used / done, 4), "field_seconds": round(spent["seconds"] / done, 4)}
    row["peak_memory_mb"] = round(peak_mb())
    row["steps_at_equal_time"] = marks["at_equal_time"].step if seconds else steps
    row.setdefault("at_equal_time", row["at_equal_steps"])
    return row


def main() -> None:
    work, style, out = sys.argv[1:4]
    steps, method = int(sys.argv[4]) if len(sys.argv) > 4 else 30, sys.argv[5] if len(sys.argv) > 5 else "desrf"
    if len(sys.argv) == 7:
        print(field_memory(work, style, method, sys.argv[6]))
        return
    if len(sys.argv) > 7:
        print(json.dumps(measure(work, style, method, sys.argv[6], steps, float(sys.argv[7]))))
        return
    rows: list[dict] = []
    for case in CASES:
        seconds = rows[0]["seconds_at_equal_steps"] if rows else 0.0
        requested = [work, style, out, str(steps), method, case, str(seconds)]
        command = [sys.executable, "-m", "benchmarks.strategies", *requested]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
        memory = subprocess.run(command[:-1], check=True, capture_output=True, text=True, env=os.environ | GIVEN_BACK)
        rows.append({**json.loads(said), "field_memory_mb": float(memory.stdout)})
        print(rows[-1], flush=True)
        report = {
            "command": f"python -m benchmarks.strategies WORK {Path(style).name} OUT.json {steps} {method}",
            "scene": Path(work).name,
            "protocol": __doc__.split("Protocol: ")[1],
            **here_and_now(),
            "method": method,
            "rows": rows,
        }
        Path(out).write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
