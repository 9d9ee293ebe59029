"""The hand-written kernels as JAX functions (room: residuals; pure JAX).

In: arrays of one camera. Out: what the functions of the same names in this room return, for Tukey's loss in float32.
Each may be vmapped; operands that are the same for the whole batch are not copied. `use` says which way is taken.
"""

import dataclasses
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Complex, Float, Int
from numpy.typing import DTypeLike

from semloc_jax.cameras import Camera
from semloc_jax.cameras.models import native_class_of
from semloc_jax.errors import SemlocError
from semloc_jax.host import native_status
from semloc_jax.residuals.alignment import CameraViews, Usable
from semloc_jax.residuals.chart import Chart
from semloc_jax.residuals.forward_only import forward_only
from semloc_jax.residuals.robust import LOSSES, RobustLoss
from semloc_jax.residuals.texture import RampTexture, RampTextures
from semloc_jax.structs import MapSamples

Path = Literal["auto", "analytic", "autodiff", "xla"]
"""How residuals are evaluated: `analytic`: kernels with the derivative of the camera written out; `autodiff`: kernels
around JAX's derivative of any camera; `xla`: JAX alone; `auto`: the first of these that is possible."""

_ANY_CAMERA = "any_camera"
"""The part of the kernels around JAX's derivative."""

Points = tuple[Float[Array, "3 p"], Int[Array, " p"], Float[Array, " p"]]
"""Position [m], channel and weight of each sample."""


def use(path: Path, camera: Camera, loss: RobustLoss, dtype: DTypeLike) -> Path:
    """The way that is taken for a camera model: `path` itself, or for `auto` the fastest one that is possible.

    Raises:
        SemlocError: the path was asked for and is not possible here.
    """
    if path == "xla":
        return path
    why_not, model = _why_not(loss, dtype), native_class_of(camera)
    if path == "auto":
        if why_not:
            return "xla"
        if model and native_status(model).available:
            return "analytic"
        return "autodiff" if native_status(_ANY_CAMERA).available else "xla"
    if not why_not and path == "analytic" and not model:
        why_not = f"there is no kernel for {type(camera).__name__}"
    why_not = why_not or _missing(model if path == "analytic" else _ANY_CAMERA)
    if why_not:
        raise SemlocError(f"evaluation path '{path}': {why_not}; choose 'auto', which takes what is possible")
    return path


def are_used(path: Path, dtype: DTypeLike) -> bool:
    """Whether what does not depend on camera or robust function is left to the kernels."""
    return path != "xla" and not _why_not(LOSSES["tukey"], dtype)


def _why_not(loss: RobustLoss, dtype: DTypeLike) -> str:
    if loss is not LOSSES["tukey"]:
        return "the kernels know the robust function 'tukey' only"
    if jnp.dtype(dtype) != jnp.float32:
        return f"the kernels are for float32, not {jnp.dtype(dtype).name}"
    if jax.default_backend() != "cpu":
        return f"the kernels are for CPUs, not {jax.default_backend()}"
    return _missing("common")


def _missing(part: str) -> str:
    status = native_status(part)
    return "" if status.available else f"native kernels {status.text}"


def _of_model(name: str, camera: Camera) -> str:
    """The kernel of a camera's model."""
    return f"{name}_{native_class_of(camera)}"


def _texture(texture: RampTexture, index: Int[Array, ""]) -> tuple[Array, ...]:
    return texture.texels, texture.start, texture.height, texture.width, texture.stride, index


def _call(
    name: str, shapes: list[tuple[int, ...] | jax.ShapeDtypeStruct], *operands: ArrayLike, **attributes: int | np.int32
) -> list[Array]:
    results = [jax.ShapeDtypeStruct(shape, jnp.float32) if isinstance(shape, tuple) else shape for shape in shapes]
    attributes = {key: np.int32(value) for key, value in attributes.items()}
    operands = forward_only(f"the native kernel {name}", operands)
    return jax.ffi.ffi_call(name, results, vmap_method="expand_dims")(*map(_as_32_bit, operands), **attributes)


def _as_32_bit(operand: ArrayLike) -> ArrayLike:
    """The operand as the kernels read it: with 64-bit types switched on, indices come as int64."""
    if jnp.issubdtype(operand.dtype, jnp.signedinteger):
        return operand.astype(jnp.int32)
    return operand.astype(jnp.float32) if jnp.issubdtype(operand.dtype, jnp.floating) else operand


def normal_equations(
    chart: Chart,
    skip: Bool[Array, ""],
    camera: Camera,
    T_cam_base: Float[Array, "4 4"],
    points: Points,
    texture: RampTexture,
    index: Int[Array, ""],
) -> tuple[Float[Array, "6 6"], Float[Array, "6"], Float[Array, ""]]:
    """Gauss-Newton Hessian and gradient by y, and summed Tukey cost, of one camera.

    Args:
        chart: Vehicle pose and its coordinates y.
        skip: True: nothing is computed and zeros are returned.
        camera: Intrinsics of a model with a kernel (`cameras.models`).
        T_cam_base: Extrinsics.
        points: Samples.
        texture: One level of the cost maps.
        index: Place of the camera in the cost maps.
    """
    operands = (*chart, skip, T_cam_base, *points, *_texture(texture, index), *jax.tree.leaves(camera))
    name, number = _of_model("semloc_normal_equations", camera), texture.num_channels
    return tuple(_call(name, [(6, 6), (6,), ()], *operands, num_channels=number))


def lookup(
    uv: Complex[Array, " p"], channel: Int[Array, " p"], texture: RampTexture, index: Int[Array, ""]
) -> tuple[Float[Array, " p"], Complex[Array, " p"]]:
    """Signed ramp value in [-1, 1] at pixels u + i v and its gradient [1 / px] likewise; not differentiable."""
    operands, numbers = (uv, channel, *_texture(texture, index)), {"num_channels": texture.num_channels}
    return tuple(_call("semloc_lookup", [uv.shape, jax.ShapeDtypeStruct(uv.shape, uv.dtype)], *operands, **numbers))


def accumulate(
    chart: Chart,
    T_cam_base: Float[Array, "4 4"],
    points: Points,
    slope_xy: Complex[Array, " p"],
    slope_z: Float[Array, " p"],
    value: Float[Array, " p"],
) -> tuple[Float[Array, "6 6"], Float[Array, "6"], Float[Array, ""]]:
    """As `normal_equations`, from residuals and their derivative by the point in the camera frame, (x + i y) and z."""
    operands = (*chart, T_cam_base, *points, slope_xy, slope_z, value)
    return tuple(_call("semloc_accumulate", [(6, 6), (6,), ()], *operands))


def damped_step(
    hessian: Float[Array, "6 6"], gradient: Float[Array, "6"], step_size: Float[Array, ""]
) -> Float[Array, "6"]:
    """Solution d of (H + I / step_size) d = -g by Cholesky factorisation."""
    return _call("semloc_damped_step", [(6,)], hessian, gradient, step_size)[0]


def visible_weight(
    T_local_base: Float[Array, "4 4"],
    camera: Camera,
    T_cam_base: Float[Array, "4 4"],
    points: Points,
    usable: Bool[Array, "cam h w"],
    scale: float,
    index: Int[Array, ""],
    margin_px: float,
) -> Float[Array, " p"]:
    """Weight of each sample that is in front of the camera, in its image and on a usable pixel; else 0.

    Args:
        T_local_base: Vehicle pose.
        camera: Intrinsics of a model with a kernel (`cameras.models`).
        T_cam_base: Extrinsics.
        points: Samples.
        usable: Usable pixels of all cameras.
        scale: Pixels of `usable` in one pixel of the image.
        index: Place of the camera in `usable`.
        margin_px: Samples nearer to the border of the image do not count.
    """
    numbers = jnp.float32(scale), index, jnp.float32(margin_px)
    operands = (T_local_base, T_cam_base, *points, usable, *numbers, *jax.tree.leaves(camera))
    return _call(_of_model("semloc_visible_weight", camera), [(points[0].shape[-1],)], *operands)[0]


def project(camera: Camera, p_cam: Float[Array, "3 p"]) -> Float[Array, "9 p"]:
    """Pixel u, v of each point, how far it is inside what the camera can see (positive: valid), and the derivatives of
    u, then of v, by the point in the camera frame [px / m]."""
    return _call(_of_model("semloc_project", camera), [(9, p_cam.shape[-1])], p_cam, *jax.tree.leaves(camera))[0]


def sums_by_index(values: Float[Array, "k n"], index: Int[Array, " n"], num: int) -> Float[Array, "k num"]:
    """Sums of the values of each row that share an index in 0 .. num - 1."""
    return _call("semloc_sums_by_index", [(len(values), num)], values, index)[0]


class Bucket(NamedTuple):
    """What one camera sees of the map, slot by slot."""

    index: Int[Array, " slot"]
    """Of the sample; 0 for padding."""
    silhouette_map: Float[Array, "3 slot"]
    """From the sample to its contour [m]."""
    tangent_map: Float[Array, "3 slot"]
    weight: Float[Array, " slot"]
    channel: Int[Array, " slot"]
    element: Int[Array, " slot"]
    edge: Int[Array, " slot"]


def view(
    T_local_base: Float[Array, "4 4"],
    T_base_cam: Float[Array, "4 4"],
    samples: MapSamples,
    channel_of_label: Int[Array, " label"],
    class_weight: Float[Array, " label"],
    grain: Float[Array, ""],
    numbers: Float[Array, " number"],
    camera: Camera,
    capacity: int,
    num_ground: int,
) -> Bucket:
    """The samples that one camera sees, as `residuals.view` has it.

    Args:
        T_local_base: Vehicle pose.
        T_base_cam: Extrinsics.
        samples: Of the local map.
        channel_of_label: Negative where no mask shows the class.
        class_weight: Factor on the weight of each class.
        grain: Of the masks.
        numbers: In the order of `ViewNumbers` in native/src/view.h.
        camera: Intrinsics of a model with a kernel (`cameras.models`).
        capacity: Slots.
        num_ground: So many of the first labels are painted on the ground.
    """
    floats, whole = jax.ShapeDtypeStruct((capacity,), jnp.float32), jax.ShapeDtypeStruct((capacity,), jnp.int32)
    shapes = [whole, (3, capacity), (3, capacity), floats, whole, whole, whole]
    rows = (getattr(samples, field.name) for field in dataclasses.fields(MapSamples))
    operands = (T_local_base, T_base_cam, *rows, channel_of_label, class_weight, grain, numbers)
    operands = (*operands, *jax.tree.leaves(camera))
    return Bucket(*_call(_of_model("semloc_view", camera), shapes, *operands, num_ground=num_ground))


def ramp_values(
    T_local_base: Float[Array, "4 4"],
    camera: Camera,
    T_cam_base: Float[Array, "4 4"],
    points: Points,
    texture: RampTexture,
    index: Int[Array, ""],
) -> Float[Array, " p"]:
    """Signed ramp value in [-1, 1] of each sample of one camera; arguments as above."""
    operands = (T_local_base, T_cam_base, *points, *_texture(texture, index), *jax.tree.leaves(camera))
    name, number = _of_model("semloc_ramp_values", camera), texture.num_channels
    return _call(name, [(points[0].shape[-1],)], *operands, num_channels=number)[0]


def robust_cost(
    T_local_base: Float[Array, "4 4"],
    camera: Camera,
    T_cam_base: Float[Array, "4 4"],
    points: Points,
    texture: RampTexture,
    index: Int[Array, ""],
) -> Float[Array, ""]:
    """Sum of weight x Tukey cost of one camera, 1 for each sample beyond the ramp; arguments as above."""
    operands = (T_local_base, T_cam_base, *points, *_texture(texture, index), *jax.tree.leaves(camera))
    name, number = _of_model("semloc_robust_cost", camera), texture.num_channels
    return _call(name, [()], *operands, num_channels=number)[0]


def piece_sums(
    T_local_base: Float[Array, "4 4"],
    camera: Camera,
    T_cam_base: Float[Array, "4 4"],
    points: Points,
    piece: Int[Array, " p"],
    usable: Bool[Array, "cam h w"],
    scale: float,
    margin_px: float,
    texture: RampTexture,
    index: Int[Array, ""],
) -> Float[Array, "2 p"]:
    """Weight of the samples of each piece that one camera can see, and the same times Tukey's rho of their ramp values;
    `piece` is the place of each sample's piece among as many as there are samples, the rest as above."""
    numbers = jnp.float32(scale), jnp.float32(margin_px)
    operands = (T_local_base, T_cam_base, *points, piece, usable, *numbers, *_texture(texture, index))
    name, number = _of_model("semloc_piece_sums", camera), texture.num_channels
    return _call(name, [(2, len(piece))], *operands, *jax.tree.leaves(camera), num_channels=number)[0]


class Visited(NamedTuple):
    """A pose after each level of a solve."""

    Ts: Float[Array, "level 4 4"]
    num_steps: Int[Array, " level"]
    converged: Bool[Array, " level"]


def refine(
    T_start: Float[Array, "4 4"],
    T_prior: Float[Array, "4 4"],
    sigma: Float[Array, "6"],
    levels: Int[Array, " level"],
    gain: Float[Array, " all"],
    numbers: Float[Array, "10"],
    view: CameraViews,
    usable: Usable,
    textures: RampTextures,
    max_steps: int,
) -> Visited:
    """A pose refined level by level, as `alignment.pose` has it: every evaluation of a solve in one call.

    Args:
        T_start: Start.
        T_prior: Centre of the prior.
        sigma: Its standard deviations.
        levels: Of the cost maps, in their order.
        gain: Nats for each unit of cost on every level there is: what is visited besides does not change a level.
        numbers: In the order of `SolveNumbers` in native/src/refine.h.
        view: Cameras of one model with what they see.
        usable: Usable pixels.
        textures: All levels.
        max_steps: Most evaluations on each level.
    """
    num, whole = len(levels), jax.ShapeDtypeStruct((len(levels),), jnp.int32)
    operands = (T_start, T_prior, sigma, levels, gain, numbers, view.T_cam_base)
    operands = (*operands, view.p_map, view.channel, view.weight, view.index, usable.mask, textures.texels)
    operands = (*operands, textures.start, textures.height, textures.width, textures.stride)
    name, counts = _of_model("semloc_refine", view.camera), {"num_channels": textures.num_channels}
    found = _call(
        name, [(num, 4, 4), whole, whole], *operands, *jax.tree.leaves(view.camera), **counts, max_steps=max_steps
    )
    return Visited(found[0], found[1], found[2] != 0)
