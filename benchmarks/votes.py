"""Blind votes on pairs of stylizations: `python -m benchmarks.votes OUT.json PAIRS VOTES.json[,...] WORK...`.

Protocol: `stylerf compare WORK... --pairs` writes to PAIRS a page of pairs in random order, without names; people vote
on it and save VOTES.json. Shares are of decided votes, with 95 % Wilson intervals. `matchups` are votes between two
contenders, `agreement` is how often a figure prefers the image that was voted for.
"""

import json
import sys
from pathlib import Path

from benchmarks.conditions import here_and_now
from benchmarks.fits import stylerf

KEPT = ("contender", "won", "decided", "share", "low", "high", "same")


def condensed(counted: dict) -> dict:
    """Return a summary of `stylerf compare --votes --json`: shares by group, matchups and agreement."""
    rows = [
        {"group": group, **{name: one[name] for name in KEPT}}
        for group, members in counted["standings"].items()
        for one in members
    ]
    return {"votes": counted["votes"], "files": counted["files"], "rows": rows, "matchups": counted["matchups"],
            "agreement": counted["agreement"]}  # fmt: skip


def main() -> None:
    out, pairs, votes, *works = sys.argv[1:]
    report = {
        "command": "python -m benchmarks.votes OUT.json PAIRS VOTES.json[,...] WORK...",
        "protocol": __doc__.split("Protocol: ")[1],
        **here_and_now(),
        **condensed(stylerf("compare", *works, "--out", pairs, "--votes", *votes.split(","))),
    }
    Path(out).write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    main()
