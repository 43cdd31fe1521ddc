"""Tables: what is read, and one line for every fault."""

import json
from pathlib import Path

import pytest

from schemas.errors import UsageError
from stages.farm.jobs import fields_of, jobs_of
from stages.farm.table import Table, TableFaults, read_table
from stylerf_cli.verbs.farm import build


def written(folder: Path, **changed: object) -> Path:
    """A sound table with some keys changed; JSON is YAML too."""
    (folder / "night.png").write_bytes(b"")
    content: dict = {"scenes": {"fox": "photos"}, "styles": {"night": "night.png"}}
    file = folder / "table.yaml"
    file.write_text(json.dumps(content | changed))
    return file


def read(folder: Path, **changed: object) -> Table:
    return read_table(written(folder, **changed), build)


def faults(folder: Path, **changed: object) -> list[str]:
    with pytest.raises(TableFaults) as raised:
        read(folder, **changed)
    assert "\n" not in str(raised.value) and raised.value.exit_code == 2
    return raised.value.faults


def test_paths_are_relative_to_the_table(tmp_path):
    table = read(tmp_path)
    assert table.scenes[0].source == tmp_path / "photos" and table.styles == {"night": tmp_path / "night.png"}
    assert table.out == tmp_path / "table" and read(tmp_path, out="../there").out == tmp_path.parent / "there"


def test_a_scene_overrides_what_all_share(tmp_path):
    scenes = {"fox": "photos", "fern": {"source": "fern", "fit": {"budget": 40}, "eval": {"path": "spiral"}}}
    fox, fern = read(tmp_path, scenes=scenes, fit={"budget": "60s", "samples": 4096}, eval={"path": "orbit"}).scenes
    assert (fox.fit.budget, fox.path) == ("60s", "orbit")
    assert (fern.fit.budget, fern.fit.samples, fern.path) == ("40", 4096, "spiral")


def test_a_method_is_one_of_stylize_with_options(tmp_path):
    methods = {"desrf": None, "bold": {"method": "arf", "stroke": 2.0}}
    table = read(tmp_path, methods=methods, stylize={"budget": "9s"})
    assert [(one.method, one.stroke, one.budget) for one in table.methods.values()] == [
        ("desrf", 1.0, "9s"), ("arf", 2.0, "9s"),
    ]  # fmt: skip


def test_options_that_only_some_methods_have_may_be_shared(tmp_path):
    table = read(tmp_path, methods={"arf": {}, "desrf": {}}, stylize={"bend": 0.5})
    assert table.methods["desrf"].bend == 0.5


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"scene": {}}, "unknown key 'scene'"),
        ({"scenes": {}}, "scenes is empty"),
        ({"scenes": {"a/b": "photos"}}, "'a/b' is not a valid name"),
        ({"scenes": {"../x": "photos"}}, "not a valid name"),
        ({"scenes": {"farm": "photos"}}, "scenes: farm is a reserved folder name"),
        ({"scenes": {"fox": {"fit": {}}}}, "scenes: fox has no source"),
        ({"scenes": {"fox": "pho{to}s"}}, "Snakemake treats braces as wildcards"),
        ({"scenes": {"fox": {"source": "photos", "fitt": {}}}}, "scenes: fox has unknown key 'fitt'"),
        ({"styles": {"night": "day.png"}}, "styles: night is 'day.png'; expected the file of an image"),
        ({"methods": {"bold": {}}}, "methods: bold is not a method"),
        ({"methods": {"arf": {"stroke": "wide"}}}, "stroke takes a number"),
        ({"methods": {"arf": {"bend": 1.0}}}, "--bend is an option of --method desrf"),
        ({"methods": {"arf": {"style": "x.png"}}}, "names an image"),
        ({"methods": {"palettenerf": {}}}, "methods: palettenerf is not a method"),
        ({"fit": {"budgett": "60s"}}, "unknown option 'budgett'; did you mean 'budget'?"),
        ({"fit": {"budget": "soon"}}, "budget 'soon' is neither a time"),
        ({"fit": [1]}, "fit is [1]; expected a mapping"),
        ({"seeds": [0, 0]}, "list each seed once"),
        ({"seeds": [-1]}, "expected a whole number from 0"),
        ({"seeds": 3}, "seeds is 3; expected a list"),
        ({"seeds": [True]}, "is True; expected a whole number"),
        ({"threads": 0}, "threads is 0"),
        ({"device": "tpu"}, "device is 'tpu'; expected one of"),
        ({"out": "."}, "out is the folder of the table"),
        ({"container": "docker://x; rm -rf /"}, "expected an image"),
        ({"container": "docker://$(id)"}, "expected an image"),
        ({"render": {"path": "test", "shards": 2}}, "2 shards need an orbit"),
        ({"render": {"count": 4, "shards": 5}}, "5 shards need"),
        ({"render": {"frames": "0-1"}}, "use shards: N"),
        ({"eval": {"path": "test"}}, "expected a camera path"),
        ({"styles": {}, "methods": {"arf": {}}}, "methods need a style image"),
        ({"styles": {"a-b": "night.png", "a": "night.png"}, "methods": {"c": {"method": "arf"},
          "b-c": {"method": "arf"}}}, "would both be field a-b-c"),
    ],
)  # fmt: skip
def test_a_fault_is_one_line_that_says_where(tmp_path, changed, said):
    assert any(said in fault for fault in faults(tmp_path, **changed)), faults(tmp_path, **changed)


def test_all_faults_are_named_at_once(tmp_path):
    assert len(faults(tmp_path, seeds=[-1], threads=0, device="tpu")) == 3


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("scenes: {a: x}\nscenes: {b: y}", ":2: 'scenes' occurs twice"),
        ("a: &x [1]\nb: *x", "aliases"),
        ("a: !!python/object/apply:os.system [ls]", "could not determine a constructor"),
        ("[" * 3000, "nested too deeply"),
        ("- scenes", "expected a mapping"),
        ("a: [", "table.yaml:"),
        ("out: {{ folder }}", ":1: a key is a list or mapping"),
        ("? [a, b]\n: 1", ":1: a key is a list or mapping"),
        *((f"a: {text}", "table.yaml:") for text in ("!!timestamp x", '!!int ""', "!!bool x", "!!map [1]")),
        ("\ud800", ""),
    ],
)
def test_hostile_yaml_is_refused_in_one_line(tmp_path, text, said):
    file = tmp_path / "table.yaml"
    file.write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(UsageError) as raised:
        read_table(file, build)
    assert said in str(raised.value) and "\n" not in str(raised.value)


def test_a_missing_table_is_named(tmp_path):
    with pytest.raises(UsageError, match="table not found"):
        read_table(tmp_path / "none.yaml", build)


def test_every_job_comes_after_what_it_waits_for(tmp_path):
    table = read(
        tmp_path, methods={"arf": {}, "desrf": {}}, seeds=[0, 7], render={"count": 5, "shards": 2},
        eval={"path": "orbit"}, edits={"red": {"at": ["#0:1,1"], "recolor": True, "palette": ["0=#ff0000"]}},
    )  # fmt: skip
    jobs, seen = jobs_of(table), set()
    for key, job in jobs.items():
        assert set(job.after) <= seen, key
        seen.add(key)
    assert set(fields_of(table)) == {
        (job.scene, job.name) for job in jobs.values() if job.kind == "field" and job.rule != "deform"
    }


def evaluations(table) -> dict[str, list[str]]:
    """Arguments of evaluations by the name of the field."""
    return {job.name: [*job.argv] for job in jobs_of(table).values() if job.rule == "eval"}


def test_each_field_is_measured_by_what_it_can_be_measured_by(tmp_path):
    red = {"at": ["#0:1,1"], "recolor": True, "palette": ["0=#ff0000"]}
    found = evaluations(read(tmp_path, eval={"ceiling": 5, "train_views": True}, edits={"red": red}))
    assert "--ceiling" in found["night-arf-s0"] and "--train-views" not in found["night-arf-s0"]
    assert not {"--ceiling", "--train-views", "--region"} & {*found["fit-s0"]}
    edit = found["edit-red-s0"]
    assert edit[edit.index("--region") + 1] == "edit-red-s0" and "--train-views" in edit and "--ceiling" not in edit


def test_files_that_options_name_are_found_from_any_folder(tmp_path):
    for name in ("cameras.json", "head.png"):
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "orbit").mkdir()  # no camera file, although it has a path's name
    found = evaluations(read(tmp_path, eval={"path": "cameras.json", "reference": ["#0=head.png"]}))["night-arf-s0"]
    assert found[found.index("--path") + 1] == str(tmp_path / "cameras.json")
    assert found[found.index("--reference") + 1] == f"#0={tmp_path / 'head.png'}"
    renders = [job for job in jobs_of(read(tmp_path, render={"path": "orbit"})).values() if job.rule == "render"]
    assert not any(str(tmp_path) in word for job in renders for word in job.argv)


def test_two_jobs_never_write_the_same_artifact_at_once(tmp_path):
    """An evaluation renders the frames of the field before: only one job that is done first may do so."""
    jobs = jobs_of(read(tmp_path, methods={"arf": {}, "desrf": {}}))
    assert "fox/report/fit-s0" in jobs["fox/report/night-arf-s0"].after
    assert "fox/report/fit-deformed-s0" in jobs["fox/report/night-desrf-s0"].after


def test_shards_cover_every_frame_once(tmp_path):
    jobs = jobs_of(read(tmp_path, render={"count": 7, "shards": 3}))
    shards = [job for job in jobs.values() if job.rule == "shard" and "fit" in job.name]
    spans = [job.argv[job.argv.index("--frames") + 1] for job in shards]
    frames = [frame for span in spans for frame in range(int(span.split("-")[0]), int(span.split("-")[1]) + 1)]
    assert frames == list(range(7))
    assert set(jobs["fox/frames/fit-s0-orbit"].after) >= {job.key for job in shards}
