"""Check whether fitting has become slower or worse: `python -m benchmarks.regression WORK [AGAINST.json]`.

AGAINST: a report of benchmarks.profile on the same scene (default: benchmarks/results/profile.json).

Protocol: benchmarks.profile is run again. Since speed differs between machines and over time, only ratios are compared:
each kernel to its bound on the same machine in the same run, everything without a bound to its step, and all threads to
one; as well as the dB reached by the same steps. Exit code 1 if a ratio exceeds SLOWER times the earlier one, or a fit
is more than WORSE dB worse.
"""

import json
import os
import sys
import tempfile
from pathlib import Path

from benchmarks.profile import report_of

SLOWER, WORSE = 1.6, 0.15
LEAST_SHARE = 0.02  # of a step: anything that takes less is noise and not compared


def ratios(rows: list[dict]) -> dict[str, float]:
    """Return ratios by name; larger is slower."""
    found = {}
    whole = {(row["capacity"], row["threads"]): row["step_ms"] for row in rows}
    for row in rows:
        where = f"{row['capacity']}, {row['threads']} threads"
        for kernel, ms in row["kernels_ms"].items():
            if ms < LEAST_SHARE * row["step_ms"]:
                continue
            bound = row["bounds_ms"].get(kernel)
            of = "its bound" if bound else "the step"
            found[f"{where}: {kernel} to {of}"] = ms / (bound or row["step_ms"])
        if row["threads"] > 1 and (row["capacity"], 1) in whole:
            found[f"{where}: a step to that of one thread"] = row["step_ms"] / whole[row["capacity"], 1]
    return found


def worse(before: list[dict], now: list[dict]) -> list[str]:
    """Describe what has become slower or worse; entries in only one of the two are not compared."""
    old, new, found = ratios(before), ratios(now), []
    for name in old.keys() & new.keys():
        if new[name] > SLOWER * old[name]:
            found.append(f"{name}: {new[name]:.2f}, it was {old[name]:.2f}")
    reached = {(row["capacity"], row["threads"]): row["psnr"] for row in before}
    for row in now:
        was = reached.get((row["capacity"], row["threads"]))
        if was is not None and not row["psnr"] >= was - WORSE:  # in this form, NaN also counts as worse
            found.append(f"{row['capacity']}, {row['threads']} threads: {row['psnr']:.2f} dB, it was {was:.2f}")
    return sorted(found)


def main() -> int:
    work = Path(sys.argv[1])
    against = Path(sys.argv[2] if len(sys.argv) > 2 else Path(__file__).parent / "results" / "profile.json")
    before = json.loads(against.read_text())
    if before["scene"] != work.name:
        print(f"{against}: measured on {before['scene']}, not on {work.name}", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory() as scratch:
        now = report_of(work, sorted({1, os.cpu_count() or 1}), Path(scratch))
    compared = ratios(before["rows"]).keys() & ratios(now["rows"]).keys()
    if not compared:
        print(f"{against}: no kernel of it was measured at the same capacity and number of threads", file=sys.stderr)
        return 2
    found = worse(before["rows"], now["rows"])
    print("\n".join(found) if found else f"{len(compared)} ratios: none has become worse")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
