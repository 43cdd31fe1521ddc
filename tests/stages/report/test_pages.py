"""The pages of eval, compare and stress: well-formed, self-contained, readable without seeing, escaped."""

import re
import tomllib
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path

import pytest

from schemas.safe_names import listed
from stages.report.pages import clock, count, duration, megabytes, number, render_page
from tests.stages.report import sample_pages


def test_numbers_in_words():
    assert (number(-1.5, 1), number(None, 2), number(float("nan"), 2)) == ("−1.5", "–", "–")
    assert (duration(59.96), duration(245), duration(3725), duration(None)) == ("60.0 s", "4 min 5 s", "1 h 2 min", "–")
    assert (clock(12.34), clock(245), clock(3725)) == (("12.3", "s"), ("4:05", "min"), ("1:02", "h"))
    assert (megabytes(1500), megabytes(5e6, 1e6)) == ("1.50 GB", "5.0 MB")
    assert (count(950), count(12_345), count(4.56e6)) == ("950", "12.3 thousand", "4.56 million")
    assert listed(list("abcdefgh"), 3) == "a, b, c and 5 more"


VOID = {"meta", "link", "img", "br", "hr", "input"}


class Reader(HTMLParser):
    """Collects tags and text; fails if tags are not closed in order."""

    def __init__(self):
        super().__init__()
        self.open, self.tags, self.text = [], [], []

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-3:]}"
        self.open.pop()

    def handle_data(self, data):
        self.text.append(data)


@pytest.fixture(params=["eval", "compare", "stress"])
def page(request, page_folder):
    return (page_folder / f"{request.param}.html").read_text(encoding="utf-8")


def read(page):
    reader = Reader()
    reader.feed(page)
    reader.close()
    assert reader.open == []
    return reader


def test_nothing_is_fetched_from_elsewhere(page):
    for tag, attributes in read(page).tags:
        assert tag not in ("script", "iframe", "object", "embed")
        for key, value in attributes.items():
            if key in ("src", "href", "xlink:href", "srcset", "data", "action"):
                assert value.startswith(("data:", "#")), (tag, key, value)
    assert not re.search(r"@import|url\((?!#)|https?:", page)


def test_ids_are_unique_and_references_resolve(page):
    tags = read(page).tags
    ids = [attributes["id"] for _, attributes in tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    for _, attributes in tags:
        wanted = [attributes.get("aria-labelledby", "")]
        wanted += [attributes[key][1:] for key in ("href",) if attributes.get(key, "").startswith("#")]
        wanted += re.findall(r"url\(#([^)]+)\)", " ".join(filter(None, attributes.values())))
        assert {name for name in wanted if name} <= set(ids), wanted


def test_it_can_be_read_without_seeing(page):
    reader = read(page)
    tags = [tag for tag, _ in reader.tags]
    for tag, attributes in reader.tags:
        assert tag != "img" or attributes["alt"].strip()
        assert tag != "th" or "scope" in attributes
        assert tag != "html" or attributes["lang"] == "en"
        assert tag != "svg" or (attributes["role"] == "img" and attributes["aria-labelledby"])
    headings = [int(tag[1]) for tag in tags if re.fullmatch(r"h[1-6]", tag)]
    assert headings.count(1) == 1 and all(b - a <= 1 for a, b in pairwise(headings))
    assert (tags.count("caption") == tags.count("table") > 0 and "img" in tags) or "svg" in tags


def test_every_section_is_linked_and_has_content(page):
    links = re.findall(r'<li><a href="#(\w+)">', page)
    sections = re.findall(r'(?s)<section id="(\w+)" aria-labelledby="[\w-]+">\s*<h2[^>]*>[^<]+</h2>\s*(<\w+)', page)
    assert links == [name for name, _ in sections] and len(links) >= 5


def test_values_are_escaped():
    hostile = {"field": "<b>'\"&\x1b\u202e", "scene": "s"}
    report = sample_pages.report_with_all_metrics() | hostile
    page = sample_pages.evaluation_page.build_page(report, sample_pages.pictures())
    assert "<b>" not in page and "\x1b" not in page and "\u202e" not in page
    assert "&lt;b&gt;&#39;&#34;&amp;\\x1b\\u202e" in page


def test_templates_are_package_data():
    """Else an installed wheel has no pages."""
    root = Path(__file__).parents[3]
    settings = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["setuptools"]
    folder = root / "stages" / "report"
    packed = {path for pattern in settings["package-data"]["stages.report"] for path in folder.glob(pattern)}
    assert packed == {path for path in folder.rglob("*") if path.is_file() and path.suffix in (".html", ".css", ".js")}


def test_a_template_that_lacks_a_value_is_an_error():
    from jinja2 import UndefinedError

    with pytest.raises(UndefinedError, match="summary"):
        render_page("base.html")
