"""The pipeline as a Python object: photos to a stylized scene, its frames and a report.

    pipeline = Pipeline("work")
    pipeline.import_photos("photos")
    field = pipeline.fit(FitConfig(budget="60s"))
    stylized = pipeline.stylize(ArfConfig(style="painting.jpg"))
    pipeline.render(RenderConfig(path="orbit", video=True), of=stylized)
    print(pipeline.evaluate(of=stylized).file("report.html"))

examples/pipeline.py is a program of this kind.
"""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from schemas.errors import ArtifactDamaged, ArtifactStale
from schemas.scene import read_scene
from schemas.work_folder import Artifact, WorkFolder, shortened_name
from stages.configs.blend import BlendConfig
from stages.configs.decompose import PaletteFieldConfig
from stages.configs.deform import DeformConfig
from stages.configs.demo import DemoConfig
from stages.configs.edit import DistillConfig, ExtractConfig, FinetuneConfig, RegionConfig, WholeEditConfig
from stages.configs.evaluate import EvaluateConfig
from stages.configs.export import ExportConfig
from stages.configs.fit import FitConfig
from stages.configs.pose_import import ImportOptions
from stages.configs.render import RenderConfig, label_of
from stages.configs.select import SelectConfig
from stages.configs.stress import StressConfig
from stages.configs.stylize import StylizeConfig
from stages.pipeline import blending, evaluation, local_edit, prerequisites, stylization
from stages.pipeline.demo import Demo, run_demo
from stages.pipeline.exporting import exported
from stages.pipeline.resources import claim, usable_threads
from stages.pipeline.stage_runner import DefaultOptions, Machine, Request, StageOptions, StageRunner
from stages.pipeline.stress import Baselines, stressed
from stages.run.memory import bytes_of, in_words
from stages.run.progress import Progress, Silent
from stages.run.runner import Run, Spec
from stylerf.training.common.process_group import SINGLE_PROCESS, ProcessGroup

Field = Artifact | str  # a field, or its name; empty for the default

# Measured bytes per rendered pixel on disk, EXR and PNG: a capture fills its frames, an object only part of them.
CAPTURE_BYTES, OBJECT_BYTES = 14, 6


class Pipeline:
    """A work folder and the stages that fill it.

    Each method runs one verb of the command line and returns the artifact that it made. Missing prerequisites are made
    too, with default options unless `options` sets others. An artifact that is up to date is reused, and an interrupted
    stage resumes from its last checkpoint.

    Methods share these arguments: `of` is the field to start from, an artifact or its name; `name` is the name of the
    artifact to write; `force` rebuilds an artifact that is up to date. They raise subclasses of
    schemas.errors.StylerfError, whose message says what to do.
    """

    def __init__(
        self,
        work: Path | str,
        *,
        seed: int = 0,
        device: str = "auto",
        threads: int | None = None,
        memory: int | str = 0,
        progress: Progress | None = None,
        options: StageOptions | None = None,
        only: bool = False,
        no_paths: bool = False,
        processes: ProcessGroup = SINGLE_PROCESS,
    ) -> None:
        """Open a work folder. Nothing is written before the first stage runs.

        Args:
            work: the folder, created when the first stage runs.
            seed: for everything random.
            device: `auto`, `cpu` or `cuda`.
            threads: CPU threads; by default all that the process may use.
            memory: the most memory to use, bytes or text such as "8G"; 0 for most of what is free.
            progress: receives progress bars and notes; silent by default.
            options: options of prerequisites, by verb.
            only: raise ArtifactStale if a prerequisite is not up to date, instead of running it.
            no_paths: record files outside the work folder by name only.
            processes: the processes that run this command together (see stages.pipeline.distributed).

        Raises:
            UsageError: `work` is a file.
        """
        bound = bytes_of(memory) if isinstance(memory, str) else memory
        claim(threads, bound)
        self._runner = StageRunner(
            WorkFolder(work),
            seed,
            Machine(device, usable_threads() if threads is None else threads, bound),
            progress or Silent(),
            processes,
            options or DefaultOptions(),
            only,
            no_paths,
        )

    @property
    def work(self) -> WorkFolder:
        """The work folder."""
        return self._runner.work

    def run(
        self,
        spec: Spec,
        run: Run,
        inputs: dict[str, Artifact],
        config: Any,
        default_name: str,
        *,
        name: str = "",
        force: bool = False,
    ) -> Artifact:
        """Run any stage, such as one of your own: `spec` describes it, `run` is its function, `inputs` are by role."""
        return self._runner.run(spec, run, inputs, config, default_name, Request(name, force))

    def import_photos(
        self, source: Path | str, options: ImportOptions | None = None, *, name: str = "", force: bool = False
    ) -> Artifact:
        """Import a folder of photos, with their poses or without; return the scene."""
        return prerequisites.imported(self._runner, Path(source), options or ImportOptions(), Request(name, force))

    def fit(self, config: FitConfig | None = None, *, name: str = "", force: bool = False) -> Artifact:
        """Fit a radiance field to the scene; return the field. `config.buffers` takes a call of render_views."""
        scene = prerequisites.scene_of_work(self.work)
        return prerequisites.fitted(self._runner, scene, config or FitConfig(), Request(name, force))

    def render_views(self, field: Artifact) -> Artifact:
        """Render a field from all views of its scene, unless they are up to date; return the frames."""
        name = shortened_name(f"{field.name}-views")
        if not self._made_from(name, field):
            scene = read_scene(prerequisites.scene_of(self.work, field).path)
            largest = max(scene.views, key=lambda view: view.width * view.height)
            each = OBJECT_BYTES if scene.layout == "object" else CAPTURE_BYTES
            size = sum(view.width * view.height for view in scene.views) * each
            self._runner.say(
                f"rendering {len(scene.views)} views of {largest.width}x{largest.height} to EXR and PNG, about "
                f"{in_words(size)}; --no-buffers skips this"
            )
        return prerequisites.ensure_frames(self._runner, field, "views", name)

    def deform(
        self, config: DeformConfig | None = None, *, of: Field = "", name: str = "", force: bool = False
    ) -> Artifact:
        """Give a field (by default the fitted one) a deformation; return the deformed field."""
        runner = self._runner
        field = prerequisites.ensure_field(runner, prerequisites.scene_of_work(self.work), _name(of))
        pictures = prerequisites.training_pictures(self.work, field)
        return prerequisites.deformed(runner, pictures, field, config or DeformConfig(), Request(name, force))

    def stylize(
        self,
        config: StylizeConfig,
        *,
        of: Field = "",
        region: str | None = None,
        name: str = "",
        force: bool = False,
    ) -> Artifact:
        """Stylize a field (by default the fitted one), or one region of it; return the stylized field."""
        return stylization.stylized(self._runner, config, _name(of), region, Request(name, force))

    def stylize_region(
        self, config: RegionConfig, *, region: str = "", of: Field = "", name: str = "", force: bool = False
    ) -> Artifact:
        """Learn the look of a region (by default the only one), to recolor or stylize it; return the edit."""
        return stylization.region_styled(self._runner, config, _name(of), region, Request(name, force))

    def decompose(self, config: PaletteFieldConfig, *, of: Field = "", name: str = "", force: bool = False) -> Artifact:
        """Decompose a field's colors into a palette, or change the palette it has; return the new field."""
        return stylization.palette_field(self._runner, config, _name(of), Request(name, force))

    def blend(self, config: BlendConfig, *, name: str = "", force: bool = False) -> Artifact:
        """Mix fields made from one field, by weight or by region; return the new field."""
        return blending.blended(self._runner, config, Request(name, force))

    def select(self, config: SelectConfig, *, of: Field = "", name: str = "", force: bool = False) -> Artifact:
        """Select a region in a field (by default the fitted one); return the region."""
        return local_edit.selected(self._runner, config, self._named(of), "region", Request(name, force))

    def extract(
        self,
        config: ExtractConfig | None = None,
        *,
        region: str = "",
        of: Field = "",
        name: str = "",
        force: bool = False,
    ) -> Artifact:
        """Render what the views show of a region (by default the only one); return the edit dataset."""
        chosen = local_edit.only_one(self.work, "region", region)
        request = Request(name, force)
        return local_edit.edit_dataset(self._runner, chosen, self._named(of), config or ExtractConfig(), request)

    def distill(
        self, config: DistillConfig | None = None, *, edit: str = "", name: str = "", force: bool = False
    ) -> Artifact:
        """Paint an edit (by default the only one) into the training photos; return the edited scene."""
        chosen = local_edit.only_one(self.work, "edit", edit)
        return local_edit.distilled(self._runner, chosen, config or DistillConfig(), Request(name, force))

    def finetune(
        self,
        config: FinetuneConfig | None = None,
        *,
        edit: str = "",
        of: Field = "",
        name: str = "",
        force: bool = False,
    ) -> Artifact:
        """Train a field on an edit (by default the only one); return the edited field."""
        chosen = local_edit.only_one(self.work, "edit", edit)
        request = Request(name, force)
        return local_edit.finetuned(self._runner, chosen, self._named(of), config or FinetuneConfig(), request)

    def edit(
        self, config: WholeEditConfig, *, of: Field = "", name: str = "edit", force: bool = False
    ) -> local_edit.LocalEdit:
        """Select a region, learn its look and train the field on it; every artifact is called `name`."""
        return local_edit.edited(self._runner, config, _name(of), name, force)

    def render(
        self, config: RenderConfig | None = None, *, of: Field = "", name: str = "", force: bool = False
    ) -> Artifact:
        """Render a field (by default the newest) along a path; return the frames, named <field>-<path>."""
        from stages.render import pinned

        field = prerequisites.field_named(self._runner, _name(of))
        config = pinned(config or RenderConfig())
        strength = "" if config.strength == 1 else f"-strength-{config.strength:g}"
        default = f"{field.name}-{label_of(config.path)}{strength}" + (f"-{config.frames}" if config.frames else "")
        source = None if config.strength == 1 else blending.source_of(self.work, field, "--strength")
        return prerequisites.rendered(self._runner, field, config, default, Request(name, force), source)

    def export(
        self, config: ExportConfig | None = None, *, of: Field = "", name: str = "", force: bool = False
    ) -> Artifact:
        """Export a field (by default the newest) or cameras; return the export, named <field>-<kind>."""
        return exported(self._runner, config or ExportConfig(), _name(of), Request(name, force))

    def evaluate(
        self,
        config: EvaluateConfig | None = None,
        *,
        of: Field = "",
        path: str = "",
        regions: Sequence[str] = (),
        base: str = "",
        robust_to: str = "",
        name: str = "",
        force: bool = False,
    ) -> Artifact:
        """Measure a field (by default the newest) on the test views; return the report.

        Args:
            config: options of the metrics.
            path: camera path of the consistency metrics; by default that of the newest video.
            regions: regions of a local edit, which is compared with the field before it.
            base: the field before the edit; by default the one it started from.
            robust_to: stylized field whose renders were the references of this one.
            name: of the report; by default the field's.
            force: rebuild a report that is up to date.
        """
        against = evaluation.Comparison(path, regions, base, robust_to)
        return evaluation.evaluated(self._runner, config or EvaluateConfig(), _name(of), against, Request(name, force))

    def demo(self, config: DemoConfig | None = None, *, force: bool = False) -> Demo:
        """Run every stage on a procedural still life."""
        return run_demo(self._runner, config or DemoConfig(), force)

    def stress(
        self,
        config: StressConfig | None = None,
        *,
        baseline: Path | None = None,
        write_baseline: Path | None = None,
        force: bool = False,
    ) -> dict[str, Any]:
        """Run methods under faults of the scene; return what stress.json holds.

        Raises:
            stages.pipeline.stress.Regression: a cell is worse than in the baseline.
        """
        baselines = Baselines(baseline, write_baseline)
        return stressed(self._runner, config or StressConfig(), baselines, force)

    def _made_from(self, frames: str, field: Artifact) -> bool:
        with suppress(ArtifactDamaged, ArtifactStale):  # missing or unreadable frames are rendered
            return field.digest in [ref.digest for ref in self.work.get("frames", frames).manifest.inputs]
        return False

    def _named(self, of: Field) -> Artifact | None:
        return prerequisites.field_named(self._runner, _name(of)) if of else None


def _name(field: Field) -> str:
    return field if isinstance(field, str) else field.name
