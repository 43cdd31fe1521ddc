"""`stylerf view WORK`: a scene in the browser, to look at, select in, recolor and stylize."""

import webbrowser
from typing import Any

from stages.configs.view import ViewConfig
from stylerf_cli.arguments import Parser
from stylerf_cli.session import Session

CONFIG = ViewConfig
NAMELESS = "the page names what it makes"


def add_arguments(parser: Parser) -> None:
    """WORK, --of."""
    parser.add_argument("work", metavar="WORK", help="the work folder")
    parser.add_argument("--of", metavar="FIELD", default="", help="field to show first (default: the newest)")


def run(args: Any, session: Session) -> dict[str, Any]:
    """Serve until interrupted; return the address."""
    from stages.pipeline.resources import usable_threads
    from stages.viewing.server import Viewer
    from stylerf_cli.output import write_lines

    common = session.common
    passed: tuple[str, ...] = ("--seed", str(common.seed)) if common.seed else ()
    if common.threads:
        passed += ("--threads", str(common.threads))
    viewer = Viewer(args.work, session.config, common.threads or usable_threads(), args.of, session.say, passed)
    try:
        if not session.json:
            write_lines([f"{viewer.url}  (Ctrl-C ends the viewer)"])
        if session.config.open:
            webbrowser.open(viewer.url)
        viewer.wait()
    except KeyboardInterrupt:
        pass
    finally:
        viewer.close()
    return session.emit({"url": viewer.url}, [])
