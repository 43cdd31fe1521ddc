"""A page of the viewer in headless Chromium: what it shows, clicks, drags."""

import base64
import io
import time

import numpy as np
from PIL import Image

from tests.stages.report.browser import Browser

SOFTWARE_GL = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")

# The first is the browser's on how viser listens to a drag; the other three.js's on splats that are not there yet.
REMARKS = ("Unable to preventDefault inside passive event listener invocation.", "computeBoundingSphere")


class Tab:
    """A page of the viewer."""

    def __init__(self, browser: Browser) -> None:
        self.browser = browser

    @property
    def errors(self) -> list[str]:
        """What the page's console reports, without REMARKS."""
        return [text for text in self.browser.errors if not any(remark in text for remark in REMARKS)]

    def ready(self) -> bool:
        """Whether canvas and panels are there."""
        return self.browser.evaluate("Boolean(document.querySelector('canvas'))") and "Field" in self.words()

    def picture(self) -> np.ndarray:
        taken = base64.b64decode(self.browser.send("Page.captureScreenshot")["data"])
        return np.array(Image.open(io.BytesIO(taken)).convert("RGB"))

    def canvas(self) -> dict:
        return self.browser.evaluate(
            "(() => { const r = document.querySelector('canvas').getBoundingClientRect();"
            "return {x: r.x, y: r.y, width: r.width, height: r.height} })()"
        )

    def view(self) -> np.ndarray:
        """The middle of the canvas, which no panel covers."""
        box = self.canvas()
        x, y, w, h = (round(box[key]) for key in ("x", "y", "width", "height"))
        return self.picture()[y + h // 3 : y + 2 * h // 3, x + w // 3 : x + 2 * w // 3]

    def press(self, x: float, y: float, to: tuple[float, float] | None = None, modifiers: int = 0) -> None:
        """Click, or drag to another place, both in pixels of the page."""
        at = {"button": "left", "clickCount": 1, "modifiers": modifiers}
        self.browser.send("Input.dispatchMouseEvent", type="mouseMoved", x=x, y=y, modifiers=modifiers)
        self.browser.send("Input.dispatchMouseEvent", type="mousePressed", x=x, y=y, **at)
        for step in range(1, 6) if to else ():
            dx, dy = x + (to[0] - x) * step / 5, y + (to[1] - y) * step / 5
            self.browser.send("Input.dispatchMouseEvent", type="mouseMoved", x=dx, y=dy, buttons=1, modifiers=modifiers)
            time.sleep(0.03)
        end = to or (x, y)
        self.browser.send("Input.dispatchMouseEvent", type="mouseReleased", x=end[0], y=end[1], **at)

    def words(self) -> str:
        return self.browser.evaluate("document.body.innerText")

    def choose(self, text: str) -> None:
        """Click what shows exactly this text, once the page around it has come to rest."""
        last: list[float] | None = None

        def at_rest() -> bool:
            nonlocal last
            before, last = last, self._place(text)
            return last is not None and last == before

        assert until(at_rest), f"{text} is not on the page:\n{self.words()}"
        assert last is not None
        self.press(*last)

    def _place(self, text: str) -> list[float] | None:
        return self.browser.evaluate(
            "(() => { const e = [...document.querySelectorAll('button, [role=tab], [role=option]')]"
            f".filter(e => e.textContent.trim() == {text!r} && e.offsetParent).pop();"
            "if (!e) return null; e.scrollIntoView({block: 'center'}); const r = e.getBoundingClientRect();"
            "return [r.x + r.width / 2, r.y + r.height / 2] })()"
        )


def until(found, seconds: float = 20.0):
    """Wait for a condition; return what it returned last."""
    end = time.monotonic() + seconds
    while not (value := found()) and time.monotonic() < end:
        time.sleep(0.1)
    return value


def page_of(desk) -> int:
    """The number of the viewer's only page, once it is open."""
    assert until(lambda: list(desk.painter._pages))
    return next(iter(desk.painter._pages))
