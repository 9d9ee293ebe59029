"""What `semloc explain` prints: tables of elements, of checks, of a drive and of a posterior (room: reports; host).

In: an Explanation, checks, roles of elements in a drive, a PoseMixture. Out: text for a console of 120 columns.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from semloc_jax.analysis.explain_check import ElementEffect
from semloc_jax.analysis.explain_drive import ElementRole, is_irreplaceable
from semloc_jax.analysis.explanation import Explanation, Holder
from semloc_jax.reports.explain_files import DIRECTIONS, in_units

if TYPE_CHECKING:
    from semloc_jax.analysis.pose_mixture import PoseMixture
    from semloc_jax.analysis.seed_errors import SeedErrors


_FAR_CM = 100.0
"""No map is wrong by more: a derivative that holds farther holds."""
MEANING = (
    "share: of what holds the pose in that direction; if wrong: how far the pose goes where the element is wrong by\n"
    "that much (solved, and by the derivative, which holds up to the last column); if missing: where it is left out.\n"
    "lon: ahead, lat: left [cm]; head: to the left [deg]"
)


def explained_elements(found: Explanation, top: int) -> str:
    """The strongest holders, all classes and the prior, one line each."""
    shift = f"{100 * found.shift_m:g} cm wrong"
    head = f"{'':42}{'share [%]':>17}  {'if ' + shift + ': solver':^24} {'derivative':^16} {'if missing':^16} linear"
    units = f"{'element':34}{'points':>8}{'lon':>6}{'lat':>6}{'head':>6}  {'lon':>7}{'lat':>7} cm{'head':>7}°"
    units += f"{'lon':>7}{'lat':>7} cm{'lon':>7}{'lat':>7} cm up to"
    lines = [MEANING, "", head, units, *(_line(holder) for holder in found.elements[:top])]
    if len(found.elements) > top:
        rest = sum(holder.share for holder in found.elements[top:])
        lines.append(f"{f'... {len(found.elements) - top} more':42}" + "".join(f"{100 * s:6.1f}" for s in rest))
    lines += ["", *(_line(holder, " in all") for holder in found.classes)]
    lines += [_line(holder) for holder in found.holders if not holder.is_element]
    lon, lat, heading = in_units(found.sigma)
    lines.append(f"sigma: longitudinal {100 * lon:.1f} cm, lateral {100 * lat:.1f} cm, heading {heading:.2f} deg")
    missed = found.most_missed
    moved = in_units(missed.removed)
    lines.append(
        f"most missed: {missed.id}: without it the pose moves {100 * moved[0]:+.1f} cm longitudinal, "
        f"{100 * moved[1]:+.1f} cm lateral, {moved[2]:+.2f} deg"
    )
    lines += [f"no stand-in: {text}" for text in (_irreplaceable(holder, found) for holder in found.elements) if text]
    if not found.is_exact:
        lines.append("the derivative is that of a pose that is not settled to the last digit: the cost is rough here")
    return "\n".join(lines)


def _line(holder: Holder, more: str = "") -> str:
    shifted, linear, removed = (in_units(part) for part in (holder.shifted, holder.linear, holder.removed))
    name = holder.id + more
    if holder.is_element and not more:
        name = f"{holder.label.name.lower():15}{holder.id}"
    to_cm = 100 * holder.linear_to_m
    to = f"{to_cm:7.1f}" if to_cm < _FAR_CM else f"{f'>{_FAR_CM:g}':>7}"
    to = to if holder.is_element else ""
    text = f"{name if len(name) < 34 else name[:32] + '~':34}{holder.num_samples or '':>8}" + "".join(
        f"{100 * share:6.1f}" for share in holder.share
    )
    text += f"  {100 * shifted[0]:+7.1f}{100 * shifted[1]:+7.1f}{shifted[2]:+11.2f}"
    text += f" {100 * linear[0]:+6.1f}{100 * linear[1]:+7.1f}"
    return f"{text}   {100 * removed[0]:+7.1f}{100 * removed[1]:+7.1f}   {to}"


def _irreplaceable(holder: Holder, found: Explanation) -> str | None:
    """What becomes of a direction that an element alone holds well; None where others do."""
    if not is_irreplaceable(holder, found):
        return None
    k = int(np.argmax(holder.sigma_without / np.maximum(found.sigma, 1e-9)))
    with_it, without = in_units(found.sigma)[k], in_units(holder.sigma_without)[k]
    scale, unit = (1.0, "deg") if k == 2 else (100.0, "cm")
    name = DIRECTIONS[k].split("_")[0]
    return f"{holder.id}: without it the {name} sigma grows from {scale * with_it:.2g} to {scale * without:.2g} {unit}"


def check_table(checks: Sequence[ElementEffect]) -> str:
    """What was predicted and what happened, one line for each element."""
    head = f"{'localized again with':24}{'moved: predicted':>18}{'found':>16}{'left out: predicted':>20}{'found':>16}"
    lines = [f"{head}   [lon lat cm]"]
    for check in checks:
        parts = (check.holder.shifted, check.shifted, check.holder.removed, check.removed)
        cells = [f"{100 * part[0]:+.1f}  {100 * part[1]:+.1f}" for part in parts]
        note = "" if check.is_localized else "   no longer localized"
        lines.append(f"{check.holder.id[:24]:24}{cells[0]:>18}{cells[1]:>16}{cells[2]:>20}{cells[3]:>16}{note}")
    return "\n".join(lines)


def role_table(roles: Sequence[ElementRole], num_frames: int, top: int) -> str:
    """The elements that hold a drive, and those that nothing stands in for."""
    lines = [f"{'element':24}{'class':16}{'frames':>7}{'share of the drive':>20}{'most':>7}{'10 cm move it':>16}"]
    for role in roles[:top]:
        lines.append(
            f"{role.id[:23]:24}{role.label.name.lower():16}{role.num_frames:7}{100 * role.share:18.1f} %"
            f"{100 * role.most_share:5.0f} %{100 * role.most_moved_m:13.1f} cm"
        )
    alone = sorted((role for role in roles if role.num_irreplaceable), key=lambda role: -role.num_irreplaceable)
    lines += [f"no stand-in: {role.id} in {role.num_irreplaceable} of {num_frames} frames" for role in alone[:top]]
    return "\n".join(lines)


_DIRECTIONS = (
    ("longitudinal", 0, 100.0, 1, "cm"),
    ("lateral", 1, 100.0, 1, "cm"),
    ("heading", 5, 180.0 / np.pi, 2, "deg"),
)
"""Name, coordinate of the tangent, factor, digits, unit."""


_PROBABILITY = 0.95


def posterior_text(mixture: "PoseMixture") -> str:
    """The modes of a pose with their weights, and the interval of each direction about the first one."""
    weights = " ".join(f"{weight:.3f}" for weight in mixture.weight if weight >= 5e-4)
    lines = [f"posterior: {len(mixture.weight)} modes, weights {weights}"]
    for name, direction, scale, digits, unit in _DIRECTIONS:
        low, high = (scale * end for end in mixture.interval(direction, _PROBABILITY))
        lines.append(f"{100 * _PROBABILITY:.0f} % interval of {name}: {low:+.{digits}f} to {high:+.{digits}f} {unit}")
    return "\n".join(lines)


def scatter_text(found: "SeedErrors") -> str:
    """How far the pose of one frame scatters when only the noise of the masks changes."""
    (longitudinal_m, lateral_m, heading_deg), num = found.rms[0], found.error.shape[1]
    return (
        f"{num} draws of a network's noise: RMS error longitudinal {100 * longitudinal_m:.1f} cm, "
        f"lateral {100 * lateral_m:.1f} cm, heading {heading_deg:.2f} deg"
    )
