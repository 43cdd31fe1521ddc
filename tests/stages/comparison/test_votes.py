"""Votes: counted against made-up people, and refused where a file is not what it should be."""

import json
from itertools import count

import numpy as np
import pytest

from schemas.errors import BadInput
from stages.comparison.runs import STYLIZATIONS, Run, RunMetric
from stages.comparison.votes import EVERYWHERE, Matchup, Share, Side, Vote, agreements, matchups, read_votes, standings

PAGE = "ab" * 32
NAMES = ("arf", "snerf")


@pytest.fixture
def out(tmp_path):
    """A folder with the key of a page of 4 pairs: arf is left in even ones."""
    (tmp_path / "pairs").mkdir()
    contenders = [{"label": name, "title": f"room/{name}", "group": "room, a.png", "field": "f"} for name in NAMES]
    pairs = {str(n): {"left": n % 2, "right": 1 - n % 2, "view": 0} for n in range(4)}
    (tmp_path / "pairs" / f"{PAGE}.json").write_text(json.dumps({"contenders": contenders, "pairs": pairs}))
    return tmp_path


numbers = count()


def saved(out, votes, **changed):
    path = out / f"votes{next(numbers)}.json"
    content = {"format": "stylerf votes", "version": 1, "page": PAGE, "votes": votes} | changed
    path.write_text(json.dumps(content))
    return path


def vote(pair, choice):
    return {"pair": pair, "choice": choice, "seconds": 2.5}


def test_sides_become_contenders_by_the_key(out):
    """arf is chosen on whichever side it is."""
    file = saved(out, [vote(0, "left"), vote(1, "right"), vote(2, "same"), vote(3, "left")])
    found = read_votes([file], out)
    assert [one.winner and one.winner.label for one in found] == ["arf", "arf", None, "snerf"]
    rows = {row.label: row for row in standings(found, {})["room, a.png"]}
    assert (rows["arf"].won, rows["arf"].same) == (Share(2, 3), 1)
    assert (rows["snerf"].won, rows["snerf"].same) == (Share(1, 3), 1)


@pytest.mark.parametrize(
    ("votes", "changed", "message"),
    [
        ([vote(9, "left")], {}, "contains a vote on pair 9, which is not on its page"),
        ([vote(1, "left"), vote(1, "right")], {}, "contains 2 votes on pair 1"),
        ([vote(0, "up")], {}, "choice is 'up', expected one of left, right, same"),
        ([vote("0", "left")], {}, "pair is '0', expected a whole number"),
        ([vote(True, "left")], {}, "expected a whole number"),
        (["left"], {}, "expected an object"),
        ([vote(0, "left")], {"version": 2}, "version 1"),
        ([vote(0, "left")], {"page": "../../etc"}, "its page ID is not 64 hex digits"),
        ([vote(0, "left")], {"page": "cd" * 32}, "whose key .* does not exist; give the same --out"),
        ([], {}, "no votes found"),
        ({}, {}, "expected a list"),
    ],
)
def test_what_is_no_sound_file_of_votes_is_refused(out, votes, changed, message):
    with pytest.raises(BadInput, match=message) as refused:
        read_votes([saved(out, votes, **changed)], out)
    assert "\n" not in str(refused.value)


def test_a_file_counts_once_and_damage_is_named(out):
    first = saved(out, [vote(0, "left")])
    with pytest.raises(BadInput, match="contains the same votes as"):
        read_votes([first, saved(out, [vote(0, "left")])], out)
    with pytest.raises(BadInput, match="no such file"):
        read_votes([out / "gone.json"], out)
    key = out / "pairs" / f"{PAGE}.json"
    key.write_text(key.read_text().replace('"left": 1', '"left": 7'))
    with pytest.raises(BadInput, match="is not a valid page key: left is 7"):
        read_votes([first], out)


def test_pages_that_label_other_fields_alike_do_not_share_votes(out):
    """A page has in its labels only options in which its own contenders differ."""
    contenders = [{"label": label, "title": f"room/{name}", "group": "room, a.png", "field": name}
                  for label, name in (("arf", "arf-60s"), ("snerf, budget 9s", "snerf"))]  # fmt: skip
    key = out / "pairs" / f"{PAGE}.json"
    content = json.loads(key.read_text())
    for one in content["contenders"]:
        one["field"] = one["title"].partition("/")[2]
    key.write_text(json.dumps(content))
    content["contenders"] = contenders
    (out / "pairs" / f"{'cd' * 32}.json").write_text(json.dumps(content))
    votes = read_votes([saved(out, [vote(0, "right")]), saved(out, [vote(0, "left")], page="cd" * 32)], out)
    rows = {row.label: row.won for row in standings(votes, {})["room, a.png"]}
    assert rows == {"arf (arf)": Share(0, 1), "arf (arf-60s)": Share(1, 1), "snerf, budget 9s": Share(1, 2)}


def test_the_interval_is_wilsons():
    """Its ends solve |p - k/n| = z sqrt(p (1 - p) / n) (Wilson 1927)."""
    z = 1.959963984540054
    for k, n in ((7, 10), (0, 5), (50, 50), (31, 90)):
        roots = np.roots([1 + z * z / n, -(2 * k / n + z * z / n), (k / n) ** 2])
        assert Share(k, n).interval == pytest.approx(sorted(roots.real), abs=1e-9)
    assert np.isnan(Share(0, 0).mean) and np.isnan(Share(0, 0).interval).all()


def side(label, group):
    return Side(label, f"{group}/{label}", group, "f")


def people(true_share: float, votes: int, seed: int) -> list[Vote]:
    """Votes of people who choose `a` with this probability, in two groups."""
    generator, found = np.random.default_rng(seed), []
    for n in range(votes):
        group = f"scene {n % 2}"
        sides = (side("a", group), side("b", group))
        found.append(Vote(sides[0 if generator.random() < true_share else 1], sides))
    return found


def test_the_interval_holds_the_true_share_in_most_polls():
    holds = []
    for seed in range(200):
        table = {row.label: row for row in standings(people(0.7, 40, seed), {})[EVERYWHERE]}
        low, high = table["a"].won.interval
        holds.append(low <= 0.7 <= high)
        assert table["a"].won.successes + table["b"].won.successes == 40
    assert 0.9 <= np.mean(holds) <= 0.99


def test_groups_are_counted_apart_and_together_best_first():
    votes = people(0.8, 60, 0)
    tables = standings(votes, {})
    assert [*tables] == ["scene 0", "scene 1", EVERYWHERE]
    for rows in tables.values():
        assert [row.label for row in rows] == ["a", "b"]
    totals = [sum(row.won.successes for row in tables[group] if row.label == "a") for group in tables]
    assert totals[0] + totals[1] == totals[2] and all(row.won.decided == 30 for row in tables["scene 0"])
    assert [*standings(votes[::2], {})] == ["scene 0"]  # one group needs no total


def test_matchups_are_between_two_contenders_over_all_groups():
    def chosen(group, first, second, winner):
        sides = (side(first, group), side(second, group))
        return Vote(next((one for one in sides if one.label == winner), None), sides)

    votes = [
        chosen("x", "a", "b", "b"),
        chosen("y", "b", "a", "b"),
        chosen("y", "a", "b", "a"),
        chosen("x", "b", "a", None),
        chosen("x", "c", "a", None),
    ]
    assert matchups(votes) == [Matchup(("a", "c"), Share(0, 0), 1), Matchup(("b", "a"), Share(2, 3), 1)]
    assert matchups(votes[:4]) == []  # the votes by contender are the same numbers


def run_with(title: str, **metrics: tuple[float, str]) -> Run:
    found = {key: RunMetric(mean, key, "", better, "p", 3, 0) for key, (mean, better) in metrics.items()}
    return Run(STYLIZATIONS, "", title, "", "arf", "", "cpu", (), {}, found)


def test_figures_agree_with_votes_by_their_direction():
    votes = people(0.75, 80, 1)
    won = sum(one.winner is one.sides[0] for one in votes)
    runs = {}
    for group in ("scene 0", "scene 1"):
        runs[f"{group}/a"] = run_with("a", sifid=(1.0, "lower"), edges_kept=(0.2, "higher"), colorfulness=(1.0, ""),
                                      speckle=(0.0, "lower"))  # fmt: skip
        runs[f"{group}/b"] = run_with("b", sifid=(2.0, "lower"), edges_kept=(0.5, "higher"), colorfulness=(0.1, ""),
                                      speckle=(0.0, "lower"))  # fmt: skip
    found = {one.label: one.agreed for one in agreements(votes, runs)}
    assert found == {"sifid": Share(won, 80), "edges_kept": Share(80 - won, 80)}
    assert agreements(votes, {}) == []
