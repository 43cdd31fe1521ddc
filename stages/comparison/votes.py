"""People's votes on pairs of pictures: read, checked and counted, next to the figures of the same runs."""

import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from scipy.stats import binomtest

from schemas.atomic_write import sweeping, write_bytes, write_json
from schemas.canonical_json import digest_of
from schemas.errors import BadInput
from schemas.safe_reading import UNSOUND, read_json
from schemas.work_folder import WorkFolder
from stages.comparison.pairs import KEYS
from stages.comparison.pareto_fronts import why_excluded
from stages.comparison.runs import Gap, Run, RunMetric, fields_of, runs_of
from stages.evaluation.metric_definitions import BY_KEY
from stages.report.pages import render_page
from stylerf import validation

CHOICES = ("left", "right", "same")
CONFIDENCE = 0.95
MOST_BYTES, MOST_PAIRS = 4 << 20, 100_000
SHOWN = ("sifid", "color_distribution", "speckle", "edges_kept", "short_rmse", "long_rmse")  # next to the votes
EVERYWHERE = "all scenes and style images"


@dataclass(frozen=True)
class Side:
    """What one side of a pair shows: the contender's label, and its run's title and group."""

    label: str
    title: str
    group: str
    field: str


@dataclass(frozen=True)
class Vote:
    """A person's choice between two sides; None for neither."""

    winner: Side | None
    sides: tuple[Side, Side]


@dataclass(frozen=True)
class Share:
    """Successes among decided votes, as a fraction with its Wilson interval; NaN without any."""

    successes: int
    decided: int

    @property
    def mean(self) -> float:
        """The fraction."""
        return self.successes / self.decided if self.decided else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's score interval (1927) at CONFIDENCE."""
        if not self.decided:
            return math.nan, math.nan
        found = binomtest(self.successes, self.decided).proportion_ci(CONFIDENCE, method="wilson")
        return float(found.low), float(found.high)


@dataclass(frozen=True)
class Standing:
    """Votes for one contender in a group. metrics: of its run there; empty over all groups."""

    label: str
    won: Share
    same: int
    metrics: Mapping[str, RunMetric]


@dataclass(frozen=True)
class Matchup:
    """Votes between two contenders over all groups; `won` by the first."""

    labels: tuple[str, str]
    won: Share
    same: int


@dataclass(frozen=True)
class Agreement:
    """How often the picture of the run with the better figure was chosen."""

    label: str
    agreed: Share


def read_votes(files: Sequence[Path], out: Path) -> list[Vote]:
    """Read votes files, in the order given. out: the folder with the keys of their pages.

    A field has one label in a group, that of the last page, which no other field shares.

    Raises:
        BadInput: A file is missing, not a votes file, from an unknown page, given twice, or has two votes on a pair.
    """
    found: list[Vote] = []
    seen: dict[str, Path] = {}
    for path in files:
        content = _content(path)
        digest = digest_of(content)
        if digest in seen:
            raise BadInput(f"{path} contains the same votes as {seen[digest]}; give each file once")
        seen[digest] = path
        pairs = _key(path, content["page"], out)
        voted = Counter(vote["pair"] for vote in content["votes"])
        if unknown := [pair for pair in voted if str(pair) not in pairs]:
            raise BadInput(
                f"{path} contains a vote on pair {unknown[0]}, which is not on its page; save the votes again"
            )
        if twice := [pair for pair, times in voted.items() if times > 1]:
            raise BadInput(f"{path} contains {voted[twice[0]]} votes on pair {twice[0]}; keep one of them")
        for vote in content["votes"]:
            sides = pairs[str(vote["pair"])]
            found.append(Vote(None if vote["choice"] == "same" else sides[CHOICES.index(vote["choice"])], sides))
    if not found:
        raise BadInput(
            f"{', '.join(map(str, files))}: no votes found; vote on a page written by `stylerf compare --pairs`"
        )
    return _labeled_apart(found)


def _labeled_apart(votes: Sequence[Vote]) -> list[Vote]:
    """Return the votes with labels that are unique within a group: a page only distinguishes its own contenders."""
    sides = [side for vote in votes for side in vote.sides]
    labels = {(side.group, side.title, side.field): side.label for side in sides}
    uses = Counter((group, label) for (group, *_), label in labels.items())
    made = Counter((group, title) for group, title, _ in labels)

    def apart(side: Side) -> Side:
        label = labels[side.group, side.title, side.field]
        if uses[side.group, label] > 1:
            again = f", {side.field[:8]}" if made[side.group, side.title] > 1 else ""
            label = f"{label} ({side.title.rpartition('/')[2]}{again})"
        return replace(side, label=label)

    found = []
    for vote in votes:
        left, right = map(apart, vote.sides)
        winner = None if vote.winner is None else left if vote.winner is vote.sides[0] else right
        found.append(Vote(winner, (left, right)))
    return found


def _content(path: Path) -> dict[str, Any]:
    try:
        content = read_json(path, limit=MOST_BYTES)
    except FileNotFoundError:
        raise BadInput(f"--votes {path}: no such file") from None
    try:
        data = validation.table(content, "the document")
        if (data.get("format"), data.get("version")) != ("stylerf votes", 1):
            raise ValueError("its format is not 'stylerf votes', version 1")
        if not re.fullmatch("[0-9a-f]{64}", validation.entry(data, "page", str)):
            raise ValueError("its page ID is not 64 hex digits")
        votes = validation.entry(data, "votes", list)
        for vote in votes:
            validation.integer(validation.table(vote, "a vote"), "pair", 0, MOST_PAIRS)
            validation.one_of(vote, "choice", CHOICES)
    except UNSOUND as error:
        raise BadInput(
            f"{path} is not a votes file: {error}; save one from a page of `stylerf compare --pairs`"
        ) from error
    return data


def _key(votes: Path, page: str, out: Path) -> dict[str, tuple[Side, Side]]:
    """Return the sides by pair number, from the key of a page."""
    path = out / KEYS / f"{page}.json"
    try:
        content = read_json(path)
    except FileNotFoundError:
        raise BadInput(
            f"{votes} belongs to a page whose key {path} does not exist; give the same --out and first WORK as for "
            "`stylerf compare --pairs`"
        ) from None
    try:
        sides = [Side(**{name: validation.entry(one, name, str) for name in ("label", "title", "group", "field")})
                 for one in validation.entry(content, "contenders", list)]  # fmt: skip
        found = {}
        for number, pair in validation.entry(content, "pairs", dict).items():
            places = [validation.integer(pair, side, 0, len(sides) - 1) for side in ("left", "right")]
            found[number] = (sides[places[0]], sides[places[1]])
    except UNSOUND as error:
        raise BadInput(f"{path} is not a valid page key: {error}; write the page again") from error
    return found


def standings(votes: Iterable[Vote], runs: Mapping[str, Run]) -> dict[str, list[Standing]]:
    """By group, then over all of them if there are several: contenders by falling share of decided votes won.

    runs: by title, with their metrics.
    """
    tables: dict[str, dict[str, list[Vote]]] = defaultdict(lambda: defaultdict(list))
    titles: dict[tuple[str, str], str] = {}
    for vote in votes:
        for side in vote.sides:
            titles[side.group, side.label] = side.title
            for group in (side.group, EVERYWHERE):
                tables[group][side.label].append(vote)
    groups = sorted(group for group in tables if group != EVERYWHERE)
    found = {}
    for group in [*groups, *([EVERYWHERE] if len(groups) > 1 else [])]:
        rows = []
        for label, own in tables[group].items():
            won = sum(vote.winner is not None and vote.winner.label == label for vote in own)
            decided = sum(vote.winner is not None for vote in own)
            run = runs.get(titles.get((group, label), ""))
            rows.append(Standing(label, Share(won, decided), len(own) - decided, run.metrics if run else {}))
        found[group] = sorted(rows, key=lambda row: (-row.won.mean if row.won.decided else 1.0, row.label))
    return found


def matchups(votes: Iterable[Vote]) -> list[Matchup]:
    """Return the votes between every two contenders, the one with more of them first; empty for two contenders."""
    winners: dict[tuple[str, ...], list[str | None]] = defaultdict(list)
    for vote in votes:
        labels = tuple(sorted(side.label for side in vote.sides))
        winners[labels].append(None if vote.winner is None else vote.winner.label)
    found = []
    for labels, won in winners.items():
        first, second = sorted(labels, key=won.count, reverse=True)
        decided = len(won) - won.count(None)
        found.append(Matchup((first, second), Share(won.count(first), decided), won.count(None)))
    return sorted(found, key=lambda matchup: matchup.labels) if len(found) > 1 else []


def agreements(votes: Iterable[Vote], runs: Mapping[str, Run]) -> list[Agreement]:
    """Return, for every figure that has a better direction, in how many decided votes the better run's picture won.

    Left out: votes between equal figures, or figures measured by different protocols or not on all views.
    """
    counts: dict[str, list[int]] = defaultdict(lambda: [0, 0])
    labels: dict[str, str] = {}
    for vote in votes:
        first, second = (runs.get(side.title) for side in vote.sides)
        if vote.winner is None or first is None or second is None:
            continue
        for key in first.metrics.keys() & second.metrics.keys():
            a, b = first.metrics[key], second.metrics[key]
            excluded = why_excluded(first, key) or why_excluded(second, key) or a.comparable_by != b.comparable_by
            if a.better and not excluded and a.mean != b.mean:
                better = vote.sides[(a.mean < b.mean) == (a.better == "higher")]
                counts[key][0] += vote.winner is better
                counts[key][1] += 1
                labels[key] = a.label
    order = [key for key in BY_KEY if key in counts]
    return [Agreement(labels[key], Share(*counts[key])) for key in order]


def counted_votes(works: Sequence[WorkFolder], files: Sequence[Path], out: Path) -> dict[str, Any]:
    """Write votes.json and votes.html to `out`; return the contents of votes.json. Errors as in read_votes."""
    votes = read_votes(files, out)
    known, _ = runs_of(works)
    runs, gaps = {run.title: run for run in known}, []
    fields = fields_of(works)
    for side in dict.fromkeys(side for vote in votes for side in vote.sides):
        if side.title not in fields:
            gaps.append(Gap(side.title, "It is not in these work folders; its figures are left out."))
        elif fields[side.title][1].digest != side.field:
            gaps.append(Gap(side.title, "It was rebuilt after the vote; its figures are left out."))
            runs.pop(side.title, None)
    tables, between, agreed = standings(votes, runs), matchups(votes), agreements(votes, runs)
    content = {
        "votes": len(votes),
        "files": len(files),
        "standings": {
            group: [
                {"contender": row.label, **_numbers(row.won), "same": row.same,
                 "metrics": {key: asdict(metric) for key, metric in row.metrics.items()}}
                for row in rows
            ]
            for group, rows in tables.items()
        },
        "matchups": [
            {"contender": one.labels[0], "against": one.labels[1], **_numbers(one.won), "same": one.same}
            for one in between
        ],
        "agreement": [{"metric": one.label, **_numbers(one.agreed)} for one in agreed],
        "missing": [asdict(gap) for gap in gaps],
    }  # fmt: skip
    people = "1 file" if len(files) == 1 else f"{len(files)} files"
    shown = [key for key in SHOWN if any(key in row.metrics for rows in tables.values() for row in rows)]
    page = render_page(
        "votes.html",
        summary=f"{len(votes)} votes from {people}.",
        tables=tables,
        matchups=between,
        columns=[(BY_KEY[key], _label(key, tables)) for key in shown],
        agreements=agreed,
        gaps=gaps,
    )
    with sweeping((out,)):
        write_json(out / "votes.json", content)
        write_bytes(out / "votes.html", page.encode())
    return content


def _label(key: str, tables: Mapping[str, Sequence[Standing]]) -> str:
    labels = {row.metrics[key].label for rows in tables.values() for row in rows if key in row.metrics}
    return labels.pop() if len(labels) == 1 else BY_KEY[key].label.partition(",")[0]


def _numbers(share: Share) -> dict[str, Any]:
    """The share for JSON: null without decided votes."""
    low, high = share.interval
    values = {"share": share.mean, "low": low, "high": high}
    return {"won": share.successes, "decided": share.decided} | {
        name: None if math.isnan(value) else round(value, 6) for name, value in values.items()
    }
