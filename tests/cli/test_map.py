"""`semloc map` on a simulated drive: its files, that other verbs open them, and one line for bad input."""

import csv
import shutil

import cv2
import numpy as np
import pytest

from semloc_jax.cli.main import FAILED, OK, USAGE, main
from semloc_jax.datasets import open_drive
from semloc_jax.evaluation import read_metrics, read_trajectory
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.mapping import parts
from semloc_jax.mapping.found_loops import COLUMNS
from semloc_jax.mapping.looking import Looker
from semloc_jax.mapping.mapper import make_map
from semloc_jax.maps import BeliefMap, MapElement, read_map
from semloc_jax.reports.map_film import MapFilm
from semloc_jax.simulation import SimulationConfig, simulate

NUM = 14


@pytest.fixture(scope="module")
def drive_dir(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drives") / "road"
    simulate("road", 5, folder, SimulationConfig(num_frames=NUM, rate_hz=8.0, width_px=480, height_px=300))
    return folder


@pytest.fixture(scope="module", autouse=True)
def small_parts():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parts, "PART_FRAMES", 4)
        yield


@pytest.fixture(scope="module")
def made(drive_dir, small_parts, tmp_path_factory):
    out = tmp_path_factory.mktemp("made")
    words = ["map", str(drive_dir), "--masks", "sem", "--start", "truth", "--overlays", "1", "--video"]
    assert main([*words, "--out", str(out)]) == OK
    return out


def test_the_map_is_that_of_the_drive(made):
    metrics = {m.key: m.value for m in read_metrics(made / "metrics.json")}
    assert metrics["map.line.precision"] > 0.9
    assert metrics["map.line.rms_across"] < 0.04
    assert metrics["horizontal.max"] < 0.5


def test_both_files_hold_one_map_with_its_beliefs(made):
    packed, text = (BeliefMap.of(read_map(made / f"map.{suffix}")) for suffix in ("gpkg", "geojson"))
    assert dict(packed.beliefs) == dict(text.beliefs)
    with (made / "elements.csv").open() as file:
        rows = {row["id"]: row for row in csv.DictReader(file)}
    assert rows.keys() == packed.beliefs.keys()
    for key, belief in packed.beliefs.items():
        assert belief.num_seen >= 3
        assert belief.existence > 0.5
        assert int(rows[key]["num_seen"]) == belief.num_seen
        assert 0.0 < belief.sigma_across_m < 0.3
    assert (made / "config.yaml").is_file()
    assert (made / "map.png").stat().st_size > 5000
    assert len(list((made / "overlays").iterdir())) == 1


def test_the_film_shows_what_was_seen_by_then(made, drive_dir):
    """A picture for each frame; of the first frame on the plan holds more and more, at last all of the map."""
    video = cv2.VideoCapture(str(made / "map.mp4"))
    assert int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == NUM
    video.release()
    drive = open_drive(drive_dir)
    held = BeliefMap.of(read_map(made / "map.gpkg"))
    poses = read_trajectory(made / "trajectory.tum").T_map_base
    film = MapFilm(held, mask_source("sem", drive, None, None), drive.frames, poses, drive.name)
    known = [int(film.known(frame.time_s).sum()) for frame in drive.frames]
    assert 0 < known[0] < known[-1] == held.map.num_elements
    assert known == sorted(known)
    first, last = (film.picture(row, 320) for row in (0, NUM - 1))
    assert first.shape == last.shape and not np.array_equal(first[-20:], last[-20:])


def test_the_trajectory_has_every_frame(made, drive_dir):
    assert len(read_trajectory(made / "trajectory.tum")) == len(read_trajectory(drive_dir / "poses_body.tum"))


def test_a_second_look_along_the_same_way_adds_nothing_and_takes_phantoms_away(made, drive_dir):
    """The made map with a dash and a pole that are not there, taken in by the drive that made it."""
    drive = open_drive(drive_dir)
    poses = read_trajectory(made / "trajectory.tum").T_map_base
    places = [[6.0, 1.0, 0.0, 1.0], [9.0, 1.0, 0.0, 1.0], [12.0, -5.0, 0.0, 1.0], [12.0, -5.0, 3.0, 1.0]]
    ahead = poses[6] @ np.array(places).T
    phantoms = [
        MapElement("phantom_dash", "lane_marking", ahead[:3, :2].T, width_m=0.15, style="dashed"),
        MapElement("phantom_pole", "pole", ahead[:3, 2:].T, radius_m=0.08),
    ]
    known = BeliefMap.of(read_map(made / "map.gpkg"))
    base = BeliefMap.of(known.as_map().with_elements([*known.as_map().elements, *phantoms]))
    masks = mask_source("sem", drive, None, None)
    again = make_map(drive, masks, drive.frames, poses, base=base)
    removed = {change.id for change in again.changes if change.change == "removed"}
    assert removed == {"phantom_dash", "phantom_pole"}
    assert len(again.changes) == len(removed)
    assert again.belief_map.beliefs.keys() == known.beliefs.keys()
    twice = [again.belief_map.beliefs[k].num_seen > b.num_seen for k, b in known.beliefs.items()]
    assert all(twice)


def test_a_drive_that_never_comes_back_has_no_loops(made):
    assert (made / "loops.csv").read_text() == COLUMNS + "\n"
    metrics = {m.key: m.value for m in read_metrics(made / "metrics.json")}
    assert (metrics["loops.searched"], metrics["loops.accepted"]) == (0.0, 0.0)


@pytest.mark.slow
def test_a_run_that_was_killed_goes_on_and_makes_the_same_map(made, drive_dir, tmp_path, monkeypatch, capsys):
    """It dies in the draft, while it looks and while it counts; what is finished is not done again."""
    seen = []
    dies_after = 6
    looks = Looker.looks

    def counted(self, frame, index, poses):
        if len(seen) == dies_after:
            raise KeyboardInterrupt
        seen.append(index)
        return looks(self, frame, index, poses)

    monkeypatch.setattr(Looker, "looks", counted)
    words = ["map", str(drive_dir), "--masks", "sem", "--start", "truth", "--overlays", "0"]
    main([*words, "--out", str(tmp_path)])
    assert sorted(path.name for path in (tmp_path / "parts").iterdir()) == ["draft"]
    assert sorted(path.name for path in (tmp_path / "parts" / "draft").iterdir()) == ["looks_000004"]
    draft = [*range(6), *range(4, NUM), *range(NUM)]
    dies_after = len(draft) + 6
    main([*words, "--resume", str(tmp_path)])
    assert seen[:-6] == draft
    assert sorted(path.name for path in (tmp_path / "parts").iterdir()) == ["draft", "looks_000004", "refined.npz"]
    assert main([*words, "--resume", str(tmp_path), "--min-seen", "4"]) == FAILED
    assert "began with other settings" in capsys.readouterr().err
    dies_after += NUM - 4 + 9
    main([*words, "--resume", str(tmp_path)])
    assert (tmp_path / "parts" / "counts_000008").is_dir()
    dies_after = None
    assert main([*words, "--resume", str(tmp_path)]) == OK
    assert seen == [*draft, *range(6), *range(4, NUM), *range(9), *range(8, NUM)]
    assert not (tmp_path / "parts").exists()
    assert (tmp_path / "map.geojson").read_bytes() == (made / "map.geojson").read_bytes()
    assert main([*words, "--resume", str(tmp_path)]) == FAILED
    assert "that run is finished" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--start", "gnss", "--no-gnss"], USAGE, "choose one of them"),
        (["--front", "classical", "--masks", "sem"], USAGE, "choose one of them"),
        (["--masks", "ipm:sem"], USAGE, "give sem"),
        (["--frames", "90:"], FAILED, f"no frames chosen of {NUM}"),
        (["--start", "nowhere.tum"], FAILED, "nowhere.tum"),
        (["--base", "map.gpkg", "--start", "identity"], FAILED, "nothing says where in it the drive begins"),
        (["--base", "nowhere.gpkg", "--start", "truth"], FAILED, "nowhere.gpkg"),
        (
            [*"--masks sem --min-seen 1000 --start identity --refine.rounds 0 --frames :4".split()],
            FAILED,
            "was seen in 1000 frames",
        ),
    ],
)
def test_bad_input_is_one_line(drive_dir, tmp_path, capsys, words, code, said):
    assert main(["map", str(drive_dir), *words, "--out", str(tmp_path)]) == code
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("semloc map:")]
    assert len(lines) == 1
    assert said in lines[0]


def test_without_wheels_it_says_what_is_missing(drive_dir, tmp_path, capsys):
    bare = tmp_path / "bare"
    shutil.copytree(drive_dir, bare)
    (bare / "wheel_odom.csv").unlink()
    assert main(["map", str(bare), "--out", str(tmp_path / "out")]) == FAILED
    assert "no wheel odometry" in capsys.readouterr().err


@pytest.mark.slow
def test_a_start_from_a_file_moves_the_map(drive_dir, tmp_path):
    poses = np.loadtxt(drive_dir / "poses_body.tum")
    poses[:, 1] += 100.0
    np.savetxt(tmp_path / "start.tum", poses)
    words = ["map", str(drive_dir), *"--masks sem --overlays 0 --refine.rounds 0 --frames :6".split()]
    assert main([*words, "--start", str(tmp_path / "start.tum"), "--out", str(tmp_path / "out")]) == OK
    assert main([*words, "--start", "truth", "--out", str(tmp_path / "here")]) == OK
    moved, here = (read_trajectory(tmp_path / name / "trajectory.tum") for name in ("out", "here"))
    np.testing.assert_allclose(moved.T_map_base[:, 0, 3] - here.T_map_base[:, 0, 3], 100.0, atol=1e-3)


def test_a_baseline_is_told_beside_a_map_that_is_there_already(made, drive_dir, monkeypatch, capsys):
    """The map is not made again; way, loops, points and metrics of the baseline stand in a folder of their own."""
    before = (made / "map.gpkg").read_bytes()
    monkeypatch.setattr(Looker, "rays", None)  # only our own map looks along rays
    words = ["map", str(drive_dir), "--masks", "sem", "--start", "truth", "--overlays", "0", "--out", str(made)]
    assert main([*words, "--baseline", "avp"]) == OK
    told = capsys.readouterr().out
    heads = [line.split() for line in told.splitlines() if "no loops" in line]
    assert heads == [["no", "loops", "avp", "true", "loops", "ours"]]
    assert "trajectory, RMSE [m]" in told
    assert (made / "map.gpkg").read_bytes() == before
    folder = made / "baseline_avp"
    names = {path.name for path in folder.iterdir()}
    assert names == {"trajectory.tum", "loops.csv", "points.csv", "metrics.json", "map.png"}
    assert len(read_trajectory(folder / "trajectory.tum")) == len(read_trajectory(made / "trajectory.tum"))
    with (folder / "points.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["class"] for row in rows} >= {"lane_marking"}
    truth = read_trajectory(drive_dir / "poses_body.tum").T_map_base[:, :2, 3]
    places = np.array([[float(row["x_m"]), float(row["y_m"])] for row in rows])
    assert np.min(np.linalg.norm(places[:, None] - truth, axis=2), axis=1).max() < 15.0


def test_an_unknown_baseline_is_refused(drive_dir, capsys):
    assert main(["map", str(drive_dir), "--baseline", "orb"]) == USAGE
    assert "road-slam" in capsys.readouterr().err
