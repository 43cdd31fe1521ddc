"""Reads and writes the data that a local edit is learned from (edit-dataset) and the learned edit itself (edit)."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from schemas.atomic_write import write_json
from schemas.errors import ArtifactDamaged
from schemas.images import to_uint8, write_png
from schemas.json_numbers import LARGEST_PICTURE, LARGEST_SIDE
from schemas.safe_reading import sound
from schemas.tensors import save_tensors
from schemas.work_folder import Artifact
from stages.configs.edit import PaletteConfig, color_of, number_of
from stylerf import validation
from stylerf.editing.extraction import EditView, check_pixels
from stylerf.editing.palette_module import PaletteModule
from stylerf.errors import InvalidValue
from stylerf.fields.palette_edits import PaletteEdits, tinted

DESCRIPTION, NUMBERS, PALETTE, SWATCH = "edit.json", "edit.safetensors", "palette.json", "palette.png"
OF_WEIGHTS = ("sparsity", "palette_variation")  # keys of palette.json about the weights, besides their shares
SWATCH_SIDE = 64


@dataclass(frozen=True, eq=False)
class Edit:
    """A palette module and the user's changes of its palette."""

    module: PaletteModule
    changes: PaletteEdits


def save_edit(folder: Path, edit: Edit, shares: list[float], details: dict) -> None:
    """shares: of the palette's colors in the region. details: further keys of palette.json, such as sparsity.

    Whoever reads the palette counts its colors by their shares, the largest first; `column` is the module's own count.
    """
    save_tensors(folder / NUMBERS, edit.module.arrays())
    write_json(folder / DESCRIPTION, {"module": edit.module.describe(), "changes": edit.changes.describe()})
    learned = edit.module.palette
    save_palette(folder, learned, edit.changes.palette(learned), shares, details)


def save_palette(folder: Path, learned: np.ndarray, now: np.ndarray, shares: list[float], details: dict) -> None:
    """palette.json and palette.png of palettes [A, 3] as learned and as they are now."""
    order = [int(column) for column in np.argsort(-np.asarray(shares), kind="stable")]
    entries = [
        {
            "index": index,
            "name": color_name(learned[column]),
            "learned": _hex(learned[column]),
            "now": _hex(now[column]),
            "share": round(shares[column], 4),
            "column": column,
        }
        for index, column in enumerate(order)
    ]
    write_json(folder / PALETTE, {"colors": entries, **details})
    write_png(folder / SWATCH, swatch(learned[order], now[order], [shares[column] for column in order]))


def load_edit(artifact: Artifact) -> Edit:
    """Return the edit; ArtifactDamaged if its files are not a valid one."""
    artifact.check_sizes()
    arrays, _ = artifact.tensors(NUMBERS)
    data = artifact.json(DESCRIPTION)
    with sound(artifact.path, "a sound edit"):
        module = PaletteModule.restore(validation.entry(data, "module"), arrays)
        changes = PaletteEdits.restore(validation.entry(data, "changes"))
        changes.check(len(module.palette))
        return Edit(module, changes)


def palette_entries(artifact: Artifact) -> list[dict]:
    """The colors of palette.json: index, name, learned and now as text, share, and column, the module's number."""
    data = artifact.json(PALETTE)
    with sound(artifact.path / PALETTE, "a valid palette"):
        entries = validation.entry(data, "colors", list)
        for number, one in enumerate(entries):
            validation.integer(one, "index", number, number)
            validation.number(one, "share", 0, 1)
            for key in ("name", "learned", "now"):
                validation.entry(one, key, str)
        if sorted(validation.integer(one, "column", 0, len(entries)) for one in entries) != [*range(len(entries))]:
            raise InvalidValue(f"its columns must be 0 to {len(entries) - 1}, each exactly once")
        return entries


def columns_and_shares(artifact: Artifact, colors: int) -> tuple[list[int], list[float]]:
    """(the module's number of each color as palette.json counts them, shares by the module's numbers).

    colors: that the module has.
    """
    entries = palette_entries(artifact)
    if len(entries) != colors:
        raise ArtifactDamaged(
            f"{artifact.path / PALETTE} has {len(entries)} colors, but {colors} were learned; rebuild it"
        )
    columns = [entry["column"] for entry in entries]
    shares = {entry["column"]: entry["share"] for entry in entries}
    return columns, [shares[column] for column in range(len(columns))]


def kept_details(artifact: Artifact, changes: PaletteEdits) -> dict:
    """Return what palette.json has besides colors that remains valid after a palette change that keeps the weights."""
    stored = artifact.json(PALETTE)
    kept = () if changes.scales or changes.biases else OF_WEIGHTS
    with sound(artifact.path / PALETTE, "a valid palette"):
        return {key: validation.number(stored, key) for key in kept if stored.get(key, "nan") != "nan"}  # of no pixel


def by_column(changes: PaletteEdits, columns: list[int]) -> PaletteEdits:
    """Convert changes from palette.json's color numbers to the module's."""
    return PaletteEdits(
        {columns[index]: color for index, color in changes.colors.items()},
        {columns[index]: scale for index, scale in changes.scales.items()},
        {columns[index]: bias for index, bias in changes.biases.items()},
    )


def changes_of(config: PaletteConfig, palette: np.ndarray, shares: np.ndarray) -> PaletteEdits:
    """Return the changes that a config requests; palette [A, 3] and shares [A] are in palette.json's order."""
    requested = dict(map(color_of, config.palette))
    colors = {index: color for index, color in requested.items() if index is not None}
    if None in requested:
        every = enumerate(tinted(palette, shares, requested[None]).tolist())
        colors = {index: tuple(color) for index, color in every} | colors
    return PaletteEdits(
        colors,
        dict(map(number_of, config.palette_weight)),
        dict(map(number_of, config.palette_bias)),
    )


def swatch(learned: np.ndarray, now: np.ndarray, shares: list[float]) -> np.ndarray:
    """[h, w, 3] uint8: a column for each color, as wide as its share; what was learned above, what it is now below."""
    widths = np.maximum(np.round(np.array(shares) / max(sum(shares), 1e-9) * 8 * SWATCH_SIDE).astype(int), 12)
    rows = [np.concatenate([np.tile(c, (SWATCH_SIDE, w, 1)) for c, w in zip(p, widths)], 1) for p in (learned, now)]
    return to_uint8(np.clip(np.concatenate(rows), 0, 1))


def _hex(color: np.ndarray) -> str:
    return "#" + "".join(f"{value:02x}" for value in to_uint8(np.clip(color, 0, 1)))


def color_name(color: np.ndarray) -> str:
    """Name an sRGB color [3] by lightness and hue, as 'dark blue'.

    The hue is that of HSV, because in CIELAB pure blue has a hue beyond violet.
    """
    from skimage.color import rgb2hsv, rgb2lab

    color = np.clip(color, 0, 1).reshape(1, 1, 3)
    light, a, b = rgb2lab(color)[0, 0]
    chroma = float(np.hypot(a, b))
    if light < 12:
        return "black"
    if chroma < 8:
        return "white" if light > 92 else "light gray" if light > 65 else "gray" if light > 35 else "dark gray"
    hues = ("red", "orange", "yellow", "green", "cyan", "blue", "violet", "pink", "red")
    begins = (0, 15, 45, 70, 165, 200, 250, 310, 345)  # degrees
    hue = 360 * float(rgb2hsv(color)[0, 0, 0])
    word = hues[int(np.searchsorted(begins, hue, side="right")) - 1]
    if word == "orange" and light < 50:
        word = "brown"
    elif word == "red" and light > 70:
        word = "pink"
    return f"{'dark ' if light < 35 else 'light ' if light > 78 else ''}{word}"


DATASET, DATASET_NUMBERS = "dataset.json", "dataset.safetensors"
ARRAYS = ("pixels", "x", "along", "directions", "target", "weight", "inside", "depth", "through", "transition", "edges")

WIDE = {"x": 3, "along": 3, "directions": 3, "target": 3, "edges": 2}  # numbers a pixel, where there are several


def save_edit_views(folder: Path, views: list[EditView], details: dict) -> None:
    """Write the views. details: further keys of dataset.json, such as the views that do not see the region."""
    arrays = {f"{v.view}.{name}": getattr(v, name) for v in views for name in ARRAYS}
    save_tensors(folder / DATASET_NUMBERS, arrays)
    listed = [{"view": v.view, "width": v.width, "height": v.height, "pixels": len(v)} for v in views]
    write_json(folder / DATASET, {**details, "views": listed})


def load_edit_views(artifact: Artifact) -> tuple[list[EditView], dict]:
    """Return the views and the contents of dataset.json; ArtifactDamaged if the two files do not match."""
    artifact.check_sizes()
    arrays, _ = artifact.tensors(DATASET_NUMBERS)
    data = artifact.json(DATASET)
    with sound(artifact.path, "a valid edit dataset"):
        views = [_view(item, arrays) for item in validation.entry(data, "views", list)]
        if not views or len({one.view for one in views}) < len(views):
            raise InvalidValue("it has no views or repeats one")
        return views, data


def _view(item: dict, arrays: dict[str, np.ndarray]) -> EditView:
    view = validation.integer(item, "view", 0, 10**9)
    width, height = (validation.integer(item, side, 1, LARGEST_SIDE) for side in ("width", "height"))
    if width * height > LARGEST_PICTURE:
        raise InvalidValue(f"view {view} has {width}x{height} pixels; at most {LARGEST_PICTURE} are supported")
    count = validation.integer(item, "pixels", 1, width * height)
    pixels = validation.array(arrays, f"{view}.pixels", np.int64, (count,))
    check_pixels(pixels, f"{view}.pixels", width, height)
    if not (np.diff(pixels) > 0).all():
        raise InvalidValue(f"the array {view}.pixels is not in ascending order")
    shapes = {name: (count, WIDE[name]) if name in WIDE else (count,) for name in ARRAYS[1:]}
    own = {name: validation.array(arrays, f"{view}.{name}", np.float32, shape) for name, shape in shapes.items()}
    if not (np.abs(np.linalg.norm(own["directions"].astype(np.float64), axis=1) - 1) < 1e-3).all():
        raise InvalidValue(f"the array {view}.directions contains a vector whose length is not 1")
    return EditView(view, width, height, pixels, **own)
