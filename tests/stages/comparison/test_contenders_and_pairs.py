"""Which stylizations meet in which pairs, what they are called, and that the page does not tell which is which."""

import base64
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from schemas.errors import ArtifactStale, UsageError
from schemas.images import write_png
from schemas.work_folder import WorkFolder
from stages.comparison.contenders import contenders_of, labels_of
from stages.comparison.pairs import chosen_pairs, written_pairs
from stages.comparison.runs import fields_of, runs_of
from tests.stages import comparison_fixture as runs
from tests.stages import evaluation_fixture as made

POSITIONS = [-0.3, 0.0, 0.3]
TINTS = {"secret-red": (1.0, 0.2, 0.2), "secret-green": (0.2, 1.0, 0.2), "secret-blue": (0.2, 0.2, 1.0)}


def stylized(work: WorkFolder, scene, base, name: str, style, tint, **config):
    """A field whose frames are the scene in one color."""
    field = runs.stylized(work, scene, base, name, 20.0, {}, style=str(style), style_digest=style.stem, **config)
    cameras = [made.camera(x, f"photo_{i:02d}") for i, x in enumerate(POSITIONS)]
    seen = [made.look(view) for view in cameras]
    tinted = [replace(one, rgb=one.rgb.mean(-1, keepdims=True) * np.float32(tint)) for one in seen]
    made.make_frames(work, f"{name}-test", "test", cameras, tinted, field)
    return field


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pairs")
    style = folder / "starry.png"
    write_png(style, np.full((20, 30, 3), 90, np.uint8))
    work = WorkFolder(folder / "room")
    scene = made.make_scene(work, POSITIONS, depth=False)
    base = runs.fit(work, scene, "fit", 10.0, None)
    for rate, (name, tint) in enumerate(TINTS.items()):
        stylized(work, scene, base, name, style, tint, rate=rate)
    write_png(folder / "other.png", np.full((20, 30, 3), 20, np.uint8))
    stylized(work, scene, base, "other-style", folder / "other.png", (1, 1, 1), rate=0)
    runs.stylized(work, scene, base, "no-frames", 20.0, {}, style=str(style), style_digest="starry")
    return work


@pytest.fixture(scope="module")
def contenders(work):
    return contenders_of(runs_of([work])[0], fields_of([work]))


def test_contenders_are_named_by_what_differs(contenders):
    found, missing = contenders
    labels = {one.run.name: one.label for one in found}
    assert labels == {"secret-red": "arf, rate 0", "secret-green": "arf, rate 1", "secret-blue": "arf, rate 2",
                      "other-style": "arf, rate 0"}  # fmt: skip
    assert [gap.what for gap in missing] == ["room/no-frames"] and "stylerf eval" in missing[0].why


def test_two_of_the_same_name_get_that_of_their_field(contenders):
    run = contenders[0][0].run
    config = {"rate": 0.1, "style_digest": "a"}
    pair = [(run, config), (replace(run, name="other"), {**config, "style_digest": "b"})]
    assert labels_of(pair) == [f"arf ({run.name})", "arf (other)"]
    older = [(run, {"budget": "30s", "layers": ""}), (run, {"budget": "30s", "layers": "conv3", "coarse": 0.5})]
    assert labels_of(older) == ["arf", "arf, coarse 0.5, layers conv3"]
    usual = [(run, {"coarse": -1.0, "budget": "2m"}), (run, {"coarse": 0.5, "budget": "90s"})]
    assert labels_of(usual) == ["arf", "arf, budget 90s, coarse 0.5"]
    assert labels_of([(run, config), (replace(run, method="snerf"), config)]) == ["arf", "snerf"]


def test_pairs_are_within_a_group_balanced_and_shuffled(contenders):
    found, _ = contenders
    pairs = chosen_pairs(found, 60, seed=0)
    assert len(pairs) == 3 * len(POSITIONS)
    assert len({(frozenset((one.left, one.right)), one.view) for one in pairs}) == len(pairs)
    assert all(found[one.left].run.group == found[one.right].run.group for one in pairs)
    fewer = chosen_pairs(found, 6, seed=0)
    meetings = [frozenset((one.left, one.right)) for one in fewer]
    assert sorted(meetings.count(one) for one in {*meetings}) == [2, 2, 2]  # all of them before any a third time
    assert chosen_pairs(found, 60, 0) == pairs != chosen_pairs(found, 60, 1)
    sides = [(one.left < one.right) for seed in range(40) for one in chosen_pairs(found, 60, seed)]
    assert 0.4 < np.mean(sides) < 0.6  # no side is anyone's
    for first, second in {(min(one.left, one.right), max(one.left, one.right)) for one in pairs}:
        swaps = [one.left == first for one in pairs if {one.left, one.right} == {first, second}]
        assert abs(2 * sum(swaps) - len(swaps)) <= 1


@pytest.fixture(scope="module")
def page(work, tmp_path_factory):
    out = tmp_path_factory.mktemp("out")
    key = written_pairs([work], out, (), 60, seed=3)
    return out, key, (out / "pairs.html").read_text()


def data_of(page: str) -> dict:
    return json.loads(re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)[1])


def test_the_page_shows_what_its_key_says(page):
    out, key, text = page
    data = data_of(text)
    assert json.loads((out / "pairs" / f"{data['page']}.json").read_text()) == {
        name: value for name, value in key.items() if name != "missing"
    }
    for number, pair in enumerate(data["pairs"]):
        for side in ("left", "right"):
            name = key["contenders"][key["pairs"][str(number)][side]]["title"].removeprefix("room/")
            mean = decoded(data["pictures"][pair[side]]).mean((0, 1))
            assert np.argmax(mean) == np.argmax(TINTS[name])


def decoded(uri: str) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2]))).convert("RGB"))


def test_nothing_on_the_page_tells_what_made_a_picture(page, work):
    """Neither names nor metadata: all pictures of a view differ in their pixels alone."""
    _, key, text = page
    plain = re.sub(r"data:image/jpeg;base64,[A-Za-z0-9+/=]+", "", text)
    for word in ("secret", "room", "arf", "rate", "starry", *(one["field"] for one in key["contenders"])):
        assert not re.search(rf"\b{word}", plain), word
    for uri in data_of(text)["pictures"]:
        image = Image.open(io.BytesIO(base64.b64decode(uri.partition(",")[2])))
        assert {*image.info} <= {"jfif", "jfif_version", "jfif_unit", "jfif_density", "dpi"}
        assert not image.getexif() and "comment" not in image.info
    assert not re.search(r"https?:|@import", plain)


def test_the_same_seed_gives_the_same_bytes(page, work, tmp_path):
    _, key, text = page
    assert written_pairs([work], tmp_path, (), 60, seed=3)["page"] == key["page"]
    assert (tmp_path / "pairs.html").read_text() == text
    assert written_pairs([work], tmp_path, (), 60, seed=4)["page"] != key["page"]
    assert len([*(tmp_path / "pairs").iterdir()]) == 2  # votes on the first page can still be counted


def test_named_fields_alone_are_compared(work, tmp_path):
    key = written_pairs([work], tmp_path, ("secret-red", "room/secret-blue"), 60, seed=0)
    assert {one["title"] for one in key["contenders"]} == {"room/secret-red", "room/secret-blue"}
    with pytest.raises(UsageError, match="--of nowhere: unknown stylization; choose from no-frames"):
        written_pairs([work], tmp_path, ("nowhere",), 60, seed=0)
    with pytest.raises(ArtifactStale, match="no two stylizations"):
        written_pairs([work], tmp_path, ("secret-red", "other-style"), 60, seed=0)
