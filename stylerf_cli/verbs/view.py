"""`stylerf view WORK`: a scene in the browser, to look at, select in, recolor and stylize."""

import webbrowser
from pathlib import Path
from typing import Any

from schemas.errors import UsageError
from stages.configs.view import ViewConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Common, Session

CONFIG = ViewConfig
NAMELESS = "the page names what it makes"


def add_arguments(parser: Parser) -> None:
    """WORK, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", default="", help="field to show first (default: the newest)")


def passed_on(args: Any, common: Common, file: Path | None) -> tuple[str, ...]:
    """Return the common options that also apply to the page's commands. file: that of --config."""
    found: tuple[str, ...] = ()
    for flag, value, default in (
        ("--seed", common.seed, 0), ("--threads", common.threads, None), ("--device", common.device, "auto"),
        ("--memory", common.memory, 0),
    ):  # fmt: skip
        if value != default:
            found += (flag, str(value))
    if args.no_paths:
        found += ("--no-paths",)
    return (*found, "--config", str(file)) if file else found


def run(args: Any, session: Session) -> dict[str, Any]:
    """Serve until interrupted; return the address."""
    from stages.pipeline.resources import usable_threads
    from stages.viewing.server import Viewer
    from stylerf_cli.output import write_fault, write_lines

    common = session.common
    for flag, why in (("force", "the page asks before it replaces anything"), ("only", "the page runs whole edits")):
        if getattr(args, flag):
            raise UsageError(f"--{flag} has no effect here: {why}; leave it out")
    threads, passed = common.threads or usable_threads(), passed_on(args, common, session.file_for_others())
    viewer = Viewer(args.work, session.config, threads, args.of, session.say, passed)
    try:
        address = f"{viewer.url}  (Ctrl-C ends the viewer)"
        if session.json:  # stdout is for the result
            write_fault(address)
        else:
            write_lines([address])
        if session.config.open:
            webbrowser.open(viewer.url)
        viewer.wait()
    except KeyboardInterrupt:
        pass
    finally:
        viewer.close()
    return session.emit({"url": viewer.url}, [])
