"""Commands of the viewer, read back by the command line's own parser."""

import importlib
from typing import Any

from stylerf_cli.main import HELP_ALL, parser_of
from stylerf_cli.session import Options
from stylerf_cli.verbs import VERBS


def config_of(arguments: list[str]) -> tuple[Any, Any]:
    """The arguments and options that the command line makes of a command."""
    verb, *rest = arguments
    module = importlib.import_module(VERBS[verb][0])
    config = module.options_for(rest) if hasattr(module, "options_for") else module.CONFIG
    args = parser_of(verb, module, config, HELP_ALL in rest).parse_args(rest)
    return args, Options(verb, args, list(VERBS), getattr(module, "CONFIGS", ())).config(config)
