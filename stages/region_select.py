"""Select: a part of the scene in 3D, from pixels, masks, boxes or colors, grown over the density (LAENeRF, 3.2)."""

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
from stages.artifacts.photos import level_of, photo_for, photo_over
from stages.artifacts.region import load_region, save_region
from stages.artifacts.scene import SceneData, view_index
from stages.artifacts.view_images import load_pictures
from stages.configs.select import SelectConfig
from stages.configs.views import depth_of, file_of, pixel_of
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
    halved_light,
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
from stylerf.rendering.region_alpha import alpha_inside

SPEC = Spec(
    stage="region_select", verb="select", revision=3, writes="region",
    outside=lambda config: {"files_digest": digest_of_masks(config)},
)  # fmt: skip
LOOKING_VIEWS = 24  # views whose photos give the cells their colors
PIXELS_A_CELL = 1.5
CLAIMS = 2  # rounds in which views claim what is as much the region as what has grown
TINT = np.array([1.0, 0.1, 0.8], np.float32)  # of the region, in previews
AROUND = np.array([0.1, 0.9, 1.0], np.float32)  # of what takes part in the transition


@dataclass
class Looking:
    """What the parts of a selection look at."""

    scene: SceneData
    field: RadianceField
    level: float
    asked_cells: int
    chunks: int
    say: Callable[[str], None]

    @cached_property
    def cells(self) -> int:
        """Cells a side: as asked for, or PIXELS_A_CELL of what a pixel sees."""
        if self.asked_cells:
            return self.asked_cells
        some = self.looks[:: max(1, len(self.looks) // 3)]
        wide = float(np.median([cells_of(look.surface) * look.stride for look in some]))
        wide = wide if np.isfinite(wide) else FEWEST_CELLS
        return int(np.clip(round(wide / PIXELS_A_CELL / 16) * 16, FEWEST_CELLS, MOST_CELLS))

    @cached_property
    def looks(self) -> list[Look]:
        """Some of the training views."""
        train = self.scene.splits["train"]
        chosen = [train[i] for i in np.unique(np.linspace(0, len(train) - 1, LOOKING_VIEWS).round().astype(int))]
        photos = ((i, photo_for(self.field, self.scene, i, self.level, self.chunks)) for i in chosen)
        return [Look.at(self.field, self.scene.cameras[i], photo, self.chunks) for i, photo in photos]

    @cached_property
    def seen(self) -> SeenCells:
        """What they see in the cells."""
        return SeenCells(self.looks, self.cells)

    def mask(self, text: str) -> tuple[int, np.ndarray]:
        """View and mask [h, w] in 0..1 of VIEW=MASK.png."""
        name, path = file_of(text)
        view, pixels = view_index(self.scene, name, text), read_image(path).pixels
        camera = self.scene.cameras[view]
        if pixels.shape[:2] != (camera.height, camera.width):
            raise BadInput(
                f"{path} has {pixels.shape[1]}x{pixels.shape[0]} pixels where view {name} has "
                f"{camera.width}x{camera.height}; give a mask of that size"
            )
        return view, coverage(pixels)


def masks_of(config: SelectConfig) -> list[tuple[str, str, Path]]:
    """Option, view and file of its scribbles and masks; BadInput where one is not there."""
    files = [(option, *file_of(text)) for option in ("scribble", "mask") for text in getattr(config, option)]
    if missing := [path for *_, path in files if not path.is_file()]:
        raise BadInput(f"{missing[0]}: there is no such mask")
    return files


def digest_of_masks(config: SelectConfig) -> str:
    """Of the scribbles and masks with their views, empty without any."""
    files = masks_of(config)
    return digest_of([[*one, file_sha256(path)] for *one, path in files]) if files else ""


def run(inputs: dict[str, Artifact], config: SelectConfig, partial: PartialArtifact, context: Context) -> dict:
    """Writes the region and previews of it over the photos; returns the figures."""
    chunks = set_threads(context.threads)
    scene = load_pictures(inputs["scene"], inputs["field"], chunks)
    field, background = load_field(inputs["field"])
    others = {role: load_region(artifact) for role, artifact in inputs.items() if role.partition(".")[2]}
    with compiling_note(context.progress.say):
        cells = _asked_cells(config, others)
        looking = Looking(scene, field, level_of(background), cells, chunks, context.progress.say)
        solid = solid_cells(field, looking.cells, chunks, config.solid)
        if not solid.any():
            raise BadInput(f"{inputs['field'].path}: nothing in the field is solid; give a smaller --solid")
        edit = _marked(looking, solid, config)
        edit = _combined(edit, others, field, inputs)
        share = float((edit & solid).sum() / solid.sum())
        _check(edit, solid, share, config)
        region = Region(edit, _around(looking, edit, solid, config))
        told = {"solid_share": round(share, 5), "edit_cells": int((edit & solid).sum())}
        seen_in = _previews(looking, region, config, partial.path)
    save_region(partial.path, region, field.space, told)
    return {**told, "cells": looking.cells, "grow_cells": int(region.grow.sum()), "previews": seen_in}


def _around(looking: Looking, edit: np.ndarray, solid: np.ndarray, config: SelectConfig) -> np.ndarray:
    """G: what views see of the scene beside the region; what lies behind its surface is no neighbor of its look."""
    near = shell(edit, config.transition, solid)
    return near & looking.seen.seen if near.any() else near


def _asked_cells(config: SelectConfig, others: dict) -> int:
    """Cells a side as asked for, or as regions to combine with have them; 0: by what a pixel sees."""
    sizes = {role.partition(".")[2]: region.cells for role, (region, _) in others.items()}
    if len(set(sizes.values())) > 1:
        told = ", ".join(f"{name} {cells}" for name, cells in sizes.items())
        raise BadInput(f"regions of different numbers of cells a side cannot be combined ({told}); select one anew")
    for cells in sizes.values():
        if config.cells not in (0, cells):
            raise BadInput(f"--cells {config.cells}: a region to combine with has {cells}; leave it out")
    return next(iter(sizes.values()), config.cells)


def _marked(looking: Looking, solid: np.ndarray, config: SelectConfig) -> np.ndarray:
    """What the config marks and what grows from it, before other regions are joined or taken away."""
    edit = np.zeros_like(solid)
    space, cells = looking.field.space, looking.cells
    if config.box:
        edit |= inside_box(space, cells, np.array(config.box[:3]), np.array(config.box[3:]))
    if config.sphere:
        edit |= inside_sphere(space, cells, np.array(config.sphere[:3]), config.sphere[3])
    if config.mask:
        views, masks = zip(*(looking.mask(text) for text in config.mask), strict=True)
        cameras = [looking.scene.cameras[view] for view in views]
        shown = shown_by_masks(looking.field, cameras, list(masks), cells, looking.chunks)
        edit |= padded(shown, np.zeros_like(shown))
    if config.depth:
        edit |= _between_depths(looking, config.depth)
    seeds = _seeds(looking, config.at, config.scribble)
    if config.color or len(seeds.points):
        seen = looking.seen
        if config.color:
            wanted = np.array([[int(config.color[i : i + 2], 16) / 255 for i in (1, 3, 5)]])
            alike = seen.like(halved_light(wanted), config.tolerance)
            edit |= padded(alike & solid, seen.seen & ~alike)
        if len(seeds.points):
            edit |= _grown(looking, solid, seen, seeds, config)
    return edit


@dataclass(frozen=True, eq=False)
class Seeds:
    """n places of a scene: points [n, 3] in the cube, which row-major pixels [n] of which views [n] show."""

    points: np.ndarray
    views: np.ndarray
    pixels: np.ndarray

    def marked(self, cells: int) -> np.ndarray:
        """[cells, cells, cells] bool: their cells."""
        return marked_at(self.points, cells)

    def lab(self, looking: Looking) -> np.ndarray:
        """[m, 3] colors of their cells, as SeenCells has them; where no look has seen a cell, those of the pixels."""
        seen = looking.seen
        unknown = ~seen.known[tuple(cells_of_points(self.points, looking.cells).T)]
        found = [seen.lab[self.marked(looking.cells) & seen.known]]
        for view in np.unique(self.views[unknown]):
            photo = photo_over(looking.scene, view, looking.level).reshape(-1, 3)
            found.append(halved_light(photo[self.pixels[unknown & (self.views == view)]]))
        return np.concatenate(found)


def _seeds(looking: Looking, at: tuple[str, ...], scribbles: tuple[str, ...]) -> Seeds:
    """Where the rays of the seeds end; BadInput for a pixel, or a scribble, that meets nothing."""
    found = [(np.empty((0, 3), np.float32), np.empty(0, np.int64), np.empty(0, np.int64))]

    def meet(view: int, pixels: np.ndarray) -> float:
        """Takes what the pixels meet; the share of them that meets anything."""
        x, alpha = ends_of_rays(looking.field, looking.scene.cameras[view], pixels, looking.chunks)
        met = alpha > 0.5
        found.append((x[met], np.full(met.sum(), view), pixels[met]))
        return float(met.mean())

    for text in at:
        name, x, y = pixel_of(text)
        view = view_index(looking.scene, name, text)
        camera = looking.scene.cameras[view]
        if not (0 <= x < camera.width and 0 <= y < camera.height):
            raise BadInput(f"{text}: view {name} has {camera.width}x{camera.height} pixels")
        if not meet(view, np.array([int(y) * camera.width + int(x)])):
            raise BadInput(f"{text} meets nothing of the field: choose a pixel where the render shows the object")
    for text in scribbles:
        view, mask = looking.mask(text)
        bright = np.flatnonzero(mask.ravel() > 0.5)
        if not len(bright):
            raise BadInput(f"{text}: no pixel of the scribble is brighter than half")
        share = meet(view, bright)
        if not share:
            raise BadInput(f"{text}: no pixel of the scribble meets anything of the field: draw it over the object")
        if share < 1:
            looking.say(f"{text}: {1 - share:.0%} of the scribble meets nothing of the field and is left out")
    return Seeds(*(np.concatenate(parts) for parts in zip(*found)))


def _grown(looking: Looking, solid, seen: SeenCells, seeds: Seeds, config: SelectConfig) -> np.ndarray:
    """Grown from seeds over solid cells of the seeds' colors, with a margin of one cell."""
    start, allowed = seeds.marked(looking.cells), solid
    refused = np.zeros_like(solid)
    if config.tolerance > 0:
        colors = modes(seeds.lab(looking), config.tolerance / 2)
        alike = seen.like(colors, config.tolerance)
        if config.avoid:
            avoided = _seeds(looking, config.avoid, ())
            alike &= ~seen.nearer(modes(avoided.lab(looking), 1.0), colors)
        allowed, refused = solid & alike, seen.seen & ~alike
    if config.reach > 0:
        allowed = allowed & _within(looking, seeds.points, config.reach, allowed)
    found = filled(grow(start, allowed, config.steps * config.iterations, config.neck).grown, config.fill, solid)
    found = padded(found, refused & ~found) | start
    for _ in range(CLAIMS):
        found = claimed(looking.looks, found, looking.chunks)
    return found


def _within(looking: Looking, points: np.ndarray, reach: float, among: np.ndarray) -> np.ndarray:
    """The cells of `among` whose centers lie within `reach`, scene units, of any of the cube points [n, 3]."""
    where = np.argwhere(among)
    unwarp, out = looking.field.space.unwarp, np.zeros_like(among)
    ends = unwarp(np.clip(points, 1e-6, 1 - 1e-6))
    away, _ = cKDTree(ends).query(unwarp((where + 0.5) / looking.cells), distance_upper_bound=reach)
    out[tuple(where[away <= reach].T)] = True
    return out


def _between_depths(looking: Looking, text: str) -> np.ndarray:
    name, near, far = depth_of(text)
    view = view_index(looking.scene, name, f"--depth {text}")
    camera = looking.scene.cameras[view]
    ends = ends_of_view(looking.field, camera, [np.ones((1, 1, 1), bool)], looking.chunks)[0]
    x, alpha = ends[:, 3:], ends[:, 0]
    world = looking.field.space.unwarp(np.clip(x, 1e-6, 1 - 1e-6))
    z = (world - camera.world_from_camera[:3, 3]) @ camera.world_from_camera[:3, 2]
    chosen = (alpha > 0.5) & (z >= near) & (z <= far)
    if not chosen.any():
        spread = f"{z[alpha > 0.5].min():.3g} to {z[alpha > 0.5].max():.3g}" if (alpha > 0.5).any() else "nothing"
        raise BadInput(f"--depth {text}: view {name} sees nothing there; what it sees lies at {spread}")
    found = marked_at(x[chosen], looking.cells)
    return padded(found, np.zeros_like(found))


def _combined(edit: np.ndarray, others: dict, field: RadianceField, inputs: dict[str, Artifact]) -> np.ndarray:
    """Joined with, cut to and without other regions, in this order."""
    for role, (_, space) in others.items():
        if space != field.space:
            raise BadInput(f"region {inputs[role].name} divides the space of another field; select it anew on this one")
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
        raise BadInput("the selection holds nothing of the scene: seeds, masks or box meet no solid part of the field")
    if share > config.most:
        raise BadInput(
            f"the region has grown over {share:.0%} of all that is solid (limit --most {config.most:g}): lower "
            "--tolerance or --iterations, set --reach, or mark what does not belong to it with --avoid VIEW:X,Y"
        )


def _previews(looking: Looking, region: Region, config: SelectConfig, folder: Path) -> list[str]:
    """Pictures of the region over the photos, preview/NAME.png; the names of their views."""
    named = [pixel_of(t)[0] for t in config.at] + [file_of(t)[0] for t in (*config.scribble, *config.mask)]
    views = [view_index(looking.scene, name, f"--preview {name}") for name in (config.preview or named)]
    every = looking.scene.splits["train"] + looking.scene.splits["test"]
    if not config.preview:
        views += [every[len(every) // 3], every[2 * len(every) // 3]]
    names = []
    for view in dict.fromkeys(views):
        camera = looking.scene.cameras[view]
        alpha = np.zeros((camera.height * camera.width, 2), np.float32)
        for part, samples in march_view(looking.field, camera, looking.chunks):
            alpha[part, 0] = region.alpha(samples, looking.chunks)
            alpha[part, 1] = alpha_inside(region.grow, samples, looking.chunks)
        shown = alpha.reshape(camera.height, camera.width, 2)
        photo = photo_over(looking.scene, view, looking.level)
        tinted = photo * (1 - 0.55 * shown[..., :1]) + 0.55 * shown[..., :1] * TINT
        tinted = tinted * (1 - 0.35 * shown[..., 1:]) + 0.35 * shown[..., 1:] * AROUND
        write_png(folder / "preview" / f"{camera.name}.png", to_uint8(np.clip(tinted, 0, 1)))
        names.append(camera.name)
    return names
