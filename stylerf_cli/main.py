"""The command `stylerf`: finds the verb, reads its options, runs it, and ends with the exit code of what happened."""

import importlib
import os
import signal
import sys
import threading
from _thread import interrupt_main
from argparse import SUPPRESS, Namespace, RawDescriptionHelpFormatter
from contextlib import contextmanager
from pathlib import Path

from schemas.errors import UsageError
from schemas.native_output import native_output_restored
from stages.pipeline.distributed import leave_fault, speaks
from stylerf_cli.arguments import Parser, add_common, add_config, nearest
from stylerf_cli.exit_codes import told
from stylerf_cli.output import OutputClosed, open_standard_streams, print_json, stdout_kept_free, write_fault, write_out
from stylerf_cli.verbs import VERBS

ABOUT = "From photos and a painting to a stylized, editable 3D scene."
EXIT_CODES = (
    "exit codes: 0 done, 1 failed, 2 usage, 3 bad input, 4 artifact damaged or stale, 5 out of resources, "
    "130 interrupted"
)


def main(argv: list[str] | None = None) -> int:
    """Runs one command and returns its exit code; `argv` is without the program's name."""
    open_standard_streams()
    _name_the_nameless()
    argv = list(sys.argv[1:] if argv is None else argv)
    as_json = "--json" in argv
    state: dict[str, Path | None] = {"work": None}
    result = None
    try:
        with _terminable(), stdout_kept_free(as_json), native_output_restored():
            result = _run(argv, state)
        if as_json and result is not None and speaks():
            print_json(result)
        write_out("")
        return 0
    except OutputClosed:
        _leave_stdout()
        return 0
    except BaseException as error:
        if not speaks():
            return getattr(error, "exit_code", 1)
        code, line = told(error, argv, state["work"])
        write_fault(f"stylerf: error: {line}")
        if as_json:
            try:
                print_json({"error": line, "exit_code": code, **getattr(error, "details", {})})
            except OutputClosed:
                _leave_stdout()
        return code


def _name_the_nameless() -> None:
    """Gives a user whom the system does not know, as in containers, a home (where nothing can be kept) and a name.

    Libraries ask for both as they are imported, and break where there are none.
    """
    if os.path.expanduser("~") == "~" and hasattr(os, "getuid"):  # neither $HOME nor an entry in passwd
        os.environ["HOME"] = "/nonexistent"
        for name in ("LOGNAME", "USER"):
            os.environ.setdefault(name, str(os.getuid()))


def _leave_stdout() -> None:
    """Python would complain once more when it closes a stdout that nobody reads."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def _run(argv: list[str], state: dict[str, Path | None]) -> dict | None:
    if not argv or argv[0].startswith("-"):
        if _parsed(_top_parser(), argv) is None:
            return None
        raise UsageError("a verb is missing; see `stylerf --help`")
    verb = argv[0]
    if verb not in VERBS:
        raise UsageError(f"there is no verb {verb!r}{nearest(verb, list(VERBS))}")
    module = importlib.import_module(VERBS[verb][0])
    parser = Parser(
        prog=f"stylerf {verb}", description=f"{module.HELP[0].upper()}{module.HELP[1:]}.", epilog=EXIT_CODES
    )
    module.add_arguments(parser)
    # A verb may have other options in one use than in another.
    config = module.options_for(argv[1:]) if hasattr(module, "options_for") else module.CONFIG
    if config is not None:
        add_config(parser, config)
    add_common(parser)
    args = _parsed(parser, argv[1:])
    if args is None:
        return None
    state["work"] = _existing_folder(args)
    return _run_verb(verb, module, args, config)


def _parsed(parser: Parser, argv: list[str]) -> Namespace | None:
    """The arguments; None after `--help` and `--version`, which argparse answers by leaving."""
    try:
        return parser.parse_args(argv)
    except SystemExit:
        return None
    except BrokenPipeError as error:  # of a long --help that nobody reads to its end
        raise OutputClosed from error


def _run_verb(verb: str, module, args: Namespace, config: type | None) -> dict:
    # Late, so that --help and usage faults do not wait for what only a run needs.
    from stylerf_cli.options import Options
    from stylerf_cli.session import Session

    if args.name is not None and hasattr(module, "NAMELESS"):
        raise UsageError(f"--name: {module.NAMELESS}; leave it out")
    options = Options(verb, args, list(VERBS), getattr(module, "CONFIGS", ()))
    session = Session(verb, args, options, config)
    try:
        return module.run(args, session)
    except BaseException as error:
        leave_fault(session.ranks, error)
        raise
    finally:
        session.progress.finish()


def _existing_folder(args: Namespace) -> Path | None:
    work = getattr(args, "work", None)
    return Path(work) if work is not None and Path(work).is_dir() else None


def _top_parser() -> Parser:
    width = max(map(len, VERBS))
    lines = [f"  {verb:<{width}}  {help}" for verb, (_, help) in VERBS.items()]
    parser = Parser(
        prog="stylerf",
        usage="stylerf VERB ...",
        description=ABOUT + "\n\nverbs:\n" + "\n".join(lines),
        epilog="`stylerf VERB --help` tells the options of a verb.\n" + EXIT_CODES,
        formatter_class=RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"stylerf {_version()}")
    parser.add_argument("--json", action="store_true", help=SUPPRESS)
    return parser


def _version() -> str:
    from stylerf import __version__

    return __version__


@contextmanager
def _terminable():
    """Treats SIGTERM, by which schedulers and containers end a job, as Ctrl-C: the run stays resumable."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [signal.SIGTERM]
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # else whoever started it wants it ignored
        numbers.append(signal.SIGINT)
    before = {number: signal.signal(number, _interrupt) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(*_) -> None:
    sys.unraisablehook = _complaint  # for good: what was left half built is thrown away as the process ends
    raise KeyboardInterrupt


def _complaint(report) -> None:
    """Says nothing of what an interruption left half built; one lost in a destructor, where Python drops it, is sent
    anew.
    """
    if report.exc_type is KeyboardInterrupt:
        threading.Timer(0.1, interrupt_main).start()


if __name__ == "__main__":
    sys.exit(main())
