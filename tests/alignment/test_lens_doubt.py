"""Which lens a frame speaks for, told by the costs of its best poses through others."""

import numpy as np
import pytest

from semloc_jax.alignment.candidates import planar
from semloc_jax.alignment.fault_modes import FaultConfig
from semloc_jax.alignment.lens_doubt import LensDoubt, ThroughLens, doubted, told_share
from semloc_jax.cameras import BrownConradyCamera, Rig

RIG = Rig([BrownConradyCamera(500.0, 500.0, 320.0, 200.0, 640, 400, -0.2)], np.eye(4)[None], ["front"])


def lens_of(cost_through) -> LensDoubt:
    """The doubt of a frame whose pose goes 1 mm ahead for each pixel of focal length."""

    def solved_through(rig: Rig) -> ThroughLens:
        ahead_m = 1e-3 * (float(rig.cameras[0].fx) - 500.0)
        return ThroughLens(cost_through(rig), planar(np.array([ahead_m]), np.zeros(1), 0.0)[0])

    doubt, modes = doubted(RIG, lambda rigs: [solved_through(rig) for rig in rigs], np.zeros((3, 3)), FaultConfig())
    assert len(modes) == 3 and all(np.isfinite(mode.odds) for mode in modes)
    return doubt


def parabola(fx: float, fy: float, k1: float):
    """Costs of a frame whose lens is this, and whose scatter tells focal lengths to 5 px and k1 to 0.05."""

    def cost_through(rig: Rig) -> float:
        lens = rig.cameras[0]
        off = (float(lens.fx) - fx) / 5.0, (float(lens.fy) - fy) / 5.0, (float(lens.k1) - k1) / 0.05
        return 0.5 * float(np.sum(np.square(off)))

    return cost_through


@pytest.mark.parametrize(
    ("lens", "says"),
    [
        ((475.0, 475.0, -0.2), "focal lengths that are 2.5 % shorter"),
        ((525.0, 525.0, -0.2), "focal lengths that are 2.5 % longer"),
        ((525.0, 500.0, -0.2), "horizontal focal lengths that are 2.5 % longer"),
        ((500.0, 500.0, 0.2), "the distortion with the other sign"),
    ],
)
def test_a_wrong_lens_is_named(lens, says):
    found = lens_of(parabola(*lens))
    assert found.lens == says and found.lens_nats > 3.0


def test_a_sound_lens_is_not_doubted():
    assert lens_of(parabola(500.0, 500.0, -0.2)).lens_nats == 0.0


@pytest.mark.parametrize(("nats", "is_doubted"), [(4.0, True), (-2.9, True), (-3.1, False)])
def test_a_lens_that_the_evidence_excludes_is_none_whatever_the_cost_says(nats, is_doubted):
    cost_through = parabola(525.0, 525.0, -0.2)

    def solved_through(rigs):
        return [ThroughLens(cost_through(rig), np.eye(4), 0.0 if rig is rigs[0] else nats) for rig in rigs]

    doubt, modes = doubted(RIG, solved_through, np.zeros((3, 3)), FaultConfig())
    assert (doubt.lens_nats > 3.0) == is_doubted
    assert doubt.lens_left_nats == nats
    assert (modes[0].odds > 1.0) == is_doubted


def test_a_frame_that_gains_by_any_second_solve_says_nothing():
    """The pose that was found is no best one yet: every other lens, longer or shorter, costs less."""

    def cost_through(rig: Rig) -> float:
        return 0.0 if float(rig.cameras[0].fx) != 500.0 else 9.0 if float(rig.cameras[0].k1) < 0.0 else np.nan

    assert lens_of(cost_through).lens_nats == 0.0


def test_costs_count_as_far_as_masks_show_the_map_and_traffic_hides_none_of_it():
    """Of masks that show 0.4 of the map a miss costs -log(0.6), of those that show 0.8 of it -log(0.2)."""
    assert told_share(1.0, 0.8) == told_share(1.0, 0.95) == told_share(1.0, 1.0) == 1.0
    assert told_share(0.28, 0.9) == pytest.approx(0.28)
    assert told_share(1.0, 0.4) == pytest.approx(np.log(0.6) / np.log(0.2))
    assert told_share(0.5, 0.0) == 0.0
