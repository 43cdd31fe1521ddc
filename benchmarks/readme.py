"""Write README's figures from benchmarks/results: `python -m benchmarks.readme` (`--check` only compares)."""

import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BEGIN, END = "<!-- figures -->", "<!-- /figures -->"


def table() -> str:
    """Markdown of the fits, with the protocol under it."""
    report = json.loads((ROOT / "benchmarks" / "results" / "fit.json").read_text())
    lines = [
        "| scene | training | held-out PSNR | SSIM | parameters | grid | peak memory |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in report["rows"]:
        lines.append(
            f"| {row['scene']} | {row['train_seconds']:.0f} s | {row['psnr']:.2f} dB | {row['ssim']:.3f} "
            f"| {row['parameters'] / 1e6:.2f} M | {row['resolution']}^3 | {row['peak_memory_mb'] / 1000:.1f} GB |"
        )
    lines += [
        "",
        f"{report['machine']['cores']} CPU cores, no GPU, {report['date']}; `{report['command']}`; one seed. "
        "Not measured on a GPU.",
    ]
    return "\n".join(lines)


def main() -> int:
    readme = ROOT / "README.md"
    text = readme.read_text()
    head, _, rest = text.partition(BEGIN)
    _, _, tail = rest.partition(END)
    wanted = f"{head}{BEGIN}\n{table()}\n{END}{tail}"
    if "--check" in sys.argv:
        return int(wanted != text)
    readme.write_text(wanted)
    return 0


if __name__ == "__main__":
    sys.exit(main())
