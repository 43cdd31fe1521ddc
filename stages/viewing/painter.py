"""Paints pictures in a thread: small ones while the camera moves, exact ones once it is at rest.

The thread serves one page after another. A new pose or anything else to show interrupts the current picture.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from stages.viewing.cameras import FEWEST_PIXELS, Pose
from stages.viewing.pace import MOST_RAYS, Pace, use_threads
from stages.viewing.pictures import Mixtures, Painted, Quality, render
from stages.viewing.shown import Shown, picture_of
from stylerf.fields.marching import ScratchArena
from stylerf.rendering.interlaced import coarsest_within, in_batches, interlaced, spread_out

REST_SECONDS = 0.12  # without a new pose, after which the camera is considered at rest
FIRST_PASS_SECONDS = 0.35  # time that the first pass of an exact picture may take
LOADING_RAYS = 16  # that load the kernels
BATCH_SECONDS = 0.08  # between checks whether the picture is still wanted
MOVING = Quality(min_transmittance=1e-2, steps=2.0)  # while the camera moves
SLOW_SECONDS = 0.1  # time that recoloring all pixels of a picture may take; otherwise a quarter of them are recolored
FEWER = 0.8  # of the rays that would just keep the frame rate: sending takes time too


@dataclass(eq=False)
class Wanted:
    """What one page wants to show.

    Attributes:
        send: Receives pictures [h, w, 3] uint8, whether exact, and the stride of those that are not.
        pose, shown: None until known.
        changed: When either changed, on the painter's clock.
        painted: What was painted last, as (version, 0 while moving, 1 when exact).
        exact: The exact picture of what is wanted, once finished.
        kept: The last exact picture, for recoloring.
    """

    send: Callable[[np.ndarray, bool, int], None]
    pose: Pose | None = None
    shown: Shown | None = None
    changed: float = 0.0
    version: int = 0
    painted: tuple[int, int] = (-1, 0)
    exact: np.ndarray | None = field(default=None, repr=False)
    kept: Painted | None = field(default=None, repr=False)


class Painter:
    """Paints what pages want; see the module.

    Args:
        threads: CPU threads of the renderer.
        exact_pixels: of an exact picture.
        fps: pictures per second while the camera moves.
        clock: seconds; tests replace it.
        failed: receives errors of the thread, which continues.
    """

    def __init__(
        self,
        threads: int,
        exact_pixels: float,
        fps: float,
        clock: Callable[[], float] = time.monotonic,
        failed: Callable[[Exception], None] = lambda error: None,
    ) -> None:
        self._exact_pixels, self._fps, self._clock = exact_pixels, fps, clock
        self._failed = failed
        self._pages: dict[int, Wanted] = {}
        self._ready = threading.Condition()
        self._ended = False
        self._loading: Callable[[], object] = lambda: None
        self._arena = ScratchArena()
        self._thinned = 1  # stride of recolored pixels
        self.pace = Pace(threads)
        self._thread = threading.Thread(target=self._work, name="painter", daemon=True)

    def start(self, first: Shown | None = None, pose: Pose | None = None) -> None:
        """Start painting.

        Args:
            first, pose: what a page will request first; its kernels are loaded while that page opens.
        """
        if first is not None and pose is not None and pose.sound():
            camera = pose.camera(FEWEST_PIXELS)
            self._loading = partial(render, camera, first, np.arange(LOADING_RAYS), 1, self._arena)
        self._thread.start()

    def stop(self) -> None:
        """End the thread after its current batch of rays."""
        with self._ready:
            self._ended = True
            self._ready.notify_all()
        if self._thread.is_alive():
            self._thread.join(10)

    def open(self, page: int, send: Callable[[np.ndarray, bool, int], None]) -> None:
        """Add a page."""
        with self._ready:
            self._pages[page] = Wanted(send)

    def close(self, page: int) -> None:
        """Remove a page."""
        with self._ready:
            self._pages.pop(page, None)

    def move(self, page: int, pose: Pose, drawn: bool = False) -> None:
        """Record the pose of a page's camera. drawn: the page itself draws what is seen as it moves."""
        with self._ready:
            wanted = self._pages.get(page)
            if wanted is not None and wanted.pose != pose:
                wanted.pose = pose
                self._touch(wanted)
                if drawn:
                    wanted.painted = (wanted.version, 0)

    def show(self, shown: Shown | None) -> None:
        """Show something else on every page; None: nothing."""
        with self._ready:
            for wanted in self._pages.values():
                if wanted.shown is not shown:
                    wanted.shown = shown
                    self._touch(wanted)

    def pose(self, page: int) -> Pose | None:
        """Return the pose of a page's camera, None if not reported yet."""
        with self._ready:
            return self._pages[page].pose if page in self._pages else None

    def exact(self, page: int) -> np.ndarray | None:
        """Return the exact picture of what the page shows now; None if it is not finished."""
        with self._ready:
            wanted = self._pages.get(page)
            return wanted.exact if wanted is not None and wanted.painted == (wanted.version, 1) else None

    def resting(self) -> bool:
        """Return whether pages are open and all of them show exact pictures."""
        with self._ready:
            return bool(self._pages) and all(one.painted == (one.version, 1) for one in self._pages.values())

    def _touch(self, wanted: Wanted) -> None:
        wanted.version += 1
        wanted.changed = self._clock()
        wanted.exact = None
        self._ready.notify_all()

    def _work(self) -> None:
        try:
            self._loading()
        except Exception as error:
            self._failed(error)
        while True:
            with self._ready:
                if self._ended:
                    return
                chosen = self._choose()
                if chosen is None:
                    self._ready.wait(self._pause())
                    continue
                wanted, exact = chosen
                version, pose, shown = wanted.version, wanted.pose, wanted.shown
            try:
                assert pose is not None and shown is not None
                if exact:
                    self._paint_exact(wanted, version, pose, shown)
                else:
                    self._paint_moving(wanted, version, pose, shown)
            except Exception as error:  # a closed page, a field that cannot be rendered
                self._failed(error)
                with self._ready:
                    wanted.painted = (version, 1)

    def _choose(self) -> tuple[Wanted, bool] | None:
        """Return the page to paint for, and whether exactly; None if all are painted or still moving."""
        now = self._clock()
        open_ones = [one for one in self._pages.values() if one.pose is not None and one.shown is not None]
        for wanted in sorted(open_ones, key=lambda one: -one.changed):
            if wanted.painted[0] != wanted.version:
                return wanted, False
            if wanted.painted == (wanted.version, 0) and now - wanted.changed >= REST_SECONDS:
                return wanted, True
        return None

    def _pause(self) -> float | None:
        """Return the time until a camera is considered at rest, None if none moves."""
        moving = [one.changed for one in self._pages.values() if one.painted == (one.version, 0)]
        return max(0.005, min(moving) + REST_SECONDS - self._clock()) if moving else None

    def _paint_moving(self, wanted: Wanted, version: int, pose: Pose, shown: Shown) -> None:
        if wanted.kept is not None and wanted.kept.recolors_to(pose, shown):
            use_threads(1)  # short steps: waiting for a second thread takes longer than it saves
            began = time.perf_counter()
            wanted.send(wanted.kept.recolored(shown, self._thinned), False, 1)
            seconds = time.perf_counter() - began
            self._thinned = 2 if seconds > SLOW_SECONDS else 1 if seconds < SLOW_SECONDS / 8 else self._thinned
            with self._ready:
                wanted.painted = (version, 0)
            return
        camera = pose.camera(min(self.pace.moving / self._fps * FEWER, self._exact_pixels))
        pixels = np.arange(camera.width * camera.height)
        with self.pace.in_motion(len(pixels)) as threads:
            rendered = [  # in batches: each ray uses separate pages in every array of its samples
                render(camera, shown, batch, threads, self._arena, MOVING)
                for batch in in_batches(pixels, MOST_RAYS, lambda: self._ended)
            ]
        if self._ended:
            return
        out = np.concatenate(rendered).reshape(camera.height, camera.width, 6)
        wanted.send(picture_of(shown, camera, out), False, 1)
        with self._ready:
            wanted.painted = (version, 0)

    def _paint_exact(self, wanted: Wanted, version: int, pose: Pose, shown: Shown) -> None:
        camera = pose.camera(self._exact_pixels)
        count = camera.width * camera.height
        out = np.zeros((count, 6), np.float32)
        # A picture that was recolored is better than a coarse one: nothing is sent before the exact one.
        recolored = wanted.kept if wanted.kept is not None and wanted.kept.recolors_to(pose, shown) else None
        mixtures = None if recolored else Mixtures.room_for(camera, shown)

        def stopped() -> bool:
            return wanted.version != version or self._ended

        for stride, pixels in interlaced(
            camera.width, camera.height, coarsest_within(count, self.pace.rate * FIRST_PASS_SECONDS)
        ):
            for batch in in_batches(pixels, self.pace.rays_within(BATCH_SECONDS), stopped):
                with self.pace.exactly(len(batch)) as threads:
                    out[batch] = render(camera, shown, batch, threads, self._arena, mixtures=mixtures)
            if stopped():
                return
            if recolored and stride > 1:
                continue
            grid = spread_out(out.reshape(camera.height, camera.width, 6), stride)
            picture = picture_of(shown, camera, grid)
            with self._ready:
                if stopped():
                    return
                if stride == 1:
                    wanted.painted, wanted.exact = (version, 1), picture
                    wanted.kept = Painted(pose, shown, camera, grid, recolored.mixtures if recolored else mixtures)
            wanted.send(picture, stride == 1, stride)
