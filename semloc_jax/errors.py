"""The exception for bad input (room: ground).

In: nothing. Out: SemlocError, which the command line prints as one line.
"""


class SemlocError(ValueError):
    """Bad user input: the message names what was given, what was expected and what to do."""


class UsageError(Exception):
    """The command line or a configuration file is wrong (exit code 2)."""
