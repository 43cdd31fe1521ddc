"""Self-contained HTML pages of eval, compare and stress from their templates; numbers and text on them."""

import functools
import html
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from schemas.safe_names import printable
from stages.evaluation.metrics import is_number


def escape(text: str) -> str:
    """Escape text for HTML or SVG, in elements and attributes: markup, control and bidirectional characters."""
    return html.escape(printable(text))


def number(value: object, digits: int) -> str:
    """Format with `digits` decimals and a true minus sign; an en dash if the value is not a finite number."""
    if not is_number(value):
        return "–"
    return f"{value:.{digits}f}".replace("-", "−")


def duration(seconds: float | None) -> str:
    """Format as 12.3 s, 4 min 5 s or 1 h 2 min."""
    if not is_number(seconds):
        return "–"
    if seconds < 60:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def clock(seconds: float | None) -> tuple[str, str]:
    """Format briefly, as value and unit: 12.3 s, 4:05 min, 1:02 h."""
    if not is_number(seconds):
        return "–", ""
    if seconds < 60:
        return f"{seconds:.1f}", "s"
    whole = round(seconds)
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02d}", "min"
    return f"{whole // 3600}:{whole % 3600 // 60:02d}", "h"


def megabytes(value: float | None, per: float = 1.0) -> str:
    """Format a size in units of 1/`per` MB (1 MB is 1e6 bytes) as MB or GB."""
    if not is_number(value):
        return "–"
    size = value / per
    return f"{size / 1000:.2f} GB" if size >= 1000 else f"{size:.1f} MB"


def count(value: float | None) -> str:
    """Format as 950, 12.3 thousand or 4.56 million."""
    if not is_number(value):
        return "–"
    if value >= 1e6:
        return f"{value / 1e6:.2f} million"
    return f"{value / 1e3:.1f} thousand" if value >= 1e4 else f"{value:,.0f}".replace(",", " ")


def render_page(template: str, **context: Any) -> str:
    """Render a template of stages/report/templates; HTML 5 without scripts or external references.

    Every value is escaped: markup and control characters in names show as text.
    """
    return _environment().get_template(template).render(**context)


@functools.cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("stages.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_printable,
    )
    environment.filters |= {"count": count, "duration": duration, "megabytes": megabytes, "number": number}
    return environment


def _printable(value: Any) -> Any:
    """Autoescape handles markup; control and bidirectional characters are escaped here."""
    return printable(value) if isinstance(value, str) and not isinstance(value, Markup) else value
