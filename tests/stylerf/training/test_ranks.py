"""Two processes that train together against one with both their rays; parts, sums, and a process that is lost."""

import json

import numpy as np
import pytest

from stylerf.training.ranks import ALONE
from tests.ranks import start
from tests.stylerf.training import two_ranks


@pytest.fixture(scope="module")
def together(tmp_path_factory) -> dict[str, dict[str, np.ndarray]]:
    """What each of two processes came to."""
    folder = tmp_path_factory.mktemp("ranks")
    processes = start(2, "tests.stylerf.training.two_ranks", str(folder), folder=folder)
    assert [process.wait(240) for process in processes] == [0, 0], (folder / "err0").read_text()
    return {path.stem: dict(np.load(path)) for path in sorted(folder.glob("*.npz"))}


@pytest.mark.parametrize("kind", ["fit", "tune"])
def test_two_processes_end_as_one_with_the_rays_of_both(together, kind):
    """Bit for bit where both add as many buffers: a chunk each, two chunks of one process; the curve is among it."""
    alone = {"fit": two_ranks.fitted, "tune": two_ranks.tuned}[kind](2)
    state = json.loads(str(alone["state"]))
    assert len(state["curve"]) > 1 and state["step"] in (280, 20)
    if kind == "fit":
        assert [text.split()[1] for text in state["decisions"]] == ["dropped:"] and state["rays"] > 256
    for place in (0, 1):
        found = together[f"{kind}{place}"]
        assert found.keys() == alone.keys()
        for name, values in alone.items():
            assert np.array_equal(found[name], values), (place, name)


def test_one_process_has_it_all():
    values, buffers = np.arange(3.0), np.ones((2, 4))
    ALONE.add(values)
    ALONE.add_gradients(buffers)
    assert ALONE.own(7) == slice(0, 7) and ALONE.of_first(2.5) == 2.5 and ALONE.checkpoint(None) is None
    assert values.tolist() == [0, 1, 2] and (buffers == 1).all()
