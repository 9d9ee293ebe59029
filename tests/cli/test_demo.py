"""`semloc demo` tells a story: a headline, pictures, next commands that work as printed; never long without a word."""

import re
import shlex
import sys
import time

import pytest

from semloc_jax.cli.main import OK, main
from semloc_jax.reports import demo as story

pytestmark = pytest.mark.usefixtures("single_precision")


def test_the_demo_says_how_good_it_is_and_what_comes_next(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--frames", "6", "--out", "first hour"]) == OK
    said = capsys.readouterr().out
    assert re.search(r"2 of 2 frames within \d+ cm of the truth; the satellite fixes .* were \d\.\d m off", said)
    pictures = re.findall(r"^  (/.*\.png)  ", said, re.MULTILINE)
    assert len(pictures) == 3 and all((tmp_path / path).is_file() for path in pictures)
    commands = re.findall(r"^  (\S.*?)  # ", said.split("next:")[1], re.MULTILINE)
    assert len(commands) == 3
    words = shlex.split(commands[-1])
    words = words[words.index("inspect") :]  # after `semloc`, or after `/path/of/python -m semloc_jax.cli.main`
    assert main(words) == OK  # the paths are those of this folder
    for command in commands:
        drive = next(word for word in shlex.split(command) if "first hour" in word)
        assert (tmp_path / drive).exists()


def test_what_takes_long_is_told(capsys, monkeypatch):
    with story.spoken("compiling", every_s=0.01):
        time.sleep(0.1)
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "compiling ..." and len(lines) > 2
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    with story.spoken("compiling", every_s=0.01):
        time.sleep(0.1)
    assert capsys.readouterr().out.count("\n") == 1  # a terminal counts in one line, which is empty in the end
    with pytest.raises(RuntimeError), story.spoken("failing", every_s=10.0):
        raise RuntimeError("the word ends with the work")


def test_a_distance_is_never_told_smaller_than_it_is():
    assert [story._rounded_up_cm(d) for d in (0.0, 0.002, 0.0301, 0.25)] == [1, 1, 4, 25]
    assert story.headline([], {}) == "none of 0 frames was localized"
