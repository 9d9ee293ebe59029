"""Trajectory files keep nanometres, and times find their partners."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.errors import SemlocError
from semloc_jax.evaluation import Trajectory, associate, read_trajectory, write_tum


def sample_trajectory(num_poses=20):
    rng = np.random.default_rng(0)
    T = np.tile(np.eye(4), (num_poses, 1, 1))
    T[:, :3, :3] = Rotation.random(num_poses, random_state=3).as_matrix()
    T[:, :3, 3] = rng.normal(size=(num_poses, 3)) * 1000.0
    return Trajectory(1.6e9 + np.arange(num_poses) * 0.1, T)


def test_tum_round_trip_keeps_nanometres_and_nanoseconds(tmp_path):
    trajectory = sample_trajectory()
    write_tum(trajectory, tmp_path / "t.tum")
    back = read_trajectory(tmp_path / "t.tum")
    np.testing.assert_allclose(back.T_map_base[:, :3, 3], trajectory.T_map_base[:, :3, 3], atol=1e-9)
    np.testing.assert_allclose(back.T_map_base[:, :3, :3], trajectory.T_map_base[:, :3, :3], atol=1e-11)
    np.testing.assert_allclose(back.time_s, trajectory.time_s, rtol=0, atol=2.5e-7)


def test_tum_is_read_by_evo_alike(tmp_path):
    file_interface = pytest.importorskip("evo.tools.file_interface")
    trajectory = sample_trajectory()
    write_tum(trajectory, tmp_path / "t.tum")
    other = file_interface.read_tum_trajectory_file(str(tmp_path / "t.tum"))
    np.testing.assert_allclose(np.stack(other.poses_se3), trajectory.T_map_base, atol=1e-8)


def test_kitti_and_npy(tmp_path):
    trajectory = sample_trajectory()
    np.savetxt(tmp_path / "00.txt", trajectory.T_map_base[:, :3].reshape(-1, 12))
    np.save(tmp_path / "poses.npy", trajectory.T_map_base)
    for name in ("00.txt", "poses.npy"):
        back = read_trajectory(tmp_path / name)
        np.testing.assert_allclose(back.T_map_base, trajectory.T_map_base, atol=1e-12)
        np.testing.assert_array_equal(back.time_s, np.arange(20.0))
    np.savetxt(tmp_path / "times.txt", np.arange(20) * 0.1)
    np.testing.assert_allclose(read_trajectory(tmp_path / "00.txt").time_s, np.arange(20) * 0.1)


def test_association_is_one_to_one_and_gated():
    time_a = np.array([0.0, 0.1, 0.2, 0.3, 1.0])
    time_b = np.array([0.004, 0.104, 0.109, 0.35, 1.5])
    index_a, index_b = associate(time_a, time_b, 0.02)
    assert index_a.tolist() == [0, 1]
    assert index_b.tolist() == [0, 1]
    index_a, _ = associate(time_a, np.array([0.2]), 0.02)
    assert index_a.tolist() == [2]


def test_interpolation_is_halfway():
    T = np.stack([np.eye(4), np.eye(4)])
    T[1, :3, :3] = Rotation.from_euler("z", 40, degrees=True).as_matrix()
    T[1, :3, 3] = [2.0, 4.0, 0.0]
    middle = Trajectory(np.array([0.0, 1.0]), T).interpolate(np.array([0.5]))[0]
    assert np.degrees(np.arctan2(middle[1, 0], middle[0, 0])) == pytest.approx(20.0)
    np.testing.assert_allclose(middle[:3, 3], [1.0, 2.0, 0.0])


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("1 2 3\n", "8 columns"),
        ("a b c\n", "not a table of numbers"),
        ("1 2 3\n1 2\n", "row 1 holds 3 cells and row 2 2"),
        ("", "holds no pose"),
        ("0 0 0 0 5 0 0 1\n", "norm"),
        ("0 0 0 0 0 0 1e300 1\n", "norm inf"),
        ("0 1e300 0 0 0 0 0 1\n", "lies 1e\\+300 m from the origin"),
        ("1 0 0 0 0 1 0 1e200 0 0 1 0\n", "lies 1e\\+200 m from the origin"),
        ("1 0 0 0 0 0 0 1\n0.5 0 0 0 0 0 0 1\n", "increasing"),
    ],
)
def test_bad_files_say_what_is_wrong(tmp_path, content, says):
    (tmp_path / "bad.tum").write_text(content)
    with pytest.raises(SemlocError, match=says):
        read_trajectory(tmp_path / "bad.tum")


def test_missing_file_is_named(tmp_path):
    with pytest.raises(SemlocError, match="no such file"):
        read_trajectory(tmp_path / "none.tum")


def test_the_header_says_whose_poses_they_are(tmp_path):
    poses = Trajectory(np.array([0.0]), np.eye(4)[None])
    for what in ("base", "camera front"):
        write_tum(poses, tmp_path / "poses.tum", what)
        assert (tmp_path / "poses.tum").read_text().splitlines()[0].endswith(f": {what} in map")


def test_a_few_times_have_the_poses_that_they_have_among_many():
    random = np.random.default_rng(0)
    T = np.tile(np.eye(4), (40, 1, 1))
    T[:, :3, :3], T[:, :3, 3] = Rotation.random(40, random_state=1).as_matrix(), random.normal(size=(40, 3))
    known = Trajectory(np.cumsum(random.uniform(0.1, 1.0, 40)), T)
    every = np.sort(np.concatenate([known.time_s, random.uniform(known.time_s[0], known.time_s[-1], 60)]))
    whole = known.interpolate(every)
    for rows in ([0], [99], [3, 4], [70, 20], range(100)):
        np.testing.assert_allclose(known.interpolate(every[list(rows)]), whole[list(rows)], atol=1e-14)
    assert known.interpolate(every[:0]).shape == (0, 4, 4)
