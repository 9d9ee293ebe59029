"""`semloc demo`: simulate, localize and draw, in less than a minute (room: cli)."""

import time
from dataclasses import dataclass
from pathlib import Path

from semloc_jax.cli import localize

WIDTH_PX, HEIGHT_PX = 640, 400


@dataclass(frozen=True)
class Options:
    """Render a short drive, localize it with masks like a network's, and draw the result.

    Needs no data. The first run compiles; later ones take the compiled programs from the cache.
    """

    frames: int = 4
    """Number of frames."""
    seed: int = 0
    """Another seed is another road."""
    out: Path | None = None
    """Folder for the drive and the results; default: results/TIME, to which results/latest points."""


def run(options: Options) -> int:
    """Simulate, localize, tell where the pictures are."""
    from semloc_jax.reports.folder import make_folder
    from semloc_jax.simulation import SimulationConfig, simulate

    started = time.perf_counter()
    folder = make_folder(options.out)
    config = SimulationConfig(num_frames=options.frames, rate_hz=2.0, width_px=WIDTH_PX, height_px=HEIGHT_PX)
    drive = simulate("road", options.seed, folder / "drive", config)
    print(f"simulated {len(drive)} frames in {time.perf_counter() - started:.1f} s: {folder / 'drive'}", flush=True)
    code = localize.run(_Localize(drive.path, masks="sem_net", seed=options.seed, overlays=1, out=folder))
    print(f"picture: {next((folder / 'overlays').glob('*.png'), 'none')}")
    print(f"whole demo: {time.perf_counter() - started:.1f} s")
    return code


class _Localize(localize.Options):
    """The options of localize with its default configuration."""

    @property
    def settings(self):
        return localize.default_settings()
