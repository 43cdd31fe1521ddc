"""The command `stylerf`: find the verb, read its options, run it, and return the exit code."""

import importlib
import os
import signal
import sys
import threading
import warnings
from _thread import interrupt_main
from argparse import SUPPRESS, Namespace, RawDescriptionHelpFormatter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from schemas.errors import UsageError
from schemas.native_output import native_output_restored
from stages.pipeline.distributed import leave_fault, prints
from stylerf.environment.performance import keep_freed_pages, wait_passively
from stylerf_cli.arguments import Parser, add_common, add_config, nearest
from stylerf_cli.exit_codes import code_and_line
from stylerf_cli.output import (
    OutputClosed,
    open_standard_streams,
    print_json,
    stdout_redirected,
    write_fault,
    write_out,
)
from stylerf_cli.verbs import VERBS

ABOUT = "From photos and a style image to a stylized, editable 3D scene."
HELP_ALL = "--help-all"
EXIT_CODES = (
    "exit codes: 0 done, 1 failed, 2 usage, 3 bad input, 4 artifact damaged or stale, 5 out of resources, "
    "130 interrupted"
)


def main(argv: list[str] | None = None) -> int:
    """Run one command and return its exit code. argv: without the name of the program."""
    open_standard_streams()
    # numpy warns if numbers of a damaged file overflow; everything read is checked to be finite and reported anyway.
    warnings.filterwarnings("ignore", category=RuntimeWarning, module="numpy|stages|stylerf|schemas")
    _name_the_nameless()
    wait_passively()
    keep_freed_pages()
    argv = list(sys.argv[1:] if argv is None else argv)
    as_json = "--json" in argv
    state: dict[str, Path | None] = {"work": None}
    result = None
    try:
        with _terminable(), stdout_redirected(as_json), native_output_restored():
            result = _run(argv, state)
        if as_json and result is not None and prints():
            print_json(result)
        write_out("")
        return 0
    except OutputClosed:
        _leave_stdout()
        return 0
    except BaseException as error:
        if not prints():
            return getattr(error, "exit_code", 1)
        code, line = code_and_line(error, argv, state["work"])
        write_fault(f"stylerf: error: {line}")
        if as_json:
            try:
                print_json({"error": line, "exit_code": code, **getattr(error, "details", {})})
            except OutputClosed:
                _leave_stdout()
        return code


def _name_the_nameless() -> None:
    """Give a user without a passwd entry, as in containers, a name and a home (that does not exist).

    Libraries ask for both on import and break without them.
    """
    if os.path.expanduser("~") == "~" and hasattr(os, "getuid"):  # neither $HOME nor an entry in passwd
        os.environ["HOME"] = "/nonexistent"
        for name in ("LOGNAME", "USER"):
            os.environ.setdefault(name, str(os.getuid()))


def _leave_stdout() -> None:
    """Keep Python from complaining when it closes a stdout that nobody reads."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)


def _run(argv: list[str], state: dict[str, Path | None]) -> dict[str, Any] | None:
    if not argv or argv[0].startswith("-"):
        if _parsed(_top_parser(), argv) is None:
            return None
        raise UsageError("no verb given; see `stylerf --help`")
    verb = argv[0]
    if verb not in VERBS:
        raise UsageError(f"unknown verb {verb!r}{nearest(verb, list(VERBS))}")
    module = importlib.import_module(VERBS[verb][0])
    # The options of some verbs depend on how they are used.
    config = module.options_for(argv[1:]) if hasattr(module, "options_for") else module.CONFIG
    args = _parsed(parser_of(verb, module, config, HELP_ALL in argv), argv[1:])
    if args is None:
        return None
    state["work"] = _existing_folder(args)
    return _run_verb(verb, module, args, config)


def parser_of(verb: str, module: ModuleType, config: type | None, everything: bool) -> Parser:
    """Return the parser of a verb.

    Args:
        config: the dataclass of its options, None without any.
        everything: whether the help lists advanced options too.
    """
    parser = Parser(
        prog=f"stylerf {verb}",
        description=f"{VERBS[verb][1][0].upper()}{VERBS[verb][1][1:]}.",
        epilog=EXIT_CODES if everything else f"{HELP_ALL} lists all options and the exit codes.",
    )
    parser.add_argument(HELP_ALL, action="help", help="show all options and exit")
    module.add_arguments(parser)
    if not everything:  # in place of argparse's own list of every flag
        parser.usage = f"stylerf {verb} [options] {parser.positionals()}".rstrip()
    if config is not None:
        add_config(parser, config, everything)
    add_common(parser, everything)
    return parser


def _parsed(parser: Parser, argv: list[str]) -> Namespace | None:
    """Return the arguments, None after `--help` and `--version`, which argparse answers by exiting."""
    try:
        return parser.parse_args(argv)
    except SystemExit:
        return None
    except BrokenPipeError as error:  # a long --help piped to `head`
        raise OutputClosed from error


def _run_verb(verb: str, module: ModuleType, args: Namespace, config: type | None) -> dict[str, Any]:
    # Imported late: --help and usage errors need neither.
    from stylerf_cli.session import Options, Session

    if args.name is not None and hasattr(module, "NAMELESS"):
        raise UsageError(f"--name: {module.NAMELESS}; leave it out")
    options = Options(verb, args, list(VERBS), getattr(module, "CONFIGS", ()))
    session = Session(verb, args, options, config)
    try:
        result: dict[str, Any] = module.run(args, session)
        return result
    except BaseException as error:
        leave_fault(session.processes, error)
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
        epilog="`stylerf VERB --help` shows the options of a verb.\n" + EXIT_CODES,
        formatter_class=RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"stylerf {_version()}")
    parser.add_argument("--json", action="store_true", help=SUPPRESS)
    return parser


def _version() -> str:
    from stylerf import __version__

    return __version__


@contextmanager
def _terminable() -> Iterator[None]:
    """Treat SIGTERM, which schedulers and containers send to end a job, as Ctrl-C, so that the run can resume."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = [signal.SIGTERM]
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # otherwise the parent wants it ignored
        numbers.append(signal.SIGINT)
    before = {number: signal.signal(number, _interrupt) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _interrupt(*_: object) -> None:
    sys.unraisablehook = _resend_interrupt  # permanently: half-built objects are destroyed as the process ends
    raise KeyboardInterrupt


def _resend_interrupt(report: "sys.UnraisableHookArgs") -> None:
    """Ignore errors of half-built objects; resend an interrupt that Python dropped because a destructor raised it."""
    if report.exc_type is KeyboardInterrupt:
        threading.Timer(0.1, interrupt_main).start()


if __name__ == "__main__":
    sys.exit(main())
