"""What every residual of poses over time promises: derivatives that are finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import semloc_jax as sj
from semloc_jax.fusion.pose_factors import GNSS, ODOMETER, fixes, measured_poses, motions, odometry, prior, verticals
from semloc_jax.geometry import rigid
from semloc_jax.mapping.turn_errors import WANDER, turning_odometry, wandering
from semloc_jax.residuals import motion, road_contact, vehicle_motion
from semloc_jax.residuals.inverse_depth import (
    Sight,
    on_road_linearised,
    on_road_residual,
    sight_linearised,
    sight_residual,
)
from semloc_jax.residuals.lamp_line import LineSight, lamp_residual
from semloc_jax.residuals.lane_curve import MOST_PLACES, CurveSight, lane_residual
from semloc_jax.residuals.preintegration import InertialState, imu_residual, preintegrate
from semloc_jax.residuals.road_sight import at_end_residual, on_line_residual, same_spot_residual
from semloc_jax.residuals.seen_point import PointSight, shift_residual
from semloc_jax.residuals.sign_circle import circle_residual
from semloc_jax.residuals.sign_corners import MOST_CORNERS, corners_residual
from semloc_jax.solvers.factors import POSE, Factors, vector

RNG = np.random.default_rng(5)
KINDS = {
    "pose": POSE,
    "metre": vector(0.01),
    "odometer": ODOMETER,
    "gnss": GNSS,
    "wander": WANDER,
    "stance": vector(0.1, 0.01, 0.01),
    "velocity": vector(1.0, 1.0, 1.0),
    "bias": vector(0.01, 0.01, 0.01, 0.1, 0.1, 0.1),
    "scale": vector(0.02),
    "landmark": vector(0.01, 0.01, 0.05),
    "camera_mount": POSE,
    "line": vector(0.1, 0.02),
    "height": vector(0.01),
    "bend": vector(5e-4),
    "mount": vector(0.01, 0.01, 0.01),
    "delay": vector(0.005),
}
GRAVITY = jnp.array([0.0, 0.0, -9.81])
STEP_S, SAMPLES = 0.01, 20


def near(scale=0.3):
    return rigid.exp(RNG.normal(size=6) * scale)


def info(rows):
    return RNG.normal(size=(1, rows, rows))


def inertial(T_from, v_from, bias, T_to, v_to, factor, sqrt_info):
    """`imu_residual` of two times as one function of five variables."""
    states = InertialState(T_from, v_from), InertialState(T_to, v_to)
    return imu_residual(*states, bias, GRAVITY, factor, sqrt_info)


def mounted_inertial(T_from, v_from, bias, mount, delay, T_to, v_to, factor, sqrt_info):
    """`imu_residual` of a sensor that is turned and whose clock is not that of the poses."""
    states = InertialState(T_from, v_from), InertialState(T_to, v_to)
    return imu_residual(*states, bias, GRAVITY, factor, sqrt_info, mount, delay[0])


def samples(num):
    """Turning and pushed: angular rate and specific force of one interval."""
    t = STEP_S * np.arange(SAMPLES) + 0.3 * num
    gyro = np.stack([0.02 * np.sin(t), 0.03 * np.cos(t), 0.3 + 0.1 * np.sin(2 * t)], axis=1)
    accel = np.stack([0.5 * np.cos(t), 0.8 * np.sin(t), 9.81 + 0.1 * np.sin(3 * t)], axis=1)
    return jnp.asarray(gyro), jnp.asarray(accel), jnp.full(SAMPLES, STEP_S)


def interval(num):
    return preintegrate(*samples(num), jnp.zeros(6))


def range_residual(T_map_base, beacon_map, range_m, sqrt_info):
    """A term of a user: the distance to a beacon."""
    return sqrt_info * (jnp.linalg.norm(T_map_base[:3, 3] - beacon_map) - range_m)[None]


def sight(ray):
    """A camera on the vehicle then, another place of it now, a ray that misses the landmark."""
    pixels = 500.0 * RNG.normal(size=(2, 3))
    axes = near()[:3, :3]
    return (Sight(*(jnp.asarray(leaf) for leaf in (axes, near(), near(), np.array(ray), pixels))),)


def point_sight(ray):
    """A pixel of a camera on the vehicle."""
    return PointSight(*(jnp.asarray(leaf) for leaf in (near(), np.array(ray), 500.0 * RNG.normal(size=(2, 3)))))


def point_sights(num):
    """Several of them, as the places of one shape."""
    return stacked([point_sight([0.6, 0.0, 0.8]) for _ in range(num)])


def directions(num):
    angle = RNG.uniform(0, 6, num)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def stacked(parts):
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *parts)


ZERO, ONE = np.zeros(1, int), np.ones(1, int)
DOWN = np.array([[0.0, -1.0, 0.0, 1.5], [-1.0, 0.0, 0.0, 0.2], [0.0, 0.0, -1.0, 2.0], [0.0, 0.0, 0.0, 1.0]])
"""A camera 2 m above the road that looks straight down."""
RAY, ALONG = np.array([[0.1, 0.3, 0.9]]), np.array([[[3.0, 0.5], [0.6, 0.8]]])
PAIR = ZERO, ONE
FACTORS = {
    "measured pose": measured_poses(np.stack([near(), near()]), RNG.normal(size=(2, 6, 6)), 1e6),
    "motion": motions(ZERO, ONE, near()[None], info(6)),
    "pull of an element": Factors(
        motion.pulled_residual,
        ("pose", "pose", "metre"),
        (*PAIR, ZERO),
        (near()[None], RNG.normal(size=(1, 6))),
        info(6),
        linearised=motion.pulled_linearised,
    ),
    "metre of the images": Factors(motion.metre_residual, ("metre",), (ZERO,), (), RNG.normal(size=(1, 1))),
    "vertical": verticals(ZERO, np.array([[0.1, -0.2, 0.97]]), RNG.normal(size=(1, 2))),
    "odometry": odometry(ZERO, ONE, near()[None], RNG.normal(size=(1, 6, 3)), np.array([[1.0, 0.0, 0.0]]), info(6)),
    "odometry that turns too far": turning_odometry(
        near()[None], RNG.normal(size=(1, 6, 4)), np.array([1.0, 0.0, 0.0]), info(6)
    ),
    "wander of the gyro bias": wandering(np.array([0.0, 0.3]), 2.0)[0],
    "gyro bias at first": wandering(np.array([0.0, 0.3]), 2.0)[1],
    "satellite fix": fixes(RNG.normal(size=(2, 2)), RNG.normal(size=(2, 3)), RNG.normal(size=(2, 2)), 1e6),
    "prior": prior(near(), np.array([1.0, 0.0, 0.0, 0.5, -0.5]), RNG.normal(size=(11, 11))),
    "road": Factors(
        road_contact.road_residual,
        ("pose", "stance"),
        (ZERO, ZERO),
        (RNG.normal(size=(1, 3)), np.array([[0.0, 0.6, 0.8]])),
        RNG.normal(size=(1, 3)),
        linearised=road_contact.road_linearised,
    ),
    "sight": Factors(
        sight_residual,
        ("pose", "pose", "landmark"),
        (ZERO, ONE, ZERO),
        (stacked(sight([0.6, 0.0, 0.8])),),
        np.array([2.0]),
        linearised=sight_linearised,
    ),
    "sight of what lies behind": Factors(
        sight_residual,
        ("pose", "pose", "landmark"),
        (ZERO, ONE, ZERO),
        (stacked(sight([0.0, 0.6, -0.8])),),
        np.array([2.0]),
        linearised=sight_linearised,
    ),
    "range": sj.pose_term(range_residual, (np.array([[5.0, -2.0, 3.0]]), np.array([6.0])), np.array([4.0])),
    "rolling": Factors(
        vehicle_motion.rolling_residual, ("pose", "velocity"), (ZERO, ZERO), (), RNG.normal(size=(1, 2))
    ),
    "wheel speed": Factors(
        vehicle_motion.wheel_speed_residual,
        ("pose", "velocity", "scale"),
        (ZERO, ZERO, ZERO),
        (np.array([7.0]),),
        RNG.normal(size=(1, 1)),
    ),
    "place on a line of the road": Factors(
        on_line_residual, ("camera_mount", "pose", "line"), (ZERO, ZERO, ZERO), (RAY, ALONG), np.array([3.0])
    ),
    "end of a line of the road": Factors(
        at_end_residual, ("camera_mount", "pose", "scale"), (ZERO, ZERO, ZERO), (RAY, ALONG), np.array([3.0])
    ),
    "spot of the road seen twice": Factors(
        same_spot_residual,
        ("camera_mount", "pose", "camera_mount", "pose"),
        (ZERO, ZERO, ONE, ONE),
        (RAY, RAY),
        info(2),
    ),
    "spot of the road seen twice by one camera": Factors(
        same_spot_residual,
        ("camera_mount", "pose", "camera_mount", "pose"),
        (ZERO, ZERO, ZERO, ONE),
        (RAY, RAY),
        info(2),
    ),
    "standing": Factors(vehicle_motion.standing_residual, ("velocity",), (ZERO,), (), RNG.normal(size=(1, 3))),
    "lane": Factors(
        lane_residual,
        ("pose",),
        (ZERO,),
        (
            5.0 * RNG.normal(size=(1, MOST_PLACES, 3)),
            stacked(
                [CurveSight(point_sights(MOST_PLACES), directions(MOST_PLACES), 1e-3 * RNG.normal(size=MOST_PLACES))]
            ),
        ),
        1e-2 * info(MOST_PLACES),
    ),
    "sign by its corners": Factors(
        corners_residual,
        ("pose",),
        (ZERO,),
        (5.0 * RNG.normal(size=(1, MOST_CORNERS, 3)), stacked([point_sights(MOST_CORNERS)])),
        info(2 * MOST_CORNERS),
    ),
    "round sign": Factors(
        circle_residual,
        ("pose",),
        (ZERO,),
        (np.array([[6.0, -2.0, 3.0]]), np.array([0.4]), stacked([point_sight([0.6, 0.0, 0.8])]), np.array([21.0])),
        RNG.normal(size=(1, 3)),
    ),
    "lamp post": Factors(
        lamp_residual,
        ("pose",),
        (ZERO,),
        (5.0 * RNG.normal(size=(1, 2, 3)), stacked([LineSight(point_sights(2), directions(2))])),
        info(4),
    ),
    "shift of a landmark": Factors(shift_residual, ("velocity",), (ZERO,), (), RNG.normal(size=(1, 3))),
    "inertial": Factors(
        inertial,
        ("pose", "velocity", "bias", "pose", "velocity"),
        (ZERO, ZERO, ZERO, ONE, ONE),
        (stacked([interval(0)]),),
        info(9),
    ),
    "inertial sensor that is turned and late": Factors(
        mounted_inertial,
        ("pose", "velocity", "bias", "mount", "delay", "pose", "velocity"),
        (ZERO, ZERO, ZERO, ZERO, ZERO, ONE, ONE),
        (stacked([interval(0)]),),
        info(9),
    ),
    "landmark on the road": Factors(
        on_road_residual,
        ("height", "bend", "landmark"),
        (ZERO, ZERO, ZERO),
        (np.array([[0.2, -0.3, -0.4]]), np.array([1.4]), np.array([9.0])),
        np.array([[3.0]]),
        linearised=on_road_linearised,
    ),
    "what fades or walks": Factors(
        vehicle_motion.fading_residual,
        ("velocity", "velocity"),
        (ZERO, ONE),
        (np.array([[0.9, 1.0, 1.0]]),),
        RNG.normal(size=(1, 3)),
        linearised=vehicle_motion.fading_linearised,
    ),
}
VALUES = {
    "pose": jnp.asarray(np.stack([near(), near()])),
    "metre": jnp.array([[0.03]]),
    "odometer": jnp.array([[1.0, 0.0, 0.0]]),
    "gnss": jnp.array([[0.3, -0.2]]),
    "stance": jnp.array([[0.05, 0.01, -0.02]]),
    "velocity": jnp.asarray(RNG.normal(size=(2, 3))),
    "bias": jnp.asarray(0.01 * RNG.normal(size=(1, 6))),
    "scale": jnp.array([[1.02]]),
    "landmark": jnp.array([[0.05, -0.03, 0.2]]),
    "camera_mount": jnp.asarray(np.stack([DOWN, DOWN @ near(0.1)])),
    "line": jnp.array([[0.1, -0.02]]),
    "height": jnp.array([[0.02]]),
    "bend": jnp.array([[4e-4], [-2e-4]]),
    "mount": jnp.array([[0.02, -0.01, 0.03]]),
    "delay": jnp.array([[0.004]]),
    "wander": jnp.array([[0.0], [0.3]]),
}


@pytest.mark.parametrize("name", FACTORS)
def test_gradients_and_hessians_are_finite_differences(name):
    """Of the residuals, by the retraction of every variable; analytic derivatives and automatic ones alike."""
    factors = FACTORS[name]
    sizes = [KINDS[family].size for family in factors.on]
    first = [VALUES[family][key[0]] for family, key in zip(factors.on, factors.keys, strict=True)]
    rest = jax.tree.map(lambda leaf: jnp.asarray(leaf[0]), (factors.data, factors.sqrt_info))

    @jax.jit
    def residual(x):
        steps = jnp.split(x, np.cumsum(sizes)[:-1])
        moved = [KINDS[f].retract(value, s) for f, value, s in zip(factors.on, first, steps, strict=True)]
        return factors.residual(*moved, *rest[0], rest[1])

    zero, step = np.zeros(sum(sizes)), 1e-6
    J = np.array([(residual(step * d) - residual(-step * d)) / (2 * step) for d in np.eye(len(zero))]).T
    local = jax.jit(lambda values: factors.local(values, KINDS))(VALUES)
    scale = np.abs(J).max()
    np.testing.assert_allclose(local.gradient[0], J.T @ residual(zero), atol=2e-7 * scale * (1 + scale))
    np.testing.assert_allclose(local.hessian[0], J.T @ J, atol=2e-7 * scale * (1 + scale))
