"""WoodScape calibrations (room: cameras; host).

In: json with intrinsic {model radial_poly, k1 ... k4, cx_offset ...} and extrinsic {quaternion xyzw, translation}.
Out: Rig of one camera; the vehicle frame of WoodScape is the middle of the rear axle on the ground, as ours.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from semloc_jax.cameras.angle_polynomial import PolynomialFisheyeCamera
from semloc_jax.cameras.io.fields import check_focal, numbers, required, resolution
from semloc_jax.cameras.rig import Rig
from semloc_jax.errors import SemlocError
from semloc_jax.geometry.rigid import pose_from


def is_woodscape(content: Mapping[str, Any]) -> bool:
    """Whether the content is a calibration of WoodScape."""
    return isinstance(content.get("intrinsic"), Mapping) and "cx_offset" in content["intrinsic"]


def rig_from_woodscape(content: Mapping[str, Any], path: Path) -> Rig:
    """The camera, named by the file (FV, RV, MVL, MVR behind the number of the picture)."""
    where = f"calibration {path}"
    lens = required(content, "intrinsic", where)
    model = lens.get("model", "radial_poly")
    if model != "radial_poly":
        raise SemlocError(f"{where}: model '{model}' is not supported; expected radial_poly")
    size = resolution([lens.get("width"), lens.get("height")], f"{where} width, height")
    k1, k2, k3, k4 = numbers([required(lens, f"k{i}", where) for i in range(1, 5)], (4,), f"{where} k1 ... k4")
    offset = numbers([lens.get("cx_offset"), lens.get("cy_offset")], (2,), f"{where} cx_offset, cy_offset")
    aspect = numbers(lens.get("aspect_ratio", 1.0), (1,), f"{where} aspect_ratio")[0]
    check_focal(k1, k1 * aspect, f"{where} k1, k1 times aspect_ratio")
    cx, cy = 0.5 * size - 0.5 + offset
    camera = PolynomialFisheyeCamera(k1, k1 * aspect, cx, cy, *size, k2 / k1, k3 / k1, k4 / k1)
    name = str(content.get("name") or path.stem.rsplit("_", 1)[-1])
    return Rig([camera], _pose(content, where)[None], [name])


def _pose(content: Mapping[str, Any], where: str) -> np.ndarray:
    place = required(content, "extrinsic", where)
    quaternion = numbers(required(place, "quaternion", where), (4,), f"{where} quaternion")
    if np.linalg.norm(quaternion) < 1e-6:
        raise SemlocError(f"{where}: quaternion {quaternion.tolist()}; expected x y z w of length one")
    return pose_from(
        Rotation.from_quat(quaternion).as_matrix(),
        numbers(required(place, "translation", where), (3,), f"{where} translation"),
    )
