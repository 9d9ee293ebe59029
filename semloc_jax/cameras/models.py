"""The table of camera models: one row for each (room: cameras; host).

In: a camera, or the names that calibration files give to its model. Out: its row, the camera of the file's numbers.
Whatever depends on the model (readers and writers of calibration, bags, native kernels) looks it up here.
"""

from dataclasses import dataclass

from semloc_jax.cameras.angle_polynomial import PolynomialFisheyeCamera
from semloc_jax.cameras.base import Camera
from semloc_jax.cameras.bev import BevCamera
from semloc_jax.cameras.cylinder import CylindricalCamera
from semloc_jax.cameras.double_sphere import DoubleSphereCamera
from semloc_jax.cameras.fisheye import KannalaBrandtCamera
from semloc_jax.cameras.pinhole import BrownConradyCamera, PinholeCamera


@dataclass(frozen=True)
class CameraModel:
    """One row.

    Attributes:
        camera: the class.
        projection: `camera_model` of a camchain.
        distortion: names of `distortion_model`; the first is written, all are read.
        coefficients: fields that are the `distortion_coeffs`, in the order of the file.
        leading: fields that stand in `intrinsics` before fx fy cx cy; the constructor takes them before `coefficients`.
        limits: fields with a key of their own, each a limit of the view.
        num_optional: coefficients at the end that files may leave out; they are 0 then.
        ros: distortion model of a ROS CameraInfo; empty where ROS has none.
        native: class of `native/src/cameras.h`; empty: JAX's derivative of the class is taken.
    """

    camera: type[Camera]
    projection: str = "pinhole"
    distortion: tuple[str, ...] = ()
    coefficients: tuple[str, ...] = ()
    leading: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()
    num_optional: int = 0
    ros: str = ""
    native: str = ""

    @property
    def intrinsics(self) -> tuple[str, ...]:
        """Fields that are the `intrinsics`, in the order of the file."""
        return (*self.leading, "fx", "fy", "cx", "cy")

    @property
    def counts(self) -> tuple[int, ...]:
        """How many coefficients a file may give."""
        most = len(self.coefficients)
        return tuple(range(most - self.num_optional, most + 1))


MODELS = (
    CameraModel(PinholeCamera, distortion=("none", ""), ros="plumb_bob", native="Pinhole"),
    CameraModel(
        BrownConradyCamera,
        distortion=("radtan", "plumb_bob"),
        coefficients=("k1", "k2", "p1", "p2", "k3"),
        limits=("max_radius",),
        num_optional=1,
        ros="plumb_bob",
        native="BrownConrady",
    ),
    CameraModel(
        KannalaBrandtCamera,
        distortion=("equidistant", "fisheye", "kannala_brandt"),
        coefficients=("k1", "k2", "k3", "k4"),
        limits=("max_theta_rad",),
        ros="equidistant",
        native="KannalaBrandt",
    ),
    CameraModel(
        PolynomialFisheyeCamera,
        distortion=("angle_polynomial",),
        coefficients=("c2", "c3", "c4"),
        limits=("max_theta_rad",),
    ),
    CameraModel(
        DoubleSphereCamera, projection="ds", distortion=("none", ""), leading=("xi", "alpha"), limits=("max_theta_rad",)
    ),
    CameraModel(CylindricalCamera, projection="cylindrical", limits=("max_phi_rad",), native="Cylindrical"),
    CameraModel(BevCamera, projection="bev", limits=("max_height_m",), native="Bev"),
)


def model_of(camera: Camera) -> CameraModel | None:
    """The row of a camera; None where there is none. A subclass may project otherwise: it has no row."""
    return next((model for model in MODELS if model.camera is type(camera)), None)


def find_model(projection: str, distortion: str = "") -> CameraModel | None:
    """The row of the names of a calibration file; None where there is none."""
    projection, distortion = projection.strip().lower(), distortion.strip().lower()
    fits = (m for m in MODELS if m.projection == projection and (not m.distortion or distortion in m.distortion))
    return next(fits, None)


def projections() -> tuple[str, ...]:
    """Every `camera_model` that is known."""
    return tuple(dict.fromkeys(model.projection for model in MODELS))


def distortions() -> tuple[str, ...]:
    """Every `distortion_model` that is known."""
    return tuple(name for model in MODELS for name in model.distortion if name)


def native_class_of(camera: Camera) -> str:
    """Class of a camera's model in C++; empty where no kernel knows it."""
    model = model_of(camera)
    return "" if model is None else model.native
