"""Roads with a crown: the ground is as built, and the map gives back the plane of the side a vehicle is on."""

import numpy as np
import pytest

from semloc_jax.datasets.drive import CLASS_IDS
from semloc_jax.errors import SemlocError
from semloc_jax.geometry import rigid
from semloc_jax.maps import SemanticMap, read_map
from semloc_jax.simulation import SimulationConfig, simulate
from semloc_jax.simulation.country import build_country_road
from semloc_jax.simulation.crown import CrownedSurface
from semloc_jax.simulation.path import path_from_curvature
from semloc_jax.simulation.road import build_road
from semloc_jax.simulation.surface import WaveSurface

FALL = 0.02


def straight(curvature: float = 0.0) -> CrownedSurface:
    s = np.arange(-100.0, 200.0, 0.05)
    level = WaveSurface(np.zeros(2), np.zeros(1), np.zeros((1, 2)), np.zeros(1))
    return CrownedSurface.along(level, path_from_curvature(s, np.full_like(s, curvature), 0.4), 1.5, FALL, 4.0)


def test_a_road_falls_to_both_sides_of_its_crown():
    surface, heading = straight(), 0.4
    left = np.array([-np.sin(heading), np.cos(heading)])
    xy = 30.0 * np.array([np.cos(heading), np.sin(heading)]) + np.array([-2.0, 1.5, 5.0, 9.0])[:, None] * left
    rounding_m = 0.3 * FALL
    # On the crown, 3.5 m to both sides, and on the verge, which is as high as the edge 4 m from the crown.
    assert surface.height(*xy.T) == pytest.approx([-0.07, 0.0, -0.07, -0.08], abs=rounding_m)
    slope = -surface.normal(xy) @ np.append(left, 0.0)
    assert slope[[0, 2, 3]] == pytest.approx([FALL, -FALL, 0.0], abs=1e-3)
    assert np.abs(slope).max() <= surface.max_slope


def test_a_road_leans_into_a_bend():
    """In a bend of 200 m to the left the left side is lower by 2 % more."""
    surface = straight(0.005)
    path_left = np.array([[0.0, 0.0]]) + np.array([-np.sin(0.4), np.cos(0.4)]) * 1.5
    here = surface.normal(path_left)[0]
    assert -(here[:2] / here[2]) @ np.array([-np.sin(0.4), np.cos(0.4)]) == pytest.approx(-0.02, abs=2e-3)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["country", "road"])
def test_the_map_gives_the_plane_of_the_own_side(kind, seed):
    """Anywhere in the lane the roll is within what the map leaves open, and in its middle within 0.5 deg; one plane for
    both sides is off by 1.15 deg."""
    rng = np.random.default_rng(seed)
    country = kind == "country"
    scene = build_country_road(rng, 120.0, 0.0, FALL) if country else build_road(rng, 120.0, 10.0, 0.0, FALL)
    road = SemanticMap(scene.elements)
    for s in np.arange(0.0, 120.0, 17.0):
        for d in (0.0, -0.7, 0.7) if country else (0.0,):
            (xy,), heading = scene.path.at(np.array([s]), d), float(scene.path.heading_at(np.array([s]))[0])
            stands = scene.surface.stand(xy[None], np.array([heading]))[0]
            found = road.road_pose(*xy, heading, near_z_m=stands[2, 3])
            off = rigid.log(rigid.inverse(found) @ stands)
            spread = road.road_spread(found)
            assert abs(np.degrees(off[3])) < (0.5 if d == 0.0 else np.hypot(0.5, 1.5 * np.degrees(spread.roll_rad)))
            assert abs(off[2]) < 0.03


def test_a_country_road_has_lines_dashes_and_posts_only(tmp_path):
    config = SimulationConfig(num_frames=1, width_px=96, height_px=60, has_images=False)
    drive = simulate("country", 1, tmp_path / "country", config)
    assert {element.label.name for element in read_map(drive.map_path).elements} == {"LANE_MARKING", "POLE"}
    mask = drive.frames[0].mask("sem", "front")
    assert {"lane_solid", "road"} <= {name for name, value in CLASS_IDS.items() if (mask == value).any()}


def test_a_crown_that_is_no_road_is_refused(tmp_path):
    with pytest.raises(SemlocError, match=r"crown = 0.5; expected the fall of a road"):
        simulate("road", 0, tmp_path / "road", SimulationConfig(crown=0.5))
