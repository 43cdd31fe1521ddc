"""Work folders of strangers: a sealed manifest proves nothing, names lead nowhere, links are not followed."""

import errno
import json
import os
import shutil

import pytest

from schemas import partial_artifact
from schemas.errors import ArtifactDamaged, StylerfError, WouldBeLost
from schemas.manifest import MANIFEST
from schemas.work_folder import Artifact, Recipe, WorkFolder, newest
from tests.schemas.test_work_folder import die_between_renames, make, recipe, reseal

DIGEST = "0" * 63 + "1"
LEAVES = (None, True, -1, 5, 1.5, 2**70, "", "x", "../x", [], {}, [5], {"a": 5})


def record(path, **changes):
    return {"path": path, "bytes": 7, "sha256": DIGEST, **changes}


@pytest.mark.parametrize(
    "path", ["../../out", "/etc/passwd", "sub/../../out", "a\n", "a\x1b[2J", "", ".", "sub//a.bin", "x" * 300, MANIFEST]
)
def test_a_listed_path_that_leaves_the_artifact_is_damage(tmp_path, path):
    artifact = make(WorkFolder(tmp_path))
    reseal(artifact, files=[record(path)])
    for use in (Artifact(artifact.path).verify, lambda: WorkFolder(tmp_path).copy(Artifact(artifact.path), "other")):
        with pytest.raises(ArtifactDamaged) as fault:
            use()
        assert str(fault.value).isprintable()
    assert sorted(os.listdir(tmp_path)) == ["field"]


def test_a_file_listed_twice_is_damage(tmp_path):
    artifact = make(WorkFolder(tmp_path))
    for twice in ("b.json", "B.JSON"):
        reseal(artifact, files=[record("b.json"), record(twice)])
        with pytest.raises(ArtifactDamaged, match="twice"):
            Artifact(artifact.path).verify()


@pytest.mark.parametrize("field", ["kind", "name", "stage", "revision", "recipe", "config", "inputs", "files", "seed",
                                   "device", "versions", "seconds", "peak_memory_mb", "created", "figures", "threads",
                                   "schema"])  # fmt: skip
def test_any_field_of_another_type_is_damage_or_no_matter(tmp_path, field):
    artifact = make(WorkFolder(tmp_path))
    whole = json.loads((artifact.path / MANIFEST).read_text())
    for value in LEAVES:
        reseal(artifact, **{**whole, field: value})
        try:
            again = Artifact(artifact.path)
            again.verify()
            made, as_written = again.manifest, value
            assert type(getattr(made, field)) is type(as_written) or field in ("seconds", "peak_memory_mb"), value
            assert (
                newest([again, again])
                and WorkFolder(tmp_path).artifacts()
                and WorkFolder(tmp_path).outdated(again) is not None
            )
        except StylerfError as fault:
            assert "\n" not in str(fault)


@pytest.mark.parametrize("depth", [500, 50_000])  # what json can parse, and what it cannot
def test_a_nested_manifest_is_damage(tmp_path, depth):
    artifact = make(WorkFolder(tmp_path))
    text = b'{"recipe": ' * depth + b"1" + b"}" * (depth - 1) + b', "self_sha256": "' + b"0" * 64 + b'"}'
    from schemas.manifest import sealed

    (artifact.path / MANIFEST).write_bytes(sealed(text))
    with pytest.raises(ArtifactDamaged, match="nested"):
        Artifact(artifact.path).verify()


def test_what_a_link_leads_to_is_no_part_of_an_artifact(tmp_path):
    artifact, elsewhere = make(WorkFolder(tmp_path)), tmp_path / "elsewhere"
    shutil.move(artifact.path / "sub", elsewhere)
    (artifact.path / "sub").symlink_to(elsewhere)
    with pytest.raises(ArtifactDamaged, match="sub is a link"):
        Artifact(artifact.path).verify()
    with pytest.raises(ArtifactDamaged, match="sub is a link"):
        artifact.file("sub/a.bin")
    (artifact.path / "sub").unlink()
    shutil.move(elsewhere, artifact.path / "sub")
    artifact.verify()
    (artifact.path / "more").symlink_to(tmp_path)  # a folder that nothing lists
    with pytest.raises(ArtifactDamaged, match="more is not part"):
        artifact.verify()


def test_only_listed_files_are_opened(tmp_path):
    artifact = make(WorkFolder(tmp_path))
    (artifact.path / "deformation.safetensors").write_bytes(b"unlisted")
    assert artifact.has("b.json") and not artifact.has("deformation.safetensors")
    with pytest.raises(ArtifactDamaged, match="lists no file"):
        artifact.file("deformation.safetensors")


@pytest.mark.parametrize("place", ["", "files", "checkpoint", "files/sub", "files/b.json"])
def test_a_run_does_not_go_on_through_a_link(tmp_path, place):
    begun, outside = WorkFolder(tmp_path / "work").begin("field", "fox", recipe()), tmp_path / "outside"
    (begun.path / "sub").mkdir()
    (begun.path / "b.json").write_text("{}")
    begun.release()
    target = begun.folder / place
    shutil.move(target, outside)
    target.symlink_to(outside)
    before = sorted(outside.rglob("*")), outside.stat().st_mtime_ns
    with pytest.raises(WouldBeLost, match="is a link"):
        WorkFolder(tmp_path / "work").begin("field", "fox", recipe())
    assert (sorted(outside.rglob("*")), outside.stat().st_mtime_ns) == before


def test_a_link_made_while_a_run_goes_on_is_not_finished(tmp_path):
    begun = WorkFolder(tmp_path).begin("field", "fox", recipe())
    (begun.path / "a").symlink_to("/etc/hostname")
    with pytest.raises(WouldBeLost, match="is a link"):
        begun.commit()


def test_a_run_that_cannot_be_read_is_not_given_up(tmp_path, monkeypatch):
    begun = WorkFolder(tmp_path).begin("field", "fox", recipe())
    (begun.checkpoint / "state").write_text("an hour's work")
    begun.release()
    with monkeypatch.context() as failing:
        failing.setattr(
            partial_artifact.Path, "read_bytes", lambda self: (_ for _ in ()).throw(OSError(errno.EIO, "I/O"))
        )
        with pytest.raises(OSError, match="I/O"):
            WorkFolder(tmp_path).begin("field", "fox", recipe())
    again = WorkFolder(tmp_path).begin("field", "fox", recipe())
    assert again.resumed and (again.checkpoint / "state").read_text() == "an hour's work"


def test_readers_see_the_older_one_where_a_kill_came_between_two_renames(tmp_path, monkeypatch):
    work = WorkFolder(tmp_path)
    old = make(work).digest
    die_between_renames(work, monkeypatch)
    assert not (tmp_path / "field" / "fox").exists()
    found = work.get("field", "fox")
    found.verify()
    assert (found.digest, found.name) == (old, "fox")
    assert [one.name for one in work.artifacts()] == ["fox"] and work.find("field", "f").digest == old
    assert work.up_to_date("field", "fox", recipe()).digest == old
    assert make(work).digest == old  # the next run puts it back first
    assert [one.path.name for one in work.artifacts()] == ["fox"]


def test_an_artifact_dated_in_the_future_is_not_the_newest(tmp_path):
    work = WorkFolder(tmp_path)
    wrong, right = make(work, "wrong"), make(work, "right")
    reseal(wrong, created="9999-12-31T00:00:00.000+00:00")
    assert [one.name for one in newest(work.artifacts())] == ["right", "wrong"]
    reseal(right, created="2020-01-01T02:00:00+02:00")
    reseal(wrong, created="2020-01-01T00:00:01+00:00")
    assert [one.name for one in newest(WorkFolder(tmp_path).artifacts())] == ["wrong", "right"]


def test_a_name_of_an_input_that_leads_elsewhere_is_damage(tmp_path):
    artifact = make(WorkFolder(tmp_path))
    reseal(artifact, inputs=[{"role": "scene", "kind": "scene", "name": "../../x", "digest": DIGEST}])
    with pytest.raises(ArtifactDamaged, match="name of an input"):
        WorkFolder(tmp_path).outdated(Artifact(artifact.path))


def test_a_disk_that_cannot_flush_folders_is_used_all_the_same(tmp_path, monkeypatch):
    from schemas import atomic_write

    def refuse(handle):
        raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(atomic_write.os, "fsync", refuse)
    make(WorkFolder(tmp_path)).verify()
    monkeypatch.setattr(atomic_write.os, "fsync", lambda handle: (_ for _ in ()).throw(OSError(errno.EIO, "I/O")))
    with pytest.raises(OSError, match="I/O"):
        make(WorkFolder(tmp_path), "other")


def test_a_file_that_changes_while_it_is_copied_gets_no_sound_seal(tmp_path, monkeypatch):
    work = WorkFolder(tmp_path)
    artifact = make(work)
    copyfile = shutil.copyfile

    def altering(source, target):
        copyfile(source, target)
        with open(target, "ab") as stream:
            stream.write(b"!")

    monkeypatch.setattr(shutil, "copyfile", altering)
    with pytest.raises(ArtifactDamaged, match="changed while being copied"):
        work.copy(artifact, "other")
    assert [one.name for one in work.artifacts()] == ["fox"]


def test_threads_are_recorded(tmp_path):
    begun = WorkFolder(tmp_path).begin("field", "fox", Recipe("toy", 1, {}, []))
    assert begun.commit(threads=2).manifest.threads == 2
    assert WorkFolder(tmp_path).copy(WorkFolder(tmp_path).get("field", "fox"), "copy").manifest.threads == 2
