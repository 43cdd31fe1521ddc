"""Render the self-contained HTML pages of eval, compare and stress from their templates."""

import functools
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from schemas.safe_names import printable
from stages.report.formatting import count, duration, megabytes, number


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
