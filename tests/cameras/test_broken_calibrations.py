"""Broken calibration files: read, or refused in one line, in bounded time; never another exception."""

import numpy as np
import pytest

from semloc_jax.cameras.io import read_calibration
from semloc_jax.cameras.plausibility import implausible
from semloc_jax.errors import SemlocError
from semloc_jax.simulation.cameras import front_rig, surround_rig
from tests.cameras.calibration_files import calibration_files
from tests.maps.io.mutations import COUNTS, break_often, stops_hangs


@pytest.fixture(scope="module")
def originals(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibrations")
    return calibration_files(folder, front_rig(), surround_rig())


def test_the_originals_are_read(originals):
    for path in originals.values():
        assert len(read_calibration(path)) >= 1, path


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize(
    "kind", ["camchain", "camera_info", "opencv", "opencv_xml", "colmap", "kitti", "ocam", "woodscape", "nuscenes"]
)
def test_broken_copies_are_read_or_refused(originals, kind, count, tmp_path):
    original = originals[kind]
    folder = tmp_path / "copy"
    folder.mkdir()
    for beside in original.parent.iterdir() if kind == "nuscenes" else ():
        (folder / beside.name).write_bytes(beside.read_bytes())
    path = folder / original.name

    def use(content):
        path.write_bytes(content)
        rig = read_calibration(path)
        implausible(rig)
        assert all(np.isfinite([c.fx, c.fy, c.cx, c.cy]).all() for c in rig.cameras)

    assert break_often(original.read_bytes(), count, use) > 0


def test_bombs_and_tricks_are_refused(tmp_path):
    """Aliases that grow without bound, deep nesting, endless numbers, a device, a folder of folders."""
    bomb = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
        f"{chr(98 + i)}: &{chr(98 + i)} [{','.join(['*' + chr(97 + i)] * 9)}]\n" for i in range(8)
    )
    (tmp_path / "bomb.yaml").write_text(bomb + "cam0: *i\n")
    (tmp_path / "deep.yaml").write_text("cam0: " + "[" * 20_000)
    (tmp_path / "long.yaml").write_text("cam0:\n  intrinsics: [" + "9" * 5000 + ", 1, 1, 1]\n")
    (tmp_path / "tag.yaml").write_text("cam0: !!python/object/apply:os.system ['true']\n")
    (tmp_path / "big.yaml").write_bytes(b"x" * 11_000_000)
    entities = "".join(f'<!ENTITY e{i + 1} "{f"&e{i};" * 10}">' for i in range(9))
    (tmp_path / "xml.yaml").write_text(
        f'<?xml version="1.0"?><!DOCTYPE x [<!ENTITY e0 "9">{entities}]><opencv_storage><K>&e9;</K></opencv_storage>'
    )
    for name in ("bomb", "deep", "long", "tag", "big", "xml"):
        with stops_hangs(), pytest.raises(SemlocError):
            read_calibration(tmp_path / f"{name}.yaml")
