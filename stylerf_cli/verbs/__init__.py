"""The verbs, one module each, listed in one table so that `stylerf --help` imports none of them.

A verb module has CONFIG (the dataclass of its options, None without any),
`add_arguments(parser)` for arguments that are not options of a stage, and `run(args, session) -> dict`, whose result is
what `--json` prints. A verb whose options depend on its use has `options_for(argv)`, which returns the dataclass, and
lists all of them in CONFIGS.
"""

# verb: (module, help)
VERBS: dict[str, tuple[str, str]] = {
    "demo": ("stylerf_cli.verbs.demo", "run the whole pipeline on a built-in procedural scene"),
    "import": ("stylerf_cli.verbs.import_", "import photos, with or without camera poses"),
    "fit": ("stylerf_cli.verbs.fit", "fit a radiance field to the photos"),
    "deform": ("stylerf_cli.verbs.deform", "fit the initial deformation that DeSRF trains further"),
    "stylize": ("stylerf_cli.verbs.stylize", "stylize a scene or a region, or change its palette"),
    "blend": ("stylerf_cli.verbs.blend", "mix stylizations of one field, by weight or by region"),
    "select": ("stylerf_cli.verbs.select", "select a region in 3D by pixels, masks, a box or a color"),
    "extract": ("stylerf_cli.verbs.extract", "render the training data of a local edit from a region"),
    "distill": ("stylerf_cli.verbs.distill", "paint an edit into the training photos"),
    "finetune": ("stylerf_cli.verbs.finetune", "train a field on the edited photos"),
    "edit": ("stylerf_cli.verbs.edit", "select a region, recolor or stylize it, and train the field, in one command"),
    "render": ("stylerf_cli.verbs.render", "render a field along a camera path: EXR with depth, PNG, video"),
    "export": ("stylerf_cli.verbs.export", "export a mesh, splats, cameras or a whole shot for other programs"),
    "eval": ("stylerf_cli.verbs.eval_", "measure quality, style, consistency and cost of a field"),
    "compare": ("stylerf_cli.verbs.compare", "compare runs: quality against time, memory and parameters"),
    "stress": ("stylerf_cli.verbs.stress", "measure success rates under faults; find regressions against a baseline"),
    "farm": ("stylerf_cli.verbs.farm", "run a table of scenes, styles, methods and seeds, here or on a cluster"),
    "view": ("stylerf_cli.verbs.view", "view, select, recolor and stylize a scene in the browser"),
    "show": ("stylerf_cli.verbs.show", "show what a work folder or an artifact holds"),
    "verify": ("stylerf_cli.verbs.verify", "verify the checksums of an artifact or a work folder"),
    "doctor": ("stylerf_cli.verbs.doctor", "check the installation; say how to get what is missing"),
}
