"""What a suspected fault of calibration or map does to the protection levels, and how it is told (room: localization;
host).

In: WatchState, cameras. Out: Separation for each fault, with its sentence.
Solution separation: the pose that fits with the fault and the one without it may both be right, so a level reaches from
one to the farther side of the other.
"""

import numpy as np

from semloc_jax.alignment.class_profiles import GROUPS
from semloc_jax.alignment.pose_prior import RoadSigmas
from semloc_jax.cameras import Rig
from semloc_jax.localization import lens_sign, stance_sums
from semloc_jax.localization.course import Course
from semloc_jax.localization.moved_elements import CLASSES
from semloc_jax.localization.other_calibrations import FOCAL, RADIAL, WIDTH
from semloc_jax.localization.separation import Separation, separated
from semloc_jax.localization.suspicions import suspicions
from semloc_jax.localization.watch_config import WatchConfig
from semloc_jax.localization.watch_sums import Suspicion, WatchState

_ADVICE = "run semloc calibrate"
ALL_ASIDE = (
    "all cameras look aside: those at the front and at the rear do not agree how far to the side the vehicle stands; "
    f"{_ADVICE}"
)
_OWN_TILT_RAD = np.deg2rad(RoadSigmas().roll_pitch_deg)
_GROUP_WORDS = dict(zip(GROUPS, ("lines", "posts", "lines to the left", "lines to the right"), strict=True))


def spoken_for(watch: WatchState, rig: Rig, config: WatchConfig) -> list[Separation]:
    """Every fault that the last frames speak for; arguments as `separations`."""
    found = []
    for suspected in suspicions(watch, len(rig.names), config):
        if suspected.nats >= (config.class_count_nats if suspected.name in CLASSES else config.count_nats):
            # Elements that were moved say where they are, not where the pose is: it lies between them and all others.
            is_sided = suspected.name not in CLASSES
            told, right_poses = _told(suspected, rig), _right_poses(suspected)
            found += [separated(moved, told, is_sided) for moved in right_poses]
    return found


def _right_poses(suspected: Suspicion) -> list[np.ndarray]:
    """How far the pose would be off: forward [m], left [m], heading [rad].

    Which side of a road of another width was moved nothing tells; the pose that was found lies in the middle between
    those with one side in its place and with the other.
    """
    if suspected.name != WIDTH:
        return [suspected.moved]
    return [suspected.moved + np.array([0.0, half_m, 0.0]) for half_m in (0.5 * suspected.size, -0.5 * suspected.size)]


def separations(watch: WatchState, rig: Rig, config: WatchConfig) -> list[Separation]:
    """Every fault that joins the protection levels whatever the last frames say.

    Args:
        watch: Sums over the last frames.
        rig: Cameras.
        config: What counts.
    """
    height_m, found = float(np.asarray(rig.T_base_cam, np.float64)[:, 2, 3].mean()), []
    speaks = lens_sign.nats(watch.sign, config.share)
    if watch.sign.num > 0 and speaks > -config.count_nats:
        moved = lens_sign.mean_move(watch.sign)
        how = f"the other one fits {speaks:.0f} nats better" if speaks >= 1.0 else "the drive has not told yet"
        cause = f"the distortion of {_whose(rig)} may have the wrong sign: {how}"
        found.append(separated(moved, f"{cause}; {_ADVICE}"))
    tilted = _tilted(stance_sums.mount_tilt_rad(watch.stance, _OWN_TILT_RAD, config.mount_sigma_deg), height_m, rig)
    return [*found, *tilted]


def aside_cause(course: Course, aside_rad: float, level_deg: float, rig: Rig) -> str:
    """A sentence for cameras that may look aside: by how much, or that the drive has not told yet.

    Args:
        course: Of the pose.
        aside_rad: What is remembered of the way before.
        level_deg: Level of the heading that holds if they do.
        rig: Cameras.
    """
    told_rad = max(course.off_rad, aside_rad, key=abs)
    told_deg = abs(float(np.degrees(told_rad)))
    if told_deg < 0.5 * level_deg:
        which = "the camera looks" if len(rig.names) == 1 else "the cameras look"
        return f"the direction of travel is not known yet, and with it whether {which} aside: a few metres tell"
    side = "right" if told_rad > 0.0 else "left"
    return f"{_cameras(rig)} {told_deg:.1f} deg to the {side} of where the vehicle drives; {_ADVICE}"


def _tilted(tilt_rad: np.ndarray, height_m: float, rig: Rig) -> list[Separation]:
    """Cameras that are rolled or pitched in their mount are not above where they would be."""
    (roll, pitch), word = tilt_rad, _cameras(rig)
    leans = f"{word} {abs(np.degrees(roll)):.1f} deg rolled against the road of the map; {_ADVICE}"
    nods = f"{word} {abs(np.degrees(pitch)):.1f} deg too far {'down' if pitch > 0.0 else 'up'}; {_ADVICE}"
    return [
        Separation(abs(float(roll)) * height_m, 0.0, 0.0, leans),
        Separation(0.0, abs(float(pitch)) * height_m, 0.0, nods),
    ]


def cameras_ahead_m(rig: Rig) -> float:
    """How far the cameras stand ahead of the base on average [m]."""
    return float(np.asarray(rig.T_base_cam, np.float64)[:, 0, 3].mean())


def is_ahead(rig: Rig) -> bool:
    """Whether all cameras look ahead, by no more than 60 deg aside."""
    return bool((np.asarray(rig.T_base_cam, np.float64)[:, 0, 2] > 0.5).all())


def _cameras(rig: Rig) -> str:
    return f"camera {rig.names[0]} looks" if len(rig.names) == 1 else "the cameras look"


def _whose(rig: Rig) -> str:
    return f"camera {rig.names[0]}" if len(rig.names) == 1 else "the cameras"


def _told(suspected: Suspicion, rig: Rig) -> str:
    """What the fault is, with its size."""
    name, size = suspected.name, suspected.size
    if name in CLASSES:
        group, axis = name.split("_")
        side = {"ahead": ("ahead", "behind"), "left": ("to the left", "to the right")}[axis][size < 0.0]
        one_state = "the sides of the road" if group.endswith("side") else "lines and posts"
        return (
            f"{_GROUP_WORDS[group]} of the map, taken alone, fit {abs(size):.2f} m {side}: {one_state} are not of one "
            "state of the road; see map_changes.csv"
        )
    if name == WIDTH:
        wider = "wider" if size > 0.0 else "narrower"
        return f"masks fit better with a road that is {abs(size):.2f} m {wider} than in the map; see map_changes.csv"
    if name in (FOCAL, RADIAL):
        return f"masks fit better with {_lens(suspected, rig)}; {_ADVICE}"
    turn, index = name.split()
    return f"camera {rig.names[int(index)]} does not fit the others: {np.degrees(size):+.1f} deg in {turn}; {_ADVICE}"


def _lens(suspected: Suspicion, rig: Rig) -> str:
    """A lens that is another one, with its size."""
    which, share = _whose(rig), 100 * suspected.size
    if suspected.name == FOCAL:
        return f"focal lengths of {which} that are {share:+.1f} % different"
    wider = "wider" if share > 0.0 else "narrower"
    return f"a distortion of {which} that makes the sides of the image {abs(share):.1f} % {wider}"
