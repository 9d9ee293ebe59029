"""`semloc slots`: parking slots around a vehicle, made exact over many frames (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from semloc_jax.cli.main import OK, log_to_console


@dataclass(frozen=True)
class Options:
    """Find parking slots in every frame of a drive and follow them in the frame of its odometry.

    Writes slots.csv (each sight: t, track, type, pose in base and in odom, width, depth, occupied, obstacle, sigmas,
    existence), slots_final.csv (one line for each slot), slots.geojson, config.yaml, with --video the film slots.mp4,
    and metrics.json: where the drive has a true map and true poses, errors of single sights, of a plain Kalman filter
    and of the fused tracks along x and y of the vehicle. `obstacle` is what keeps a slot free: a lock, a sign, a cone.

    x_m, y_m are the middle of the entrance, yaw_rad is the direction from there into the slot. A slot is confirmed when
    three of the first five frames that look at it show it, and ends after five visible misses.

    Of a map (`semloc slots MAP.gpkg`): its slots as slots_final.csv (places of the map, type, occupied, number, sigmas
    and existence where the map states them), slots.geojson and slots.png.

    Top views without a drive: `semloc slots FOLDER --metres-per-px 0.0167` finds the slots of each picture of a folder
    by itself (600 x 600 px of 10 m, as those of ps2.0; up is ahead, metres from the middle of the picture). Writes
    slots.csv (corners in px; middle of the entrance, direction, width, depth in m; the depth is assumed), points.csv
    (marking points: the middle of the paint, px and m, L or T, confidence down to 0.1) and pictures/.
    """

    drive: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DRIVE|MAP|FOLDER")]
    """The drive: a folder or a bag (.bag, .db3, .mcap) with wheel odometry, its type is guessed; a map; with
    --metres-per-px a top view or a folder of them."""
    metres_per_px: float | None = None
    """The pictures are top views with pixels of this size, each by itself: there is no drive."""
    calib: Path | None = None
    """Calibration file; default: the drive's own."""
    front: Literal["masks", "net"] = "masks"
    """What finds slots in a frame: masks: the lines of slots in them; net: a network's marking points in the top view
    of the images. Masks then say only what hides the road and who parks."""
    weights: Path | None = None
    """With --front net: what `semloc learn slots` wrote; default: the network that ships with the package."""
    masks: str | None = None
    """Mask folder of the drive (sem, sem_net ...), any folder CAMERA/FRAME.png, or FILE.onnx; default: the drive's best
    masks."""
    class_table: str | None = None
    """What the ids in the masks mean: a preset or a YAML file; default: the drive's own."""
    cameras: str | None = None
    """Names of cameras, separated by commas; default: all."""
    frames: str = ":"
    """Which frames, as a Python slice: ::2, 100:200; the way is that of the whole drive."""
    window: int = 5
    """Frames whose looks at the road are laid over each other before lines are followed, or whose marking points have
    to agree; 1: each by itself."""
    video: bool = False
    """Write slots.mp4: the top view with the slots."""
    rrd: Path | None = None
    """Write a recording for the Rerun viewer to this file; needs the extra `viz`."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def run(options: Options) -> int:
    """Find and follow the slots, print how exact they are."""
    from semloc_jax.datasets import open_drive
    from semloc_jax.errors import UsageError
    from semloc_jax.inputs.choices import chosen_frames, parse_names
    from semloc_jax.inputs.mask_source import best_masks, mask_source
    from semloc_jax.mapping.slot_sights import SlotSightConfig
    from semloc_jax.maps.io.formats import MAP_SUFFIXES
    from semloc_jax.reports.slots import report_slots

    log_to_console()
    if options.drive.suffix.lower() in MAP_SUFFIXES:
        from semloc_jax.reports.map_slots import report_map_slots

        print(report_map_slots(options.drive, options.out))
        return OK
    has_net = options.front == "net" or options.metres_per_px is not None
    if options.weights is not None and not has_net:
        raise UsageError("--weights is for --front net; give both, or leave it out")
    net = None
    if has_net:
        from semloc_jax.perception.networks.marking_net import SHIPPED, MarkingNet

        net = MarkingNet.load(options.weights or SHIPPED)
    if net is not None and options.metres_per_px is not None:
        from semloc_jax.reports.view_slots import report_view_slots

        print(report_view_slots(options.drive, options.metres_per_px, net, options.out))
        return OK
    drive = open_drive(options.drive, options.calib)
    chosen = chosen_frames(drive, options.frames)
    masks = mask_source(options.masks or best_masks(drive), drive, parse_names(options.cameras), options.class_table)
    kept = {"masks": masks.name, "cameras": ",".join(masks.cameras), "frames": options.frames}
    kept["front"] = options.front
    sights = SlotSightConfig(window=options.window)
    print(
        report_slots(
            drive, masks, chosen, sights, net=net, video=options.video, rrd=options.rrd, out=options.out, options=kept
        )
    )
    return OK
