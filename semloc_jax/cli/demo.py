"""`semloc demo`: simulate, localize and draw (room: cli)."""

from dataclasses import dataclass
from pathlib import Path

from semloc_jax.cli.main import LOST, OK


@dataclass(frozen=True)
class Options:
    """Render a short drive, localize every fifth frame with masks like a network's, and draw the result.

    Needs no data. The first run compiles; later ones take the compiled programs from the cache.
    """

    frames: int = 20
    """Number of frames of the drive, five a second."""
    seed: int = 0
    """Another seed is another road."""
    open: bool = False
    """Show the first picture when it is done."""
    out: Path | None = None
    """Folder for the drive and the results; default: results/TIME, to which results/latest points."""


def run(options: Options) -> int:
    """Simulate, localize, say how good it is, where the pictures are and what comes next."""
    from semloc_jax.reports.demo import report_demo

    demo = report_demo(options.frames, options.seed, options.out)
    print(demo.text)
    if options.open and demo.pictures:
        import webbrowser

        webbrowser.open(demo.pictures[0].as_uri())
    return OK if demo.num_localized else LOST
