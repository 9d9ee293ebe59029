"""Where the vehicle may be when hardly anything is known: a coarse lattice over tens of metres and all headings (room:
localization; JAX).

In: the frame, a place, the half width of the search. Out: the poses that explain the widest ramps best, best first.
Every pose of the lattice is scored once with few map samples as they are, without silhouettes; what is worth a closer
look then goes through the ordinary search with the map as it is seen from there.
"""

from dataclasses import dataclass, field

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from semloc_jax.alignment.hypotheses import keep_distinct, score
from semloc_jax.alignment.pose import AlignConfig, Evidence, Prior, in_chunks, refine
from semloc_jax.alignment.proposals import displaced
from semloc_jax.alignment.single_frame import FrameInput
from semloc_jax.residuals.alignment import CameraViews, camera_views
from semloc_jax.runtime.programs import stored_program
from semloc_jax.structs import MapSamples, ViewSamples


@dataclass(frozen=True)
class WideSearchConfig:
    """The lattice and what is kept of it. All values are ours."""

    step_m: float = 1.0
    step_deg: float = 5.0
    """Spacing of the lattice: within the reach of the widest ramp from each pose to the next."""
    num_samples: int = 512
    """Map samples that score a pose."""
    num_refined: int = 192
    """Poses of the lattice that are refined, on the two widest ramps."""
    keep: int = 16
    """Poses that are returned."""
    apart: float = 2.0
    """Poses differ by at least this many times (0.5 m, 0.5 m, 1 deg)."""
    align: AlignConfig = field(default_factory=lambda: AlignConfig(max_steps=5, min_visible_px=20.0))
    sigma: tuple[float, float, float, float, float, float] = (1.0, 1.0, 0.05, 0.01, 0.01, 0.06)
    """How far a pose of the lattice may move when it is refined (x, y, z [m], roll, pitch, yaw [rad])."""


def wide_search(
    T_center: Float[Array, "4 4"],
    frame: FrameInput,
    half_width_m: float,
    half_heading_deg: float,
    config: WideSearchConfig,
) -> tuple[Float[Array, "keep 4 4"], Float[Array, " keep"]]:
    """The best poses of the lattice around a place and their scores [nats], best first.

    Args:
        T_center: Middle of the search relative to the local origin; its x and y axes are the plane of the road.
        frame: Map samples (all around the vehicle, of the whole width), cost maps, cameras.
        half_width_m: The lattice reaches this far along x and along y.
        half_heading_deg: And turns this far to both sides; 180 for all headings.
        config: Spacing, samples, survivors.
    """
    views = _plain_views(frame, config.num_samples)
    xy_yaw = lattice(half_width_m, half_heading_deg, config.step_m, config.step_deg)
    filled = np.concatenate([xy_yaw, np.repeat(xy_yaw[:1], -len(xy_yaw) % 1024, axis=0)])
    evidence = Evidence(views, frame.textures, frame.usable, frame.always)
    return _best(jnp.asarray(filled, jnp.float32), T_center, evidence, config)


def lattice(half_width_m: float, half_heading_deg: float, step_m: float, step_deg: float) -> Float[np.ndarray, "n 3"]:
    """Offsets (forward [m], left [m], heading [rad]) of an even lattice; its first row is the middle."""
    num = int(np.ceil(half_width_m / step_m))
    along = np.arange(-num, num + 1) * step_m
    if half_heading_deg >= 180:
        turns = np.arange(0.0, 360.0, 360.0 / np.ceil(360.0 / step_deg))
    else:
        num = int(np.ceil(half_heading_deg / step_deg))
        turns = np.arange(-num, num + 1) * step_deg
    rows = np.stack(np.meshgrid(along, along, np.deg2rad(turns), indexing="ij"), axis=-1).reshape(-1, 3)
    return np.concatenate([np.zeros((1, 3)), rows])


def _plain_views(frame: FrameInput, num_samples: int) -> tuple[CameraViews, ...]:
    """Some of the map samples, evenly spread, the same and of the same weight for every camera."""
    samples: MapSamples = jax.tree.map(np.asarray, frame.samples)
    channel = np.asarray(frame.channel_of_label)[samples.label]
    usable = np.flatnonzero(samples.valid & (channel >= 0))
    # An empty map leaves samples without weight: no pose is better than another.
    weight = np.float32(len(usable) > 0)
    usable = usable if len(usable) else np.zeros(1, int)
    chosen = usable[np.linspace(0, len(usable) - 1, num_samples).astype(int)]
    cameras = (len(frame.rig.names),)
    plain = ViewSamples(
        p_map=jnp.asarray(np.broadcast_to(samples.p_map[chosen].T, (*cameras, 3, num_samples)), jnp.float32),
        tangent_map=jnp.asarray(
            np.broadcast_to(samples.tangent_map[chosen].T, (*cameras, 3, num_samples)), jnp.float32
        ),
        channel=jnp.asarray(np.broadcast_to(np.maximum(channel[chosen], 0), (*cameras, num_samples)), jnp.int32),
        weight=jnp.full((*cameras, num_samples), weight, jnp.float32),
        element=jnp.zeros((*cameras, num_samples), jnp.int32),
    )
    return camera_views(frame.rig, plain)


@stored_program("config")
def _best(
    xy_yaw: Float[Array, "n 3"], T_center: Float[Array, "4 4"], evidence: Evidence, config: WideSearchConfig
) -> tuple[Float[Array, "keep 4 4"], Float[Array, " keep"]]:
    Ts = displaced(T_center, xy_yaw)
    sigma = jnp.asarray(config.sigma, Ts.dtype)
    # One length of contour for all: within the window no pose is likelier for seeing more of the map.
    one_length = jnp.asarray(1000.0, Ts.dtype)

    def scored(T: Array, level: int) -> Array:
        return score(T, level, evidence, Prior(T, sigma), config.align, one_length)

    def refined(T: Array) -> tuple[Array, Array]:
        T = refine(T, evidence, Prior(T, sigma), config.align, jnp.arange(2))[0][-1]
        return T, scored(T, 1)

    scores = in_chunks(lambda T: scored(T, 0), Ts, 64)
    best, index = jax.lax.top_k(-scores, min(4096, len(Ts)))
    chosen, _ = keep_distinct(Ts[index], -best, config.num_refined, config.apart)
    Ts, scores = in_chunks(refined, Ts[index][chosen], 64)
    survivors, filled = keep_distinct(Ts, scores, config.keep, config.apart)
    return Ts[survivors], jnp.where(filled, scores[survivors], jnp.inf)
