"""A localizer that runs for long needs no more memory than one that has warmed up.

SEMLOC_SOAK_FRAMES=18000 makes it half an hour of a drive with 10 frames a second.
"""

import gc
import os
from pathlib import Path

import pytest

from semloc_jax.fusion.prediction import MotionLog
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.localization.localizer import Localizer
from semloc_jax.localization.pipeline import Pipeline
from semloc_jax.maps import read_map
from semloc_jax.simulation import SimulationConfig, simulate

NUM_FRAMES = int(os.environ.get("SEMLOC_SOAK_FRAMES", "600"))
STATUS = Path("/proc/self/statm")


def resident_mb() -> float:
    gc.collect()
    return int(STATUS.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.slow
@pytest.mark.skipif(not STATUS.is_file(), reason="no /proc/self/statm on this system to read the memory from")
def test_memory_is_flat(tmp_path):
    config = SimulationConfig(num_frames=30, rate_hz=5.0, width_px=480, height_px=300, has_images=False)
    drive = simulate("road", 8, tmp_path, config)
    source = mask_source("sem", drive, offset_px=(0.0, 0.0))
    localizer = Localizer(read_map(drive.map_path), source.table, MotionLog.of_drive(drive))

    def drive_once() -> None:
        assert len(list(Pipeline(drive, source, localizer).run(drive.frames))) == len(drive.frames)

    loops = max(NUM_FRAMES // len(drive.frames), 8)
    for _ in range(loops // 4):
        drive_once()
    warm = resident_mb()
    for _ in range(loops - loops // 4):
        drive_once()
    assert resident_mb() < warm + 25.0
