"""Choices of frames and names as typed by a user (room: inputs; host).

In: text such as `::5` or `front,left`. Out: slices, names.
"""

from typing import TYPE_CHECKING

from semloc_jax.errors import SemlocError, UsageError

if TYPE_CHECKING:
    from semloc_jax.datasets import Drive


def parse_slice(text: str, option: str = "--frames") -> slice:
    """A Python slice such as `::5`, `10:20` or `-3:`; a single number selects one frame.

    Raises:
        UsageError: The text is not a slice.
    """
    parts = text.strip().removeprefix("[").removesuffix("]").split(":")
    try:
        numbers = [int(part) if part.strip() else None for part in parts]
        if len(numbers) == 1 and numbers[0] is not None:
            return slice(numbers[0], numbers[0] + 1 or None)
        if len(numbers) in (2, 3) and (len(numbers) == 2 or numbers[2] != 0):
            return slice(*numbers)
    except ValueError:
        pass
    raise UsageError(f"{option} '{text}': expected a Python slice such as ::5, 10:20 or -3:, or one number")


def chosen_frames(drive: "Drive", text: str) -> slice:
    """The frames of a drive that a slice chooses.

    Raises:
        UsageError: the text is not a slice.
        SemlocError: it chooses none.
    """
    chosen = parse_slice(text)
    if not drive.frames[chosen]:
        raise SemlocError(f"drive {drive.name}: no frames chosen of {len(drive)}; check --frames {text}")
    return chosen


def parse_names(text: str | None) -> tuple[str, ...] | None:
    """Names of a comma-separated list; None where nothing was given."""
    names = tuple(name.strip() for name in (text or "").split(",") if name.strip())
    return names or None


def parse_own_car(text: str) -> tuple[float, ...]:
    """Rear, front, right and left end of the own car [m], separated by commas.

    Raises:
        UsageError: too few or too many, or one is not a finite number.
    """
    form = "REAR,FRONT,RIGHT,LEFT"
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise UsageError(f"--own-car '{text}': expected numbers as {form}") from error
    if len(numbers) != 4 or not all(abs(number) < float("inf") for number in numbers):
        raise UsageError(f"--own-car '{text}': expected 4 finite numbers as {form}")
    return numbers
