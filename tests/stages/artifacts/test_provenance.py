"""What an artifact was made from: fields, edits and costs behind it, also where two replaced each other."""

import pytest

from schemas.work_folder import WorkFolder
from stages.artifacts.provenance import edit_behind, field_before, field_unstylized, fields_behind, upstream
from tests.stages import evaluation_fixture as made


@pytest.fixture
def circle(tmp_path) -> WorkFolder:
    """Fields `red` and `blue`, and scenes `a` and `b`, each made from the other before it was replaced."""
    work = WorkFolder(tmp_path)
    for kind, stage, names in (("field", "stylize", ("red", "blue", "red")), ("scene", "distill", ("a", "b", "a"))):
        inputs = {}
        for number, name in enumerate(names):
            config = {"number": number}
            inputs = {kind: made.commit(work, kind, name, stage, inputs, blank, config=config)}
    return work


def blank(folder) -> None:
    (folder / "numbers").write_bytes(b"\0")


def test_fields_that_replaced_each_other_end_every_walk(circle):
    blue, red = (circle.get("field", name) for name in ("blue", "red"))
    assert [one.name for one in fields_behind(blue)] == ["red"]
    assert [one.name for one in fields_behind(red)] == ["blue"]
    assert [one.name for one in upstream([blue])] == ["red", "blue"]
    assert edit_behind(circle.get("scene", "a")) is None


def test_what_was_made_again_is_remarked(circle):
    assert {one.name: one.remark for one in upstream([circle.get("field", "blue")])} == {
        "red": "rebuilt after field blue",
        "blue": "",
    }


def test_what_an_edit_and_a_stylization_began_with(tmp_path):
    """Behind palettes the field that they were learned of, behind a stylized one that from before its deformation."""
    work, field, before, unstylized = WorkFolder(tmp_path), None, {}, {}
    for name, stage in (
        ("fit", "nerf_fit"), ("head", "finetune"), ("palette", "decompose"), ("blue", "recolor"),
        ("green", "recolor"), ("foot", "finetune"), ("bent", "deform_init"), ("starry", "stylize"),
        ("starrier", "stylize"),
    ):  # fmt: skip
        field = made.make_field(work, name, stage, {"field": field} if field else {})
        before[name], unstylized[name] = (one and one.name for one in (field_before(field), field_unstylized(field)))
    assert before["fit"] is None and before["head"] == "fit" and before["foot"] == "green"
    assert before["palette"] == before["blue"] == before["green"] == "head"
    assert unstylized["starry"] == unstylized["starrier"] == "foot"
