"""Runs a verb and kills it at the n-th change of a file below a folder: `python -m tests.storage.killed_verb FOLDER N
WORDS...`; N = 0 kills nothing and says at the end how many changes there were.

What libraries write without Python (pictures, films, GeoPackages) is seen when the file is renamed into its place.
"""

import os
import signal
import sys
from pathlib import Path

CHANGES = ("os.rename", "os.remove", "os.mkdir", "os.rmdir")


def main(folder: str, at: str, *words: str) -> int:
    """Exit code of the verb; the number of changes goes to the last line of stderr."""
    top, count = str(Path(folder).resolve()), 0

    def watch(event: str, values: tuple) -> None:
        nonlocal count
        is_written = event == "open" and isinstance(values[2], int) and values[2] & (os.O_WRONLY | os.O_RDWR)
        if (is_written or event in CHANGES) and isinstance(values[0], (str, bytes, os.PathLike)):
            if os.path.abspath(os.fsdecode(values[0])).startswith(top):
                count += 1
                if count == int(at):
                    os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(watch)
    from semloc_jax.cli.main import main as verb

    code = verb(list(words))
    print(count, file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
