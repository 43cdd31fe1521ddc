"""The table: scenes, styles, methods, seeds and options in one YAML file, checked as a whole before anything runs."""

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from schemas.errors import StylerfError, UsageError
from schemas.safe_names import printable
from stages.configs import options_of
from stages.configs.deform import DeformConfig
from stages.configs.edit import WholeEditConfig
from stages.configs.evaluate import EvaluateConfig
from stages.configs.fit import FitConfig
from stages.configs.pose_import import ImportOptions
from stages.configs.render import OWN_VIEWS, RenderConfig
from stages.configs.stylize import CONFIGS as METHOD_CONFIGS
from stages.configs.stylize import refuse_foreign
from stages.farm.yaml_file import read_yaml
from stylerf.geometry.camera_paths import PATHS

# Builds a config of a class from a mapping of options; the text names the mapping in errors; options of the other
# classes are ignored. UsageError for anything invalid.
Build = Callable[[type, Mapping[str, Any], str, tuple[type, ...]], Any]

METHODS = tuple(METHOD_CONFIGS)  # those with a style image
VERBS: dict[str, type] = {
    "import": ImportOptions, "fit": FitConfig, "deform": DeformConfig, "render": RenderConfig, "eval": EvaluateConfig,
}  # fmt: skip
STYLIZE, EDITS = "stylize", "edits"
KEYS = (
    "out", "scenes", "styles", "methods", EDITS, "seeds", "threads", "device", "container", STYLIZE, *VERBS,
)  # fmt: skip
RESERVED = ("farm", "report")  # folders of the table besides those of its scenes
MOST_SEEDS, LARGEST_SEED, MOST_THREADS, MOST_SHARDS = 1000, 2**32 - 1, 1024, 10_000
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+]*(-[A-Za-z0-9._+]+)*")
_IMAGE = re.compile(r"[A-Za-z0-9._:/@+-]{0,300}")  # it ends up in Snakemake's shell commands
LONGEST = 30  # characters of a name, so that a field can be called after a style, a method and a seed
DEVICES = ("cpu", "cuda", "auto")


@dataclass(frozen=True)
class Scene:
    """A capture, with the configs of the verbs that read it.

    path: camera path of the consistency metrics, empty for none. shards: parts that a render is split into.
    render: None for no renders.
    """

    name: str
    source: Path
    imported: ImportOptions
    fit: FitConfig
    deform: DeformConfig
    render: RenderConfig | None
    shards: int
    evaluate: EvaluateConfig | None
    path: str


@dataclass(frozen=True)
class Table:
    """A checked table. methods: configs of `stylize`, without a style. edits: configs of `edit`, by name."""

    file: Path
    out: Path
    scenes: tuple[Scene, ...]
    styles: dict[str, Path]
    methods: dict[str, Any]
    edits: dict[str, WholeEditConfig]
    seeds: tuple[int, ...]
    threads: int
    device: str
    container: str


class TableFaults(UsageError):
    """A table that cannot be run. details: every fault, one line each."""

    def __init__(self, file: Path, faults: list[str]) -> None:
        more = f" (the first of {len(faults)} faults)" if len(faults) > 1 else ""
        super().__init__(f"{file}: {faults[0]}{more}")
        self.faults = faults
        self.details = {"faults": faults}


@dataclass
class _Checks:
    """Collects faults, so that all are reported at once."""

    file: Path
    build: Build
    faults: list[str] = field(default_factory=list)

    def fault(self, where: str, what: str) -> None:
        self.faults.append(f"{where} {what}".strip())

    def mapping(self, value: object, where: str) -> dict[str, Any]:
        """Return the value if it is a mapping with text keys, else {} and a fault; an empty value means {}."""
        if value is None:
            return {}
        if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
            self.fault(where, f"is {_shown(value)}; expected a mapping of names")
            return {}
        return value

    def names(self, value: object, where: str) -> Iterator[tuple[str, Any]]:
        """Return the items of a mapping whose keys can name artifacts."""
        for name, item in self.mapping(value, where).items():
            if len(name) > LONGEST or not _NAME.fullmatch(name):
                self.fault(f"{where}:", f"{name!r} is not a valid name; expected up to {LONGEST} letters, digits, "
                           "'.', '_', '+' or single '-', beginning with a letter or digit")  # fmt: skip
            else:
                yield name, item

    def config(self, config: type, options: Mapping[str, Any], where: str, others: tuple[type, ...] = ()) -> Any:
        """Return the config, or None and a fault."""
        try:
            return self.build(config, self.placed(config, options), where, others)
        except (StylerfError, ValueError) as error:
            self.faults.append(str(error))
            return None

    def placed(self, config: type, options: Mapping[str, Any]) -> dict[str, Any]:
        """The options, with paths of files beside the table made absolute, as jobs run in another folder, and whole
        numbers as text where that is expected, such as a budget in steps."""
        known = {item.name: item for item in options_of(config)}
        found = {}
        for key, value in options.items():
            item = known.get(key.replace("-", "_"))
            if item is not None and item.type is str and type(value) is int:
                value = str(value)
            if item is not None and item.metadata["digest"] and item.name != "images":
                value = self.located(value)
            found[key] = value
        return found

    def located(self, value: object) -> object:
        """Make an option that names a file or folder, or a list of VIEW=FILE, absolute if it exists."""
        if isinstance(value, list):
            return [self._located_of_view(one) for one in value]
        if not isinstance(value, str) or not value or value in PATHS or not self.path(value).exists():
            return value
        return str(self.path(value))

    def _located_of_view(self, value: object) -> object:
        if not isinstance(value, str) or "=" not in value:
            return value
        view, _, file = value.partition("=")
        return f"{view}={self.located(file)}"

    def path(self, text: str) -> Path:
        """Return a path from the table, which is relative to its folder."""
        return (self.file.parent / Path(text).expanduser()).resolve()

    def outside(self, text: str, where: str) -> Path:
        """Return the path of a file or folder that Snakemake watches, with a fault if it cannot."""
        found = self.path(text)
        if {"{", "}"} & {*str(found)}:
            self.fault(where, f"is {_shown(str(found))}; Snakemake treats braces as wildcards: rename or link it")
        return found

    def whole(self, value: object, where: str, low: int, high: int, default: int) -> int:
        """Return a whole number in a range, else the default and a fault."""
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            self.fault(where, f"is {_shown(value)}; expected a whole number from {low} to {high}")
            return default
        return value

    def choice(self, value: object, where: str, known: tuple[str, ...]) -> str:
        """Return one of the known words, else the first and a fault."""
        if value not in known:
            self.fault(where, f"is {_shown(value)}; expected one of {', '.join(known)}")
            return known[0]
        return str(value)


def read_table(file: Path, build: Build) -> Table:
    """Read and check a table.

    Args:
        file: the YAML file. Paths in it are relative to its folder.
        build: checks options as the command line does.

    Raises:
        TableFaults: anything in it is invalid.
        UsageError: it cannot be read.
    """
    content = read_yaml(file)
    if not isinstance(content, dict):
        raise UsageError(f"{file}: expected a mapping with scenes, styles and methods; see docs/how-to/many-scenes.md")
    checks = _Checks(file, build)
    for key in content:
        if key not in KEYS:
            checks.fault("", f"unknown key {_shown(key)}; choose from {', '.join(KEYS)}")
    scenes = _scenes(checks, content)
    styles = _styles(checks, content.get("styles"))
    methods = _methods(checks, content, bool(styles))
    edits = _edits(checks, content.get(EDITS))
    seeds = _seeds(checks, content.get("seeds", [0]))
    _refuse_equal_fields(checks, styles, methods, edits)
    out = content.get("out", file.stem)
    if not isinstance(out, str) or not out:
        checks.fault("out", f"is {_shown(out)}; expected a folder")
        out = file.stem
    container = content.get("container", "")
    if not isinstance(container, str) or not _IMAGE.fullmatch(container):
        checks.fault("container", f"is {_shown(container)}; expected an image such as docker://HOST/stylerf:TAG")
        container = ""
    threads = checks.whole(content.get("threads", 2), "threads", 1, MOST_THREADS, 2)
    device = checks.choice(content.get("device", "cpu"), "device", DEVICES)
    place = checks.path(out)
    if place == file.parent.resolve():
        checks.fault("out", "is the folder of the table; expected a separate one")
    if checks.faults:
        raise TableFaults(file, checks.faults)
    return Table(file.resolve(), place, scenes, styles, methods, edits, seeds, threads, device, container)


def _scenes(checks: _Checks, content: Mapping[str, Any]) -> tuple[Scene, ...]:
    found = []
    shared = {verb: _verb_options(checks, content.get(verb), verb) for verb in VERBS}
    for name, given in checks.names(content.get("scenes"), "scenes"):
        where = f"scenes: {name}"
        own = {"source": given} if isinstance(given, str) else checks.mapping(given, where)
        if name in RESERVED:
            checks.fault(where, "is a reserved folder name; choose another")
        for key in own:
            if key not in ("source", *VERBS):
                checks.fault(where, f"has unknown key {_shown(key)}; choose from source, {', '.join(VERBS)}")
        source = own.get("source")
        if not isinstance(source, str) or not source:
            checks.fault(where, "has no source; give the folder or file of its photos")
            continue
        options = {verb: {**shared[verb], **_verb_options(checks, own.get(verb), f"{where}: {verb}")} for verb in VERBS}
        rendered = "render" in own or content.get("render") is not None
        evaluated = content.get("eval") is not False and own.get("eval") is not False
        found.append(_scene(checks, name, checks.outside(source, f"{where}: source"), options, rendered, evaluated))
    if not found and not checks.faults:
        checks.fault("scenes", "is empty; expected NAME: SOURCE, one for each capture")
    return tuple(found)


def _verb_options(checks: _Checks, value: object, where: str) -> dict[str, Any]:
    if value is False and where.endswith("eval"):
        return {}
    return dict(checks.mapping(value, where))


def _scene(
    checks: _Checks, name: str, source: Path, options: dict[str, dict[str, Any]], rendered: bool, evaluated: bool
) -> Scene:
    where = f"scenes: {name}:"
    shards = checks.whole(options["render"].pop("shards", 1), f"{where} render: shards", 1, MOST_SHARDS, 1)
    path = checks.located(options["eval"].pop("path", ""))
    if not isinstance(path, str) or path in OWN_VIEWS:
        checks.fault(f"{where} eval: path", f"is {_shown(path)}; expected a camera path such as orbit or spiral")
        path = ""
    # The regions would be those of edits that happen to be finished: a picture must not depend on the order of jobs.
    options["render"].setdefault("regions", False)
    options["fit"].setdefault("buffers", False)
    render = checks.config(RenderConfig, options["render"], f"{where} render") if rendered else None
    if render is not None:
        if render.frames:
            checks.fault(f"{where} render:", "frames splits a path manually; use shards: N")
        if shards > 1 and (render.path not in PATHS or shards > render.count):
            checks.fault(f"{where} render:", f"{shards} shards need an orbit, a spiral or an interpolated path of at "
                         "least as many frames")  # fmt: skip
        if render.regions or render.masks or render.cryptomatte:
            checks.fault(f"{where} render:", "regions depend on which edits are finished; leave them out")
    return Scene(
        name=name,
        source=source,
        imported=checks.config(ImportOptions, options["import"], f"{where} import"),
        fit=checks.config(FitConfig, options["fit"], f"{where} fit"),
        deform=checks.config(DeformConfig, options["deform"], f"{where} deform"),
        render=render,
        shards=shards,
        evaluate=checks.config(EvaluateConfig, options["eval"], f"{where} eval") if evaluated else None,
        path=path,
    )


def _styles(checks: _Checks, value: object) -> dict[str, Path]:
    found = {}
    for name, file in checks.names(value, "styles"):
        if not isinstance(file, str) or not checks.path(file).is_file():
            checks.fault(f"styles: {name}", f"is {_shown(file)}; expected the file of an image, relative to the table")
        else:
            found[name] = checks.outside(file, f"styles: {name}")
    return found


def _methods(checks: _Checks, content: Mapping[str, Any], styled: bool) -> dict[str, Any]:
    given = content.get("methods", {"arf": {}} if styled else {})
    shared = checks.mapping(content.get(STYLIZE), STYLIZE)
    if given and not styled and not checks.faults:
        checks.fault("methods", "need a style image; add styles: NAME: FILE")
    found = {}
    for name, options in checks.names(given, "methods"):
        where = f"methods: {name}"
        own = dict(checks.mapping(options, where))
        method = own.pop("method", name)
        if method not in METHODS:
            checks.fault(where, f"is not a method of `stylize` with a style image; add method: {' or '.join(METHODS)}")
            continue
        if {"style", "reference"} & {*own, *shared}:
            checks.fault(where, "names an image; style images are listed under styles")
            continue
        try:
            refuse_foreign(method, own)
        except ValueError as error:
            checks.fault(f"{where}:", str(error))
            continue
        config = METHOD_CONFIGS[method]
        kind = {} if method == config.method else {"method": method}
        placeholder = {"style": "STYLE"}  # known when a job is created; some methods require it
        if checks.config(config, {**own, **kind, **placeholder}, where) is None:
            continue
        others = tuple(METHOD_CONFIGS.values())
        built = checks.config(config, {**shared, **own, **kind, **placeholder}, f"{where} with {STYLIZE}", others)
        if built is not None:
            found[name] = built
    return found


def _edits(checks: _Checks, value: object) -> dict[str, WholeEditConfig]:
    found = {}
    for name, options in checks.names(value, EDITS):
        config = checks.config(WholeEditConfig, checks.mapping(options, f"{EDITS}: {name}"), f"{EDITS}: {name}")
        if config is not None:
            found[name] = config
    return found


def _seeds(checks: _Checks, value: object) -> tuple[int, ...]:
    if not isinstance(value, list) or not 0 < len(value) <= MOST_SEEDS:
        checks.fault("seeds", f"is {_shown(value)}; expected a list of 1 to {MOST_SEEDS} whole numbers")
        return (0,)
    found = [checks.whole(one, "seeds:", 0, LARGEST_SEED, 0) for one in value]
    if len({*found}) < len(found) and not checks.faults:
        checks.fault("seeds", f"is {_shown(value)}; list each seed once")
    return tuple(found)


def _refuse_equal_fields(
    checks: _Checks, styles: Mapping[str, Any], methods: Mapping[str, Any], edits: Mapping[str, Any]
) -> None:
    """Reject rows whose fields would have the same name, such as style a-b by c and style a by b-c."""
    seen: dict[str, str] = {"fit": "the fit", "fit-deformed": "the deformed fit"}
    rows = [(f"{style}-{method}", f"style {style} by {method}") for style in styles for method in methods]
    for name, what in [*rows, *((f"edit-{name}", f"edit {name}") for name in edits)]:
        if name.casefold() in seen:
            checks.fault("", f"{what} and {seen[name.casefold()]} would both be field {name}; rename one of them")
        seen[name.casefold()] = what


def _shown(value: object) -> str:
    text = printable(repr(value))
    return text if len(text) <= 60 else f"{text[:57]}..."
