"""Samples against exact masks: seen from the true pose, they lie on the borders of their class."""

import cv2
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from semloc_jax.cameras.io import read_calibration
from semloc_jax.maps import read_map, sample
from semloc_jax.residuals.view import contour_points
from semloc_jax.structs import ElementClass

MASK_IDS = {
    ElementClass.LANE_MARKING: (10, 11),
    ElementClass.STOP_LINE: (12,),
    ElementClass.CROSSWALK: (13,),
    ElementClass.ROAD_MARK: (14,),
    ElementClass.SLOT_LINE: (15,),
    ElementClass.SPEED_BUMP: (16,),
    ElementClass.POLE: (20,),
    ElementClass.SIGN: (21,),
    ElementClass.PILLAR: (23,),
    ElementClass.CONE: (24,),
}
NEAR_M = {"road": 20.0, "garage": 6.0}


def _distance_to_border(mask: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Signed distance [px], positive outside, zero between two pixels."""
    inside = mask.astype(np.uint8)
    signed = np.where(
        inside > 0,
        0.5 - cv2.distanceTransform(inside, cv2.DIST_L2, 5),
        cv2.distanceTransform(1 - inside, cv2.DIST_L2, 5) - 0.5,
    )
    return cv2.remap(signed.astype(np.float32), *uv.astype(np.float32).T[:, :, None], cv2.INTER_LINEAR).ravel()


def _distances(folder, frames, near_m):
    """Distance to the border of its class [px] for every sample that nothing hides, by class."""
    road, rig = read_map(folder / "map.geojson"), read_calibration(folder / "calib.yaml")
    poses = np.loadtxt(folder / "poses_body.tum")
    found = {label: [] for label in MASK_IDS}
    for frame in frames:
        T_map_base = np.eye(4)
        T_map_base[:3, :3] = Rotation.from_quat(poses[frame, 4:8]).as_matrix()
        T_map_base[:3, 3] = poses[frame, 1:4]
        local = road.query(T_map_base[:3, 3], 30.0)
        samples = sample(local, 0.1)
        for name, camera, T_base_cam in zip(rig.names, rig.cameras, rig.T_base_cam, strict=True):
            mask = cv2.imread(str(folder / "depth" / name / f"{frame:06d}_semfull.png"), cv2.IMREAD_UNCHANGED)
            depth_m = cv2.imread(str(folder / "depth" / name / f"{frame:06d}.png"), cv2.IMREAD_UNCHANGED) / 100.0
            if mask is None:
                pytest.skip(f"no exact labels for frame {frame} in {folder.name}")
            T_map_cam = T_map_base @ T_base_cam
            p_map, is_contour = contour_points(samples, jnp.asarray(T_map_cam[:3, 3] - local.origin_map))
            p_cam = (np.asarray(p_map) + local.origin_map - T_map_cam[:3, 3]) @ T_map_cam[:3, :3]
            uv, valid = (np.asarray(part) for part in camera.project(jnp.asarray(p_cam)))
            height, width = mask.shape
            keep = np.asarray(samples.valid) & np.asarray(is_contour) & valid & (p_cam[:, 2] > 0.5)
            keep &= (uv > 6).all(axis=1) & (uv < [width - 7, height - 7]).all(axis=1)
            keep &= np.linalg.norm(p_cam, axis=1) < near_m
            rows = np.flatnonzero(keep)
            column, row = np.rint(uv[rows]).astype(int).T
            farthest = cv2.dilate(depth_m.astype(np.float32), np.ones((5, 5)))[row, column]
            rows = rows[p_cam[rows, 2] < farthest + 0.05 + 0.01 * p_cam[rows, 2]]
            for label, ids in MASK_IDS.items():
                chosen = rows[np.asarray(samples.label)[rows] == label]
                if len(chosen) and np.isin(mask, ids).any():
                    found[label].append(_distance_to_border(np.isin(mask, ids), uv[chosen]))
    return {label: np.concatenate(parts) for label, parts in found.items() if parts}


@pytest.mark.parametrize(("drive", "frames"), [("road", (0, 30, 60, 80, 100, 120)), ("garage", (0, 20, 40))])
def test_samples_lie_on_mask_borders(drive, frames, request):
    distances = _distances(request.getfixturevalue(f"{drive}_dir"), frames, NEAR_M[drive])
    expected = {"road": {"LANE_MARKING", "CROSSWALK", "POLE"}, "garage": {"SLOT_LINE", "PILLAR"}}[drive]
    assert expected <= {label.name for label, values in distances.items() if len(values) > 100}
    for label, values in distances.items():
        if len(values) < 40:
            continue
        bias_px, share_off = float(np.median(values)), float(np.mean(np.abs(values) > 1.5))
        assert abs(bias_px) < (0.3 if label in (ElementClass.CONE, ElementClass.SPEED_BUMP) else 0.2), label.name
        assert share_off < (0.2 if label in (ElementClass.CONE, ElementClass.POLE) else 0.06), label.name
