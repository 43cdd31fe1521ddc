"""The tables of docs/import.md, whose rows are named as their tests are."""

import re

from tests.conftest import REPOSITORY


def rows_of(section: str) -> set[str]:
    """Names of the rows of a section: what stands in the first column, as `name`."""
    page = (REPOSITORY / "docs" / "import.md").read_text()
    part = page.partition(f"\n## {section}\n")[2].partition("\n## ")[0]
    return set(re.findall(r"^\| `([^`]+)`", part, re.M))
