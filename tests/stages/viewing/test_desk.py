"""The desk: what a run has made is shown, and nothing else instead."""

from types import SimpleNamespace

import pytest

from stages.artifacts.field import save_field
from tests.stages import evaluation_fixture as made


@pytest.mark.parametrize("code", [0, 130])
def test_the_field_that_a_run_has_made_is_shown(desk, code):
    work = desk.library.work
    newest = desk.library.first_field()
    desk.display.look(field=next(name for name in desk.library.fields() if name != newest))
    before = desk.display.field
    desk.showing_its_field()(SimpleNamespace(code=code))
    assert desk.display.field == before, "a run that makes no field leaves the page as it is"
    ended, field = desk.showing_its_field(), desk.library.source("plain").field
    inputs = {"scene": work.get("scene", "wall")}
    made.commit(work, "field", "new", "nerf_fit", inputs, lambda folder: save_field(folder, field, "none"))
    assert desk.library.first_field() == "new"
    ended(SimpleNamespace(code=code))
    assert desk.display.field == ("new" if code == 0 else before)
