"""Numbers in the words of a page, and what is safe to stand in one."""

import html

from schemas.safe_names import printable
from stages.evaluation.metrics import is_number


def escape(text: str) -> str:
    """Text for HTML or SVG, in an element or an attribute: no markup, no control characters, nothing turned round."""
    return html.escape(printable(text))


def number(value: object, digits: int) -> str:
    """`digits` decimals, an en dash for what was not measured, a true minus sign."""
    if not is_number(value):
        return "–"
    return f"{value:.{digits}f}".replace("-", "−")


def duration(seconds: float | None) -> str:
    """12.3 s, 4 min 5 s, 1 h 2 min."""
    if not is_number(seconds):
        return "–"
    if seconds < 60:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def clock(seconds: float | None) -> tuple[str, str]:
    """Value and unit in few letters: 12.3 s, 4:05 min, 1:02 h."""
    if not is_number(seconds):
        return "–", ""
    if seconds < 60:
        return f"{seconds:.1f}", "s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02d}", "min"
    return f"{whole // 3600}:{whole % 3600 // 60:02d}", "h"


def megabytes(value: float | None, per: float = 1.0) -> str:
    """A size of `value` units, `per` of them to the megabyte (1e6 bytes), as MB or GB."""
    if not is_number(value):
        return "–"
    size = value / per
    return f"{size / 1000:.2f} GB" if size >= 1000 else f"{size:.1f} MB"


def count(value: float | None) -> str:
    """950, 12.3 thousand, 4.56 million."""
    if not is_number(value):
        return "–"
    if value >= 1e6:
        return f"{value / 1e6:.2f} million"
    return f"{value / 1e3:.1f} thousand" if value >= 1e4 else f"{value:,.0f}".replace(",", " ")
