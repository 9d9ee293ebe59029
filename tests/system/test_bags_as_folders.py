"""One drive as a folder, as a ROS 2 bag and as an MCAP: `localize` and `track` give the same trajectory."""

import shutil

import numpy as np
import pytest

from semloc_jax.cli.main import LOST, OK, main
from semloc_jax.datasets import open_drive, write_bag
from semloc_jax.evaluation import read_trajectory
from semloc_jax.maps import read_map

pytest.importorskip("rosbags")
NUM_FRAMES = 15
COMMON = ["--masks", "sem_net", "--class-table", "drive", "--overlays", "0", "--seed", "3"]
LOCALIZE = ["localize", "--frames", "::7", "--hypotheses", "256"]
TRACK = ["track", "--fusion", "kalman", "--search.num-hypotheses", "256"]


@pytest.fixture(scope="module")
def drives(road_dir, tmp_path_factory):
    """The first frames of rendered_road: the folder, a bag with raw pictures and an MCAP with compressed ones."""
    home = tmp_path_factory.mktemp("drives")
    folder = home / "folder"
    folder.mkdir()
    for path in road_dir.iterdir():
        if path.name != "frames.csv":
            (folder / path.name).symlink_to(path)
    lines = (road_dir / "frames.csv").read_text().splitlines()[: NUM_FRAMES + 1]
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
    drive = open_drive(folder)
    origin = read_map(drive.map_path).origin
    return {
        "folder": folder,
        "sqlite3": write_bag(drive, home / "sqlite3", "sqlite3", origin),
        "mcap": write_bag(drive, home / "mcap", "mcap", origin, compressed=True),
    }


def trajectory(words, drive, road_dir, out):
    verb, *options = words
    code = main([verb, str(drive), "--map", str(road_dir / "map.geojson"), *COMMON, *options, "--out", str(out)])
    assert code in (OK, LOST)
    shutil.rmtree(out / "overlays", ignore_errors=True)
    return read_trajectory(out / "trajectory.tum")


@pytest.mark.slow
@pytest.mark.data
@pytest.mark.parametrize("words", [LOCALIZE, TRACK], ids=["localize", "track"])
def test_bags_give_the_trajectory_of_the_folder(drives, road_dir, words, tmp_path):
    found = {kind: trajectory(words, drive, road_dir, tmp_path / kind) for kind, drive in drives.items()}
    expected = found.pop("folder")
    assert len(expected) >= (3 if words is LOCALIZE else NUM_FRAMES - 1)
    for kind, poses in found.items():
        np.testing.assert_allclose(poses.time_s, expected.time_s, rtol=0, atol=1e-9, err_msg=kind)
        apart_m = np.linalg.norm(poses.T_map_base[:, :3, 3] - expected.T_map_base[:, :3, 3], axis=1)
        turned = np.abs(poses.T_map_base[:, :3, :3] - expected.T_map_base[:, :3, :3]).max()
        assert apart_m.max() < 1e-6 and turned < 1e-6, f"{kind}: {apart_m.max():.3g} m, {turned:.3g} rad"
