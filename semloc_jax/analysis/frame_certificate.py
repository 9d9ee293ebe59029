"""The certificate of a frame from its masks (room: analysis; host).

In: map and configuration, masks, cameras, a pose. Out: Certificate.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from semloc_jax.alignment.frame_localizer import FrameLocalizer
from semloc_jax.alignment.single_frame import evidence_from
from semloc_jax.analysis.certificate import CLAIMS, Certificate, CertificateConfig, Claim, certify
from semloc_jax.cameras import Rig


def certify_frame(
    localizer: FrameLocalizer,
    masks: Sequence[np.ndarray],
    rig: Rig,
    T_map_base: Float[np.ndarray, "4 4"],
    config: CertificateConfig | None = None,
    claims: Sequence[Claim] = CLAIMS,
) -> Certificate:
    """The certificate of the minimum that the masks of a frame have near a pose.

    Args:
        localizer: Map and configuration; its cost maps have the level that is certified.
        masks: Of each camera.
        rig: Cameras as the masks show them.
        T_map_base: Pose in the map frame.
        config: None for the defaults.
        claims: What to prove.
    """
    inputs, local_map = localizer.prepare(masks, rig, T_map_base)
    start = jnp.asarray(local_map.frame.from_map(T_map_base))
    evidence = evidence_from(start, inputs, localizer.config.frame.search_view)
    return certify(start, evidence, localizer.config.frame.search_align, config, claims)
