"""The command as a whole: help at once, exit codes, one line for each error."""

import subprocess
import sys
from pathlib import Path

import pytest

from semloc_jax.cli.main import FAILED, OK, USAGE, VERBS, main

ROOT = Path(__file__).resolve().parents[2]
HEAVY = "jax", "numpy", "cv2", "matplotlib", "scipy", "yaml", "equinox"
MOST_MODULES = {"--help": 90, "VERB --help": 400}
"""Modules that help may load, with those of Python itself; `import numpy` alone loads 150, JAX 1,000 more."""


def test_help_names_every_verb_and_exit_code(capsys):
    assert main(["--help"]) == OK
    text = capsys.readouterr().out
    assert all(verb in text for verb in VERBS)
    assert "0 done, 1 failed, 2 wrong usage, 3 ran but is lost" in text


@pytest.mark.parametrize("words", [["--help"], *([verb, "--help"] for verb in VERBS)])
def test_help_imports_nothing_heavy(words):
    code = (
        f"import sys\nfrom semloc_jax.cli.main import main\ncode = main({words!r})\n"
        f"print('LOADED', *[n for n in {HEAVY!r} if n in sys.modules])\nprint(len(sys.modules))\nsys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == OK, done.stderr
    loaded, count = done.stdout.splitlines()[-2:]
    assert loaded == "LOADED"
    assert int(count) <= MOST_MODULES["VERB --help" if len(words) > 1 else "--help"]


def test_version_is_printed(capsys):
    assert main(["--version"]) == OK
    assert capsys.readouterr().out.startswith("semloc 0.")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["localise"], "unknown verb 'localise'; did you mean 'localize'?"),
        (["evaluate", "a.tum"], "Missing"),
        (["evaluate", "a.tum", "b.tum", "--max-diference-s", "1"], "did you mean '--max-difference-s'?"),
        (["evaluate", "a.tum", "b.tum", "--max-difference-s", "soon"], "could not convert string to float: 'soon'"),
    ],
)
def test_wrong_usage_is_one_line_and_exit_code_2(words, message, capsys):
    assert main(words) == USAGE
    said = capsys.readouterr()
    assert message in said.err
    assert len(said.err.strip().splitlines()) == 1
    assert said.out == ""


def test_no_verb_prints_the_usage_as_an_error(capsys):
    assert main([]) == USAGE
    assert "usage: semloc VERB" in capsys.readouterr().err


def test_bad_input_is_one_line_and_exit_code_1(capsys):
    assert main(["evaluate", "missing.tum", "missing.tum"]) == FAILED
    said = capsys.readouterr().err
    assert said == "semloc evaluate: trajectory missing.tum: no such file; expected a TUM, KITTI or npy file\n"


def test_debug_shows_the_traceback(capsys):
    with pytest.raises(ValueError, match="no such file"):
        main(["evaluate", "missing.tum", "missing.tum", "--debug"])


def test_a_bug_is_one_line_too(monkeypatch, capsys):
    from semloc_jax.cli import evaluate

    def broken(options):
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr(evaluate, "run", broken)
    assert main(["evaluate", "a", "b"]) == FAILED
    said = capsys.readouterr().err
    assert said.startswith(
        "semloc evaluate: internal error: ZeroDivisionError: division by zero; run again with --debug"
    )
    assert len(said.splitlines()) == 1


def test_an_interrupt_ends_quietly(monkeypatch, capsys):
    from semloc_jax.cli import evaluate

    def interrupted(options):
        raise KeyboardInterrupt

    monkeypatch.setattr(evaluate, "run", interrupted)
    assert main(["evaluate", "a", "b"]) == 130
    assert capsys.readouterr().err == "semloc evaluate: interrupted\n"


def test_the_reader_of_the_output_may_go_away():
    script = f"{sys.executable} -m semloc_jax.cli.main --help | head -n 1"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, cwd=ROOT, check=False)
    assert "Traceback" not in done.stderr
