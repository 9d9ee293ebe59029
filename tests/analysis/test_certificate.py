"""A certificate is never wrong: what it proves is tried at random places by a cost that is computed another way."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from semloc_jax.alignment.frame_localizer import FrameLocalizer, LocalizeConfig
from semloc_jax.alignment.one_start import WIDE_COST_MAPS
from semloc_jax.alignment.pose import AlignConfig
from semloc_jax.alignment.single_frame import evidence_from
from semloc_jax.analysis.certificate import CLAIMS, CertificateConfig, certify, plane_problem
from semloc_jax.analysis.intervals import Interval
from semloc_jax.analysis.ramp_bounds import ramp_bounds
from semloc_jax.datasets import open_drive
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_source import mask_source
from semloc_jax.maps import read_map
from semloc_jax.perception.cost_maps import cost_maps
from semloc_jax.residuals.texture import lookup, pack
from semloc_jax.structs import CostMaps

ALIGN = AlignConfig()
WIDE = LocalizeConfig(cost_maps=WIDE_COST_MAPS)


class Scene:
    """One frame of the simulated road: evidence for the certificate, and its cost once more in plain numpy."""

    def __init__(self, folder, masks: str, index: int):
        drive = open_drive(folder)
        source = mask_source(masks, drive, offset_px=(0.0, 0.0))
        localizer = FrameLocalizer(read_map(drive.map_path), source.table, WIDE)
        frame = drive.frames[index]
        T = drive.truth_at(frame)
        inputs, local_map = localizer.prepare(source.masks(frame), source.seen_by(frame.rig), T)
        self.T_true, self.camera = jnp.asarray(local_map.frame.from_map(T)), frame.rig.cameras[0]
        self.evidence = evidence_from(self.T_true, inputs, localizer.config.frame.search_view)
        self.maps = cost_maps(source.masks(frame), localizer.shown, localizer.config.cost_maps, quantised=True)

    def certificate(self, level: int, claims):
        return certify(self.T_true, self.evidence, ALIGN, CertificateConfig(level=level, budget=3000), claims)

    def cost_function(self, level: int, certificate):
        """Cost of places [n 3] (longitudinal, lateral [m], heading [rad]) about the pivot, in float64."""
        problem = plane_problem(self.T_true, self.evidence, ALIGN, level)
        np.testing.assert_allclose(problem.T_local_base, certificate.T_local_base, atol=1e-6)
        (view,) = problem.views
        p_map, weight, channel = (np.asarray(leaf[0], np.float64) for leaf in (view.p_map, view.weight, view.channel))
        used = weight > 0
        p_map, weight, channel = p_map[:, used], weight[used], channel[used].astype(int)
        T_base_map = np.linalg.inv(certificate.T_local_base)
        T_cam_base, pivot = np.asarray(view.T_cam_base[0], np.float64), certificate.pivot[:, None]
        p_pivot = T_base_map[:3, :3] @ p_map + T_base_map[:3, 3:] - pivot
        ramp = np.asarray(self.maps.ramps[level][0], np.float64) / 127.0 - 1.0
        stride, project = self.maps.stride[level], jax.jit(lambda camera, x, y, z: camera.project_xyz(x, y, z))

        def cost(q):
            c, s = np.cos(q[2]), np.sin(q[2])
            R_moved = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
            p_base = R_moved @ (p_pivot - np.array([[q[0]], [q[1]], [0.0]])) + pivot
            x, y, z = T_cam_base[:3, :3] @ p_base + T_cam_base[:3, 3:]
            u, v, _ = (np.asarray(part, np.float64) for part in project(self.camera, x, y, z))
            r = np.clip(_bilinear(ramp, channel, (u + 0.5) / stride - 0.5, (v + 0.5) / stride - 0.5), -1.0, 1.0)
            return float(np.sum(weight * (1 - (1 - r * r) ** 3)) / 6.0)

        return cost


def _bilinear(images, plane, x, y):
    _, height, width = images.shape
    x, y = np.clip(x, 0.0, width - 1.0), np.clip(y, 0.0, height - 1.0)
    i, j = np.minimum(y.astype(int), height - 2), np.minimum(x.astype(int), width - 2)
    a, b = x - j, y - i
    top = (1 - a) * images[plane, i, j] + a * images[plane, i, j + 1]
    return (1 - b) * top + b * ((1 - a) * images[plane, i + 1, j] + a * images[plane, i + 1, j + 1])


def _between(region, num: int, rng) -> np.ndarray:
    """Places in the outer box that are not in the inner one, [n 3] with the heading in radians."""
    inner, outer = (np.array(box) * [1.0, 1.0, np.deg2rad(1.0)] for box in (region.inner, region.outer))
    found = np.zeros((0, 3))
    while len(found) < num:
        draw = rng.uniform(-1.0, 1.0, (2 * num, 3)) * outer
        found = np.concatenate([found, draw[(np.abs(draw) > inner).any(axis=1)]])
    return found[:num]


def false_claims(scene: Scene, level: int, num: int, rng, claims=CLAIMS) -> tuple[int, int]:
    """How many random places contradict the certificate of a scene, and how many were tried."""
    certificate = scene.certificate(level, claims)
    if certificate.falls is None and certificate.higher is None:
        return 0, 0
    cost = scene.cost_function(level, certificate)
    wrong = tried = 0
    lowest = cost(np.zeros(3))
    if certificate.higher is not None:
        places = _between(certificate.higher, num, rng)
        wrong += sum(cost(q) <= lowest for q in places)
        tried += num
    if certificate.falls is not None:
        places = _between(certificate.falls, num, rng)
        wrong += sum(cost(q) <= cost((1 - 1e-4) * q) for q in places)
        tried += num
    return wrong, tried


def test_bounds_of_ramps_hold_in_random_windows():
    """Value and slopes of a ramp at 20,000 places lie within the bounds of the windows that they were drawn from."""
    rng = np.random.default_rng(2)
    ramps = rng.integers(0, 255, (1, 2, 40, 60), dtype=np.uint8)
    maps = CostMaps((jnp.asarray(ramps),), (8.0,), (2,), jnp.ones((1, 80, 120), bool), 1)
    texture = pack(maps).level(0)
    plane = rng.integers(0, 2, 200)
    center = rng.uniform([-8.0, -8.0], [128.0, 88.0], (200, 2))
    radius = np.abs(rng.normal(0.0, 6.0, (200, 2)))
    u, v = (Interval(jnp.asarray((center - radius)[:, k]), jnp.asarray((center + radius)[:, k])) for k in range(2))
    held = ramp_bounds(texture, 1).over(jnp.asarray(plane), u, v)
    image = texture.image_index(jnp.zeros((), int), jnp.asarray(plane))
    at = jax.jit(lambda x, y: lookup(texture, image, x, y))
    slopes = jax.jit(lambda x, y: [jax.jvp(at, (x, y), d)[1] for d in ((x * 0 + 1, y * 0), (x * 0, y * 0 + 1))])
    for _ in range(100):
        x, y = (jnp.asarray(c) for c in (center + radius * rng.uniform(-1, 1, center.shape)).T)
        for interval, value in zip(held, (at(x, y), *slopes(x, y)), strict=True):
            assert bool(jnp.all((interval.low - 1e-5 <= value) & (value <= interval.high + 1e-5)))


@pytest.mark.slow
def test_a_certificate_holds_at_random_places(simulated_road):
    """That no pose metres around is as good is proven for one frame, and none of 300 places contradicts it."""
    scene = Scene(simulated_road, "sem", 0)
    wrong, tried = false_claims(scene, 0, 300, np.random.default_rng(0), ("higher",))
    assert tried == 300 and wrong == 0


@pytest.mark.slow
def test_ten_thousand_trials_find_no_false_claim(simulated_road):
    """Exact and network-like masks, all frames, two levels: 10,000 random places, not one against a claim."""
    rng, wrong, tried, given = np.random.default_rng(1), 0, 0, 0
    for masks in ("sem", "sem_net"):
        for index in range(3):
            scene = Scene(simulated_road, masks, index)
            for level in (0, 1):
                more_wrong, more = false_claims(scene, level, 1700, rng)
                wrong, tried, given = wrong + more_wrong, tried + more, given + (more > 0)
    print(f"{given} of 12 certificates given, {tried} trials, {wrong} false")
    assert tried >= 10_000 and wrong == 0


def test_other_kernels_have_no_bounds(simulated_road):
    scene = Scene(simulated_road, "sem", 1)
    with pytest.raises(SemlocError, match="expected 'tukey'"):
        certify(scene.T_true, scene.evidence, AlignConfig(loss="huber"))
