"""The store: artifacts are finished or absent, altered bytes are found, one writer at a time, old recipes resume."""

import errno
import json
import multiprocessing
import os
import shutil
import time
from pathlib import Path

import pytest

from schemas import lock, migrations, partial_artifact
from schemas.errors import ArtifactDamaged, ArtifactStale, OutOfResources, StylerfError, UsageError, WouldBeLost
from schemas.manifest import MANIFEST, InputRef
from schemas.work_folder import Artifact, Recipe, WorkFolder, sources_of


def recipe(**changes) -> Recipe:
    return Recipe(**{"stage": "toy", "revision": 1, "config": {"steps": 3}, "inputs": [], "seed": 0, **changes})


def make(work: WorkFolder, name="fox", kind="field", content=b"weights", made_of=None, **changes) -> Artifact:
    begun = work.begin(kind, name, made_of or recipe(**changes))
    (begun.path / "sub").mkdir(exist_ok=True)
    (begun.path / "sub" / "a.bin").write_bytes(content)
    (begun.path / "b.json").write_text("{}")
    return begun.commit(device="cpu", versions={"x": "1"}, seconds=1.5, peak_memory_mb=3, figures={"psnr": 27.1})


def test_a_finished_artifact_reads_back(tmp_path):
    artifact = make(WorkFolder(tmp_path))
    again = WorkFolder(tmp_path).get("field", "fox")
    assert again.digest == artifact.digest == again.manifest.digest
    assert [record.path for record in again.manifest.files] == ["b.json", "sub/a.bin"]
    assert again.manifest.figures == {"psnr": 27.1}
    assert again.file("sub/a.bin").read_bytes() == b"weights"
    assert sorted(os.listdir(tmp_path / "field")) == [".fox.lock", "fox"]
    again.verify()


def test_of_two_made_within_a_second_the_later_is_known(tmp_path):
    """What is made of "the last" of several looks at nothing else."""
    work, times = WorkFolder(tmp_path), []
    for name in ("b", "a", "c"):
        time.sleep(0.002)
        times.append(make(work, name).manifest.created)
    assert times == sorted(times) and len(set(times)) == 3
    # What earlier versions wrote counts as the beginning of its second.
    assert times[0].split(".")[0] + "+00:00" < times[0]


def test_digest_tells_content_recipe_and_kind_but_not_name(tmp_path):
    work = WorkFolder(tmp_path)
    base = make(work, "a").digest
    assert make(work, "b").digest == base
    assert make(work, "c", content=b"Weights").digest != base
    assert make(work, "d", seed=1).digest != base
    assert make(work, "e", kind="edit").digest != base


def test_a_copy_is_the_same_artifact_by_another_name_at_what_it_cost(tmp_path):
    work = WorkFolder(tmp_path)
    first, other = make(work), make(work, "den", content=b"other").digest
    copy = work.copy(first, "den")
    copy.verify()
    assert copy.name == "den" and copy.digest == first.digest != other
    assert (copy.manifest.seconds, copy.manifest.figures) == (1.5, {"psnr": 27.1})
    first.verify()
    moved = make(work, "moved", config={"path": "/here"}, incidental=["path"])
    assert work.copy(moved, "den").digest == moved.digest  # which knows nothing of the path that it tells
    held = work.begin("field", "den", recipe())
    with pytest.raises(OutOfResources, match="being written"):
        work.copy(first, "den")
    held.discard()
    assert sorted(os.listdir(tmp_path / "field")) == [".den.lock", ".fox.lock", ".moved.lock", "den", "fox", "moved"]


def test_an_artifact_whose_manifest_nobody_can_read_may_be_made_again(tmp_path):
    work = WorkFolder(tmp_path)
    (make(work).path / MANIFEST).write_text("{")
    again = make(work, seed=1)
    again.verify()
    assert again.manifest.seed == 1 and sorted(os.listdir(tmp_path / "field")) == [".fox.lock", "fox"]


@pytest.mark.parametrize("which", ["b.json", "sub/a.bin", MANIFEST])
def test_a_flipped_bit_anywhere_is_found(tmp_path, which):
    artifact = make(WorkFolder(tmp_path))
    path = artifact.path / which
    whole = path.read_bytes()
    for position in range(len(whole)):
        damaged = bytearray(whole)
        damaged[position] ^= 1 << position % 8
        path.write_bytes(damaged)
        with pytest.raises(ArtifactDamaged, match=which.rpartition("/")[2]):
            Artifact(artifact.path).verify()
    path.write_bytes(whole)
    artifact.verify()


def test_missing_shortened_and_additional_files_are_found(tmp_path):
    artifact = make(WorkFolder(tmp_path))
    (artifact.path / "sub" / "new.bin").write_bytes(b"")
    artifact.check_sizes()
    with pytest.raises(ArtifactDamaged, match=r"new.bin"):
        artifact.verify()
    (artifact.path / "sub" / "new.bin").unlink()
    (artifact.path / "sub" / "a.bin").write_bytes(b"weight")
    with pytest.raises(ArtifactDamaged, match="6 bytes, but 7"):
        artifact.check_sizes()
    (artifact.path / "sub" / "a.bin").unlink()
    with pytest.raises(ArtifactDamaged, match=r"lacks sub/a.bin.*run the command that made it with --force"):
        artifact.verify()
    (artifact.path / MANIFEST).unlink()
    with pytest.raises(ArtifactDamaged, match=r"no manifest.json"):
        Artifact(artifact.path).verify()


def test_what_desktops_leave_in_folders_is_no_part_of_an_artifact(tmp_path):
    begun = WorkFolder(tmp_path).begin("field", "fox", recipe())
    (begun.path / "sub").mkdir()
    for name in ("a.bin", ".DS_Store"):
        (begun.path / "sub" / name).write_bytes(b"x")
    artifact = begun.commit()
    (artifact.path / "sub" / ".DS_Store").unlink()
    for name in (".DS_Store", "._a.bin", "Thumbs.db", "desktop.ini", ".directory"):
        (artifact.path / "sub" / name).write_bytes(b"x")
    artifact.verify()
    assert [record.path for record in artifact.manifest.files] == ["sub/a.bin"]


@pytest.mark.parametrize(
    ("stage", "config", "command"),
    [
        ("nerf_fit", {}, "stylerf fit {work} --name fox --force"),
        ("stylize", {}, "stylerf stylize {work} --name fox --force"),
        ("distill", {}, "stylerf distill {work} --name fox --force"),
        ("pose_import", {"source": "my photos"}, "stylerf import 'my photos' {work} --name fox --force"),
    ],
)
def test_a_damaged_artifact_is_made_again_by_the_verb_that_made_it(tmp_path, stage, config, command):
    artifact = make(WorkFolder(tmp_path / "a folder"), stage=stage, config=config)
    (artifact.path / "b.json").write_text("[]")
    work = f"'{tmp_path}/a folder'"
    with pytest.raises(ArtifactDamaged) as caught:
        artifact.verify()
    assert command.format(work=work) in str(caught.value)
    assert f"stylerf show '{tmp_path}/a folder/field/fox'" in str(caught.value)


def test_absent_artifacts_come_with_the_command_that_makes_them(tmp_path):
    with pytest.raises(ArtifactStale, match="stylerf fit"):
        WorkFolder(tmp_path).get("field", "fox")
    with pytest.raises(ArtifactStale, match="stylerf import"):
        WorkFolder(tmp_path).find("scene", "fox")
    assert not list(tmp_path.iterdir())


def test_find_by_unique_prefix(tmp_path):
    work = WorkFolder(tmp_path)
    for name in ("starry", "start", "wave"):
        make(work, name)
    assert work.find("field", "w").name == "wave"
    assert work.find("field", "start").name == "start"
    for name in ("star", "x"):
        with pytest.raises(UsageError, match=r"starry, start, wave|start, starry, wave"):
            work.find("field", name)


@pytest.mark.parametrize("name", ["", ".a", "a/b", "../x", "a b", "x" * 101])
def test_unvalid_names_are_refused(tmp_path, name):
    with pytest.raises(UsageError):
        WorkFolder(tmp_path).begin("field", name, recipe())


def test_what_is_begun_again_goes_on_with_nothing_but_its_own(tmp_path):
    work = WorkFolder(tmp_path)
    first = work.begin("field", "fox", recipe())
    (first.checkpoint / "step").write_text("7")
    first.release()
    second = work.begin("field", "fox", recipe(), rebuild=True)
    assert not second.resumed and not (second.checkpoint / "step").exists()
    second.release()
    for rebuild in (True, False):  # killed, and asked for again in either way
        again = work.begin("field", "fox", recipe(), rebuild=rebuild)
        assert again.resumed
        again.release()


def test_a_copy_of_what_is_damaged_is_refused(tmp_path):
    work = WorkFolder(tmp_path)
    made = make(work)
    file = next(item for item in made.path.iterdir() if item.name != "manifest.json")
    data = bytearray(file.read_bytes())
    data[0] ^= 1
    file.write_bytes(data)
    with pytest.raises(ArtifactDamaged):
        work.copy(made, "other")
    assert [one.name for one in work.artifacts("field")] == [made.name]


def test_interrupted_run_resumes_only_for_the_same_recipe(tmp_path):
    work = WorkFolder(tmp_path)
    first = work.begin("field", "fox", recipe())
    assert not first.resumed
    (first.checkpoint / "step").write_text("7")
    (first.path / ".a.0123.tmp.png").write_bytes(b"half")
    first.release()
    assert work.artifacts() == [] and work.unfinished() == [("field", "fox")]

    second = work.begin("field", "fox", recipe())
    assert second.resumed and (second.checkpoint / "step").read_text() == "7"
    assert list(second.path.iterdir()) == []
    second.release()

    third = work.begin("field", "fox", recipe(seed=1))
    assert not third.resumed and not (third.checkpoint / "step").exists()
    third.discard()
    assert work.unfinished() == []


@pytest.mark.parametrize("ended_by", ["discard", "another recipe"])
def test_what_a_kill_leaves_of_a_deletion_is_not_resumed(tmp_path, monkeypatch, ended_by):
    work = WorkFolder(tmp_path)
    first = work.begin("field", "fox", recipe())
    (first.path / "a.png").write_text("")

    def half(folder, **_):
        (first.path / "a.png").unlink()
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(partial_artifact.shutil, "rmtree", half)
        if ended_by == "discard":
            first.discard()
        first.release()
        work.begin("field", "fox", recipe(seed=1))
    first.release()
    assert not work.begin("field", "fox", recipe()).resumed


def test_damaged_recipe_starts_afresh(tmp_path):
    first = WorkFolder(tmp_path).begin("field", "fox", recipe())
    (first.folder / "recipe.json").write_text("{")
    first.release()
    assert not WorkFolder(tmp_path).begin("field", "fox", recipe()).resumed


def test_an_unsound_recipe_starts_afresh(tmp_path):
    first = WorkFolder(tmp_path).begin("field", "fox", recipe())
    content = json.loads((first.folder / "recipe.json").read_text())
    (first.folder / "recipe.json").write_text(json.dumps(content | {"config": [], "run": "x"}))
    (first.folder / "clock.json").write_text('{"seconds": 1e6}')
    first.release()
    assert not WorkFolder(tmp_path).begin("field", "fox", recipe()).resumed


@pytest.mark.parametrize("added", ["comp.nk", "sub/retouched.exr"])
def test_what_no_run_wrote_is_not_deleted_with_what_is_replaced(tmp_path, added):
    work = WorkFolder(tmp_path)
    old = make(work)
    begun = work.begin("field", "fox", recipe(seed=1))
    (old.path / added).write_text("mine")
    (old.path / ".DS_Store").write_text("")
    with pytest.raises(WouldBeLost, match=f"{added} would be deleted .*; move it elsewhere"):
        begun.commit()  # saved while the run went on
    begun.release()
    with pytest.raises(WouldBeLost, match=added):
        work.begin("field", "fox", recipe(seed=2))
    assert (old.path / added).read_text() == "mine"
    (old.path / added).unlink()
    again = work.begin("field", "fox", recipe(seed=1))
    assert again.resumed and again.commit().manifest.seed == 1


def test_what_no_run_wrote_is_found_in_any_locale(tmp_path, monkeypatch):
    work = WorkFolder(tmp_path)
    partial = work.begin("frames", "fox", recipe())
    (partial.path / "caf\u00e9.png").write_bytes(b"frame")
    partial.commit()
    (tmp_path / "frames" / "fox" / "notes.txt").write_text("mine")
    read_text = Path.read_text
    monkeypatch.setattr(Path, "read_text", lambda path, encoding="ascii", errors=None: read_text(path, encoding))
    with pytest.raises(WouldBeLost, match=r"notes\.txt"):
        work.begin("frames", "fox", recipe(seed=1))


def test_foreign_folders_are_kept_and_damaged_artifacts_rebuilt(tmp_path):
    work, folder = WorkFolder(tmp_path), tmp_path / "field" / "fox"
    (folder / "scans").mkdir(parents=True)
    work.begin("field", "fox", recipe()).discard()  # nothing would be lost
    (folder / "scans" / "1.exr").write_text("mine")
    with pytest.raises(WouldBeLost, match=r"scans/1\.exr"):
        work.begin("field", "fox", recipe())
    shutil.rmtree(folder)
    folder.write_text("mine")
    with pytest.raises(WouldBeLost, match="field/fox would be deleted"):
        work.begin("field", "fox", recipe())
    folder.unlink()
    make(work)
    text = (folder / MANIFEST).read_text()
    (folder / MANIFEST).write_text(text.replace("27.1", "27.2"))
    with pytest.raises(ArtifactDamaged, match="altered"):
        Artifact(folder).verify()
    make(work).verify()


def test_a_dangling_link_is_reported_before_a_run_and_costs_no_result(tmp_path):
    work = WorkFolder(tmp_path)
    begun = work.begin("field", "fox", recipe())
    os.symlink(tmp_path / "gone", tmp_path / "field" / "fox")
    with pytest.raises(WouldBeLost, match="field/fox is a broken link"):
        begun.commit()
    begun.release()
    with pytest.raises(WouldBeLost, match="a broken link"):
        work.begin("field", "fox", recipe())
    (tmp_path / "field" / "fox").unlink()
    assert work.begin("field", "fox", recipe()).resumed


@pytest.mark.parametrize("exchange", [True, False])
def test_replacing_keeps_the_older_one_until_the_rename(tmp_path, monkeypatch, exchange):
    if not exchange:
        monkeypatch.setattr(partial_artifact, "_exchange", lambda one, other: False)
    work = WorkFolder(tmp_path)
    old = make(work)
    begun = work.begin("field", "fox", recipe(seed=1))
    (begun.path / "other.bin").write_bytes(b"new")
    old.verify()
    new = begun.commit()
    assert work.get("field", "fox").digest == new.digest != old.digest
    assert sorted(os.listdir(new.path)) == [MANIFEST, "other.bin"]
    assert sorted(os.listdir(tmp_path / "field")) == [".fox.lock", "fox"]


def die_between_renames(work: WorkFolder, monkeypatch) -> None:
    """Replaces field fox by another, without a way to swap the two, up to a death after the first of two renames."""
    begun = work.begin("field", "fox", recipe(seed=1))
    monkeypatch.setattr(partial_artifact, "_exchange", lambda one, other: False)
    rename = os.rename

    def die(source, target):
        if os.fspath(source).endswith("ready"):
            raise KeyboardInterrupt
        rename(source, target)

    monkeypatch.setattr(partial_artifact.os, "rename", die)
    with pytest.raises(KeyboardInterrupt):
        begun.commit()
    monkeypatch.undo()
    begun.release()


def test_a_death_between_the_two_renames_is_mended(tmp_path, monkeypatch):
    work = WorkFolder(tmp_path)
    old = make(work).digest
    die_between_renames(work, monkeypatch)
    again = work.begin("field", "fox", recipe(seed=1))
    assert again.resumed and work.get("field", "fox").digest == old
    assert again.commit().digest == work.get("field", "fox").digest != old
    assert not work.begin("field", "fox", recipe(seed=1)).resumed


def _hold(root, ready, done):
    begun = WorkFolder(root).begin("field", "fox", recipe())
    ready.set()
    done.wait(20)
    del begun


def test_a_second_writer_is_refused_until_the_first_ends(tmp_path):
    context = multiprocessing.get_context("fork")
    ready, done = context.Event(), context.Event()
    child = context.Process(target=_hold, args=(tmp_path, ready, done))
    child.start()
    assert ready.wait(20)
    with pytest.raises(OutOfResources, match=f"another process .{child.pid}"):
        WorkFolder(tmp_path).begin("field", "fox", recipe())
    WorkFolder(tmp_path).begin("field", "other", recipe()).discard()
    child.kill()
    child.join()
    WorkFolder(tmp_path).begin("field", "fox", recipe()).discard()


def test_a_disk_that_cannot_lock_is_not_taken_for_another_process(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

    monkeypatch.setattr(lock, "lock_descriptor", refuse)
    with pytest.raises(OutOfResources, match=r"\.fox\.lock cannot be locked .Function not implemented.") as caught:
        WorkFolder(tmp_path).begin("field", "fox", recipe())
    assert "another process" not in str(caught.value)


def test_standing_needs_the_recipe_and_whole_files(tmp_path):
    work = WorkFolder(tmp_path)
    artifact = make(work)
    assert work.up_to_date("field", "fox", recipe()).digest == artifact.digest
    assert work.up_to_date("field", "fox", recipe(config={"steps": 4})) is None
    assert work.up_to_date("field", "other", recipe()) is None
    (artifact.path / "b.json").write_text("")
    assert work.up_to_date("field", "fox", recipe()) is None


def test_recipe_ignores_input_names_and_order_but_not_roles_and_digests():
    one, two = InputRef("scene", "scene", "fox", "d1"), InputRef("field", "field", "fox", "d2")
    renamed = InputRef("scene", "scene", "den", "d1")
    assert recipe(inputs=[one, two]).digest == recipe(inputs=[two, renamed]).digest
    swapped = [InputRef("scene", "scene", "fox", "d2"), InputRef("field", "field", "fox", "d1")]
    assert recipe(inputs=[one, two]).digest != recipe(inputs=swapped).digest


def test_outdated_follows_inputs_to_the_scene(tmp_path):
    work = WorkFolder(tmp_path)
    scene = make(work, "fox", "scene")
    field = make(work, "fox", inputs=[scene.reference("scene")])
    frames = make(work, "turn", "frames", inputs=[field.reference("field")])
    assert work.outdated(frames) == []
    make(work, "fox", "scene", seed=5)
    assert work.outdated(frames) == ["scene fox was rebuilt after field fox"]
    shutil.rmtree(tmp_path / "scene" / "fox")
    assert work.outdated(field) == ["scene fox, from which fox was made, no longer exists"]


def test_artifacts_that_were_made_from_each_other_are_each_looked_at_once(tmp_path):
    work = WorkFolder(tmp_path)
    make(work, "a")
    make(work, "b", inputs=[work.get("field", "a").reference("field")])
    make(work, "a", inputs=[work.get("field", "b").reference("field")])
    assert work.outdated(work.get("field", "b")) == ["field a was rebuilt after field b"]
    assert [one.name for one in sources_of(work.get("field", "b"))] == ["a"]
    make(work, "b", inputs=[work.get("field", "b").reference("field")])
    assert work.outdated(work.get("field", "b")) == ["field b was rebuilt after field b"]


def test_sources_are_reported_nearest_first_and_of_the_kinds_asked_for(tmp_path):
    work = WorkFolder(tmp_path)
    scene = make(work, "fox", "scene")
    fit = make(work, "fit", inputs=[scene.reference("scene")])
    red = make(work, "red", inputs=[fit.reference("field"), scene.reference("scene")])
    assert [one.name for one in sources_of(red)] == ["fit", "fox"]
    assert [one.name for one in sources_of(red, ["field"])] == ["fit"]
    shutil.rmtree(tmp_path / "scene" / "fox")
    assert [one.name for one in sources_of(red)] == ["fit"]


def reseal(artifact, **changes):
    """Writes the manifest again as an honest writer of another version would."""
    import hashlib

    content = json.loads((artifact.path / MANIFEST).read_text()) | changes
    content["self_sha256"] = "0" * 64
    text = json.dumps(content, indent=1) + "\n"
    seal = hashlib.sha256(text.encode()).hexdigest()
    (artifact.path / MANIFEST).write_text(text.replace("0" * 64, seal))


def test_a_newer_schema_or_kind_is_refused(tmp_path):
    artifact = make(WorkFolder(tmp_path))
    reseal(artifact)
    Artifact(artifact.path).verify()
    reseal(artifact, schema=migrations.CURRENT["field"] + 1)
    with pytest.raises(ArtifactStale, match="newer stylerf"):
        Artifact(artifact.path).verify()
    assert WorkFolder(tmp_path).up_to_date("field", "fox", recipe()) is None
    reseal(artifact, schema=1, kind="hologram")
    with pytest.raises(ArtifactStale, match="newer stylerf"):
        Artifact(artifact.path).verify()


@pytest.mark.parametrize("changes", [{"schema": "1"}, {"schema": 0}, {"files": [{"path": "x"}]}, {"surprise": 1}])
def test_sealed_nonsense_is_damage_not_a_crash(tmp_path, changes):
    artifact = make(WorkFolder(tmp_path))
    reseal(artifact, **changes)
    with pytest.raises(StylerfError):
        Artifact(artifact.path).verify()


def test_old_schemas_migrate_step_by_step_and_keep_their_digest(tmp_path, monkeypatch):
    monkeypatch.setitem(migrations.CURRENT, "field", 1)
    artifact = make(WorkFolder(tmp_path))
    monkeypatch.setitem(migrations.CURRENT, "field", 3)
    monkeypatch.delitem(migrations.MIGRATIONS, ("field", 1))
    with pytest.raises(ArtifactStale, match="too old"):
        Artifact(artifact.path).verify()

    def rename(content, folder):
        content["figures"] = {"psnr_db": content["figures"]["psnr"], "folder": folder.name}
        return content

    monkeypatch.setitem(migrations.MIGRATIONS, ("field", 1), rename)
    monkeypatch.setitem(migrations.MIGRATIONS, ("field", 2), lambda content, folder: content)
    old = Artifact(artifact.path)
    old.verify()
    assert old.manifest.schema == 3
    assert old.manifest.figures == {"psnr_db": 27.1, "folder": "fox"}
    assert old.digest == artifact.digest


def test_a_name_that_differs_in_case_replaces_nothing(tmp_path, monkeypatch):
    """As on macOS and Windows, where the folder `fox` is found under the name `Fox` too; a link plays that part."""
    work = WorkFolder(tmp_path)
    make(work)
    (tmp_path / "field" / "Fox").symlink_to("fox")
    real = os.listdir
    monkeypatch.setattr(os, "listdir", lambda path: [name for name in real(path) if name != "Fox"])
    with pytest.raises(WouldBeLost, match="field fox would be replaced: on this disk Fox is the same name"):
        work.begin("field", "Fox", recipe())


def test_windows_refuses_artifacts_named_like_devices(tmp_path, monkeypatch):
    monkeypatch.setattr("schemas.safe_names.WINDOWS", True)
    with pytest.raises(UsageError, match=r"'nul\.v2' cannot name an artifact on Windows"):
        WorkFolder(tmp_path).begin("field", "nul.v2", recipe())
