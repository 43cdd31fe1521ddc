"""The page of pairs and that of votes in headless Chromium: a person votes by mouse and keyboard, and saves."""

import base64
import json
import os
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from stages.comparison.votes import Agreement, Matchup, Share, Standing
from stages.evaluation.metric_definitions import BY_KEY
from stages.report.contact_sheet import Picture, encoded_picture
from stages.report.pages import render_page
from tests.stages.report.browser import CHROMIUM, Browser
from tests.stages.report.test_in_browser import BROKEN_IMAGES, LOW_CONTRAST, OVERFLOWING, SIZES

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium (Debian: apt-get install chromium)")


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    made = Browser(tmp_path_factory.mktemp("profile"))
    yield made
    made.close()


def page_of_pairs(seed: int) -> str:
    """Three pairs. seed: of the page's name, under which a browser keeps votes."""
    generator = np.random.default_rng(0)
    images = [generator.random((90, 120, 3)) for _ in range(4)]
    pictures = [encoded_picture(Picture(image, "", ""), 1200, 95).uri for image in images]
    pair = {"left": 0, "right": 1, "photo": 2, "style": 3, "width": 120, "height": 90}
    pairs = [pair, pair | {"left": 1, "right": 0}, pair]
    data = {"page": f"{seed:02x}" * 32, "pairs": pairs, "pictures": pictures}
    return render_page("pairs.html", summary="3 pairs, about 1 min.", data=data)


def page_of_votes() -> str:
    rows = [Standing("arf, match-by transport and another long option", Share(7, 10), 2, {}),
            Standing("snerf <b>", Share(0, 0), 2, {})]  # fmt: skip
    return render_page(
        "votes.html", summary="12 votes.", tables={"fern, starry.jpg": rows, "all": rows},
        matchups=[Matchup(("arf", "snerf"), Share(7, 10), 2)],
        columns=[(BY_KEY["sifid"], "SIFID-style distance, st-vgg16, conv2_2"), (BY_KEY["speckle"], "Speckle")],
        agreements=[Agreement("SIFID-style distance", Share(7, 10))], gaps=[{"what": "a/b", "why": "It is gone."}],
    )  # fmt: skip


SHOWN = "Promise.all(Array.from(document.images).map(i => i.decode())).then(() => document.images.length)"
PLACE = 'document.getElementById("place").textContent'
SAVED = 'fetch(document.getElementById("save").href).then(r => r.text())'


def press(browser: Browser, key: str) -> None:
    for kind in ("keyDown", "keyUp"):
        browser.send("Input.dispatchKeyEvent", type=kind, key=key)


@pytest.mark.parametrize(("width", "scheme"), SIZES)
@pytest.mark.parametrize("name", ["pairs", "votes"])
def test_the_pages_are_shown_without_faults(browser, tmp_path, name, width, scheme):
    path = tmp_path / f"{name}.html"
    path.write_text(page_of_pairs(1) if name == "pairs" else page_of_votes(), encoding="utf-8")
    browser.open(path, width, scheme)
    assert browser.evaluate(SHOWN) == {"pairs": 4, "votes": 0}[name]
    for found in (BROKEN_IMAGES, OVERFLOWING, LOW_CONTRAST):
        assert browser.evaluate(found) == []
    assert browser.evaluate("document.documentElement.scrollWidth") == width
    if screenshots := os.environ.get("STYLERF_SCREENSHOTS"):
        taken = browser.send("Page.captureScreenshot", captureBeyondViewport=True)
        Path(screenshots, f"{name}-{width}-{scheme}.png").write_bytes(base64.b64decode(taken["data"]))
    assert browser.errors == []


def test_votes_by_mouse_and_keyboard_are_saved(browser, tmp_path):
    path = tmp_path / "pairs.html"
    path.write_text(page_of_pairs(2), encoding="utf-8")
    browser.open(path, 1400, "light")
    assert browser.evaluate(PLACE) == "Pair 1 of 3"
    first = browser.evaluate('document.getElementById("left").src')
    browser.evaluate('document.getElementById("vote-right").click()')
    assert browser.evaluate('document.getElementById("right").src') == first  # the sides are swapped in the second
    press(browser, "ArrowLeft")
    press(browser, "ArrowUp")
    assert browser.evaluate(PLACE) == "Pair 2 of 3, voted left"
    press(browser, "ArrowDown")
    content = json.loads(browser.evaluate(SAVED))
    assert (content["format"], content["version"], content["page"]) == ("stylerf votes", 1, "02" * 32)
    assert [(vote["pair"], vote["choice"]) for vote in content["votes"]] == [(0, "right"), (1, "same")]
    browser.open(path, 1400, "light")  # votes outlast the tab
    assert browser.evaluate(PLACE) == "Pair 3 of 3"
    browser.evaluate('document.getElementById("right").click()')
    assert browser.evaluate('document.getElementById("done").hidden') is False
    assert browser.evaluate('document.getElementById("vote").hidden') is True
    assert browser.evaluate('document.getElementById("save").download') == "votes-02020202.json"
    press(browser, "ArrowRight")  # nothing is left to vote on
    assert [vote["choice"] for vote in json.loads(browser.evaluate(SAVED))["votes"]] == ["right", "same", "right"]
    assert browser.errors == []


def test_a_click_on_a_picture_is_one_vote(browser, tmp_path):
    path = tmp_path / "pairs.html"
    path.write_text(page_of_pairs(4), encoding="utf-8")
    browser.open(path, 1400, "light")
    for name in ("left", "right"):
        browser.evaluate(f'document.getElementById("{name}").click()')
    assert [one["choice"] for one in json.loads(browser.evaluate(SAVED))["votes"]] == ["left", "right"]
    assert browser.evaluate(PLACE) == "Pair 3 of 3"


def test_saved_votes_are_read(browser, tmp_path):
    """What the page saves is what `compare --votes` reads."""
    from stages.comparison.votes import Side, read_votes

    path, sides = tmp_path / "pairs.html", [Side(name, f"w/{name}", "w", "f") for name in ("a", "b")]
    path.write_text(page_of_pairs(3), encoding="utf-8")
    (tmp_path / "pairs").mkdir()
    key = {"contenders": [asdict(one) for one in sides],
           "pairs": {str(n): {"left": n % 2, "right": 1 - n % 2} for n in range(3)}}  # fmt: skip
    (tmp_path / "pairs" / f"{'03' * 32}.json").write_text(json.dumps(key))
    browser.open(path, 1400, "light")
    for name in ("ArrowLeft", "ArrowRight", "ArrowDown"):
        press(browser, name)
    (tmp_path / "votes.json").write_text(browser.evaluate(SAVED))
    found = read_votes([tmp_path / "votes.json"], tmp_path)
    assert [vote.winner and vote.winner.label for vote in found] == ["a", "a", None]
