"""The command as a whole: help at once, exit codes, one line for each error."""

import importlib
import os
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


IN_FORKS = """
import os, sys
from semloc_jax.cli.main import main

for words in {calls!r}:
    if os.fork() == 0:
        code = main(words)
        print("CALL", code, len(sys.modules), *[name for name in {heavy!r} if name in sys.modules], flush=True)
        os._exit(0)
    os.wait()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_help_imports_nothing_heavy():
    """Each call in a process that has imported the command line and nothing else."""
    calls = [["--help"], *([verb, "--help"] for verb in VERBS)]
    code = IN_FORKS.format(calls=calls, heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=False)
    told = [line.split()[1:] for line in done.stdout.splitlines() if line.startswith("CALL")]
    assert len(told) == len(calls), done.stderr
    for words, (returned, count, *loaded) in zip(calls, told, strict=True):
        assert (int(returned), loaded) == (OK, []), words
        assert int(count) <= MOST_MODULES["VERB --help" if len(words) > 1 else "--help"], words


@pytest.mark.parametrize("words", [["--help"], *([*verb.split(), "--help"] for verb in (*VERBS, "learn eyes"))])
def test_help_fits_a_terminal_and_says_no_more_than_it_means(words, capsys):
    """80 columns; no `{None}|PATH`, no default that is none; a sentence of an option is not broken in its middle."""
    assert main(words) == OK
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 80
    assert "{None}" not in text and "default: None" not in text and "default: False" not in text
    assert "(default: )" not in text and "\n\n\n" not in text
    lines = [line.strip("│ ") for line in text.splitlines()]
    assert not {"before it", "went, and", "the results"} & set(lines)


def test_help_keeps_defaults_that_say_something(capsys):
    assert main(["localize", "--help"]) == OK
    text = " ".join(line.strip("│ ") for line in capsys.readouterr().out.splitlines())
    for part in ("(default: 0.5)", "(default: 0)", "--calib PATH", "{search,icp}", "DRIVE [DRIVE...]"):
        assert part in text


def test_help_of_a_terminal_without_boxes():
    code = "from semloc_jax.cli.main import main; main(['init', '--help'])"
    env = {**os.environ, "PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, cwd=ROOT, env=env, check=True)
    assert b"FOLDER" in done.stdout and b"\xe2" not in done.stdout


@pytest.mark.parametrize("verb", ["map", "odometry", "simulate"])
def test_the_configuration_of_a_verb_is_printed_and_read_back(verb, tmp_path, capsys):
    from semloc_jax.cli.arguments import read_settings

    assert main(["config", verb]) == OK
    (tmp_path / "mine.yaml").write_text(capsys.readouterr().out)
    module = importlib.import_module(f"semloc_jax.cli.{verb}")
    assert read_settings(str(tmp_path / "mine.yaml"), module.Options, module.default_settings())[0] == (
        module.default_settings()
    )


WAITS = """
import atexit, sys, time
from concurrent.futures import ThreadPoolExecutor
import semloc_jax.cli.main as command

def main():
    pool = ThreadPoolExecutor(1)  # never shut down
    pool.submit(lambda: (time.sleep(0.1), print("work")))
    print("done")
    return 3

atexit.register(lambda: print("registered"))
command.main = main
command.leave()
"""


def test_the_process_ends_at_once_but_for_what_others_have_to_see():
    found = subprocess.run([sys.executable, "-c", WAITS], capture_output=True, text=True, check=False, timeout=60)
    assert (found.returncode, found.stdout.split(), found.stderr) == (3, ["done", "work", "registered"], "")


def test_version_is_printed(capsys):
    assert main(["--version"]) == OK
    assert capsys.readouterr().out.startswith("semloc 0.")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["localise"], "unknown verb 'localise'; did you mean 'localize'?"),
        (["evaluate", "a.tum"], "Missing"),
        (["config", "nothing"], "for argument 'verb'. Expected one of ('localize', 'track', 'map'"),
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
