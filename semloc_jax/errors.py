"""The one exception that stands for bad input, and what to install where a library is missing (room: ground).

In: nothing. Out: SemlocError, which the command line prints as one line; `install_command`.
"""

import re
import sys

EXTRAS = {
    "viz": "rerun-sdk>=0.23",
    "onnx": "onnxruntime>=1.19",
    "bags": "rosbags>=0.10.9",
    "argoverse": "pyarrow>=17",
    "gis": "pyogrio>=0.10",
}
"""What each extra of this package installs, as in pyproject.toml."""


def install_command(extra: str) -> str:
    """The command that installs what an extra of this package needs.

    It names the library, not this package: it works from every folder, however this package was installed.
    """
    return f'{sys.executable or "python"} -m pip install "{EXTRAS[extra]}"'


class SemlocError(ValueError):
    """Bad user input: the message names what was given, what was expected and what to do.

    It is one line of plain text: what parsers say over several lines is joined, and control characters that a file has
    brought in cannot move the cursor of a terminal.
    """

    def __init__(self, message: object = "") -> None:
        one_line = re.sub(r"\s*[\r\n]\s*", " ", str(message))
        super().__init__(re.sub(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]", "?", one_line))


class UsageError(Exception):
    """The command line or a configuration file is wrong (exit code 2)."""


class DamagedPicture(SemlocError):
    """A picture is there and cannot be decoded."""
