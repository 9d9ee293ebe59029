"""A drive past contours known in closed form: every frame sees the scene of `ground_scene` from another place.

The map of frame i is the ground scene moved with the vehicle, so that one exact cost map serves all frames.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from semloc_jax.calibration.drive_problem import Anchors, CalibrationProblem, CalibrationState, DriveMotion, PictureRows
from semloc_jax.geometry import rigid
from tests.contracts import ground_scene
from tests.contracts.ground_scene import T_TRUE

SIGMA_COMMON = np.array([0.02, 0.005, 3.0, 3.0, 0.01, 0.001, 0.001, 0.3, 0.3])
SCALE, BIAS, OFFSET = 1.01, 0.002, np.array([0.8, -0.5])
STEP_M, STEP_S = 4.0, 0.5


def path(turns_rad):
    """True planar motion of the vehicle over the scene: T_map_base of every frame, and the steps between."""
    steps = [rigid.exp(np.array([STEP_M, 0.0, 0.0, 0.0, 0.0, turn])) for turn in turns_rad]
    first = rigid.planar_pose(T_TRUE[0, 3], T_TRUE[1, 3], 0.7)
    poses = [first]
    for step in steps:
        poses.append(poses[-1] @ step)
    return np.stack(poses), np.stack([*steps, np.eye(4)])


def build(name, turns_rad, fields=(), num=200, level=0):
    """Problem and true state of a rig on a path.

    Args:
        name: A rig of the ground scene.
        turns_rad: Turn between neighbouring frames.
        fields: Unknown fields of the cameras of each model.
        num: Samples of each picture.
        level: Of the cost maps: 0 has a ramp of 20 px, 1 of 6 px.
    """
    scene = ground_scene.scene(name, num)
    rig = ground_scene.RIGS[name]
    Ts, steps = path(turns_rad)
    frames, cameras = len(Ts), len(rig)
    width = max((len(names) for names in fields), default=0)
    groups = []
    for view, group in zip(scene.views, rig.groups(), strict=True):
        row = np.repeat(np.arange(frames), len(group.index))
        camera = np.tile(np.array(group.index), frames)
        local = np.tile(np.arange(len(group.index)), frames)
        views = jax.tree.map(lambda leaf, k=local: jnp.asarray(np.asarray(leaf)[k]), view)
        moved = np.stack([Ts[i] @ np.linalg.inv(T_TRUE) for i in row])
        p_map = np.einsum("rij,rjp->rip", moved[:, :3, :3], np.asarray(views.p_map)) + moved[:, :3, 3:]
        # The scene of one frame serves all: every picture is that of its camera.
        views = eqx.tree_at(lambda v: (v.p_map, v.index), views, (jnp.asarray(p_map), jnp.asarray(camera)))
        names = fields[len(groups)] if fields else ()
        still = jnp.asarray(np.tile(np.eye(4), (len(row), 1, 1)))
        groups.append(PictureRows(views, jnp.asarray(row), jnp.asarray(camera), still, names))
    state = CalibrationState(
        jnp.asarray(Ts),
        jnp.asarray(rig.T_base_cam),
        jnp.asarray(np.zeros((cameras, width))),
        jnp.asarray(np.array([SCALE, BIAS, *OFFSET, *[0.0] * 5])),
    )
    sigma = np.concatenate(
        [np.tile([0.05] * 3 + [0.035] * 3, cameras), np.tile(_lens_sigmas(fields, width), cameras), SIGMA_COMMON]
    )
    texture = scene.textures.level(level)
    problem = CalibrationProblem(
        tuple(groups),
        texture,
        jnp.asarray(float(texture.ramp_px) ** 2 / 4.0 / 60.0),
        _motion(steps),
        _anchors(Ts),
        jnp.asarray(rig.T_base_cam),
        jnp.asarray(np.array([1.0, *[0.0] * 8])),
        jnp.asarray(sigma),
    )
    return problem, state


def _lens_sigmas(fields, width):
    sizes = {"fx": 2.0, "fy": 2.0, "cx": 3.0, "cy": 3.0}
    names = max(fields, key=len) if fields else ()
    return [sizes.get(name, 0.02) for name in names] + [0.0] * (width - len(names))


def _motion(steps):
    """What wheels with a scale and a gyroscope with a bias say of the true steps, exactly to first order."""
    num = len(steps)
    jacobian, sqrt_info, said = np.zeros((num, 6, 2)), np.zeros((num, 6, 6)), steps.copy()
    for i in range(num - 1):
        jacobian[i, 0, 0], jacobian[i, 5, 1] = STEP_M, -STEP_S
        said[i] = steps[i] @ np.linalg.inv(rigid.exp(jacobian[i] @ np.array([SCALE - 1.0, BIAS])))
        sqrt_info[i] = np.diag(1.0 / np.array([0.03, 0.012, 0.04, 0.004, 0.004, 0.001]))
    return DriveMotion(jnp.asarray(said), jnp.asarray(jacobian), jnp.asarray(sqrt_info))


def _anchors(Ts):
    num = len(Ts)
    p_base = np.tile([0.4, 0.1, 1.5], (num, 1))
    antenna = np.einsum("nij,nj->ni", Ts[:, :3, :3], p_base) + Ts[:, :3, 3]
    road = np.tile(1.0 / np.array([0.03, 0.01, 0.01]), (num, 1))
    return Anchors(
        jnp.asarray(p_base),
        jnp.asarray(antenna[:, :2] + OFFSET),
        jnp.asarray(np.full((num, 2), 0.3)),
        jnp.asarray(Ts[:, :3, 3]),
        jnp.asarray(Ts[:, :3, 2]),
        jnp.asarray(road),
        jnp.asarray(Ts),
        jnp.asarray(np.tile(np.diag(1.0 / np.array([30.0] * 3 + [1.0] * 3)), (num, 1, 1))),
    )
