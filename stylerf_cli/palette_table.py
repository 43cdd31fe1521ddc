"""The palette of an edit or a field, as lines of text."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:  # imports numpy, for which `--help` must not wait
    from schemas.work_folder import Artifact


def palette_lines(made: "Artifact", kind: str = "edit") -> list[str]:
    """Return one line per palette color, after a heading and before the path."""
    from stages.artifacts.edit import told_colors

    colors = told_colors(made)
    lines = [
        f"  {one['index']}  {one['now']}  {one['share']:6.1%}  {one['name']}"
        + (f" (was {one['learned']})" if one["now"] != one["learned"] else "")
        for one in colors
    ]
    return [f"{kind} {made.name}: a palette of {len(colors)} colors", *lines, f"  {made.path}"]
