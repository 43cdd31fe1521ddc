"""The pages of eval, compare and stress in headless Chromium: no errors, images load, nothing overflows, good contrast.

With STYLERF_SCREENSHOTS=FOLDER each page is also saved as a PNG, to look at.
"""

import base64
import os
from pathlib import Path

import pytest

from tests.stages.report.browser import CHROMIUM, Browser

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium (Debian: apt-get install chromium)")
SIZES = [(width, scheme) for width in (380, 1400) for scheme in ("light", "dark")]

BROKEN_IMAGES = "Array.from(document.images).filter(i => !i.naturalWidth).map(i => i.alt)"
# Tables scroll inside .wide; the skip link waits outside the page.
OVERFLOWING = """
Array.from(document.querySelectorAll("body *"))
  .filter(e => !e.closest(".skip") && !e.parentElement.closest(".wide"))
  .filter(e => { const r = e.getBoundingClientRect(); return r.width && (r.right > innerWidth + 0.5 || r.left < -0.5) })
  .map(e => e.outerHTML.slice(0, 200))
"""
# WCAG 2.2, 1.4.3: at least 4.5 to 1 between a text and what is behind it.
LOW_CONTRAST = """
(() => {
  const rgb = text => text.match(/[\\d.]+/g).map(Number)
  const light = color => color.slice(0, 3)
    .map(v => v / 255).map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0)
  const behind = e => {
    for (; e; e = e.parentElement) {
      const color = rgb(getComputedStyle(e).backgroundColor)
      if (color.length == 3 || color[3] == 1) return color
    }
    return [255, 255, 255]
  }
  return Array.from(document.querySelectorAll("body *:not(svg *)"))
    .filter(e => Array.from(e.childNodes).some(n => n.nodeType == 3 && n.data.trim()))
    .map(e => {
      const [a, b] = [light(rgb(getComputedStyle(e).color)), light(behind(e))].sort((x, y) => y - x)
      return [(a + 0.05) / (b + 0.05), e.outerHTML.slice(0, 100)]
    })
    .filter(([contrast]) => contrast < 4.5)
})()
"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    made = Browser(tmp_path_factory.mktemp("profile"))
    yield made
    made.close()


@pytest.mark.parametrize(("width", "scheme"), SIZES)
@pytest.mark.parametrize("name", ["eval", "compare", "stress"])
def test_a_page_is_shown_without_faults(browser, page_folder, name, width, scheme):
    browser.open(page_folder / f"{name}.html", width, scheme)
    images = browser.evaluate("document.images.length")
    assert images == {"eval": 9, "compare": 0, "stress": 2}[name]
    assert browser.evaluate(BROKEN_IMAGES) == []
    assert browser.evaluate("document.documentElement.scrollWidth") == width
    assert browser.evaluate(OVERFLOWING) == []
    assert browser.evaluate(LOW_CONTRAST) == []
    background = browser.evaluate("getComputedStyle(document.body).backgroundColor")
    assert background == {"light": "rgb(255, 255, 255)", "dark": "rgb(13, 17, 23)"}[scheme]
    if screenshots := os.environ.get("STYLERF_SCREENSHOTS"):
        taken = browser.send("Page.captureScreenshot", captureBeyondViewport=True, clip=_whole(browser, width))
        Path(screenshots, f"{name}-{width}-{scheme}.png").write_bytes(base64.b64decode(taken["data"]))
    assert browser.errors == []


def _whole(browser: Browser, width: int) -> dict:
    height = browser.evaluate("document.documentElement.scrollHeight")
    return {"x": 0, "y": 0, "width": width, "height": height, "scale": 1}


@pytest.mark.parametrize(
    ("body", "found"),
    [
        ('<img src="data:image/png;base64,AAAA" alt="broken">', BROKEN_IMAGES),
        ('<div style="width:2000px">wide</div>', OVERFLOWING),
        ('<p style="color:#888;background:#999">gray</p>', LOW_CONTRAST),
    ],
)
def test_the_checks_find_a_fault(browser, tmp_path, body, found):
    (tmp_path / "bad.html").write_text(f'<!DOCTYPE html><link rel="icon" href="data:,"><body>{body}</body>')
    browser.open(tmp_path / "bad.html", 380, "light")
    assert len(browser.evaluate(found)) == 1


def test_the_browser_reports_errors(browser, tmp_path):
    (tmp_path / "bad.html").write_text('<!DOCTYPE html><link rel="icon" href="data:,"><img src="gone.png" alt="">')
    browser.open(tmp_path / "bad.html", 380, "light")
    assert any("ERR_FILE_NOT_FOUND" in error for error in browser.errors)
