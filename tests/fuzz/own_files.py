"""Files that the package itself writes and reads again: beliefs, compared maps, unfinished runs, settings, questions of
the explorer. What a run only writes (changes.json, loops.csv, elements.csv) has no reader.
"""

import csv
import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import yaml

from semloc_jax.alignment.result import LocalizationResult, Mode, ModeEvidence
from semloc_jax.cli import arguments, track
from semloc_jax.datasets import Frame, open_drive
from semloc_jax.evaluation import compare_maps
from semloc_jax.explorer.messages import read_query
from semloc_jax.localization import checkpoint
from semloc_jax.mapping.seen_area import MadeFrame, read_seen_area, write_seen_area
from semloc_jax.maps import Belief, BeliefMap, read_map, write_drive_geojson, write_map
from semloc_jax.maps.io.packed_drive import PackedDrive, read_packed, write_packed
from semloc_jax.reports import localize_log, run_inputs, track_log
from semloc_jax.reports.versions import report_applied, report_difference
from semloc_jax.storage import json_document
from semloc_jax.structs import SolveStatus
from tests.fuzz.readers import Reader, use_calibration, use_map
from tests.localization.test_checkpoint import template
from tests.mapping.crowd_world import Road, drive
from tests.maps.versions.made_maps import road

QUERY = {
    "pose": {"x_m": 1.0, "y_m": 2.0, "yaw_deg": 3.0, "height_m": 0.1, "roll_deg": 0.2, "pitch_deg": 0.3},
    "level": 1,
    "channels": ["LANE_MARKING"],
    "grid": "fine",
    "zoom": 2.0,
    "path": True,
    "prior": "drive",
}
PARTS = {"drive": "0a", "masks": "1b", "map": "2c", "settings": "3d", "options": "4e"}


def own_files(simulated: Path, place: Path) -> Iterator[Reader]:
    """Readers of what the package wrote.

    Args:
        simulated: a small simulated drive.
        place: where inputs are written.
    """
    made = place / "own"
    made.mkdir()
    yield from _of_made_maps(simulated, made)
    content = yaml.safe_load((simulated / "calib.yaml").read_text())
    del content["cam0"]["T_body_cam"]
    content["cam0"]["mounted"] = {"position_m": [1.6, 0.0, 1.4], "down_deg": 3.0, "roll_deg": 0.5, "yaw_deg": 1.0}
    (made / "calib.yaml").write_text(yaml.safe_dump(content))
    yield Reader("calibration mounted", made / "calib.yaml", use_calibration)
    settings = {"track": {"acquisition": {"min_weight": 0.2, "max_tracks": 3}}, "frames": "::2", "masks": "sem"}
    (made / "config.yaml").write_text(yaml.safe_dump(settings))
    yield Reader("settings of track", made / "config.yaml", use_settings)
    (made / "query.json").write_text(json.dumps(QUERY))
    yield Reader("question of the explorer", made / "query.json", use_query)
    yield from _of_many_drives(made)
    yield from _of_runs(open_drive(simulated).frames, made)


def _of_made_maps(simulated: Path, place: Path) -> Iterator[Reader]:
    whole = read_map(simulated / "map.geojson")
    rng = np.random.default_rng(1)
    sigmas = rng.uniform(0.01, 0.3, (len(whole.elements), 2)).tolist()
    rows = zip(whole.elements, sigmas, strict=True)
    beliefs = {e.id: Belief(*sigma, 3.0, 7, 1, 0.5, 9.25, "a drive") for e, sigma in rows}
    stated = BeliefMap(whole, beliefs).as_map()
    write_map(stated, place / "beliefs.gpkg")
    write_drive_geojson(stated, place / "beliefs.geojson")
    for suffix in (".gpkg", ".geojson"):
        yield Reader(f"beliefs {suffix}", place / f"beliefs{suffix}", use_beliefs)
        yield Reader(f"compared {suffix}", place / f"beliefs{suffix}", _compared_with(simulated / "map.geojson"))


def _of_many_drives(place: Path) -> Iterator[Reader]:
    """What a car uploads, what it looked at, and what makes one version of a map of another."""
    write_packed(drive(Road.of(100.0), 0), place / "drive.slocal")
    yield Reader("packed drive", place / "drive.slocal", use_packed)
    yield Reader("packed drive as a map", place / "drive.slocal", use_map)
    ring = np.array([[0.0, 0.0], [9.0, 0.0], [9.0, 4.0], [0.0, 4.0]])
    write_seen_area([ring], MadeFrame("gnss", 1.0), place / "seen_area.json")
    yield Reader("area that was seen", place / "seen_area.json", read_seen_area)
    for name, num in (("base", 6), ("target", 8)):
        write_map(road(num), place / f"{name}.gpkg")
    report_difference(place / "base.gpkg", place / "target.gpkg", place / "step.sdiff")
    apply = partial(report_applied, place / "base.gpkg")
    yield Reader("difference of maps", place / "step.sdiff", lambda path: apply(path, path.parent / "new.gpkg"))


def _of_runs(frames: tuple[Frame, ...], place: Path) -> Iterator[Reader]:
    """Folders of unfinished runs, as `--resume` reads them."""
    run = place / "run"
    run.mkdir()
    localize_log.begin(run)
    for frame in frames:
        localize_log.append(run, _result(frame))
    yield Reader("results.jsonl", run / localize_log.FILE, lambda path: use_results(path, frames), run)
    with (run / track_log.FILE).open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, track_log.COLUMNS, restval="0.5")
        table.writeheader()
        for frame in frames:
            quaternion = {"qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}
            line = {"frame": frame.id, "time_s": f"{frame.time_s:.9f}", "status": "TRACKING", "reasons": ""}
            table.writerow(line | quaternion)
    yield Reader("frames.csv", run / track_log.FILE, lambda path: use_table(path, frames), run)
    run_inputs.begun(run, PARTS, False)
    yield Reader("inputs.json", run / run_inputs.FILE, lambda path: run_inputs.begun(path, PARTS, True), run)
    state = run / "state.npz"
    checkpoint.save(checkpoint.Checkpoint(template(num_tracks=2, seed=1), 2, True), state)
    yield Reader("checkpoint", state, lambda path: checkpoint.load(path, template()))


def _result(frame: Frame) -> LocalizationResult:
    evidence = ModeEvidence(60.5, 1.25, 0.75, 0.25, 0.5, -1.5, SolveStatus.CONVERGED)
    mode = Mode(0.9, np.eye(4), 0.01 * np.eye(6), 3.5, 0.2, 0.9, 0.8, np.eye(6)[0], evidence)
    poses = np.eye(4), np.eye(4)
    return LocalizationResult(frame, *poses, SolveStatus.CONVERGED, True, ("a reason",), (mode,), {"solve": 0.1})


def use_packed(path: Path) -> PackedDrive:
    """Reads a packed drive and looks whether every number in it is one."""
    found = read_packed(path)
    assert np.isfinite(found.way).all(), "a way that is not finite"
    assert all(np.isfinite(element.points).all() for element in found.beliefs.map.elements), (
        "points that are not finite"
    )
    return found


def use_beliefs(path: Path) -> BeliefMap:
    """Reads beliefs and looks whether every number in them is one."""
    found = BeliefMap.of(read_map(path))
    for belief in found.beliefs.values():
        numbers = [value for value in vars(belief).values() if isinstance(value, int | float)]
        assert np.isfinite(numbers).all() and 0.0 <= belief.existence <= 1.0, "a belief that is not finite"
        assert np.isfinite(belief.information).all(), "information that is not finite"
    return found


def _compared_with(sound: Path) -> Callable[[Path], str]:
    """`semloc evaluate MAP MAP`: the damaged map against the sound one, both ways."""
    reference = read_map(sound).elements

    def compare(path: Path) -> str:
        made = read_map(path).elements
        found = compare_maps(made, reference, "se2")
        assert np.isfinite(found.T_reference_made).all(), "a motion that is not finite"
        for one in (found, compare_maps(reference, made)):
            values = [m.value for m in one.metrics() if m.unit == "share" and np.isfinite(m.value)]
            assert all(0.0 <= value <= 1.0 for value in values), "a share that is none"
        return found.to_text()

    return compare


def use_results(folder: Path, frames: tuple[Frame, ...]) -> list[LocalizationResult]:
    """Reads the results of an unfinished run and looks whether poses are poses, each frame once."""
    found = localize_log.read(folder, frames)
    ids = [result.frame.id for result in found if result.frame is not None]
    assert len(set(ids)) == len(found), "a frame twice"
    for result in found:
        R = result.T_map_base[:3, :3]
        assert np.isfinite(result.T_map_base).all(), "a pose that is not finite"
        assert np.allclose(R @ R.T, np.eye(3), atol=1e-3), "a pose that is none"
    return found


def use_table(folder: Path, frames: tuple[Frame, ...]) -> track_log.TrackTable:
    """Reads the table of an unfinished run as `--resume` does: it begins with the frames that the state has seen."""
    track_log.require_lines(folder, frames, "--resume")
    found = track_log.TrackTable.read(folder)
    assert found.frames == tuple(frame.id for frame in frames), "other frames"
    R = found.trajectory().T_map_base[:, :3, :3]
    assert np.allclose(R @ R.transpose(0, 2, 1), np.eye(3), atol=1e-3), "poses that are no rotations"
    return found


def use_query(path: Path) -> object:
    """Reads a question of the explorer's page."""
    return read_query(json_document(path.read_bytes(), "query"), 4, ["LANE_MARKING", "POLE"])


def use_settings(path: Path) -> object:
    """Reads a configuration of `track` with its options."""
    return arguments.parse("track", track, ["drive", "--config", str(path)])
