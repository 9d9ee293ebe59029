"""Lenses from views of a board, mounts from surveyed mats: truth is found again, bad views are refused."""

import json

import cv2
import numpy as np
import pytest

from semloc_jax.calibration.lens_on_boards import fit_lens
from semloc_jax.calibration.mounts_on_mats import MatCorners, fit_mounts, ground_errors
from semloc_jax.cameras import KannalaBrandtCamera, Rig
from semloc_jax.cli.main import main
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import lie
from semloc_jax.perception.target_pictures import Board, read_boards, read_survey
from semloc_jax.simulation.cameras import surround_rig
from semloc_jax.simulation.targets import TargetPlan, simulate_targets

BOARD = Board(8, 5, 0.1)
LENS = (194.0, 194.3, 321.0, 238.0)
TERMS = (-0.013, -0.0042, 0.0011, -0.0002)
ROUGH = KannalaBrandtCamera(200.0, 200.0, 319.5, 239.5, 640, 480)


def views(rng, num=16, noise_px=0.2, sides=2.0 * np.pi):
    """Corners of a board all over the picture, projected by OpenCV."""
    K = np.array([[LENS[0], 0, LENS[2]], [0, LENS[1], LENS[3]], [0, 0, 1]])
    found = []
    for k in range(num):
        theta, phi = np.deg2rad(8.0 + 52.0 * ((k * 0.618) % 1.0)), sides * ((k * 0.382) % 1.0)
        sight = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
        turn = cv2.Rodrigues(np.cross([0, 0, 1.0], sight) * theta / max(np.sin(theta), 1e-9))[0]
        R = turn @ cv2.Rodrigues(rng.uniform(-0.5, 0.5, 3))[0]
        t = 0.9 * sight - R @ [0.35, 0.2, 0.0]
        uv, _ = cv2.fisheye.projectPoints(BOARD.places()[None], cv2.Rodrigues(R)[0], t, K, np.array(TERMS))
        found.append((BOARD.places(), uv[0] + noise_px * rng.normal(size=uv[0].shape)))
    return found


def test_the_lens_is_found_again():
    fit = fit_lens(views(np.random.default_rng(0)), ROUGH, "front")
    assert fit.rms_px == pytest.approx(0.2 * np.sqrt(2.0), rel=0.1)
    found = [float(getattr(fit.camera, key)) for key in ("fx", "fy", "cx", "cy")]
    np.testing.assert_allclose(found, LENS, atol=0.6)
    truth = KannalaBrandtCamera(*LENS, 640, 480, *TERMS)
    p = np.stack([np.sin(np.linspace(0, 1.2, 9)), np.zeros(9), np.cos(np.linspace(0, 1.2, 9))], axis=1)
    off = np.asarray(fit.camera.project(p)[0]) - np.asarray(truth.project(p)[0])
    assert np.linalg.norm(off, axis=1).max() < 0.5  # px, to 69 deg from the axis


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"num": 4}, "found in 4 pictures; expected 6 and more"),
        ({"sides": 0.5}, "of 8 directions from the middle of the picture; expected 5"),
    ],
)
def test_few_or_one_sided_views_are_refused(how, words):
    shown = views(np.random.default_rng(1), **how)
    if "sides" in how:
        shown = [view for view in shown if (view[1][:, 0] > 330).all()] * 2
    with pytest.raises(SemlocError, match=words):
        fit_lens(shown, ROUGH, "front")


def test_mounts_are_found_on_mats():
    rng, truth = np.random.default_rng(2), surround_rig()
    grid = 0.2 * np.stack(np.meshgrid(np.arange(5.0), np.arange(4.0)), axis=-1).reshape(-1, 2)
    seen = []
    for mat, middle in enumerate([(5.0, 2.0), (5.0, -2.0), (2.0, 2.2), (2.0, -2.4), (-2.0, 2.0), (-2.0, -2.0)]):
        p_base = np.array(middle) + grid - 0.4
        for camera, T in enumerate(np.asarray(truth.T_base_cam)):
            p_cam = (np.column_stack([p_base, np.zeros(len(p_base))]) - T[:3, 3]) @ T[:3, :3]
            uv, valid = (np.asarray(a) for a in truth.cameras[camera].project(p_cam))
            if valid.all() and (p_cam[:, 2] > 0.2).all():
                seen.append(MatCorners(camera, str(mat), uv + 0.2 * rng.normal(size=uv.shape), p_base))
    off = rng.normal(size=(4, 6)) * np.repeat([0.03, np.deg2rad(1.0)], 3)
    drawing = Rig(truth.cameras, np.asarray(truth.T_base_cam) @ np.asarray(lie.exp(off)), truth.names)
    fit = fit_mounts(drawing, seen)
    before, after = (np.concatenate(list(ground_errors(r, truth).values())) for r in (drawing, fit.rig))
    assert before.mean() > 0.03 and after.mean() < 0.006
    assert fit.before_m.mean() > 10.0 * fit.after_m.mean()
    assert np.nanmean(fit.held_out_m) < 0.025
    with pytest.raises(SemlocError, match="camera right: 0 surveyed corners on the ground"):
        fit_mounts(drawing, [s for s in seen if s.camera != 3])


def test_a_coded_board_is_found():
    code = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_100)
    picture = cv2.aruco.CharucoBoard((9, 6), 0.1, 0.07, code).generateImage((720, 480), marginSize=0)
    places, uv = Board(8, 5, 0.1, 0.07).find(picture)
    assert len(places) == 40
    np.testing.assert_allclose(places[:, :2], (uv + 0.5) / 800.0, atol=0.002)


def test_lists_that_cannot_be_meant_are_refused(tmp_path):
    with pytest.raises(SemlocError, match="no targets.yaml"):
        read_boards(tmp_path)
    (tmp_path / "targets.yaml").write_text("board: {columns: 2, rows: 5, square_m: 0.1}")
    with pytest.raises(SemlocError, match="expected 3 and more inner corners"):
        read_boards(tmp_path)
    (tmp_path / "mats.csv").write_text("mat,column,row,x_m,y_m\n0,9,0,1.0,2.0\n")
    with pytest.raises(SemlocError, match="line 2: .*expected mat, column"):
        read_survey(tmp_path, Board(5, 4, 0.2))


@pytest.mark.slow
def test_from_pictures_to_a_calibration(tmp_path, capsys):
    folder, plan = tmp_path / "targets", TargetPlan(num_views=15, noise_px=0.1)
    simulate_targets(folder, 3, plan, surround_rig().select(["front", "left"]))
    assert main(["calibrate", "--targets", str(folder), "--out", str(tmp_path / "out")]) == 0
    numbers = {m["key"]: m["value"] for m in json.loads((tmp_path / "out" / "metrics.json").read_text())["metrics"]}
    assert numbers["corners.before"] > 30.0 and numbers["corners.after"] < 15.0
    assert numbers["ground.mean"] < 15.0
    assert (tmp_path / "out" / "targets.png").is_file()
    assert main(["calibrate"]) == 2
    assert "--targets FOLDER" in capsys.readouterr().err
