"""Rigs whose lenses are other than stated (room: cameras; host).

In: a Rig. Out: the rig with longer, wider or otherwise bent lenses.
"""

import equinox as eqx

from semloc_jax.cameras.rig import Rig

FOCAL_SHARE = 0.025
"""By how much the focal lengths of another lens differ: less is told by its own slope. Ours."""
_DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")


def longer(rig: Rig, share: float) -> Rig:
    """Focal lengths longer by a share."""
    cameras = (eqx.tree_at(lambda c: (c.fx, c.fy), c, ((1 + share) * c.fx, (1 + share) * c.fy)) for c in rig.cameras)
    return rig.with_cameras(tuple(cameras))


def wider(rig: Rig, share: float) -> Rig:
    """Only the horizontal focal lengths longer: images are wider."""
    cameras = (eqx.tree_at(lambda c: c.fx, c, (1.0 + share) * c.fx) for c in rig.cameras)
    return rig.with_cameras(tuple(cameras))


def with_distortion(rig: Rig, factor: float) -> Rig | None:
    """The distortion of every lens multiplied: -1 is what calibrations confuse; None where no lens has any."""
    cameras = []
    for camera in rig.cameras:
        names = [name for name in _DISTORTION if hasattr(camera, name)]
        stated = [factor * getattr(camera, name) for name in names]
        cameras.append(eqx.tree_at(lambda c, n=names: [getattr(c, k) for k in n], camera, stated) if names else camera)
    is_bent = any(float(getattr(camera, name, 0.0)) for camera in rig.cameras for name in _DISTORTION)
    return rig.with_cameras(tuple(cameras)) if is_bent else None
