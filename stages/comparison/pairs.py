"""The page for blind comparison: pairs of pictures of one view, without any hint of how they were made.

The page's key, which records the author of each side, is kept next to it as pairs/ID.json. Votes refer to the page ID.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from schemas.atomic_write import sweeping, write_bytes, write_json
from schemas.canonical_json import digest_of
from schemas.errors import ArtifactStale
from schemas.work_folder import WorkFolder
from stages.comparison.contenders import Contender, contenders_of
from stages.comparison.runs import Gap, fields_of, runs_of
from stages.report.contact_sheet import Encoded, Picture, displayable, encoded_picture
from stages.report.pages import render_page

PAGE, KEYS = "pairs.html", "pairs"
# Of compared pictures: nearly lossless, without chroma subsampling, so that grain can be judged.
WIDTH, QUALITY = 1200, 95
SMALL_WIDTH, SMALL_QUALITY = 320, 85  # of photo and style image



@dataclass(frozen=True)
class Pair:
    """Two contenders in one view. left, right: places in the list of contenders."""

    left: int
    right: int
    view: int


def chosen_pairs(contenders: Sequence[Contender], most: int, seed: int) -> list[Pair]:
    """Choose at most `most` pairs in random order: every two of a group, then again in another view, sides swapped.

    So all of them are compared equally often, up to one view, and a preference for one side favors nobody.
    """
    generator = np.random.default_rng(seed)
    meetings = []
    for a, b in combinations(range(len(contenders)), 2):
        if contenders[a].run.group == contenders[b].run.group:
            views = sorted({*contenders[a].views} & {*contenders[b].views})
            first, second = (a, b) if generator.random() < 0.5 else (b, a)
            meetings.append((first, second, generator.permutation(views).tolist()))
    found: list[Pair] = []
    for turn in range(max((len(views) for *_, views in meetings), default=0)):
        for place in generator.permutation(len(meetings)).tolist():
            a, b, views = meetings[place]
            if turn < len(views) and len(found) < most:
                left, right = (b, a) if turn % 2 else (a, b)
                found.append(Pair(left, right, views[turn]))
    return [found[i] for i in generator.permutation(len(found)).tolist()]


def written_pairs(works: Sequence[WorkFolder], out: Path, named: Sequence[str], most: int, seed: int) -> dict[str, Any]:
    """Write pairs.html and its key to `out`; return the key, and as "missing" what could not be shown.

    Args:
        works: Work folders whose stylizations are compared.
        named: Fields to compare, by name; empty for all.
        most: Pairs at most.
        seed: For views, order and sides.

    Raises:
        ArtifactStale: No two stylizations share scene and style image, or their frames are missing.
    """
    runs, _ = runs_of(works)
    contenders, missing = contenders_of(runs, fields_of(works), named)
    pairs = chosen_pairs(contenders, most, seed)
    if not pairs:
        why = f": {missing[0].what}: {missing[0].why}" if missing else "; stylize the scene once more"
        raise ArtifactStale(f"no two stylizations in {works[0].root} share a scene and a style image{why}")
    album = Album(contenders)
    shown = [album.shown(pair) for pair in pairs]
    key = {
        "page": digest_of([seed, [pair | {"of": asdict(one)} for pair, one in zip(shown, pairs)], album.uris]),
        "seed": seed,
        "contenders": [
            {"label": one.label, "title": one.run.title, "group": one.run.group, "field": one.field.digest}
            for one in contenders
        ],
        "pairs": {str(number): asdict(pair) for number, pair in enumerate(pairs)},
    }
    page = render_page(
        "pairs.html",
        summary=f"{len(pairs)} pairs, about {max(1, round(len(pairs) / 6))} min. Nothing leaves this page until you "
        "save the votes.",
        data={"page": key["page"], "pairs": shown, "pictures": album.uris},
    )
    with sweeping((out, out / KEYS)):
        write_json(out / KEYS / f"{key['page']}.json", key)
        write_bytes(out / PAGE, page.encode())
    return key | {"missing": [asdict(gap) for gap in [*_unpaired(contenders, pairs), *missing]]}


class Album:
    """The pictures of a page as data URIs, each once."""

    def __init__(self, contenders: Sequence[Contender]) -> None:
        self.contenders = contenders
        self.uris: list[str] = []
        self._places: dict[tuple, int] = {}

    def shown(self, pair: Pair) -> dict[str, Any]:
        """Return the page's data for a pair: the indices of its pictures in `uris`, and the width to show them at."""
        left, right = self.contenders[pair.left], self.contenders[pair.right]
        first, second = left.picture(pair.view), right.picture(pair.view)
        height, width = first.shape[:2]
        photo = left.scene.photo(pair.view, width, height).image
        return {
            "left": self._place((pair.left, pair.view), first, WIDTH, QUALITY),
            "right": self._place((pair.right, pair.view), second, WIDTH, QUALITY),
            "photo": self._place(("photo", left.run.group, pair.view), photo, SMALL_WIDTH, SMALL_QUALITY),
            "style": self._place(("style", left.run.group), left.style_image(), SMALL_WIDTH, SMALL_QUALITY),
            "width": width,
            "height": height,
        }

    def _place(self, key: tuple, image: np.ndarray, width: int, quality: int) -> int:
        if key not in self._places:
            self._places[key] = len(self.uris)
            self.uris.append(_encoded(image, width, quality).uri)
        return self._places[key]


def _encoded(image: np.ndarray, width: int, quality: int) -> Encoded:
    return encoded_picture(Picture(displayable(image), "", ""), width, quality, subsampling=0)


def _unpaired(contenders: Sequence[Contender], pairs: Sequence[Pair]) -> list[Gap]:
    met = {place for pair in pairs for place in (pair.left, pair.right)}
    why = "No other stylization of its scene with its style image, or more pairs than --max-pairs."
    return [Gap(one.run.title, why) for place, one in enumerate(contenders) if place not in met]
