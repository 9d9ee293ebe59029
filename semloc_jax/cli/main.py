"""The `semloc` command: picks the verb, turns exceptions into one line and an exit code (room: cli).

In: the command line. Out: an exit code: 0 done, 1 failed, 2 wrong usage, 3 ran but is lost or missed a gate.
Nothing heavy is imported before a verb runs, so that `--help` answers at once.
"""

import atexit
import gc
import importlib
import os
import re
import sys
import textwrap
import threading
from collections.abc import Sequence
from types import ModuleType
from typing import NoReturn

OK, FAILED, USAGE, LOST = 0, 1, 2, 3
INTERRUPTED = 130
_GARBAGE_EVERY = 200_000
"""New objects after which Python looks for garbage: at every 700th, as by default, a fifth of all imports is that, at
every 50,000th still 6 % of a warm start."""

VERBS = {
    "localize": "where was the vehicle in each frame of a drive: trajectory, modes, metrics, pictures",
    "track": "follow the vehicle through a whole drive: pose, confidence and status of every frame",
    "map": "make a map of a drive from its masks, wheels and gyroscope, without any other map",
    "odometry": "the trajectory of a drive without any map, from cameras, inertial sensor or wheels",
    "landscape": "the cost around the pose of one frame, over two of the six directions",
    "explain": "which map elements hold the pose of a frame, and how far it moves where one of them is wrong",
    "survey": "how well a road can be localized on, from map and camera alone, and the small map that is enough",
    "evaluate": "errors of a trajectory or a map against a reference, with optional limits",
    "init": "look at your own recording: what is there, what is missing, templates, the next command",
    "inspect": "what a map holds and what looks wrong in it",
    "convert": "write a map in another format, and say what is lost",
    "pack": "what a car uploads of a mapped drive: elements, what it looked at, its trajectory; no images",
    "merge": "merge many drives into one map, keep it up to date and list what has changed",
    "diff": "the difference between two versions of a map, as a small file",
    "apply": "apply a difference to a version of a map",
    "log": "the versions of a map, and its hashes by tile",
    "rollback": "restore an earlier version of a map",
    "serve": "serve a map, its differences and its tiles over HTTP; accept packed drives",
    "pull": "fetch the newest version of a map from a server, by differences",
    "calibrate": "calibrate cameras, odometer and satellite offset from a drive; say what it leaves open",
    "learn": "learn class weights, ramp width and noise through the solver; learn eyes, slots, obstacles: networks",
    "check-calib": "what looks wrong in a calibration, and pictures of it: horizon, ground grid, map",
    "surround": "the metric top view of all cameras around a vehicle",
    "slots": "parking slots around a vehicle, refined over many frames",
    "obstacles": "cones, pillars, ground locks and signs around a vehicle, refined over many frames",
    "segment": "masks of a drive by a network, with a report of the map classes they can see",
    "data": "make the drives that the tables of figures name, from their seeds",
    "simulate": "write a small rendered drive with exact truth",
    "demo": "simulate, localize and draw, in about a minute",
    "bench": "solves per second of this package and of other solvers on this machine",
    "doctor": "check this machine: versions, device, numerical self-tests",
    "config": "print the configuration with every default filled in",
}

TEACHING = (("learn", "eyes"), ("learn", "slots"), ("learn", "obstacles"))
"""Words of verbs of their own: `semloc learn ./eyes` learns from a drive of that name."""

USAGE_TEXT = """usage: semloc VERB [OPTIONS]

Vision-based semantic localization in a map.

{verbs}

  semloc VERB --help    options of one verb
  semloc --version      version of the package
  --debug               (any verb) show the traceback of an error

exit codes: 0 done, 1 failed, 2 wrong usage, 3 ran but is lost or missed a gate
"""


def usage() -> str:
    """The text of `semloc --help`."""
    lines = [
        textwrap.fill(text, 80, initial_indent=f"  {name:<13}", subsequent_indent=" " * 15)
        for name, text in VERBS.items()
    ]
    return USAGE_TEXT.format(verbs="\n".join(lines))


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line.

    Args:
        argv: Arguments without the program's name; None takes those of the process.

    Returns:
        The exit code.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    if not words or words[0] in ("-h", "--help", "help"):
        print(usage(), end="", file=sys.stdout if words else sys.stderr)
        return OK if words else USAGE
    if words[0] == "--version":
        from semloc_jax import __version__

        print(f"semloc {__version__}")
        return OK
    if words[0] not in VERBS:
        return _refuse(f"semloc: unknown verb '{words[0]}'{_did_you_mean(words[0])}; verbs: {', '.join(VERBS)}")
    if tuple(words[:2]) in TEACHING:
        return _run_verb(" ".join(words[:2]), words[2:], debug)
    return _run_verb(words[0], words[1:], debug)


def leave() -> NoReturn:
    """Run the command line of this process, and end the process without taking Python apart.

    Taking apart some thousand modules and every program takes 0.7 CPU seconds, a quarter of a warm `localize`. What
    others have to see is done before: threads have ended, files are closed or cleaned up (`atexit`), output is flushed.
    """
    code = main()
    threading._shutdown()  # with these two Python itself begins to end; pools that wait for work end by the first only
    atexit._run_exitfuncs()
    try:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
    except BrokenPipeError:
        code = code or FAILED
    os._exit(code)


def _run_verb(name: str, words: list[str], debug: bool) -> int:
    from semloc_jax.cli.arguments import parse
    from semloc_jax.errors import SemlocError, UsageError
    from semloc_jax.runtime import prepare as runtime
    from semloc_jax.storage import release_claims

    gc.set_threshold(_GARBAGE_EVERY)
    try:
        if not {"-h", "--help"} & set(words):
            runtime.prepare_jax()
        verb: ModuleType = importlib.import_module(f"semloc_jax.cli.{re.sub('[- ]', '_', name)}")
        return verb.run(parse(name, verb, words))
    except SystemExit as stop:  # `--help` of a verb
        return int(stop.code or 0)
    except UsageError as error:
        return _refuse(f"semloc {name}: {error} (see 'semloc {name} --help')")
    except BrokenPipeError:  # the reader of our output has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except KeyboardInterrupt:
        print(f"semloc {name}: interrupted", file=sys.stderr)
        return INTERRUPTED
    except (SemlocError, OSError) as error:
        if debug:
            raise
        print(f"semloc {name}: {_one_line(error)}", file=sys.stderr)
        return FAILED
    except Exception as error:
        if debug:
            raise
        what = f"{type(error).__name__}: {_one_line(error)}"
        print(
            f"semloc {name}: internal error: {what}; run again with --debug and report the traceback", file=sys.stderr
        )
        return FAILED
    finally:
        release_claims()


def log_to_console() -> None:
    """Show what the package logs, as plain lines."""
    import logging

    logging.basicConfig(format="%(message)s")
    logging.getLogger("semloc_jax").setLevel(logging.INFO)


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__


def _refuse(text: str) -> int:
    print(text, file=sys.stderr)
    return USAGE


def _did_you_mean(word: str) -> str:
    import difflib

    close = difflib.get_close_matches(word, VERBS, n=1)
    return f"; did you mean '{close[0]}'?" if close else ""


if __name__ == "__main__":
    leave()
