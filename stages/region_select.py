"""Select a region of the scene: from pixels, masks, boxes or colors, grown over the density (LAENeRF, 3.2)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from schemas.canonical_json import digest_of, file_sha256
from schemas.errors import BadInput
from schemas.images import coverage, read_image, to_uint8, write_png
from schemas.work_folder import Artifact, PartialArtifact
from stages.artifacts.field import load_field
from stages.artifacts.photos import level_of, load_pictures, photo_for, photo_over
from stages.artifacts.region import load_region, save_region
from stages.artifacts.scene import SceneData, view_index
from stages.configs.select import SelectConfig
from stages.configs.view_syntax import depth_of, file_of, pixel_of
from stages.run.progress import Context
from stages.run.runner import Spec
from stylerf.editing.edit_grid import (
    FEWEST_CELLS,
    MOST_CELLS,
    Region,
    cells_of_points,
    grow,
    march_view,
    marked_at,
    solid_cells,
)
from stylerf.editing.extraction import ends_of_view
from stylerf.editing.selection import (
    Look,
    SeenCells,
    claimed,
    ends_of_rays,
    filled,
    halved_lightness,
    inside_box,
    inside_sphere,
    modes,
    padded,
    shell,
    shown_by_masks,
)
from stylerf.fields.packed_surface import cells_of
from stylerf.fields.radiance_field import RadianceField
from stylerf.kernels.cpu.compiling import compiling_note, set_threads
from stylerf.rendering.rays import alpha_inside

SPEC = Spec(
    stage="region_select", verb="select", revision=3, writes="region",
    outside=lambda config: {"files_digest": digest_of_masks(config)},
)  # fmt: skip
LOOKING_VIEWS = 24  # number of views whose photos give the cells their colors
PIXELS_A_CELL = 1.5
CLAIMS = 2  # rounds in which views add what belongs to the region as much as what has grown
TINT = np.array([1.0, 0.1, 0.8], np.float32)  # of the region, in previews
AROUND = np.array([0.1, 0.9, 1.0], np.float32)  # of the transition, in previews


@dataclass
class Sight:
    """What a selection works on."""

    scene: SceneData
    field: RadianceField
    level: float
    fixed_cells: int
    threads: int
    say: Callable[[str], None]

    @cached_property
    def cells(self) -> int:
        """Return the cells per side: as given, or of PIXELS_A_CELL pixels each."""
        if self.fixed_cells:
            return self.fixed_cells
        some = self.looks[:: max(1, len(self.looks) // 3)]
        wide = float(np.median([cells_of(look.surface) * look.stride for look in some]))
        wide = wide if np.isfinite(wide) else FEWEST_CELLS
        return int(np.clip(round(wide / PIXELS_A_CELL / 16) * 16, FEWEST_CELLS, MOST_CELLS))

    @cached_property
    def looks(self) -> list[Look]:
        """A sample of the training views."""
        return [self.look(view) for view in self.looking_views]

    @property
    def looking_views(self) -> list[int]:
        """The indices of that sample."""
        train = self.scene.splits["train"]
        return [train[i] for i in np.unique(np.linspace(0, len(train) - 1, LOOKING_VIEWS).round().astype(int))]

    def look(self, view: int) -> Look:
        """One of the looks."""
        photo = photo_for(self.field, self.scene, view, self.level, self.threads)
        return Look.at(self.field, self.scene.cameras[view], photo, self.threads)

    @cached_property
    def seen(self) -> SeenCells:
        """The cells that they see."""
        return SeenCells(self.looks, self.cells)

    def mask(self, text: str) -> tuple[int, np.ndarray]:
        """View and mask [h, w] in 0..1 of VIEW=MASK.png."""
        name, path = file_of(text)
        view, pixels = view_index(self.scene, name, text), read_image(path).pixels
        camera = self.scene.cameras[view]
        if pixels.shape[:2] != (camera.height, camera.width):
            raise BadInput(
                f"{path} has {pixels.shape[1]}x{pixels.shape[0]} pixels, but view {name} has "
                f"{camera.width}x{camera.height}; give a mask of that size"
            )
        return view, coverage(pixels)


def masks_of(config: SelectConfig) -> list[tuple[str, str, Path]]:
    """Option, view and file of its scribbles and masks; BadInput if one is missing."""
    files = [(option, *file_of(text)) for option in ("scribble", "mask") for text in getattr(config, option)]
    if missing := [path for *_, path in files if not path.is_file()]:
        raise BadInput(f"{missing[0]}: mask not found")
    return files


def digest_of_masks(config: SelectConfig) -> str:
    """Return the digest of the scribbles and masks with their views, empty without any."""
    files = masks_of(config)
    return digest_of([[*one, file_sha256(path)] for *one, path in files]) if files else ""


def run(inputs: dict[str, Artifact], config: SelectConfig, partial: PartialArtifact, context: Context) -> dict:
    """Write the region and previews of it over the photos; return the figures."""
    threads = set_threads(context.threads)
    scene = load_pictures(inputs["scene"], inputs["field"], threads)
    field, background = load_field(inputs["field"])
    others = {role: load_region(artifact) for role, artifact in inputs.items() if role.partition(".")[2]}
    with compiling_note(context.progress.say):
        cells = cells_given(config, others)
        sight = Sight(scene, field, level_of(background), cells, threads, context.progress.say)
        solid = solid_cells(field, sight.cells, threads, config.solid)
        if not solid.any():
            raise BadInput(f"{inputs['field'].path}: nothing in the field is solid; lower --solid")
        edit = marked_cells(sight, solid, config)
        edit = combined_cells(edit, others, field, inputs)
        share = float((edit & solid).sum() / solid.sum())
        _check(edit, solid, share, config)
        region = Region(edit, _around(sight, edit, solid, config))
        totals = {"solid_share": round(share, 5), "edit_cells": int((edit & solid).sum())}
        seen_in = _previews(sight, region, config, partial.path)
    save_region(partial.path, region, field.space, totals)
    return {**totals, "cells": sight.cells, "grow_cells": int(region.grow.sum()), "previews": seen_in}


def _around(sight: Sight, edit: np.ndarray, solid: np.ndarray, config: SelectConfig) -> np.ndarray:
    """G: what views see of the scene around the region, without what is behind its surface."""
    near = shell(edit, config.transition, solid)
    return near & sight.seen.seen if near.any() else near


def cells_given(config: SelectConfig, others: dict) -> int:
    """Cells per side, as given or as in regions to combine with; 0: by pixel size."""
    sizes = {role.partition(".")[2]: region.cells for role, (region, _) in others.items()}
    if len(set(sizes.values())) > 1:
        listed = ", ".join(f"{name} {cells}" for name, cells in sizes.items())
        raise BadInput(f"regions with different --cells cannot be combined ({listed}); select one of them again")
    for cells in sizes.values():
        if config.cells not in (0, cells):
            raise BadInput(f"--cells {config.cells}: a region to combine with has {cells}; leave it out")
    return next(iter(sizes.values()), config.cells)


def marked_cells(sight: Sight, solid: np.ndarray, config: SelectConfig) -> np.ndarray:
    """What is marked and what grows from it, before combining with other regions."""
    edit = np.zeros_like(solid)
    space, cells = sight.field.space, sight.cells
    if config.box:
        edit |= inside_box(space, cells, np.array(config.box[:3]), np.array(config.box[3:]))
    if config.sphere:
        edit |= inside_sphere(space, cells, np.array(config.sphere[:3]), config.sphere[3])
    if config.mask:
        views, masks = zip(*(sight.mask(text) for text in config.mask), strict=True)
        cameras = [sight.scene.cameras[view] for view in views]
        shown = shown_by_masks(sight.field, cameras, list(masks), cells, sight.threads)
        edit |= padded(shown, np.zeros_like(shown))
    if config.depth:
        edit |= _between_depths(sight, config.depth)
    seeds = _seeds(sight, config.at, config.scribble)
    if config.color or len(seeds.points):
        seen = sight.seen
        if config.color:
            wanted = np.array([[int(config.color[i : i + 2], 16) / 255 for i in (1, 3, 5)]])
            alike = seen.like(halved_lightness(wanted), config.tolerance)
            edit |= padded(alike & solid, seen.seen & ~alike)
        if len(seeds.points):
            edit |= _grown(sight, solid, seen, seeds, config)
    return edit


@dataclass(frozen=True, eq=False)
class Seeds:
    """Points [n, 3] in the cube, and the views and row-major pixels [n] that show them."""

    points: np.ndarray
    views: np.ndarray
    pixels: np.ndarray

    def marked(self, cells: int) -> np.ndarray:
        """[cells, cells, cells] bool: their cells."""
        return marked_at(self.points, cells)

    def lab(self, sight: Sight) -> np.ndarray:
        """Colors [m, 3] of their cells in SeenCells; of the pixels, for cells that no view sees."""
        seen = sight.seen
        unknown = ~seen.known[tuple(cells_of_points(self.points, sight.cells).T)]
        found = [seen.lab[self.marked(sight.cells) & seen.known]]
        for view in np.unique(self.views[unknown]):
            photo = photo_over(sight.scene, view, sight.level).reshape(-1, 3)
            found.append(halved_lightness(photo[self.pixels[unknown & (self.views == view)]]))
        return np.concatenate(found)


def _seeds(sight: Sight, at: tuple[str, ...], scribbles: tuple[str, ...]) -> Seeds:
    """Return where the seeds' rays end; BadInput for a pixel or scribble that hits nothing."""
    found = [(np.empty((0, 3), np.float32), np.empty(0, np.int64), np.empty(0, np.int64))]

    def meet(view: int, pixels: np.ndarray) -> float:
        """Add what the pixels hit; return the fraction that hits anything."""
        x, alpha = ends_of_rays(sight.field, sight.scene.cameras[view], pixels, sight.threads)
        met = alpha > 0.5
        found.append((x[met], np.full(met.sum(), view), pixels[met]))
        return float(met.mean())

    for text in at:
        name, x, y = pixel_of(text)
        view = view_index(sight.scene, name, text)
        camera = sight.scene.cameras[view]
        if not (0 <= x < camera.width and 0 <= y < camera.height):
            raise BadInput(f"{text}: view {name} has {camera.width}x{camera.height} pixels")
        if not meet(view, np.array([int(y) * camera.width + int(x)])):
            raise BadInput(f"{text} hits nothing in the field: choose a pixel where the render shows the object")
    for text in scribbles:
        view, mask = sight.mask(text)
        bright = np.flatnonzero(mask.ravel() > 0.5)
        if not len(bright):
            raise BadInput(f"{text}: no pixel of the scribble is brighter than half")
        share = meet(view, bright)
        if not share:
            raise BadInput(f"{text}: the scribble hits nothing in the field: draw it over the object")
        if share < 1:
            sight.say(f"{text}: {1 - share:.0%} of the scribble hits nothing in the field and is ignored")
    return Seeds(*(np.concatenate(parts) for parts in zip(*found)))


def _grown(sight: Sight, solid, seen: SeenCells, seeds: Seeds, config: SelectConfig) -> np.ndarray:
    """Grown from seeds over solid cells of the seeds' colors, with a margin of one cell."""
    start, allowed = seeds.marked(sight.cells), solid
    refused = np.zeros_like(solid)
    if config.tolerance > 0:
        colors = modes(seeds.lab(sight), config.tolerance / 2)
        alike = seen.like(colors, config.tolerance)
        if config.avoid:
            avoided = _seeds(sight, config.avoid, ())
            alike &= ~seen.nearer(modes(avoided.lab(sight), 1.0), colors)
        allowed, refused = solid & alike, seen.seen & ~alike
    if config.reach > 0:
        allowed = allowed & cells_within(sight, seeds.points, config.reach, allowed)
    found = filled(grow(start, allowed, config.steps * config.iterations, config.neck).grown, config.fill, solid)
    found = padded(found, refused & ~found) | start
    for _ in range(CLAIMS):
        found = claimed(sight.looks, found, sight.threads)
    return found


def cells_within(sight: Sight, points: np.ndarray, reach: float, among: np.ndarray) -> np.ndarray:
    """The cells of `among` whose centers lie within `reach`, scene units, of any of the cube points [n, 3]."""
    where = np.argwhere(among)
    unwarp, out = sight.field.space.unwarp, np.zeros_like(among)
    ends = unwarp(np.clip(points, 1e-6, 1 - 1e-6))
    away, _ = cKDTree(ends).query(unwarp((where + 0.5) / sight.cells), distance_upper_bound=reach)
    out[tuple(where[away <= reach].T)] = True
    return out


def _between_depths(sight: Sight, text: str) -> np.ndarray:
    name, near, far = depth_of(text)
    view = view_index(sight.scene, name, f"--depth {text}")
    camera = sight.scene.cameras[view]
    ends = ends_of_view(sight.field, camera, [np.ones((1, 1, 1), bool)], sight.threads)[0]
    x, alpha = ends[:, 3:], ends[:, 0]
    world = sight.field.space.unwarp(np.clip(x, 1e-6, 1 - 1e-6))
    z = (world - camera.world_from_camera[:3, 3]) @ camera.world_from_camera[:3, 2]
    chosen = (alpha > 0.5) & (z >= near) & (z <= far)
    if not chosen.any():
        spread = f"{z[alpha > 0.5].min():.3g} to {z[alpha > 0.5].max():.3g}" if (alpha > 0.5).any() else "nothing"
        raise BadInput(f"--depth {text}: no surface there in view {name}; depths span {spread}")
    found = marked_at(x[chosen], sight.cells)
    return padded(found, np.zeros_like(found))


def combined_cells(edit: np.ndarray, others: dict, field: RadianceField, inputs: dict[str, Artifact]) -> np.ndarray:
    """Union, intersect and subtract other regions, in this order."""
    for role, (_, space) in others.items():
        if space != field.space:
            raise BadInput(f"region {inputs[role].name} was selected on a different field; select it again on this one")
    for kind, act in (
        ("union", lambda a, b: a | b),
        ("intersect", lambda a, b: a & b),
        ("subtract", lambda a, b: a & ~b),
    ):
        for role in sorted(others):
            if role.startswith(f"{kind}."):
                edit = act(edit, others[role][0].edit)
    return edit


def _check(edit: np.ndarray, solid: np.ndarray, share: float, config: SelectConfig) -> None:
    if not (edit & solid).any():
        raise BadInput("the selection is empty: the seeds, masks or box contain no solid part of the field")
    if share > config.most:
        raise BadInput(
            f"the region has grown over {share:.0%} of everything solid (limit --most {config.most:g}): lower "
            "--tolerance or --iterations, set --reach, or mark what does not belong to it with --avoid VIEW:X,Y"
        )


def _previews(sight: Sight, region: Region, config: SelectConfig, folder: Path) -> list[str]:
    """Write images of the region over the photos, preview/NAME.png; return the names of their views."""
    named = [pixel_of(t)[0] for t in config.at] + [file_of(t)[0] for t in (*config.scribble, *config.mask)]
    views = [view_index(sight.scene, name, f"--preview {name}") for name in (config.preview or named)]
    every = sight.scene.splits["train"] + sight.scene.splits["test"]
    if not config.preview:
        views += [every[len(every) // 3], every[2 * len(every) // 3]]
    names = []
    for view in dict.fromkeys(views):
        camera = sight.scene.cameras[view]
        alpha = np.zeros((camera.height * camera.width, 2), np.float32)
        for part, samples in march_view(sight.field, camera, sight.threads):
            alpha[part, 0] = region.alpha(samples, sight.threads)
            alpha[part, 1] = alpha_inside(region.grow, samples, sight.threads)
        shown = alpha.reshape(camera.height, camera.width, 2)
        photo = photo_over(sight.scene, view, sight.level)
        tinted = photo * (1 - 0.55 * shown[..., :1]) + 0.55 * shown[..., :1] * TINT
        tinted = tinted * (1 - 0.35 * shown[..., 1:]) + 0.35 * shown[..., 1:] * AROUND
        write_png(folder / "preview" / f"{camera.name}.png", to_uint8(np.clip(tinted, 0, 1)))
        names.append(camera.name)
    return names
