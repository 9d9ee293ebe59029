"""One explorer of a small simulated drive for all tests of this room: it is compiled once."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.datasets import open_drive
from semloc_jax.explorer import ExplorerServer, ExplorerSession
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.inputs.priors import prior_source
from semloc_jax.maps import read_map


@pytest.fixture(scope="session")
def explorer(simulated_road: Path) -> Iterator[ExplorerServer]:
    """A server that is ready, opened at frame 1 with exact masks."""
    drive = open_drive(simulated_road)
    masks = mask_source("sem", drive)
    localizer = FrameLocalizer(read_map(drive.map_path), masks.table)
    session = ExplorerSession(drive, localizer, masks, prior_source("truth", drive), frame=1)
    session.warm_up()
    with ExplorerServer(session, 0) as server:
        # It warms up once more in the background, and is not ready again until it has.
        for _ in range(1200):
            if server.progress.state["ready"]:
                break
            time.sleep(0.05)
        assert server.progress.state["ready"], server.progress.state
        yield server


@pytest.fixture
def session(explorer: ExplorerServer) -> ExplorerSession:
    """The session of the explorer, at frame 1."""
    explorer.session.open_frame(1)
    return explorer.session
