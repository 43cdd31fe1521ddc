"""The verbs: one module each, named in one table so that `stylerf --help` imports none of them.

A verb module has NAME, HELP (one line, the same as here), CONFIG (its stage's config dataclass, or None; where its
options depend on how it is used, `options_for(argv)` gives the one that holds),
`add_arguments(parser)` for what is no option of the stage, and `run(args, session) -> dict`, whose result is what
`--json` prints.
"""

# verb: (module, help)
VERBS: dict[str, tuple[str, str]] = {
    "demo": ("stylerf_cli.verbs.demo", "the whole path on an embedded scene: photos, fit, painting, film, report"),
    "import": ("stylerf_cli.verbs.import_", "bring photos into a work folder, with their camera poses"),
    "fit": ("stylerf_cli.verbs.fit", "fit a radiance field to a scene, no larger than it needs"),
    "deform": (
        "stylerf_cli.verbs.deform",
        "give a fitted field a deformation, the start of a stylization that bends shapes",
    ),
    "stylize": ("stylerf_cli.verbs.stylize", "stylize the whole scene or a region of it, or change its palette"),
    "select": ("stylerf_cli.verbs.select", "select a part of the scene in 3D, by pixels, masks, a box or a color"),
    "extract": ("stylerf_cli.verbs.extract", "gather what the views show of a region, for its edit"),
    "distill": ("stylerf_cli.verbs.distill", "paint an edit into the training photos"),
    "finetune": ("stylerf_cli.verbs.finetune", "teach a field an edit"),
    "edit": (
        "stylerf_cli.verbs.edit",
        "select, recolor or stylize a part of the scene, and teach the field: all in one",
    ),
    "render": ("stylerf_cli.verbs.render", "render a field along a path: EXR with depth for compositors, PNG, video"),
    "eval": ("stylerf_cli.verbs.eval_", "measure a field: quality, style, consistency, cost; a report with pictures"),
    "compare": (
        "stylerf_cli.verbs.compare",
        "set fits, stylizations and edits side by side: figures against time, memory, parameters",
    ),
    "stress": (
        "stylerf_cli.verbs.stress",
        "run methods under faults of photos, poses and paintings: how often each succeeds, a heat map, a baseline",
    ),
    "show": ("stylerf_cli.verbs.show", "tell what a work folder or an artifact holds"),
    "verify": ("stylerf_cli.verbs.verify", "check every file of an artifact or a work folder against its digest"),
    "doctor": ("stylerf_cli.verbs.doctor", "tell what is installed, what is missing, and how to get it"),
}
