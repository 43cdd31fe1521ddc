"""Runs as manifests and reports tell them: families, costs, groups, fronts, what is missing."""

import shutil
from datetime import datetime

import pytest

from schemas import partial_artifact
from schemas.work_folder import WorkFolder
from stages.comparison.page import build_page, comparison_charts, group_style, rows_of
from stages.comparison.pareto_fronts import disagreements, on_fronts, panel_of
from stages.comparison.runs import CHARTED, EDITS, FITS, STYLIZATIONS, runs_of, unlike_machines
from tests.stages import comparison_fixture as runs
from tests.stages import evaluation_fixture as made

STYLE = {"sifid": 0.3, "edges_kept": 0.5, "short_rmse": 0.02, "long_rmse": 0.04}


@pytest.fixture
def work(tmp_path):
    work = WorkFolder(tmp_path / "room")
    scene = made.make_scene(work, [0.0], depth=False)
    small = runs.fit(work, scene, "fit-10s", 10.0, 25.0, parameters=100, memory=300.0)
    runs.fit(work, scene, "fit-60s", 60.0, 24.0, parameters=900, memory=400.0)  # beaten in everything
    runs.fit(work, scene, "fit-300s", 300.0, 30.0, parameters=900, memory=200.0)
    inputs = {"scene": scene, "field": small}
    deformed = made.make_field(work, "bent", "deform_init", inputs, seconds=7.0, peak_memory_mb=2000)
    runs.stylized(work, scene, small, "starry-arf", 20.0, STYLE)
    runs.stylized(work, scene, deformed, "starry-desrf", 30.0, STYLE | {"sifid": 0.2}, method="desrf")
    edit = {"background_mse": 0.001, "bleeding": 0.1, "sparsity": 0.5, "short_rmse": 0.01, "edit_short_rmse": 0.03}
    runs.edited(work, scene, small, "cup", (1.0, 2.0, 4.0, 8.0), edit)
    return work


def found(work, *others):
    runs_found, gaps = runs_of([work, *others])
    return {run.name: run for run in runs_found}, gaps


def test_families_and_costs_are_those_of_the_manifests(work):
    by_name, gaps = found(work)
    assert {name: run.family for name, run in by_name.items()} == {
        "fit-10s": FITS, "fit-60s": FITS, "fit-300s": FITS, "starry-arf": STYLIZATIONS, "starry-desrf": STYLIZATIONS,
        "cup": EDITS,
    }  # fmt: skip
    assert gaps == []
    costs = {name: tuple(run.costs.values()) for name, run in by_name.items()}
    assert costs["fit-300s"] == (300.0, 200.0, 900)
    assert costs["starry-arf"] == (20.0, 900.0, 2000)  # without the fit
    assert costs["starry-desrf"] == (37.0, 2000.0, 2000)  # with the deformation, whose memory is the greatest
    assert costs["cup"] == (15.0, 1500.0, 3000)  # extract to finetune, without fit and selection
    assert by_name["cup"].stages == ("edit_dataset", "edit_learn", "distill", "finetune")
    assert by_name["starry-desrf"].group == "room, starry.jpg" and by_name["cup"].group == "room, cup"
    assert by_name["fit-60s"].settings == "60s, grow" and by_name["starry-desrf"].method == "desrf"


def test_consistency_over_few_pixels_is_on_no_front(work):
    scene, base = work.get("scene", "wall"), work.get("field", "fit-10s")
    figures = STYLE | {"short_rmse": 0.001, "short_share": 0.036, "long_share": 0.2}
    runs.stylized(work, scene, base, "few", 5.0, figures, budget="5s")
    every = list(found(work)[0].values())
    fronts = on_fronts(every, ["short_rmse", "long_rmse"])["room/few"]
    assert "long_rmse/seconds" in fronts and not any(one.startswith("short") for one in fronts)
    assert any(run.name == "few" for run in panel_of(every, "short_rmse", "seconds").runs)  # it is drawn all the same
    (reported,) = disagreements(every, ["short_rmse", "long_rmse"])
    assert reported.what == "room/few: short_rmse" and reported.why.startswith("Measured on only 3.6% of the pixels")


def test_a_changed_palette_is_an_edit_that_costs_what_its_learning_did(work):
    inputs = {"scene": work.get("scene", "wall"), "field": work.get("field", "fit-10s")}
    learned = made.make_field(work, "palette", "decompose", inputs, seconds=60.0, peak_memory_mb=700)
    figures = {"parameters": 5000}
    given = {"seconds": 2.0, "peak_memory_mb": 300, "figures": figures}
    made.make_field(work, "blue", "recolor", {**inputs, "field": learned}, **given)
    by_name, gaps = found(work)
    assert "palette" not in by_name and by_name["blue"].family == EDITS and by_name["blue"].method == "palettenerf"
    assert tuple(by_name["blue"].costs.values()) == (62.0, 700.0, 5000)
    assert any("eval" in gap.why and "--region" in gap.why for gap in gaps)


def test_fields_that_replaced_each_other_cost_what_each_of_them_did(tmp_path):
    work = WorkFolder(tmp_path / "room")
    inputs = {"scene": made.make_scene(work, [0.0], depth=False)}
    for seconds, name in ((1.0, "red"), (2.0, "blue"), (4.0, "red")):
        field = made.make_field(work, name, "recolor", inputs, seconds=seconds, peak_memory_mb=100.0)
        inputs = inputs | {"field": field}
    by_name, _ = found(work)
    assert {name: run.costs["seconds"] for name, run in by_name.items()} == {"red": 6.0, "blue": 6.0}


def test_an_edit_of_an_edit_and_of_a_stylized_field_costs_what_these_did(work):
    """Whatever field it began with, all that was made since the fit counts, and the fit does not."""
    scene = work.get("scene", "wall")
    runs.edited(work, scene, work.get("field", "cup"), "saucer", (1.0, 2.0, 4.0, 8.5), {})
    runs.edited(work, scene, work.get("field", "starry-desrf"), "moon", (1.0, 2.0, 4.0, 9.0), {})
    made.make_field(
        work, "twice", "stylize", {"scene": scene, "field": work.get("field", "starry-arf")}, seconds=3.0,
        peak_memory_mb=1.0, figures={"parameters": 1}, config={"method": "arf"},
    )  # fmt: skip
    seconds = {name: run.costs["seconds"] for name, run in found(work)[0].items()}
    assert (seconds["saucer"], seconds["moon"], seconds["twice"]) == (15.5 + 15.0, 16.0 + 37.0, 3.0 + 20.0)


def test_a_metric_is_that_of_the_newest_report_with_it(work, monkeypatch):
    """A later and smaller evaluation of an edit, without its region, takes nothing away; another region's is not
    mixed in."""
    field, region = work.get("field", "cup"), work.get("region", "cup")
    other = made.commit(work, "region", "other", "region_select", {}, lambda at: (at / "b").write_text("b"))
    for minute, name, figures, regions in (
        (1, "full", {"background_mse": 0.002, "bleeding": 0.2, "short_rmse": 0.05}, [region]),
        (2, "again", {"background_mse": 0.003}, [region]),
        (3, "small", {"psnr": 20.0, "short_rmse": 0.04}, []),
        (0, "elsewhere", {"sparsity": 9.0, "content_ssim": 9.0}, [other]),
    ):
        created(monkeypatch, minute)
        reported = {"regions": [one.name for one in regions]} if regions else None
        runs.report(work, field, figures, reported, name=name, regions=regions)
    shutil.rmtree(work.root / "report" / "cup")
    run = found(work)[0]["cup"]
    means = {key: measure.mean for key, measure in run.metrics.items()}
    assert means == {"background_mse": 0.003, "bleeding": 0.2, "short_rmse": 0.04, "psnr": 20.0}
    assert run.group == "room, cup"
    created(monkeypatch, 4)
    runs.report(work, field, {"bleeding": 0.9}, {"regions": ["other"]}, name="latest", regions=[other])
    run = found(work)[0]["cup"]
    assert run.group == "room, other" and "background_mse" not in run.metrics
    assert run.metrics["bleeding"].mean == 0.9 and run.metrics["sparsity"].mean == 9.0


def created(monkeypatch, minute: int) -> None:
    """What is made from now on says that it was made at this minute."""

    class Clock(datetime):
        @classmethod
        def now(cls, tz=None):
            return datetime(2030, 1, 1, 0, minute, tzinfo=tz)

    monkeypatch.setattr(partial_artifact, "datetime", Clock)


def test_views_left_out_and_other_numbers_of_views_share_no_front(work):
    field = work.get("field", "fit-10s")
    runs.report(work, field, {"psnr": 99.0}, changed={"count": 2, "left_out": 1})
    every = list(found(work)[0].values())
    fronts = on_fronts(every, ["psnr"])
    assert not fronts["room/fit-10s"] and "psnr/seconds" in fronts["room/fit-60s"]
    reported = {gap.what: gap.why for gap in disagreements(every, ["psnr"])}
    assert reported["room/fit-10s: psnr"] == "1 of 3 views or pairs could not be measured."
    assert reported["room: psnr"].startswith("Measured over 2 and 3 views or pairs")
    runs.report(work, field, {"psnr": 99.0}, changed={"count": 2})
    fronts = on_fronts(list(found(work)[0].values()), ["psnr"])
    assert "psnr/seconds" in fronts["room/fit-10s"] and "psnr/seconds" in fronts["room/fit-300s"]


def test_metrics_of_other_networks_or_protocols_stay_apart(work):
    """Another network has a column of its own; another protocol within a group a letter, and a line in the table."""
    scene, base = work.get("scene", "wall"), work.get("field", "fit-10s")
    for name, changed in (("a", {}), ("b", {"label": "Ref-LPIPS (lpips-vgg)"}), ("c", {"protocol": "by <hand>"})):
        field = runs.stylized(work, scene, base, name, 20.0, {}, budget=name)
        runs.report(work, field, {"ref_lpips": 0.7}, changed=changed)
    some, gaps = runs_of([work])
    page = build_page(some, [], gaps, {run.title: [] for run in some})
    assert "Ref-LPIPS (lpips-alex) (lower" in page and "Ref-LPIPS (lpips-vgg) (lower" in page
    assert page.count("0.7000") == 3 and page.count("<sup") == 3
    assert '<sup title="by &lt;hand&gt; Views or pairs: 3.">b</sup>' in page and page.count(">a</sup>") == 2
    assert any(gap.what.endswith("ref_lpips") and "2 protocols" in gap.why for gap in disagreements(some, []))
    row = next(row for row in rows_of(some, {run.title: [] for run in some}) if row["name"] == "c")
    assert (row["ref_lpips"], row["ref_lpips_protocol"], row["ref_lpips_count"]) == (0.7, "by <hand>", 3)


@pytest.mark.parametrize(
    "unsound", [{"style": "", "reference": 5}, {"style": "", "reference": [1]}, {"style_digest": [2]}]
)
def test_unsound_options_of_a_run_leave_the_others(work, unsound):
    scene, base = work.get("scene", "wall"), work.get("field", "fit-10s")
    runs.stylized(work, scene, base, "odd", 20.0, STYLE, **unsound)
    by_name, gaps = found(work)
    assert "odd" not in by_name and "starry-arf" in by_name
    assert [gap.what for gap in gaps if "does not hold valid options" in gap.why] == ["room/odd"]


def test_no_two_groups_look_alike():
    assert len({group_style(place) for place in range(28)}) == len({group_style(place)[0] for place in range(28)}) == 28


def test_fronts_are_those_of_the_group(work):
    by_name, _ = found(work)
    some = [run for run in by_name.values() if run.family == FITS]
    fronts = on_fronts(some, ["psnr"])
    assert fronts["room/fit-10s"] == ["psnr/seconds", "psnr/parameters"]
    assert fronts["room/fit-60s"] == []
    assert fronts["room/fit-300s"] == ["psnr/seconds", "psnr/peak_memory_mb", "psnr/parameters"]
    panel = panel_of([run for run in by_name.values() if run.family == STYLIZATIONS], "sifid", "seconds")
    assert [[run.name for run in front] for front in panel.fronts] == [["starry-arf", "starry-desrf"]]
    assert panel_of(some, "sifid", "seconds") is None


def test_scenes_and_protocols_do_not_share_a_front(work, tmp_path):
    other = WorkFolder(tmp_path / "other")
    scene = made.make_scene(other, [0.1], depth=False)
    runs.fit(other, scene, "better", 1.0, 50.0)
    some, _ = runs_of([work, other])
    assert on_fronts(some, ["psnr"])["room/fit-10s"] == ["psnr/seconds", "psnr/parameters"]
    assert disagreements(some, ["psnr"]) == []
    runs.report(work, work.get("field", "fit-10s"), {"psnr": 25.0}, protocol="another way")
    some, _ = runs_of([work, other])
    reported = disagreements(some, ["psnr"])
    assert [gap.what for gap in reported] == ["room: psnr"] and "2 protocols" in reported[0].why
    assert "psnr/seconds" in on_fronts(some, ["psnr"])["room/fit-60s"]  # the faster one no longer counts against it


def test_the_same_scene_in_two_folders_is_one_group(work, tmp_path):
    again = WorkFolder(tmp_path / "a" / "room")
    scene = made.make_scene(again, [0.0], depth=False)
    runs.fit(again, scene, "fit-5s", 5.0, 20.0)
    some, _ = runs_of([work, again])
    names = {run.title: run.group for run in some if run.family == FITS}
    assert names["a/room/fit-5s"] == names[f"{tmp_path.name}/room/fit-10s"] == f"{tmp_path.name}/room"


def test_groups_are_known_by_content_and_called_by_names(work):
    """Two paintings of one file name, one painting under two names; reference pictures; masks; regions."""
    scene, base = work.get("scene", "wall"), work.get("field", "fit-10s")
    for name, config in {
        "a": {"style": "/one/starry.jpg", "style_digest": "1" * 64},
        "b": {"style": "/other/starry.jpg", "style_digest": "2" * 64},
        "c": {"style": "/other/night.jpg", "style_digest": "1" * 64},
        "d": {"style": "", "reference": ["0=/one/x.png"], "references_digest": "3" * 64},
        "e": {"style": "", "reference": ["0=/one/x.png"], "references_digest": "4" * 64},
    }.items():
        runs.stylized(work, scene, base, name, 20.0, STYLE, **config)
    figures, regions = {"background_mse": 0.001, "bleeding": 0.1}, [work.get("region", "cup")]
    for name, seconds, config, given in (
        ("f", 51.0, {"masks": "/one/masks", "masks_digest": "5" * 64}, ()),
        ("g", 52.0, {}, regions),
        ("h", 53.0, {}, regions),
        ("i", 54.0, {"masks": "/other/masks", "masks_digest": "6" * 64}, regions),
    ):
        runs.edited(work, scene, base, name, (1.0, 1.0, 1.0, seconds), {})
        reported = {"regions": [one.name for one in given]}
        runs.report(work, work.get("field", name), figures, reported, config=config, regions=given)
    group = {name: run.group for name, run in found(work)[0].items()}
    assert group["a"] == group["c"] != group["b"] and group["a"].startswith("room, starry.jpg (")
    assert group["d"] != group["e"] and group["d"].startswith("room, after x.png (")
    assert group["f"] != group["i"] and group["i"].startswith("room, masks masks (")
    assert group["g"] == group["h"] != group["i"]
    assert group["fit-10s"] == "room" and len({*group.values()}) == 10


def test_different_thread_counts_give_a_remark(tmp_path):
    work = WorkFolder(tmp_path)
    scene = made.make_scene(work, [0.0])
    for name, threads in (("one", 2), ("two", 2), ("old", None)):
        made.make_field(work, name, "nerf_fit", {"scene": scene}, threads=threads)
    compared, _ = runs_of([work])
    assert unlike_machines(compared) == []
    made.make_field(work, "three", "nerf_fit", {"scene": scene}, threads=8)
    reported = unlike_machines(runs_of([work])[0])
    assert len(reported) == 1 and reported[0].why.startswith("Run on 2 and 8 threads")


def test_unlike_devices_share_no_front_of_time_or_memory(tmp_path):
    work = WorkFolder(tmp_path)
    scene = made.make_scene(work, [0.0], depth=False)
    for name, device, seconds in (("slow", "cpu", 60.0), ("fast", "cuda", 5.0)):
        field = made.make_field(work, name, "nerf_fit", {"scene": scene}, device=device, seconds=seconds,
                                peak_memory_mb=seconds, figures={"parameters": 10})  # fmt: skip
        runs.report(work, field, {"psnr": 30.0 if device == "cuda" else 29.0})
    compared, _ = runs_of([work])
    fronts = on_fronts(compared, ["psnr"])
    assert all({"psnr/seconds", "psnr/peak_memory_mb"} <= {*fronts[run.title]} for run in compared)
    assert sum("psnr/parameters" in fronts[run.title] for run in compared) == 1
    assert unlike_machines(compared)[0].why.startswith("Run on cpu and cuda")


def test_what_is_missing_is_named_with_its_command(work):
    scene, base = work.get("scene", "wall"), work.get("field", "fit-10s")
    runs.fit(work, scene, "unseen", 11.0, None)
    runs.stylized(work, scene, base, "half", 20.0, {"sifid": 0.4, "edges_kept": 0.2}, budget="20s")
    runs.edited(work, scene, base, "plain", (1.0, 1.0, 1.0, 1.0), {"sparsity": 1.0})
    made.make_field(work, "nameless", "nerf_fit", {"scene": scene}, peak_memory_mb=1.0)
    _, gaps = found(work)
    reported = {gap.what: gap.why for gap in gaps}
    assert f"stylerf eval {work.root} --of unseen" in reported["room/unseen: all metrics"]
    assert reported["room/half: short_rmse, long_rmse"].endswith("--of half --path PATH")
    assert reported["room/plain: background_mse, bleeding"].endswith("--of plain --region NAME")
    assert "room/nameless: parameters" in reported


def test_reports_of_older_fields_and_damaged_ones_do_not_count(work):
    scene = work.get("scene", "wall")
    runs.fit(work, scene, "fit-60s", 61.0, None)  # made again; its report is of the one before
    by_name, gaps = found(work)
    assert by_name["fit-60s"].metrics == {} and any("fit-60s: all metrics" in gap.what for gap in gaps)
    manifest = work.root / "field" / "fit-300s" / "manifest.json"
    manifest.write_text(manifest.read_text().replace("300", "301"))
    by_name, gaps = found(work)
    assert "fit-300s" not in by_name and any("altered" in gap.why for gap in gaps)


def test_charts_page_and_table_agree(work):
    some, gaps = runs_of([work])
    fronts = on_fronts([run for run in some if run.family == FITS], ["psnr"])
    fronts = {run.title: fronts.get(run.title, []) for run in some}
    charts = comparison_charts(some)
    costs = ("seconds", "peak_memory_mb", "parameters")
    names = [f"{family}_{cost}" for family in (FITS, STYLIZATIONS, EDITS) for cost in costs]
    assert [chart.name for chart in charts] == names
    first = charts[0]
    assert first.png.startswith(b"\x89PNG") and "fit-300s" in first.svg
    assert "on the front: room/fit-10s, room/fit-300s" in first.description
    assert comparison_charts([run for run in some if run.family == FITS])[0].svg == first.svg
    edits = next(chart.description for chart in charts if chart.name == "edits_seconds")
    assert "within the region (correct)" in edits and "Short-range consistency (correct)" not in edits
    page = build_page(some, charts, gaps, fronts)
    assert page.count("<svg") == 9 and "<script" not in page and "http" not in page.replace("http://www.w3.org", "")
    assert "Nothing: " in page and "room/starry-desrf" in page
    rows = rows_of(some, fronts)
    row = next(row for row in rows if row["name"] == "cup")
    assert (row["seconds"], row["background_mse"], row["group"]) == (15.0, 0.001, "room, cup")
    assert next(row for row in rows if row["name"] == "fit-10s")["fronts"] == "psnr/seconds psnr/parameters"


def test_no_charted_figure_of_stylizations_is_one_that_a_method_minimizes():
    """ARF minimizes the NNFM distance, SNeRF the Gram distance; color matching fits palette_mean and _covariance."""
    minimized = {"nnfm", "gram", "palette", "palette_mean", "palette_covariance"}
    assert not minimized & {*CHARTED[STYLIZATIONS]}
    assert next(iter(CHARTED[STYLIZATIONS])) == "sifid"
