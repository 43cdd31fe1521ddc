"""docs/artifacts.md lists every field, kind, channel and attribute on disk, docs/exit-codes.md every exit code."""

import re
from dataclasses import fields

import numpy as np
import OpenImageIO as oiio
import pytest

from schemas import errors, exr
from schemas.manifest import FileRecord, InputRef, Manifest
from schemas.migrations import CURRENT
from schemas.scene import BACKGROUNDS, LAYOUTS, Bounds, Scene, Skipped, Truth, View
from stylerf_cli import exit_codes
from tests.conftest import REPOSITORY

TEXT = (REPOSITORY / "docs" / "artifacts.md").read_text()
EXIT_CODES = (REPOSITORY / "docs" / "exit-codes.md").read_text()


def section(title: str) -> str:
    return re.search(rf"^## {title}\n(.*?)(?=^## |\Z)", TEXT, re.S | re.M).group(1)


def first_column(text: str) -> set[str]:
    return {name for row in re.findall(r"^\| (.+?) \|", text, re.M) for name in re.findall(r"`([^`]+)`", row)}


def test_manifest_fields_are_documented():
    documented = section("manifest.json")
    assert first_column(documented) == {item.name for item in fields(Manifest)} | {"self_sha256"}
    for kind in (InputRef, FileRecord):
        assert "`{" + ", ".join(item.name for item in fields(kind)) + "}`" in documented


def test_scene_fields_are_documented():
    documented = section("scene")
    wanted = {item.name for kind in (Scene, View) for item in fields(kind)}
    assert first_column(documented) == wanted
    for word in (*LAYOUTS, *BACKGROUNDS, *(item.name for kind in (Bounds, Skipped, Truth) for item in fields(kind))):
        assert re.search(rf"`[^`]*\b{word}\b[^`]*`", documented), word


@pytest.mark.parametrize("kind", CURRENT)
def test_kinds_and_schemas_are_documented(kind):
    assert f"| `{kind}` | {CURRENT[kind]} |" in section("The work folder")


def test_exr_channels_and_attributes_are_documented(tmp_path):
    plane = np.ones((2, 2))
    view = exr.ExrView(
        np.ones((2, 2, 3)), plane, plane, plane, np.eye(4), (2, 2, 1, 1), 1, 2, {"head": plane}, {"field": "x"},
        mattes={"head": plane},
    )  # fmt: skip
    exr.write_exr(tmp_path / "v.exr", view)
    source = oiio.ImageInput.open(str(tmp_path / "v.exr"))
    documented = first_column(section("Rendered views: OpenEXR"))
    generic = {"mask.head": "mask.<name>", "stylerf:field": "stylerf:<key>", "PixelAspectRatio": "pixelAspectRatio",
               "Software": "software"}  # fmt: skip
    ours = [name.name for name in source.spec().extra_attribs if not name.name.startswith(("oiio:", "openexr:"))]
    ours = ["cryptomatte/<key>/<field>" if name.startswith("cryptomatte/") else name for name in ours]
    generic |= {f"crypto_region00.{name}": "crypto_region00.R" for name in "GBA"}
    found = {generic.get(name, name) for name in [*source.spec().channelnames, *ours]} - {"compression"}
    assert found == documented
    assert f"{exr.FAR_Z:.0e}".replace("+", "") in section("Rendered views: OpenEXR")


def test_exit_codes_are_documented():
    documented = {int(code) for code in re.findall(r"^\| (\d+) \|", EXIT_CODES, re.M)}
    classes = [kind for kind in vars(errors).values() if isinstance(kind, type) and issubclass(kind, Exception)]
    used = {kind.exit_code for kind in classes} | {0, exit_codes.FAILED, exit_codes.BAD_INPUT, exit_codes.INTERRUPTED}
    assert documented == used
