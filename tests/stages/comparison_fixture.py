"""Work folders of runs with given costs and metrics: manifests and reports, nothing computed."""

import json

from schemas.work_folder import Artifact, WorkFolder
from stages.evaluation.metric_definitions import BY_KEY
from tests.stages import evaluation_fixture as made

FACTS = {"style_label": "the style image", "perceptual_net": "LPIPS (lpips-alex)", "style_network": "st-vgg16"}


def fit(work: WorkFolder, scene: Artifact, name: str, seconds: float, psnr: float | None, **more) -> Artifact:
    """A fitted field, evaluated unless psnr is None."""
    figures, memory = {"parameters": more.pop("parameters", 1000)}, more.pop("memory", 500.0)
    config = {"budget": f"{seconds:g}s", "field": "vm", "capacity": "grow"} | more
    field = made.make_field(
        work, name, "nerf_fit", {"scene": scene}, seconds=seconds, figures=figures, device="cpu",
        peak_memory_mb=memory, config=config,
    )  # fmt: skip
    if psnr is not None:
        report(work, field, {"psnr": psnr})
    return field


def stylized(
    work: WorkFolder, scene: Artifact, base: Artifact, name: str, seconds: float, metrics: dict, **config
) -> Artifact:
    """A stylized field of 2,000 parameters, evaluated if there are metrics."""
    field = made.make_field(
        work, name, "stylize", {"scene": scene, "field": base}, seconds=seconds, peak_memory_mb=900.0,
        figures={"parameters": 2000}, config={"style": "/somewhere/starry.jpg", "method": "arf"} | config,
    )  # fmt: skip
    if metrics:
        report(work, field, metrics)
    return field


def edited(
    work: WorkFolder, scene: Artifact, base: Artifact, name: str, seconds: tuple[float, ...], metrics: dict
) -> Artifact:
    """A field that learned an edit; seconds of extract, learn, distill and finetune."""
    region = made.commit(work, "region", name, "region_select", {"field": base}, _nothing, seconds=999.0)
    inputs = {"scene": scene, "field": base, "region": region}
    dataset = made.commit(work, "edit-dataset", name, "edit_dataset", inputs, _nothing, seconds=seconds[0])
    edit = made.commit(
        work, "edit", name, "edit_learn", {"edit-dataset": dataset}, _nothing, seconds=seconds[1], peak_memory_mb=1500.0
    )
    inputs = {"scene": scene, "edit-dataset": dataset, "edit": edit}
    painted = made.commit(work, "scene", f"{name}-painted", "distill", inputs, _nothing, seconds=seconds[2])
    inputs = {"scene": painted, "field": base, "region": region}
    field = made.make_field(
        work,
        name,
        "finetune",
        inputs,
        seconds=seconds[3],
        peak_memory_mb=800.0,
        figures={"parameters": 3000},
        config={"budget": f"{seconds[3]:g}s"},
    )
    if metrics:
        report(work, field, metrics, {"regions": [name]})
    return field


def report(
    work: WorkFolder, field: Artifact, metrics: dict, edit: dict | None = None, protocol: str = "the usual one", **more
) -> Artifact:
    """What `stylerf eval` leaves, as far as a comparison looks at it. more: of its manifest; `regions`, artifacts;
    `name`, else the field's; `changed`, of each metric."""
    inputs = {"field": field} | {f"region.{one.name}": one for one in more.pop("regions", ())}
    name, changed = more.pop("name", field.name), more.pop("changed", {})
    reported = [
        {"key": key, "mean": mean, "label": BY_KEY[key].label.format_map(FACTS), "unit": BY_KEY[key].unit,
         "better": BY_KEY[key].better, "protocol": protocol, "digits": 2, "count": 3, "left_out": 0,
         "reference": {}} | changed
        for key, mean in metrics.items()
    ]  # fmt: skip

    def write(folder) -> None:
        (folder / "report.json").write_text(json.dumps({"metrics": reported, "style_image": "style.png", "edit": edit}))

    return made.commit(work, "report", name, "evaluate", inputs, write, figures=metrics, **more)


def _nothing(folder) -> None:
    (folder / "a.bin").write_bytes(b"a")
