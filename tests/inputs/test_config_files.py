"""Configuration: defaults < file < command line; nothing that is misspelt passes; what is written reads back."""

import types
from dataclasses import dataclass, field

import pytest
import tyro
import yaml

from semloc_jax.cli.arguments import parse
from semloc_jax.errors import UsageError
from semloc_jax.inputs.choices import parse_names, parse_slice
from semloc_jax.inputs.config_files import to_plain


@dataclass(frozen=True)
class Stage:
    keep: int = 10
    levels: tuple[int, ...] = ()


@dataclass(frozen=True)
class Search:
    stages: tuple[Stage, ...] = (Stage(48), Stage(6, (1, 2)))
    kernel: str = "tukey"
    lock: bool = False


@dataclass(frozen=True)
class Settings:
    radius_m: float = 60.0
    ramp_px: tuple[float, ...] = (40.0, 8.0)
    limit_m: float | None = None
    search: Search = field(default_factory=Search)


@dataclass(frozen=True)
class Options:
    """A verb with a configuration."""

    drive: tyro.conf.Positional[str]
    """Where."""
    frames: str = ":"
    seed: int = 0
    strict: bool = False
    config: str | None = None
    out: str | None = None


VERB = types.ModuleType("verb")
VERB.Options, VERB.default_settings = Options, Settings


def _parse(*words):
    return parse("try", VERB, ["town", *words])


@pytest.fixture
def config(tmp_path):
    def write(content):
        path = tmp_path / "some.yaml"
        path.write_text(content if isinstance(content, str) else yaml.safe_dump(content))
        return f"--config={path}"

    return write


def test_without_words_the_defaults_hold():
    options = _parse()
    assert options.settings == Settings()
    assert (options.drive, options.frames, options.seed) == ("town", ":", 0)


def test_the_command_line_beats_the_file_and_the_file_the_defaults(config):
    content = {"radius_m": 30, "ramp_px": [1, 2, 3], "search": {"kernel": "cauchy"}, "seed": 4, "frames": "::7"}
    options = _parse(config(content), "--radius-m", "5", "--seed", "9", "--search.lock", "True")
    assert options.settings == Settings(5.0, (1.0, 2.0, 3.0), None, Search(kernel="cauchy", lock=True))
    assert (options.seed, options.frames) == (9, "::7")


def test_switches_of_a_verb_take_no_value(config):
    assert _parse("--strict").strict
    assert _parse(config({"strict": True})).strict
    assert not _parse(config({"strict": False})).strict


def test_lists_of_stages_may_change_their_length(config):
    stages = [{"keep": 1}, {"keep": 2}, {"levels": [3]}]
    options = _parse(config({"search": {"stages": stages}}), "--search.stages.1.keep", "20")
    assert options.settings.search.stages == (Stage(1), Stage(20, (1, 2)), Stage(6, (3,)))
    assert _parse(config({"search": {"stages": [{"keep": 5}]}})).settings.search.stages == (Stage(5),)


def test_what_is_written_reads_back(config):
    once = _parse("--radius-m", "12.5", "--search.stages.0.levels", "3", "4", "--limit-m", "2", "--search.lock", "True")
    plain = {"run": {"command": "semloc try town"}, "seed": once.seed, **to_plain(once.settings)}
    assert _parse(config(plain)).settings == once.settings
    assert _parse(config(to_plain(Settings()))).settings == Settings()


def test_an_empty_file_changes_nothing(config):
    assert _parse(config("# nothing\n")).settings == Settings()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"raduis_m": 3}, "unknown key 'raduis_m'; did you mean 'radius_m'?"),
        ({"search": {"kernle": "x"}}, "search: unknown key 'kernle'; did you mean 'kernel'?"),
        ({"search": {"stages": [{"kep": 3}]}}, "stages[0]: unknown key 'kep'; did you mean 'keep'?"),
        ({"search": {"stages": 3}}, "'stages' is 3; expected a list of keep, levels"),
        ({"search": 3}, "'search' is 3; expected keys: stages, kernel, lock"),
        ({"radius_m": "far"}, "could not convert string to float: 'far'"),
        ({"search": {"lock": "perhaps"}}, "--search.lock"),
        ({"out": "here"}, "unknown key 'out'"),
        ({"zzz": 1}, "unknown key 'zzz'; keys: radius_m, ramp_px, limit_m, search, frames, seed, strict"),
        ("a: [1,", "not a YAML file"),
        (f"a: {'[' * 3000}{']' * 3000}", "not a YAML file"),
        ("- 1\n- 2\n", "holds a list; expected keys and values"),
    ],
)
def test_wrong_files_are_refused_with_their_name(config, content, message):
    with pytest.raises(UsageError) as refusal:
        _parse(config(content))
    assert message in str(refusal.value)
    assert "some.yaml" in str(refusal.value)


def test_a_missing_file_is_refused():
    with pytest.raises(UsageError, match=r"config nowhere.yaml: no such file"):
        _parse("--config", "nowhere.yaml")


def test_misspelt_options_are_refused_with_a_suggestion():
    with pytest.raises(UsageError, match=r"unknown option '--search.kernle'; did you mean '--search.kernel'"):
        _parse("--search.kernle", "x")
    with pytest.raises(UsageError, match=r"unknown option '--sed'; did you mean '--seed'"):
        _parse("--sed=3")


@pytest.mark.parametrize(
    ("text", "chosen"),
    [
        ("::5", [0, 5]),
        ("2:4", [2, 3]),
        ("-2:", [8, 9]),
        (":", list(range(10))),
        ("3", [3]),
        ("-1", [9]),
        ("[::5]", [0, 5]),
    ],
)
def test_frames_are_a_python_slice(text, chosen):
    assert list(range(10))[parse_slice(text)] == chosen


@pytest.mark.parametrize("text", ["", "a:b", "1:2:3:4", "::0", "1.5"])
def test_what_is_no_slice_is_refused(text):
    with pytest.raises(UsageError, match=r"expected a Python slice such as ::5"):
        parse_slice(text)


def test_names_are_comma_separated():
    assert parse_names("front, left,") == ("front", "left")
    assert parse_names(None) is None
