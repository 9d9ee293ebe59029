"""What a drive says about each unknown of a calibration, and what it cannot say (room: calibration; host).

In: information of the shared unknowns with all poses free, in units of their priors. Out: Observability: a sigma for
every parameter, and every independent direction with its verdict: observable, weak, or held by the prior.
"""

import enum
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

AXES = ("x", "y", "z", "roll", "pitch", "yaw")
"""Of a mount, along and about the axes of the vehicle."""
REASONS = {
    "x": "the vehicle's own origin may lie farther ahead or behind: only curves tell it, in which the rear axle must "
    "not move sideways",
    "y": "the vehicle's own origin may lie farther left or right: only curves tell it, in which an outer point drives "
    "faster than the wheels say",
    "z": "the vehicle may stand higher or lower: only the road in the map tells it",
    "roll": "the vehicle may lean: only the road in the map tells it",
    "pitch": "the vehicle may sit nose up or down: only the road in the map tells it",
    "yaw": "the vehicle may drive sideways: only the direction in which it moves tells it, so it has to move",
    "odometer_scale": "the wheels must be compared with a way in the map: drive farther",
    "gyro_bias": "the turns must be compared with the map for longer: drive longer",
    "gnss_east": "all fixes share their error",
    "gnss_north": "all fixes share their error",
    "stance_height": "a load looks like a mount that moved",
    "stance_roll": "a load looks like a mount that turned",
    "stance_pitch": "a load looks like a mount that turned",
    "mask_u": "masks that lie beside the images look like a camera that is turned",
    "mask_v": "masks that lie beside the images look like a camera that is turned",
}
_LENS_REASON = "the lens bends too little or too few contours pass there: drive where the picture is full of them"
_SHOWN = 0.3
"""Components of a direction below this are not named."""


class Knowledge(enum.StrEnum):
    """How much a drive says about a direction."""

    OBSERVABLE = "observable"
    WEAK = "weak"
    HELD = "held by the prior"


@dataclass(frozen=True)
class Parameter:
    """One unknown.

    Attributes:
        name: e.g. `front yaw`, `front fx`, `odometer_scale`.
        unit: of the numbers: m, deg, px, or empty.
        change: estimate less the calibration to start from.
        sigma: standard deviation after the drive.
        prior_sigma: before it.
        verdict: by the share of the prior's sigma that is left.
    """

    name: str
    unit: str
    change: float
    sigma: float
    prior_sigma: float
    verdict: Knowledge


@dataclass(frozen=True)
class CalibrationDirection:
    """One independent direction of all unknowns, scaled by their priors.

    Attributes:
        ratio: share of the prior's sigma that is left.
        vector: components in the order of the parameters.
        verdict: by that share.
        text: what moves together.
        reason: what would tell it, where it is not observable.
    """

    ratio: float
    vector: np.ndarray
    verdict: Knowledge
    text: str
    reason: str


@dataclass(frozen=True)
class Observability:
    """Parameters, directions (best known first) and the joint covariance of the parameters in their units."""

    parameters: tuple[Parameter, ...]
    directions: tuple[CalibrationDirection, ...]
    covariance: np.ndarray

    def parameter(self, name: str) -> Parameter:
        """One parameter by name."""
        return next(parameter for parameter in self.parameters if parameter.name == name)


def observe(
    information: np.ndarray,
    names: Sequence[str],
    units: Sequence[str],
    changes: np.ndarray,
    prior_sigmas: np.ndarray,
    observable_ratio: float,
    held_ratio: float,
    reasons: Mapping[str, str] = REASONS,
) -> Observability:
    """What is known of each unknown.

    The information less that of the priors is cut into its own directions; along one with eigenvalue l the drive leaves
    1 / sqrt(1 + l) of the prior's sigma.

    Args:
        information: Of the unknowns with all poses free and the priors in it, in units of the priors.
        names: Of the unknowns.
        units: Of changes and sigmas.
        changes: Estimate less start.
        prior_sigmas: All positive.
        observable_ratio: Below this share a direction is observable.
        held_ratio: Above this share it is held by the prior.
        reasons: What would tell a direction that is not observable, by the name or the last word of the name of what
            moves most.
    """

    def judged(ratio: float) -> Knowledge:
        if ratio <= observable_ratio:
            return Knowledge.OBSERVABLE
        return Knowledge.HELD if ratio >= held_ratio else Knowledge.WEAK

    size = len(names)
    values, vectors = np.linalg.eigh(0.5 * (information + information.T) - np.eye(size))
    ratios = 1.0 / np.sqrt(1.0 + np.maximum(values, 0.0))
    scaled = vectors @ np.diag(ratios**2) @ vectors.T
    left = np.sqrt(np.diagonal(scaled))
    parameters = tuple(
        Parameter(name, unit, float(change), float(share * prior), float(prior), judged(share))
        for name, unit, change, share, prior in zip(names, units, changes, left, prior_sigmas, strict=True)
    )
    directions = []
    for k in np.argsort(ratios, kind="stable"):
        vector = vectors[:, k] * np.sign(vectors[np.argmax(np.abs(vectors[:, k])), k])
        verdict = judged(ratios[k])
        reason = "" if verdict is Knowledge.OBSERVABLE else _reason(vector, names, reasons)
        directions.append(CalibrationDirection(float(ratios[k]), vector, verdict, _text(vector, names), reason))
    return Observability(parameters, tuple(directions), prior_sigmas[:, None] * scaled * prior_sigmas)


def to_text(observability: Observability) -> str:
    """The tables of parameters and of what is not observable, as text."""
    lines = [f"{'parameter':<22}{'change':>11}{'sigma':>10}{'prior':>10}  verdict"]
    for p in observability.parameters:
        unit = f" {p.unit}" if p.unit else ""
        lines.append(f"{p.name:<22}{p.change:>+11.4f}{p.sigma:>10.4f}{p.prior_sigma:>10.4f}{unit:<6}{p.verdict}")
    hidden = [d for d in observability.directions if d.verdict is not Knowledge.OBSERVABLE]
    num = len(observability.directions) - len(hidden)
    lines.append(f"{num} of {len(observability.directions)} independent directions are observable")
    lines += [f"- {d.verdict} ({d.ratio:.0%} of the prior's sigma left): {d.text}; {d.reason}" for d in hidden]
    return "\n".join(lines)


def _text(vector: np.ndarray, names: Sequence[str]) -> str:
    """The parameters that move, largest first; an axis that all cameras share is named once."""
    strength: dict[str, float] = {}
    for axis in AXES:
        rows = [k for k, name in enumerate(names) if name.endswith(f" {axis}")]
        part = vector[rows]
        if len(rows) > 1 and np.abs(part.mean()) * np.sqrt(len(rows)) > _SHOWN and part.std() < 0.3 * abs(part.mean()):
            strength[f"{axis} of all cameras together"] = float(part.mean() * np.sqrt(len(rows)))
            continue
        strength |= {names[k]: float(vector[k]) for k in rows}
    mounts = {f" {axis}" for axis in AXES}
    strength |= {n: float(v) for n, v in zip(names, vector, strict=True) if not any(n.endswith(m) for m in mounts)}
    largest = max(strength.values(), key=abs)
    shown = sorted((item for item in strength.items() if abs(item[1]) > _SHOWN), key=lambda item: -abs(item[1]))
    words = [f"{'' if value * largest > 0 else '-'}{name}" for name, value in shown]
    return words[0] if len(words) == 1 else f"{words[0]} trades with {', '.join(words[1:])}" if words else "many"


def _reason(vector: np.ndarray, names: Sequence[str], reasons: Mapping[str, str]) -> str:
    told = [k for k, name in enumerate(names) if name in reasons and abs(vector[k]) > _SHOWN]
    # What is there once, such as the odometer, says more than the axis of a camera.
    largest = max(told or range(len(names)), key=lambda k: abs(vector[k]))
    name = names[largest]
    return reasons.get(name, reasons.get(name.rsplit(" ", 1)[-1], _LENS_REASON))
