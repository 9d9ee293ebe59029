"""What the way of a vehicle says of its heading (room: localization; host).

In: FusedPose with its direction of travel. Out: Course; a level of the heading that holds where the cameras look aside.
Cameras that look aside and an axle that is not mounted across the vehicle look the same to masks: in both the vehicle
seems to drive aside. If it is the cameras, the heading is the direction in which the vehicle drives, and that is known
from the way, whatever the cameras say. So a level reaches from the heading to the farther side of the course, which has
an uncertainty of its own, large until some way is driven: an estimate near zero alone says nothing.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import expit, logit, stdtr, stdtrit

from semloc_jax.fusion.measurements import FusedPose, SensorBeliefs

_WIDE_RAD = 0.02
"""How far aside cameras may look, one standard deviation. Ours."""
_MEMORY_M = 20.0
"""Way over which a course is remembered: where the cameras look aside, the first lines and walls that come into view or
leave it move the pose, which passes for a drive to the other side."""
_MEMORY_SIGMAS = 2.0
"""What is remembered counts no longer beyond so many standard deviations of what the drive says by now."""
_PRIOR_RAD = np.deg2rad(SensorBeliefs().travel_sigma_deg)


class Course(NamedTuple):
    """Where the drive alone, without what is believed of axle and mount, has the vehicle going.

    Attributes:
        off_rad: against the heading of the pose, positive to the left.
        sigma_rad: standard deviation of that direction in the map.
    """

    off_rad: float
    sigma_rad: float


def course_of(fused: FusedPose) -> Course:
    """The course of a pose.

    The fusion holds the direction of travel near zero, which hides cameras that look aside until much of the way is
    driven: its prior is taken off, and one that is wide put in its place. Where no direction of travel is estimated,
    the vehicle drives where it looks.
    """
    mean, variance = fused.travel_rad, fused.travel_sigma_rad**2
    if variance <= 0.0:
        return Course(mean, 0.0)
    heading, joint = float(fused.covariance[5, 5]), fused.travel_heading_covariance
    information = np.linalg.inv(np.array([[heading, joint], [joint, variance]]))
    # What walks of calibrations added to the prior since is no information.
    known = min(1.0 / _PRIOR_RAD**2, float(information[1, 1]))
    covariance = np.linalg.inv(information + np.diag([0.0, 1.0 / _WIDE_RAD**2 - known]))
    turned, travel = covariance @ information @ np.array([0.0, mean])
    return Course(float(turned + travel), float(np.sqrt(covariance.sum())))


def joined(course: Course, off_rad: float, sigma_rad: float) -> Course:
    """The course with what the masks of cameras all round say of the same angle; one that is not estimated stays.

    Where the two differ by more than they should, neither is as sure as it says (Birge).

    Args:
        course: By the way.
        off_rad: Heading of a vehicle whose cameras look as far aside as masks say, against that of the pose.
        sigma_rad: Its standard deviation.
    """
    if course.sigma_rad <= 0.0:
        return course
    by_way, by_masks = course.sigma_rad**-2, sigma_rad**-2
    both = by_way + by_masks
    square = (course.off_rad - off_rad) ** 2 * by_way * by_masks / both
    mean = (by_way * course.off_rad + by_masks * off_rad) / both
    return Course(float(mean), float(np.sqrt(max(square, 1.0) / both)))


def remembered_rad(before_rad: float, course: Course, way_m: float) -> float:
    """How far aside the vehicle drove of late at the least, for sure by one standard deviation [rad].

    Args:
        before_rad: At the frame before.
        course: Now.
        way_m: Way since the frame before [m].
    """
    most_rad = abs(course.off_rad) + _MEMORY_SIGMAS * course.sigma_rad
    kept_rad = min(np.exp(-way_m / _MEMORY_M) * abs(before_rad), most_rad)
    least_rad = max(abs(course.off_rad) - course.sigma_rad, 0.0)
    return float(np.copysign(max(kept_rad, least_rad), course.off_rad if least_rad >= kept_rad else before_rad))


def probability(aside_rad: float, course: Course, is_ahead: bool, before: float) -> float:
    """Probability that the cameras look aside, by the way: a vehicle that drives straight ahead would do so by chance
    if they did; one that drives far aside has an axle that is far from straight if they do not.

    Cameras that also look to the side and back say nothing of it yet: what they hold the pose by is ahead of the
    vehicle first and behind it later, so that cameras which look aside move the pose to the other side, for as long.

    Args:
        aside_rad: What is remembered of the way before.
        course: Now.
        is_ahead: Whether all cameras look ahead.
        before: What it is before the way says more.
    """
    if not is_ahead:
        return before
    wide, variance = _WIDE_RAD**2, max(course.sigma_rad, 1e-9) ** 2
    # What the way alone says, without the wide prior that is in the course.
    alone = wide * variance / max(wide - variance, 1e-3 * wide)
    off_rad = max(abs(course.off_rad), abs(aside_rad)) * alone / variance
    exact, aside = alone + _PRIOR_RAD**2, alone + wide
    nats = 0.5 * (off_rad**2 * (1.0 / exact - 1.0 / aside) - np.log(aside / exact))
    return float(expit(logit(before) + nats))


def heading_level_deg(aside_rad: float, course: Course, freedom: float, share: float) -> float:
    """A level of the heading [deg] that holds where the cameras look aside.

    Args:
        aside_rad: What is remembered of the way before.
        course: Now.
        freedom: Degrees of freedom that the scale of its standard deviation stands on.
        share: Risk that the level may have on either side, where they do.
    """
    if course.sigma_rad <= 0.0:
        return float(np.degrees(abs(course.off_rad)))
    sigmas = float(stdtrit(freedom, 1.0 - min(share, 0.5)))
    return float(np.degrees(max(abs(course.off_rad), abs(aside_rad)) + sigmas * course.sigma_rad))


def turn_rad(aside_rad: float, course: Course, freedom: float, share: float, limit_deg: float) -> float:
    """The least turn of a heading [rad], positive to the left, with which `heading_level_deg` is within a limit [deg];
    0 where none is needed or none helps.

    The heading of the cameras may be right, or that of the course: a heading between the two is nearer to either than
    they are to each other. Arguments as `heading_level_deg`; the level of the cameras' own heading grows by the turn.
    """
    wide_rad, limit = float(stdtrit(freedom, 1.0 - min(share, 0.5))) * course.sigma_rad, float(np.deg2rad(limit_deg))
    off_rad = course.off_rad
    # What is remembered counts where it is farther aside than the course, or to the other side.
    other_rad = aside_rad if abs(aside_rad) > abs(off_rad) or aside_rad * off_rad < 0.0 else off_rad
    most, least = max(off_rad, other_rad) + wide_rad, min(off_rad, other_rad) - wide_rad
    if most - least > 2.0 * limit:
        return 0.0
    return max(most - limit, 0.0) + min(least + limit, 0.0)


def turned(aside_rad: float, course: Course, by_rad: float) -> tuple[float, Course]:
    """What is remembered, and the course, as seen from a heading that was turned."""
    remembers_rad = max(abs(aside_rad) - by_rad * float(np.sign(aside_rad)), 0.0)
    return float(np.copysign(remembers_rad, aside_rad)), course._replace(off_rad=course.off_rad - by_rad)


def misleading(aside_rad: float, course: Course, freedom: float, limit_deg: float) -> float:
    """Probability that the heading is beyond a limit [deg] where the cameras look aside; other arguments as
    `heading_level_deg`."""
    off_deg = float(np.degrees(max(abs(course.off_rad), abs(aside_rad))))
    sigma_deg = max(float(np.degrees(course.sigma_rad)), 1e-9)
    beyond = stdtr(freedom, (off_deg - limit_deg) / sigma_deg) + stdtr(freedom, (-off_deg - limit_deg) / sigma_deg)
    return float(beyond)
