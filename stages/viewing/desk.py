"""The viewer without its page: what is shown, selected, changed and run. Each action leaves the command that does it.

Methods are called by threads of the page, one at a time (see `lock`).
"""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from schemas.errors import BadInput, StylerfError, UsageError
from schemas.work_folder import valid_name
from stages.configs.decompose import PaletteFieldConfig
from stages.configs.edit import FinetuneConfig
from stages.configs.export import ExportConfig
from stages.configs.render import RenderConfig
from stages.viewing.cameras import Pose, pixel_at
from stages.viewing.commands import command, script_of
from stages.viewing.keyframes import Keyframes
from stages.viewing.library import Library
from stages.viewing.painter import Painter
from stages.viewing.palette_changes import Changes, learned_with
from stages.viewing.runs import ENDING_SECONDS, Run
from stages.viewing.selection import History
from stages.viewing.shown import PLANES, Shown, Source
from stages.viewing.styles import Wish
from stylerf.errors import InvalidValue
from stylerf.fields.blended_color import BlendedColor
from stylerf.fields.palette_edits import PaletteEdits

if TYPE_CHECKING:  # these import torch, which the first picture should not wait for
    from stages.viewing.growing import Grower
    from stages.viewing.recoloring import Swatch

CLICK_PIXELS = 200_000.0  # of the camera that clicks are looked up in; its pixels are finer than any field
BOX_RAYS = 24  # a side, through a rectangle that becomes a box
PREPARE_SECONDS = 0.2  # between looks at whether the page rests
WATCH_SECONDS = 3.0  # between looks at the checkpoints of a stylization
EDIT_MARK = "edit "  # before the name of a region's palette in lists of what can be recolored


class Desk:
    """What one viewer works on.

    Args:
        library: of the work folder.
        painter: paints what is shown.
        threads: CPU threads.
        said: receives notes for the user.
        changed: called when runs have begun, spoken or ended.
        common: arguments that every command gets, such as --threads 2.
    """

    def __init__(
        self,
        library: Library,
        painter: Painter,
        threads: int,
        said: Callable[[str], None] = lambda text: None,
        changed: Callable[[], None] = lambda: None,
        common: tuple[str, ...] = (),
    ) -> None:
        self.library, self.painter, self.threads = library, painter, threads
        self.lock = threading.RLock()
        self.said, self._changed, self._common = said, changed, common
        self.field = library.first_field()
        self.beside, self.wipe, self.plane, self.overlay = "", 0.5, "color", ""
        self.history = History()
        self.palette, self.changes = "", Changes()
        self.keyframes = Keyframes()
        self.commands: list[list[str]] = []
        self.run: Run | None = None
        self._half: Source | None = None  # of a stylization in progress
        self._growers: dict[str, Grower] = {}  # of the field that is shown, by its digest
        self._growing = threading.Lock()  # over _growers
        self._preparing: threading.Thread | None = None
        self._closing = threading.Event()
        self._selected: np.ndarray | None = None
        self._regions: dict[str, np.ndarray] = {}

    # -- looking -------------------------------------------------------------------------------------------------------

    def look(self, **values: object) -> None:
        """Show something else: field, beside (a field or empty), wipe (0..1), plane, overlay (a region or empty)."""
        with self.lock:
            for name, value in values.items():
                if name not in ("field", "beside", "wipe", "plane", "overlay"):
                    raise UsageError(f"there is nothing called {name} to look at")
                if name == "plane" and value not in PLANES:
                    raise UsageError(f"planes are {', '.join(PLANES)}, not {value}")
                setattr(self, name, value)
            self.refresh()

    def refresh(self) -> None:
        """Show what is to be shown now."""
        with self.lock:
            left = self._half or self._recolored(self.library.source(self.field))
            right = self.library.source(self.beside) if self.beside else None
            self.painter.show(Shown(left, right, self.wipe, self.plane, self._marked()))

    def _marked(self) -> np.ndarray | None:
        if self._selected is not None:
            return self._selected
        if not self.overlay:
            return None
        key = self.library.work.get("region", self.overlay).digest
        if key not in self._regions:
            self._regions = {key: self.library.marked(self.overlay)}
        return self._regions[key]

    def render_command(self) -> list[str]:
        """Return the command that renders the shown field along the saved path, or around the scene without one."""
        return command("render", self.library.work.root, RenderConfig(path="orbit"), of=self.field)

    def splats_command(self) -> list[str]:
        """Return the command that exports the shown field's splats for the page and for one HTML file."""
        config = ExportConfig(kind="splats", formats="ply", units="scene", budget="60s", splats=100_000)
        return command("export", self.library.work.root, config, of=self.field)

    # -- selecting -----------------------------------------------------------------------------------------------------

    def click(self, pose: Pose, across: float, down: float, avoid: bool = False) -> str:
        """Add what a place of the picture shows to the selection, or mark it as not part of it; return the seed.

        Args:
            across, down: in 0..1, from the top left.

        Raises:
            BadInput: nothing is there, or no training view shows it.
        """
        seed = self._seeds(pose, [(across, down)], skipping=False)[0]
        with self.lock:
            self.history.add("avoid" if avoid else "at", seed)
            self.grow()
        return seed

    def scribble(self, pose: Pose, places: list[tuple[float, float]], avoid: bool = False) -> int:
        """Add several places along a stroke; return how many of them meet something that a view shows.

        Raises:
            BadInput: none of them does.
        """
        found = self._seeds(pose, places, skipping=True)
        if not found:
            raise BadInput("the stroke meets nothing of the field that a training view shows: draw over an object")
        name = "avoid" if avoid else "at"
        with self.lock:
            self.history.change(**{name: tuple(dict.fromkeys((*getattr(self.history.now, name), *found)))})
            self.grow()
        return len(found)

    def _seeds(self, pose: Pose, places: list[tuple[float, float]], skipping: bool) -> list[str]:
        """Return VIEW:X,Y of places (across, down) in 0..1; skipping: leave out those that no view shows."""
        from stages.viewing.growing import place_of, seen_at

        camera, found = pose.camera(CLICK_PIXELS), list[str]()
        field = self.library.source(self.field).field
        for place in places:
            pixel = pixel_at(camera, *place)
            try:
                there = place_of(field, camera, pixel, self.threads)
                toward = camera.rays(np.array([pixel]))[1][0].astype(float)
                found.append("{}:{},{}".format(*seen_at(self.library.scene, field, there, toward, self.threads)))
            except BadInput:
                if not skipping:
                    raise
        return found

    def box(self, pose: Pose, low: tuple[float, float], high: tuple[float, float]) -> tuple[float, ...]:
        """Set the selection's box around the surfaces that a rectangle of the picture shows; return its corners."""
        from stages.viewing.growing import box_around
        from stylerf.editing.selection import ends_of_rays

        camera = pose.camera(CLICK_PIXELS)
        across = np.linspace(min(low[0], high[0]), max(low[0], high[0]), BOX_RAYS).clip(0, 1) * (camera.width - 1)
        down = np.linspace(min(low[1], high[1]), max(low[1], high[1]), BOX_RAYS).clip(0, 1) * (camera.height - 1)
        pixels = (down.astype(int)[:, None] * camera.width + across.astype(int)).ravel()
        field = self.library.source(self.field).field
        x, alpha = ends_of_rays(field, camera, pixels, self.threads)
        if not (alpha > 0.5).any():
            raise BadInput("the rectangle shows nothing of the field: draw it over an object")
        corners = box_around(field.space.unwarp(np.clip(x[alpha > 0.5], 1e-6, 1 - 1e-6)))
        self.reselect(box=corners)
        return corners

    def reselect(self, **values: object) -> None:
        """Change options of the selection, such as tolerance=10.0 or union=("a",)."""
        with self.lock:
            self.history.change(**values)
            self.grow()

    def undo(self) -> None:
        """Take back the last change of the selection."""
        with self.lock:
            self.history.undo()
            self.grow()

    def clear_selection(self) -> None:
        """Select nothing."""
        with self.lock:
            self.history.clear()
            self.grow()

    def grow(self) -> None:
        """Compute the selection's cells, and show them; one that cannot be is undone."""
        with self.lock:
            self._selected = None
            if self.history.now:
                try:
                    self._selected = self.grower().cells(self.history.now)
                except (BadInput, ValueError):
                    self.history.undo()
                    raise
            self.refresh()

    def grower(self) -> "Grower":
        """Return what grows selections in the shown field; unless prepared, its first selection takes seconds."""
        from stages.viewing.growing import Grower

        key = self.library.work.get("field", self.field).digest
        with self._growing:
            if key not in self._growers:
                self._growers = {key: Grower(self.library, self.field, self.threads, self.said)}
            return self._growers[key]

    def prepare(self) -> None:
        """From now on compute what the first selection in a field needs while no picture is waited for, in a thread."""
        with self.lock:
            if self._preparing is None:
                self._preparing = threading.Thread(target=self._prepare, name="prepare", daemon=True)
                self._preparing.start()

    def _prepare(self) -> None:
        done = ""
        while not self._closing.wait(PREPARE_SECONDS):
            field = self.field
            if field == done or not self.painter.resting():
                continue
            try:
                grower = self.grower()
                wanted = partial(self._idle_with, field)
                if grower.prepare(wanted):
                    done = field
            except (StylerfError, InvalidValue, ValueError, OSError, MemoryError):
                done = field  # a click says what is wrong

    def _idle_with(self, field: str) -> bool:
        """Wait until no picture is waited for; return whether this field is shown still."""
        while not self._closing.is_set() and self.field == field:
            if self.painter.resting():
                return True
            self._closing.wait(PREPARE_SECONDS)
        return False

    @property
    def selected_cells(self) -> int:
        """Number of marked cells of the selection."""
        return 0 if self._selected is None else int(self._selected.sum())

    def select_command(self, name: str = "") -> list[str]:
        """Return the command that makes a region of the selection.

        Raises:
            UsageError: nothing is selected.
        """
        if not self.history.now:
            raise UsageError("nothing is selected: click an object first")
        root = self.library.work.root
        return command("select", root, self.history.now.config(), of=self.field, name=name and valid_name(name))

    # -- recoloring ----------------------------------------------------------------------------------------------------

    def palettes(self) -> list[str]:
        """Return what can be recolored: decomposed fields, and regions' palettes with EDIT_MARK before their names."""
        return [*self.library.palettes(), *(EDIT_MARK + name for name in self.library.edits())]

    def open_palette(self, name: str) -> "list[Swatch]":
        """Choose what is recolored (empty: nothing), without changes; return its colors."""
        from stages.viewing.recoloring import swatches

        with self.lock:
            self.palette, self.changes = name, Changes()
            if name and not name.startswith(EDIT_MARK):
                self.field = name
            self.refresh()
            return swatches(self._palette_artifact()) if name else []

    def _palette_artifact(self):
        edit = self.palette.startswith(EDIT_MARK)
        return self.library.work.get("edit" if edit else "field", self.palette.removeprefix(EDIT_MARK))

    def recolor(self, index: int, color: str = "", weight: float | None = None, bias: float | None = None) -> None:
        """Change a palette color: its color (#rrggbb), the factor of its weight, what is added to that."""
        with self.lock:
            new = self.changes
            if color:
                new = replace(new, colors={**new.colors, index: color})
            if weight is not None:
                new = replace(new, weights={**new.weights, index: weight})
            if bias is not None:
                new = replace(new, biases={**new.biases, index: bias})
            new.config()
            self.changes = new
            self.refresh()

    def reset_palette(self) -> "list[Swatch]":
        """Take all changes of the palette back; return its colors."""
        return self.open_palette(self.palette)

    def _recolored(self, source: Source) -> Source:
        """The source with the palette's changes, if they are of it."""
        if not self.palette:
            return source
        from stages.artifacts.edit import load_edit
        from stages.viewing.recoloring import edit_changes, edited_field, field_changes, recolored_field

        artifact, config = self._palette_artifact(), self.changes.config()
        if self.palette.startswith(EDIT_MARK):
            edit = load_edit(artifact)
            region = self.library.region_of_edit(artifact)
            if region is None:
                raise BadInput(f"the region of edit {artifact.name} is gone; select it again")
            if isinstance(source.field.color, BlendedColor):
                raise BadInput(f"an edit cannot be previewed on field {source.name}, a blend; show another field")
            changes = edit_changes(artifact, edit, config)
            field = edited_field(source.field, edit, self.library.region(region.name), changes)
            return replace(source, field=field)
        if artifact.name != source.name:
            return source
        field = recolored_field(source.field, field_changes(artifact, source.field.color, config))
        return replace(source, field=field)

    def recolor_command(self, name: str = "") -> list[str]:
        """Return the command that keeps the palette's changes.

        Raises:
            UsageError: nothing was changed.
        """
        config = self.changes.config()
        if not self.palette or not config:
            raise UsageError("no palette color was changed")
        root, named = self.library.work.root, name and valid_name(name)
        if self.palette.startswith(EDIT_MARK):
            artifact = self._palette_artifact()
            region = self.library.region_of_edit(artifact)
            if region is None:
                raise UsageError(f"the region of edit {artifact.name} is gone; select it again")
            learned = learned_with(artifact.manifest.config, config)
            return command("stylize", root, learned, region=region.name, name=named)
        merged = PaletteFieldConfig(
            palette=config.palette, palette_weight=config.palette_weight, palette_bias=config.palette_bias
        )
        return command("stylize", root, merged, of=self.palette, name=named, method="palettenerf")

    def decompose_command(self) -> list[str]:
        """Return the command that learns a palette of the shown field."""
        return command("stylize", self.library.work.root, None, of=self.field, method="palettenerf")

    # -- stylizing -----------------------------------------------------------------------------------------------------

    def stylize_command(self, wish: Wish) -> list[str]:
        """Return the command of a stylization of the shown field, or of a region."""
        return wish.command(self.library.work.root, self.field)

    def watch(self, run: Run, name: str, region: str = "") -> None:
        """Show a stylization of the scene or a region while it runs, from its checkpoints, in a thread of its own."""
        from stages.viewing.half_done import half_done, half_learned
        from stages.viewing.recoloring import edited_field

        source, work = self.library.source(self.field), self.library.work
        cells = self.library.region(region) if region else None

        def newest() -> Source | None:
            if cells is None:
                return half_done(work, name, source)
            edit = half_learned(work, name)
            if edit is None:
                return None
            return replace(source, field=edited_field(source.field, edit, cells, PaletteEdits()))

        def follow() -> None:
            while run.code is None:
                time.sleep(WATCH_SECONDS)
                found = newest()
                with self.lock:
                    if found is not None and run.code is None:
                        self._half = found
                        self.refresh()
            with self.lock:
                self._half = None
                self.refresh()

        threading.Thread(target=follow, name="watch", daemon=True).start()

    def keep(self, ended: Callable[[Run], None] = lambda run: None) -> Run:
        """Stop the stylization of a scene, if it runs, and make a field of the steps that it has taken.

        Raises:
            UsageError: as keep_command.
        """
        if self.run is not None and self.run.arguments[0] == "stylize" and self.run.code is None:
            self.run.stop()
            self.run.wait()
        return self.start(self.keep_command(), ended)

    def keep_command(self) -> list[str]:
        """Return the command that ends a stopped stylization where it is: the same, until the steps that it has taken.

        Raises:
            UsageError: none was stopped, or it has no steps to keep.
        """
        from stages.viewing.half_done import steps_done

        run = self.run
        if run is None or run.arguments[0] != "stylize" or "--region" in run.arguments or run.code == 0:
            raise UsageError("no stylization of a scene was stopped: there is nothing to keep")
        if run.code is None:
            raise UsageError("the stylization runs: stop it first")
        options = dict(zip(run.arguments, run.arguments[1:], strict=False))
        steps = steps_done(self.library.work, options.get("--name", ""))
        if steps is None:
            raise UsageError("the stopped run has not taken a style step under a name of its own: resume it")
        made = run.arguments
        if "--until" in made:
            at = made.index("--until")
            made = [*made[:at], *made[at + 2 :]]
        return [*made, "--until", str(steps)]

    # -- a region's edit, stage by stage -------------------------------------------------------------------------------

    def extract_command(self, region: str) -> list[str]:
        """Return the command that renders what the views show of a region, for its edit."""
        return command("extract", self.library.work.root, region=_given(region, "region"))

    def distill_command(self, edit: str) -> list[str]:
        """Return the command that paints an edit into the training photos."""
        return command("distill", self.library.work.root, edit=_given(edit, "edit"))

    def finetune_command(self, edit: str, seconds: int) -> list[str]:
        """Return the command that trains a field on an edit."""
        config = FinetuneConfig(budget=f"{seconds}s")
        return command("finetune", self.library.work.root, config, edit=_given(edit, "edit"))

    def deform_command(self) -> list[str]:
        """Return the command that gives the shown field a deformation."""
        return command("deform", self.library.work.root, of=self.field)

    def show_newest(self, run: Run) -> None:
        """Show the newest field, if a run has made one."""
        if run.code == 0:
            newest = self.library.first_field()
            if newest != self.field:
                self.look(field=newest)
            self._changed()

    # -- paths ---------------------------------------------------------------------------------------------------------

    def add_keyframe(self, pose: Pose) -> int:
        """Add a keyframe; return how many there are."""
        with self.lock:
            self.keyframes = replace(self.keyframes, poses=(*self.keyframes.poses, pose))
            return len(self.keyframes.poses)

    def set_keyframes(self, **values: object) -> None:
        """Change keyframes: poses, between."""
        with self.lock:
            self.keyframes = replace(self.keyframes, **values)  # type: ignore[arg-type]

    def save_path(self, name: str) -> Path:
        """Write the path for `stylerf render --path`; return its file."""
        like = self.library.scene.cameras[0]
        return self.keyframes.save(self.library.own / "paths" / f"{valid_name(name)}.json", like)

    def path_command(self, path: Path) -> list[str]:
        """Return the command that renders the shown field along a saved path."""
        return command("render", self.library.work.root, RenderConfig(path=str(path)), of=self.field)

    # -- runs ----------------------------------------------------------------------------------------------------------

    def start(self, arguments: list[str], ended: Callable[[Run], None] = lambda run: None) -> Run:
        """Run a command, and note it for the session's script.

        Raises:
            UsageError: another one is still running.
        """
        with self.lock:
            if self.run is not None and self.run.code is None:
                raise UsageError(f"`stylerf {self.run.arguments[0]}` is still running; stop it, or wait for its end")
            if arguments not in self.commands[-1:]:
                self.commands.append(arguments)

            def end(run: Run) -> None:
                self._changed()
                ended(run)

            self.run = Run(arguments, self._common, lambda run: self._changed(), end)
            self._changed()
            return self.run

    def stop(self) -> None:
        """Interrupt the run; the same command resumes it."""
        if self.run is not None:
            self.run.stop()

    def close(self) -> None:
        """Interrupt the run and wait for its checkpoint; end what is computed in the background."""
        self._closing.set()
        if self._preparing is not None:
            self._preparing.join(ENDING_SECONDS)
        if self.run is not None and self.run.code is None:
            self.run.stop()
            self.run.wait()

    def script(self) -> str:
        """Return the session's commands as a shell script."""
        return script_of(self.commands)


def _given(name: str, kind: str) -> str:
    if not name:
        raise UsageError(f"there is no {kind} yet: make one first")
    return name
