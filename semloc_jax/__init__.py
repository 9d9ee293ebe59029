"""Where is this camera in the map? Semantic localization in a vector map, on JAX.

From files, a drive that `semloc demo` or `simulate` wrote, or your own folder, to poses with a verdict:

    >>> drive = sj.open_drive(folder)                                  # frames, masks, calibration, satellite fixes
    >>> semantic_map = sj.read_map(drive.map_path)                     # Lanelet2, OpenDRIVE, GeoPackage, GeoJSON ...
    >>> results = sj.localize_frames(drive, semantic_map, masks="sem")
    >>> best = results[0]                                              # T_map_base, covariance, status, reasons, modes
    >>> best.localized, bool(best.covariance[1, 1] ** 0.5 < 0.1)
    (True, True)

From arrays, without any folder: a camera matrix, a mask of class ids, three polylines, a first guess:

    >>> camera = sj.camera_from_K([[400, 0, 319.5], [0, 400, 199.5], [0, 0, 1]], (640, 400))
    >>> rig = sj.Rig([camera], [sj.mounted((1.6, 0.0, 1.4), down_deg=4.0)], ["front"])
    >>> left, right, bar = [[0, 2, 0], [30, 2, 0]], [[0, -2, 0], [30, -2, 0]], [[14, -1.9, 0], [14, 1.9, 0]]
    >>> street = sj.map_from_arrays([("lane_marking", left), ("lane_marking", right), ("stop_line", bar)])
    >>> classes = {10: "lane_marking", 12: "stop_line"}
    >>> found = sj.align(mask, rig, street, sj.planar_pose(2.6, -0.2), classes=classes)
    >>> found.T_map_base.shape, found.covariance.shape, found.status.name
    ((4, 4), (6, 6), 'CONVERGED')

The same pose as a differentiable function of cameras, extrinsics, prior; here by the focal length:

    >>> def forward_m(focal_px):
    ...     K = [[focal_px, 0.0, 319.5], [0.0, focal_px, 199.5], [0.0, 0.0, 1.0]]
    ...     own = sj.Rig([sj.camera_from_K(K, (640, 400))], rig.T_base_cam, rig.names)
    ...     pose = sj.align(mask, own, street, sj.planar_pose(2.6, -0.2), classes=classes, differentiable=True)
    ...     return pose.T_map_base[0, 3]
    >>> slope = jax.grad(forward_m)(400.0)                             # metres along the road per pixel
    >>> bool(jnp.isfinite(slope) & (slope != 0.0))
    True

The names, in the order of the data flow
    cameras      camera_from_K, mounted, Rig, read_calibration, write_calibration, PinholeCamera, ...
    map          read_map, map_from_arrays, write_map, inspect_map, SemanticMap, MapElement, sample
    masks        load_class_table, ClassTable, Channel, mask_source, cost_maps, render_masks, SurroundView,
                 BowlView, CylinderView
    drives       open_drive, Drive, Frame, simulate, simulate_on_map, with_fault
    first guess  planar_pose, PosePrior, prior_source
    one frame    align, search, localize_frames, iterate_frames, FrameLocalizer, LocalizeConfig, LocalizationResult
    derivatives  align(..., differentiable=True), differentiable_scene, align_differentiable, smooth_scene
    a drive      track_frames, Localizer, TrackConfig, TrackResult
    judge        evaluate, compare_maps, pose_errors, read_trajectory, write_tum, Metric
    solver       evidence_from, Evidence, Prior, pose_term, AlignConfig, align_one, align_many

Frames: map (metres, z up), base (rear axle on the ground, x forward, y left, z up), cam (z forward, x right, y down);
`T_map_base` maps base to map. Tangents are (x, y, z [m], roll, pitch, yaw [rad]) in the vehicle frame.

Names are loaded on first use: `import semloc_jax` costs nothing; drawing lives in `semloc_jax.viz`. Compiled programs
are kept in the user's cache folder: the second run starts at once. SEMLOC_CACHE=0 in the environment switches that off,
JAX_COMPILATION_CACHE_DIR names another folder.
"""

import importlib

from semloc_jax import host as _host
from semloc_jax.door import door

__version__ = "0.1.0"

_ROOMS = {
    "errors": ("SemlocError",),
    "structs": ("ElementClass", "MapSamples", "CostMaps", "PoseEstimate", "SolveStatus"),
    "geometry.rigid": ("planar_pose",),
    "cameras": (
        "mounted",
        "Rig",
        "PinholeCamera",
        "BrownConradyCamera",
        "KannalaBrandtCamera",
        "CylindricalCamera",
        "BevCamera",
    ),
    "cameras.io": ("camera_from_K", "read_calibration", "write_calibration"),
    "maps": ("SemanticMap", "MapElement", "read_map", "write_map", "inspect_map", "sample"),
    "maps.from_arrays": ("map_from_arrays",),
    "perception": ("ClassTable", "Channel", "load_class_table"),
    "perception.cost_maps": ("CostMapConfig", "cost_maps"),
    "perception.surround": ("SurroundView",),
    "perception.bowl": ("BowlView",),
    "perception.cylinder_view": ("CylinderView",),
    "datasets": ("Drive", "Frame", "open_drive"),
    "inputs.mask_source": ("mask_source",),
    "inputs.mask_view": ("MaskSource",),
    "inputs.priors": ("prior_source",),
    "simulation": (
        "simulate",
        "simulate_on_map",
        "SimulationConfig",
        "Degradation",
        "with_fault",
        "FaultSizes",
        "render_masks",
    ),
    "alignment.from_arrays": ("align", "search", "differentiable_scene", "pose_term"),
    "alignment.pose_prior": ("PosePrior",),
    "alignment.result": ("LocalizationResult",),
    "alignment.frame_localizer": ("FrameLocalizer", "LocalizeConfig"),
    "alignment.single_frame": ("evidence_from",),
    "alignment.pose": ("Evidence", "Prior", "AlignConfig", "align_one", "align_many"),
    "alignment.implicit": ("align_differentiable", "smooth_scene"),
    "localization.frame_by_frame": ("localize_frames", "iterate_frames"),
    "localization.drive": ("track_frames",),
    "localization.localizer": ("Localizer", "TrackConfig"),
    "localization.track_state": ("TrackResult", "TrackStatus"),
    "evaluation": (
        "Trajectory",
        "read_trajectory",
        "write_tum",
        "pose_errors",
        "evaluate",
        "compare_maps",
        "Metric",
    ),
}
"""The public names of each module, in the order of the data flow."""

# Pure JAX rooms know no host: here they are told how kernels are built and where compiled programs are kept.
_host.offer(
    native=lambda: importlib.import_module("semloc_jax.native.build").status,
    programs=lambda: importlib.import_module("semloc_jax.runtime.programs"),
)


def _prepared() -> None:
    from semloc_jax.runtime.prepare import prepare_jax

    prepare_jax()


__getattr__, __dir__, _names = door(__name__, _ROOMS, before_loading=_prepared)
__all__ = [*_names, "__version__"]
