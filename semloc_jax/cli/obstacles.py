"""`semloc obstacles`: what stands around a vehicle, made exact over many frames (room: cli)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from semloc_jax.cli.main import OK, log_to_console


@dataclass(frozen=True)
class Options:
    """Find cones, pillars, ground locks and no-parking signs in every frame of a drive and follow them in the frame of
    its odometry.

    Writes obstacles.csv (each sight: t, track, class, pose in base and in odom, length, width, sigmas, existence),
    obstacles_final.csv (one line for each obstacle), obstacles.geojson, config.yaml, with --video the film
    obstacles.mp4, and metrics.json: where the drive has a true map and true poses, errors of single frames, of a plain
    Kalman filter and of the fused tracks along x and y of the vehicle.

    x_m, y_m are the middle of the footprint; yaw_rad is the direction of its shorter side, 0 with a sigma of pi / 2
    where nothing tells it. An obstacle is confirmed when three of the first five frames that look at it show it, and
    ends after five visible misses; with --front net also not before its foot was near or lines of sight cross.
    """

    drive: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DRIVE")]
    """The drive: a folder or a bag (.bag, .db3, .mcap) with wheel odometry, its type is guessed."""
    calib: Path | None = None
    """Calibration file; default: the drive's own."""
    front: Literal["masks", "net"] = "masks"
    """What finds obstacles in a frame: masks: their patches in them; net: a network's boxes in the images. Masks then
    say only what hides the road."""
    weights: Path | None = None
    """With --front net: what `semloc learn obstacles` wrote; default: the network that ships with the package."""
    input: Literal["cylinder", "fisheye"] = "cylinder"
    """Boxes of the image on an upright cylinder, or for comparison of the image as it is."""
    masks: str | None = None
    """Mask folder of the drive (sem, sem_net ...), any folder CAMERA/FRAME.png, or FILE.onnx; default: the drive's best
    masks."""
    class_table: str | None = None
    """What the ids in the masks mean: a preset or a YAML file; default: the drive's own."""
    cameras: str | None = None
    """Names of cameras, separated by commas; default: all."""
    frames: str = ":"
    """Which frames, as a Python slice: ::2, 100:200; the way is that of the whole drive."""
    video: bool = False
    """Write obstacles.mp4: the top view with the obstacles."""
    rrd: Path | None = None
    """Write a recording for the Rerun viewer to this file; needs the extra `viz`."""
    out: Path | None = None
    """Folder for the results; default: results/TIME, to which results/latest points."""


def run(options: Options) -> int:
    """Find and follow the obstacles, print how exact they are."""
    from semloc_jax.datasets import open_drive
    from semloc_jax.errors import UsageError
    from semloc_jax.inputs.choices import chosen_frames, parse_names
    from semloc_jax.inputs.mask_source import best_masks, mask_source
    from semloc_jax.mapping.obstacle_sights import ObstacleConfig
    from semloc_jax.reports.obstacles import report_obstacles

    log_to_console()
    if options.front != "net" and options.weights is not None:
        raise UsageError("--weights is for --front net; give both, or leave it out")
    if options.front == "net" and options.input != "cylinder":
        raise UsageError("--front net looks at the cylinder; --input fisheye is for --front masks")
    net = None
    if options.front == "net":
        from semloc_jax.perception.networks.obstacle_net import SHIPPED, ObstacleNet

        net = ObstacleNet.load(options.weights or SHIPPED)
    drive = open_drive(options.drive, options.calib)
    chosen = chosen_frames(drive, options.frames)
    name = options.masks or best_masks(drive)
    masks = mask_source(name, drive, parse_names(options.cameras), options.class_table)
    kept = {"masks": masks.name, "cameras": ",".join(masks.cameras), "frames": options.frames}
    kept["front"] = options.front
    config = ObstacleConfig(input=options.input)
    print(
        report_obstacles(
            drive, masks, chosen, config, net=net, video=options.video, rrd=options.rrd, out=options.out, options=kept
        )
    )
    return OK
