"""Select: a part of the scene in 3D, from pixels, masks, boxes or colours, grown over the density (LAENeRF, 3.2)."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from schemas.errors import BadInput
from schemas.images import coverage, read_image, to_uint8, write_png
from schemas.store import Artefact, Partial
from stages.configs.select import SelectConfig
from stages.configs.views import depth_of, file_of, pixel_of
from stages.fields import load_field
from stages.photos import level_of, photo_for, photo_over
from stages.progress import Context
from stages.regions import load_region, save_region
from stages.runner import Spec
from stages.scenes import SceneData, load_scene, view_index
from stylerf.editing.extraction import ends_of_view
from stylerf.editing.regions import (
    FEWEST_CELLS,
    MOST_CELLS,
    Region,
    alpha_inside,
    grow,
    march_view,
    marked_at,
    solid_cells,
)
from stylerf.editing.selection import (
    Look,
    SeenCells,
    centres_of,
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
from stylerf.fields.field import RadianceField
from stylerf.fields.surface import cells_of
from stylerf.kernels.cpu.compiling import compiling_note, set_threads

SPEC = Spec(stage="region_select", verb="select", revision=3, writes="region")
LOOKING_VIEWS = 24  # views whose photos give the cells their colours
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


def run(inputs: dict[str, Artefact], config: SelectConfig, partial: Partial, context: Context) -> dict:
    """Writes the region and previews of it over the photos; returns the figures."""
    scene = load_scene(inputs["scene"], inputs["field"])
    field, background = load_field(inputs["field"])
    chunks = set_threads(context.threads)
    others = {role: load_region(artefact) for role, artefact in inputs.items() if role.partition(".")[2]}
    with compiling_note(context.progress.say):
        looking = Looking(scene, field, level_of(background), _asked_cells(config, others), chunks)
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
    """G: what views see of the scene beside the region; what lies behind its surface is no neighbour of its look."""
    near = shell(edit, config.transition, solid)
    return near & looking.seen.seen if near.any() else near


def _asked_cells(config: SelectConfig, others: dict) -> int:
    """Cells a side as asked for, or as regions to combine with have them; 0: by what a pixel sees."""
    for region, _ in others.values():
        if config.cells and config.cells != region.cells:
            raise BadInput(f"--cells {config.cells}: a region to combine with has {region.cells}; leave it out")
        return region.cells
    return config.cells


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
    points = _seeds(looking, config.at, config.scribble)
    if config.colour or len(points):
        seen = looking.seen
        if config.colour:
            wanted = np.array([[int(config.colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]])
            alike = seen.like(halved_light(wanted), config.tolerance)
            edit |= padded(alike & solid, seen.seen & ~alike)
        if len(points):
            edit |= _grown(looking, solid, seen, points, config)
    return edit


def _seeds(looking: Looking, at: tuple[str, ...], scribbles: tuple[str, ...]) -> np.ndarray:
    """[n, 3] cube points where the rays of the seeds end; BadInput for a seed that meets nothing."""
    by_view: dict[int, list[int]] = {}
    for text in at:
        name, x, y = pixel_of(text)
        view = view_index(looking.scene, name, text)
        camera = looking.scene.cameras[view]
        if not (0 <= x < camera.width and 0 <= y < camera.height):
            raise BadInput(f"{text}: view {name} has {camera.width}x{camera.height} pixels")
        by_view.setdefault(view, []).append(int(y) * camera.width + int(x))
    for text in scribbles:
        view, mask = looking.mask(text)
        bright = np.flatnonzero(mask.ravel() > 0.5)
        if not len(bright):
            raise BadInput(f"{text}: no pixel of the scribble is brighter than half")
        by_view.setdefault(view, []).extend(bright.tolist())
    found = []
    for view, pixels in by_view.items():
        camera = looking.scene.cameras[view]
        x, alpha = ends_of_rays(looking.field, camera, np.array(pixels), looking.chunks)
        if not (alpha > 0.5).any():
            raise BadInput(
                f"the {len(pixels)} seed pixels in view {camera.name} meet nothing of the field: "
                "choose pixels where the render shows the object"
            )
        found.append(x[alpha > 0.5])
    return np.concatenate(found) if found else np.empty((0, 3))


def _grown(looking: Looking, solid, seen: SeenCells, points: np.ndarray, config: SelectConfig) -> np.ndarray:
    """Grown from seeds over solid cells of the seeds' colours, with a margin of one cell."""
    start, allowed = marked_at(points, looking.cells), solid
    refused = np.zeros_like(solid)
    if config.tolerance > 0:
        colours = modes(seen.lab[start], config.tolerance / 2)
        if len(colours):
            alike = seen.like(colours, config.tolerance)
            avoided = _seeds(looking, config.avoid, ())
            if len(avoided):
                alike &= ~seen.nearer(modes(seen.lab[marked_at(avoided, looking.cells)], 1.0), colours)
            allowed, refused = solid & alike, seen.seen & ~alike
    if config.reach > 0:
        ends = looking.field.space.unwarp(points)
        centres = looking.field.space.unwarp(centres_of(looking.cells))
        near = np.zeros(len(centres), bool)
        for end in ends[:: max(1, len(ends) // 16)]:
            near |= np.linalg.norm(centres - end, axis=1) <= config.reach
        allowed = allowed & near.reshape(allowed.shape)
    found = filled(grow(start, allowed, config.steps * config.iterations, config.neck).grown, config.fill, solid)
    found = padded(found, refused & ~found) | start
    for _ in range(CLAIMS):
        found = claimed(looking.looks, found, looking.chunks)
    return found


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


def _combined(edit: np.ndarray, others: dict, field: RadianceField, inputs: dict[str, Artefact]) -> np.ndarray:
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
