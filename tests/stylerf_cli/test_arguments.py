"""Flags from dataclasses: every type, from the command line and from TOML, with flags above TOML above defaults."""

import re
import textwrap
from argparse import Namespace
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

import pytest

from schemas.errors import UsageError
from stages.configs import flags_of, option
from stages.configs.render import RenderConfig
from stylerf_cli.arguments import Parser, add_common, add_config
from stylerf_cli.main import main
from stylerf_cli.session import Options
from stylerf_cli.verbs import VERBS
from tests.conftest import REPOSITORY


@dataclass(frozen=True)
class Config:
    budget: str = option("5m", help="how long, 100 % of it")
    learning_rate: float = option(0.02, help="step size")
    steps: int = option(100, help="steps", flag="--iterations")
    prune: bool = option(True, help="whether to prune")
    grid: tuple[int, int] = option((4, 5), help="two sizes")
    layers: tuple[str, ...] = option((), help="layers")
    mode: str = option("fast", help="mode", choices=("fast", "exact"))
    mask: Path = option(Path(), help="file")


@dataclass(frozen=True)
class Required:
    style: str = option(help="painting")


def parse(arguments, config=Config, toml=None, tmp_path=None):
    parser = Parser(prog="stylerf fit")
    add_config(parser, config)
    add_common(parser)
    if toml is not None:
        (tmp_path / "o.toml").write_text(toml)
        arguments = [*arguments, "--config", str(tmp_path / "o.toml")]
    return Options("fit", parser.parse_args(arguments), ["fit", "import"])


def test_flags_of_a_config_make_it_again():
    made = Config("60s", -1e-3, 7, False, (8, 9), ("a", "b"), "exact", Path("my mask.png"))
    assert parse(flags_of(made)).config(Config) == made
    assert flags_of(Config()) == []
    assert flags_of(RenderConfig(path="cameras.json", path_digest="d1", exr=False)) == [
        "--path",
        "cameras.json",
        "--no-exr",
    ]


def test_defaults_live_in_the_dataclass_alone():
    assert parse([]).config(Config) == Config()


def test_every_type_from_flags():
    given = (
        "--budget 60s --learning-rate 1e-3 --iterations 7 --no-prune --grid 8 9 --layers a b --layers c "
        "--mode exact --mask m.png"
    )
    assert parse(given.split()).config(Config) == Config(
        "60s", 1e-3, 7, False, (8, 9), ("a", "b", "c"), "exact", Path("m.png")
    )
    assert parse(["--learning-rate", "-0.5"]).config(Config).learning_rate == -0.5


def test_every_type_from_toml(tmp_path):
    text = (
        'budget = "60s"\nlearning-rate = 1\nsteps = 7\nprune = false\ngrid = [8, 9]\nlayers = ["a", "b"]\n'
        'mode = "exact"\nmask = "m.png"\n'
    )
    config = parse([], toml=text, tmp_path=tmp_path).config(Config)
    assert config == Config("60s", 1.0, 7, False, (8, 9), ("a", "b"), "exact", Path("m.png"))
    assert isinstance(config.learning_rate, float)


def test_flags_win_over_tables_over_the_top_over_defaults(tmp_path):
    text = 'steps = 1\nbudget = "1s"\nmode = "exact"\n[fit]\nsteps = 2\nbudget = "2s"\n[import]\nwhatever = 1\n'
    config = parse(["--iterations", "3"], toml=text, tmp_path=tmp_path).config(Config)
    assert (config.steps, config.budget, config.mode, config.learning_rate) == (3, "2s", "exact", 0.02)


def test_other_verbs_get_their_own_table_only(tmp_path):
    text = "steps = 1\n[import]\nsteps = 9\n"
    assert parse([], toml=text, tmp_path=tmp_path).config_of("import", Config) == Config(steps=9)
    assert parse([], toml="steps = 1", tmp_path=tmp_path).config_of("import", Config) == Config()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("stesp = 3", "unknown option 'stesp'; did you mean 'steps'"),
        ("zzzz = 3", "choose from budget"),
        ("[fti]\nsteps = 1", "unknown verb 'fti'; did you mean 'fit'"),
        ("steps = 1.5", "steps takes a whole number, not 1.5"),
        ("steps = true", "steps takes a whole number"),
        ("budget = 60", "budget takes a text in quotes"),
        ("prune = 1", "true or false"),
        (f"learning_rate = 1{'0' * 400}", "1329 bits is more than TOML's 64"),
        (f"grid = [1, 0x{'f' * 9000}]", "36000 bits is more than TOML's 64"),
        ("learning_rate = nan", "learning_rate takes a number"),
        ("grid = [1]", "list of 2"),
        ("grid = 1", "list of 2"),
        ("layers = [1]", "text in quotes"),
        ('mode = "slow"', "fast, exact"),
        ("steps = ", "not valid TOML"),
        ('seed = "x"', "seed takes a value of type int"),
        ('device = "tpu"', "tpu"),
        ("threads = 0", "at least 1"),
        ("seed = -1", "seed is -1; expected 0 to"),
    ],
)
def test_faults_of_a_file_are_reported_with_its_name(tmp_path, text, words):
    with pytest.raises(UsageError, match=r"o\.toml") as caught:
        options = parse([], toml=text, tmp_path=tmp_path)
        options.common()
        options.config(Config)
    assert words in str(caught.value)


@pytest.mark.parametrize(
    "arguments",
    ["--learning-rate nan", "--learning-rate fast", "--grid 1", "--mode slow", "--prun", "--budge 3", "--steps 3", "x"],
)
def test_faults_of_flags(arguments):
    with pytest.raises(UsageError, match="stylerf fit --help"):
        parse(arguments.split()).config(Config)


def test_required():
    assert parse(["--style", "s.png"], Required).config(Required) == Required("s.png")
    with pytest.raises(UsageError, match="--style is required"):
        parse([], Required).config(Required)


def test_common_options(tmp_path):
    text = 'seed = 4\ndevice = "cpu"\nthreads = 3'
    common = parse(["--seed", "5"], toml=text, tmp_path=tmp_path).common()
    assert (common.seed, common.device, common.threads) == (5, "cpu", 3)
    common = parse([]).common()
    assert (common.seed, common.device, common.threads) == (0, "auto", None)


def test_a_verb_without_options_takes_none_from_the_file(tmp_path):
    parser = Parser(prog="stylerf fit")
    add_common(parser)
    (tmp_path / "o.toml").write_text("seed = 3\nsteps = 1")
    options = Options("fit", parser.parse_args(["--config", str(tmp_path / "o.toml")]), ["fit"])
    with pytest.raises(UsageError, match="has no option 'steps'"):
        options.config(None)


def test_help_tells_defaults_and_choices(capsys):
    parser = Parser(prog="stylerf fit")
    add_config(parser, Config)
    text = " ".join(parser.format_help().split())
    assert "how long, 100 % of it (default: 5m)" in text
    assert "--prune, --no-prune whether to prune (default: True)" in text
    assert "(default: 4 5)" in text and "fast|exact" in text


@pytest.mark.parametrize("flags", [("--region", "head", "--recolor"), ("--method", "palettenerf")])
def test_a_file_for_a_chain_serves_every_use_of_a_verb(tmp_path, capsys, flags):
    """The file of docs/configuration.md. There is no work folder: its options are sound, then nothing is there."""
    text = (REPOSITORY / "docs" / "configuration.md").read_text().partition("    seed = 7\n")
    chain = textwrap.dedent("".join(text[1:]).partition("\n\nUnknown")[0])
    (tmp_path / "chain.toml").write_text(chain)
    command = ["stylize", str(tmp_path / "work"), *flags, "--config", str(tmp_path / "chain.toml")]
    assert "[stylize]" in chain and main(command) == 4, capsys.readouterr().err
    (tmp_path / "chain.toml").write_text(chain + "\nmehtod = 1\n")
    assert main(command) == 2 and "unknown option 'mehtod'" in capsys.readouterr().err


@dataclass(frozen=True)
class Grouped:
    rate: float = option(0.5, help="how fast")
    levels: int = option(8, help="how deep", advanced=True, group="grid")
    mask: str = option("", help="file", digest="mask_digest")
    mask_digest: str = ""


def help_of(everything: bool) -> str:
    parser = Parser(prog="stylerf fit")
    add_config(parser, Grouped, everything)
    add_common(parser, everything)
    return parser.format_help()


def test_the_method_of_a_region_may_be_set_in_the_file(tmp_path):
    from stages.configs.edit import RegionConfig
    from stages.configs.stylize import RefNprConfig
    from stylerf_cli.verbs.stylize import options_for

    file = tmp_path / "c.toml"
    arguments = ["work", "--region", "shovel", "--config", str(file)]
    for method, config in (("refnpr", RefNprConfig), ("snerf", RegionConfig)):
        file.write_text(f'[stylize]\nmethod = "{method}"\n')
        assert options_for(arguments) is config
    file.write_text('[stylize]\nmethod = "refnpr"\nbend = 2.0\n')
    with pytest.raises(UsageError, match="bend"):
        options_for(arguments)


def test_the_page_of_view_hands_on_the_common_options():
    from stylerf_cli.session import Common
    from stylerf_cli.verbs.view import passed_on

    assert passed_on(Namespace(no_paths=False), Common(), None) == ()
    given = Common(seed=3, device="cpu", threads=2, memory=4_000_000_000)
    assert passed_on(Namespace(no_paths=True), given, Path("c.toml")) == (
        "--seed", "3", "--threads", "2", "--device", "cpu", "--memory", "4000000000", "--no-paths",
        "--config", "c.toml",
    )  # fmt: skip


def test_a_file_for_other_verbs_holds_options_in_tables_alone(tmp_path):
    file = tmp_path / "c.toml"
    for text, fault in (("seed = 3\n[fit]\nbudget = '9s'\n", ""), ("port = 80\n", "'port' is outside a table")):
        file.write_text(text)
        options = Options("view", Namespace(config=file), ["view", "fit"])
        if fault:
            with pytest.raises(UsageError, match=fault):
                options.file_for_others()
        else:
            assert options.file_for_others() == file


def test_advanced_options_are_listed_in_the_whole_help_alone():
    short, whole = help_of(False), help_of(True)
    assert "--rate" in short and "--levels" not in short and "--memory" not in short
    assert "--memory" in whole and re.search(r"\ngrid:\n +--levels", whole)
    assert parse(["--levels", "9"], Grouped).config(Grouped).levels == 9  # hidden, not gone


def test_a_digest_is_neither_a_flag_nor_a_key(tmp_path):
    assert "digest" not in help_of(True)
    with pytest.raises(UsageError, match="unrecognized"):
        parse(["--mask-digest", "d1"], Grouped)
    with pytest.raises(UsageError, match="unknown option 'mask_digest'"):
        parse([], Grouped, 'mask_digest = "d1"', tmp_path).config(Grouped)


@pytest.mark.parametrize("verb", [verb for verb in VERBS if verb not in ("show", "verify", "doctor", "compare")])
def test_no_verb_takes_a_digest_and_each_help_is_whole(verb, capsys):
    assert main([verb, "--help-all"]) == 0
    whole = capsys.readouterr().out
    assert main([verb, "--help"]) == 0
    short = capsys.readouterr().out
    assert "digest" not in whole and "--help-all" in short and "--memory" in whole and "--memory" not in short
    assert set(re.findall(r"--[a-z-]+", short)) <= set(re.findall(r"--[a-z-]+", whole))


@pytest.mark.parametrize("options", [[], ["--json"]])
def test_view_says_its_address_as_it_begins(options, tmp_path, monkeypatch, capsys):
    said = []
    waits = SimpleNamespace(url="http://here", close=lambda: None, wait=lambda: said.extend(capsys.readouterr()))
    monkeypatch.setattr("stages.viewing.server.Viewer", lambda *given: waits)
    assert main(["view", str(tmp_path), "--no-open", *options]) == 0
    assert ["http://here" in text for text in said] == ([False, True] if options else [True, False])
