"""Charts of README and docs from results, as deterministic SVG text."""

# Metrics that no method optimizes directly.
PARETO = {"fits": ("psnr", "held-out PSNR, dB", True), "stylizations": ("sifid", "style distance, SIFID", False)}


def drawn(size: tuple[float, float], draw) -> str:
    """Return the SVG text of a figure filled by `draw(figure)`; the same data gives the same text."""
    import io

    from stylerf.environment.matplotlib_defaults import Figure, rc_context

    with rc_context({"svg.hashsalt": "stylerf"}):
        figure = Figure(figsize=size, layout="tight")
        draw(figure)
        out = io.StringIO()
        figure.savefig(out, format="svg", metadata={"Date": None})
        return out.getvalue()


def strategies_chart(report: dict) -> str:
    """Style distance at equal time against the field's seconds per step."""

    def draw(figure) -> None:
        axes = figure.add_subplot()
        for row in report["rows"]:
            x, y = row["field_seconds"], row["at_equal_time"]["style"]
            axes.scatter(x, y, s=20 + row["field_memory_mb"] / 4, alpha=0.7)
            axes.annotate(row["case"], (x, y), xytext=(6, 4), textcoords="offset points", fontsize=8)
        axes.set_xlabel("seconds a step spends in the field (area: its memory)")
        axes.set_ylabel("style distance at equal time")
        axes.margins(0.18)

    return drawn((7, 3.4), draw)


OBJECTS = ("lego",)  # the scenes cut out by alpha; the others are captures


def fits_chart(report: dict) -> str:
    """PSNR and SSIM against seconds of training, log scale; objects dashed, captures solid."""

    def draw(figure) -> None:
        for axes, key, words in zip(figure.subplots(1, 2), ("psnr", "ssim"), ("PSNR of test views, dB", "SSIM")):
            for scene in dict.fromkeys(row["scene"] for row in report["rows"]):
                rows = [row for row in report["rows"] if row["scene"] == scene]
                places = sorted((row["train_seconds"], row[key]) for row in rows)
                style = "o--" if scene.partition(" ")[0] in OBJECTS else "o-"
                axes.plot(*zip(*places), style, markersize=3, label=scene)
            ticks = sorted({round(row["train_seconds"]) for row in report["rows"]})
            axes.set_xscale("log")
            axes.set_xticks(ticks, [str(tick) for tick in ticks])
            axes.set_xticks([], minor=True)
            axes.set(xlabel="seconds of training", ylabel=words)
        axes.legend(fontsize=7)

    return drawn((8, 3.6), draw)


def capacity_chart(report: dict) -> str:
    """PSNR against parameters, one panel per scene; fixed sizes connected, searched ones filled."""
    scenes = list(dict.fromkeys(row["scene"] for row in report["rows"]))

    def draw(figure) -> None:
        for scene, axes in zip(scenes, figure.subplots(1, len(scenes), squeeze=False)[0]):
            rows = [row for row in report["rows"] if row["scene"] == scene]
            fixed = sorted(
                (row["parameters"] / 1e6, row["psnr"], row["capacity"]) for row in rows if row["capacity"] != "grow"
            )
            axes.plot(*zip(*((x, y) for x, y, _ in fixed)), "o-", color="#0072b2", markerfacecolor="none")
            for x, y, capacity in fixed:
                axes.annotate(capacity, (x, y), xytext=(5, -10), textcoords="offset points", fontsize=7)
            for row in rows:
                if row["capacity"] == "grow":
                    axes.plot(row["parameters"] / 1e6, row["psnr"], "o", color="#d55e00")
                    axes.annotate("grown", (row["parameters"] / 1e6, row["psnr"]), xytext=(5, 5),
                                  textcoords="offset points", fontsize=7)  # fmt: skip
            axes.set(title=scene, xlabel="parameters, M", ylabel="held-out PSNR, dB")
            axes.margins(0.2)

    return drawn((3.6 * len(scenes), 3.2), draw)


def pareto_chart(report: dict) -> str:
    """Quality against seconds, a column per scene: fits above, stylizations below, Pareto fronts filled and linked."""
    from stylerf.metrics.pareto import pareto_front

    scenes = list(dict.fromkeys(row["work"] for row in report["rows"]))

    def draw(figure) -> None:
        axes = figure.subplots(2, len(scenes), squeeze=False)
        for (family, (key, words, higher)), line in zip(PARETO.items(), axes):
            for scene, one in zip(scenes, line):
                rows = [row for row in report["rows"] if (row["work"], row["family"]) == (scene, family)]
                rows = [row for row in rows if key in row["figures"] and row["costs"]["parameters"]]
                places = [(row["costs"]["seconds"], row["figures"][key]) for row in rows]
                front = pareto_front(*zip(*places), higher) if places else []
                seconds = [place[0] for place in places]
                for index, label in enumerate(unlike([row["name"] for row in rows])):
                    late = seconds[index] > (min(seconds) + max(seconds)) / 2  # the label might leave the chart
                    _mark(one, rows[index], places[index], label, index in front, late)
                if front:
                    places = [places[index] for index in front]
                    one.step(*zip(*places), where="post", color="#888888", linewidth=1)
                better = "higher" if higher else "lower"
                one.set(title=f"{scene}, {family}", xlabel="seconds", ylabel=f"{words} ({better} is better)")
                one.margins(0.2)

    return drawn((4.6 * len(scenes), 7), draw)


def stress_chart(report: dict) -> str:
    """The heat map of `stylerf stress` over all scenes combined: fraction of successful runs."""
    sums: dict[tuple[str, str], list[int]] = {}
    for row in report["rows"]:
        both = sums.setdefault((row["method"], row["fault"]), [0, 0])
        both[0] += row["successes"]
        both[1] += row["count"]
    rows = [
        {"method": method, "fault": fault, "successes": done, "count": runs, "rate": done / runs}
        for (method, fault), (done, runs) in sums.items()
    ]
    return _heat_maps({"": [row | {"median": None, "spread": None} for row in rows]}, 1)


def stress_scenes_chart(report: dict) -> str:
    """The heat maps with median scores, one panel per scene, two per row."""
    scenes = dict.fromkeys(row["work"] for row in report["rows"])
    return _heat_maps({scene: [row for row in report["rows"] if row["work"] == scene] for scene in scenes}, 2)


def _heat_maps(panels: dict[str, list[dict]], across: int) -> str:
    """Draw one heat map per title; panels holds the report rows of each."""
    from types import SimpleNamespace

    from stages.configs.faults import FAULTS
    from stages.stress.page import draw_cells

    order = list(FAULTS)
    columns = min(across, len(panels))
    lines = -(-len(panels) // columns)
    methods, faults = (max(len({row[key] for row in rows}) for rows in panels.values()) for key in ("method", "fault"))

    def draw(figure) -> None:
        figure.set_facecolor("white")
        places = figure.subplots(lines, columns, squeeze=False).flat
        for (title, rows), axes in zip(panels.items(), places):
            in_order = sorted(rows, key=lambda row: order.index(row["fault"]))
            draw_cells(axes, [SimpleNamespace(**row) for row in in_order])
            axes.set_title(title)
        for axes in list(places):
            axes.set_axis_off()

    return drawn((columns * (1.2 + 0.95 * methods), lines * (1.1 + 0.42 * faults)), draw)


def tensorf_chart(report: dict) -> str:
    """PSNR against seconds of training, log scale, one line per code and schedule."""

    def draw(figure) -> None:
        axes = figure.add_subplot()
        for row, color in zip(report["rows"], ("#d55e00", "#0072b2", "#56b4e9")):
            curve = [(entry["seconds"], entry["psnr"]) for entry in row["curve"]]
            axes.plot(*zip(*curve), "o-", markersize=3, color=color, label=f"{row['code']}, {row['schedule']}")
        axes.set_xscale("log")
        axes.set(xlabel="seconds of training", ylabel="PSNR of test views, dB")
        axes.legend()

    return drawn((7, 3.4), draw)


def unlike(names: list[str]) -> list[str]:
    """Return hyphenated names without the parts that all of them share; each keeps at least one."""
    parts = [name.split("-") for name in names]
    for shared in list(parts[0]) if len(parts) > 1 else []:
        if all(shared in name and len(name) > 1 for name in parts):
            for name in parts:
                name.remove(shared)
    return ["-".join(name) for name in parts]


def _mark(axes, row: dict, place: tuple[float, float], label: str, filled: bool, on_left: bool) -> None:
    color = "#0072b2" if row["family"] == "fits" else "#d55e00"
    area = 15 + row["costs"]["parameters"] / 1e5
    axes.scatter(*place, s=area, facecolors=color if filled else "none", edgecolors=color, alpha=0.8)
    beside = {"xytext": (-5, 3), "ha": "right"} if on_left else {"xytext": (5, 3)}
    axes.annotate(label, place, textcoords="offset points", fontsize=6, **beside)
