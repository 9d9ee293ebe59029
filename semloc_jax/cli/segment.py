"""`semloc segment`: masks of a drive by a network, with a report of the map classes they can see (room: cli)."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from semloc_jax.cli.main import LOST, OK
from semloc_jax.errors import UsageError
from semloc_jax.inputs.choices import parse_names, parse_slice

if TYPE_CHECKING:
    from semloc_jax.perception.network import NetworkPreset

_FILES = (".onnx", ".yaml", ".yml")
"""Networks that masks are made with here; others run on images while somebody asks for them."""


@dataclass(frozen=True)
class Options:
    """Make masks of the images of a drive with a segmentation network in an ONNX file.

    Writes OUT/CAMERA/FRAME.png (class ids) and OUT/segment.yaml. What is there already is not made again, so that an
    interrupted run goes on where it stopped. `semloc localize DRIVE --masks OUT` uses the masks. OUT/look.jpg shows ten
    frames with their masks: look at it before you trust them. No network at hand? `semloc localize DRIVE --masks net`
    needs none, nor files of masks.

    How images are prepared can be written to a preset (YAML): model, class_table, width_px, height_px, letterbox,
    tiles, overlap, mean, std, value_range, swap_red_blue, channels_last, threshold, output, bits, backend, batch.

    The exit code is 3 when images could not be read; the others are done.
    """

    drive: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DRIVE")]
    """The drive: a folder, a bag, a video; its type is guessed."""
    model: Path | None = None
    """ONNX file; default: that of the preset."""
    preset: str | None = None
    """How images become the input of the network: a recipe of an exporter (segformer-cityscapes, mmseg-mapillary,
    paddleseg-cityscapes, torchvision-cityscapes, keras-cityscapes, twinlite, yolop ...) or a YAML file."""
    class_table: str | None = None
    """What the ids mean: a preset (cityscapes, mapillary ...) or a YAML file; default: that of the preset."""
    size: str | None = None
    """Input of the network in pixels, e.g. 1024x512; default: what the file states, else the size of the images."""
    stretch: bool = False
    """Stretch images to that size instead of keeping their shape."""
    tiles: str | None = None
    """Columns and rows in which images are cut, e.g. 2x1; default: one piece."""
    batch: int | None = None
    """Images (or tiles) that go through the network at once."""
    output: str | None = None
    """Name of the output that holds the classes, where the network has several."""
    backend: Literal["auto", "onnxruntime", "opencv"] | None = None
    """What runs the network; default: onnxruntime where it is installed."""
    calib: Path | None = None
    """Calibration file; default: the drive's own."""
    cameras: str | None = None
    """Names of cameras, separated by commas; default: all with images."""
    frames: str = ":"
    """Which frames, as a Python slice: ::5, 10:20, 7."""
    map: Path | None = None
    """A map: tell which of its classes the masks can see; default: the drive's own."""
    overwrite: bool = False
    """Make masks again that are there."""
    out: Path | None = None
    """Folder of the masks; default: masks_MODEL/DRIVE in this folder."""


def run(options: Options) -> int:
    """Make the masks that are missing, print what the masks show."""
    from semloc_jax.datasets import open_drive
    from semloc_jax.reports.segmentation import report_segmentation

    logging.basicConfig(format="%(message)s")
    preset, chosen, cameras = _preset(options), parse_slice(options.frames), parse_names(options.cameras)
    drive = open_drive(options.drive, options.calib)
    made = report_segmentation(drive, preset, chosen, cameras, options.out, options.map, options.overwrite)
    print(made.text)
    print(f"masks: {made.folder}  (semloc localize {options.drive} --masks {made.folder})")
    return LOST if made.num_failed else OK


def _preset(options: Options) -> "NetworkPreset":
    """The preset with what the options say over it."""
    from semloc_jax.inputs.mask_source import made_of_images
    from semloc_jax.perception.network import NetworkPreset, load_network_preset
    from semloc_jax.perception.network_recipes import RECIPES, recipe

    preset = NetworkPreset()
    if options.preset is not None:
        is_file = options.preset.endswith((".yaml", ".yml")) or Path(options.preset).is_file()
        preset = load_network_preset(options.preset) if is_file else recipe(options.preset)
    elif options.class_table in RECIPES:
        preset = RECIPES[options.class_table]
        print(f"images as {options.class_table} takes them ({preset.width_px}x{preset.height_px}); --preset for others")
    given: dict = {"model": str(options.model)} if options.model is not None else {}
    if options.model is not None and made_of_images(name := str(options.model)) and not name.endswith(_FILES):
        raise UsageError(f"{name} needs no files of masks; 'semloc localize {options.drive} --masks {name}' runs it")
    if not (given or preset.model):
        raise UsageError("no network; give --model FILE.onnx, or a --preset with the key model")
    if options.size is not None:
        given |= dict(zip(("width_px", "height_px"), _pair(options.size, "--size"), strict=True))
    if options.tiles is not None:
        given["tiles"] = _pair(options.tiles, "--tiles")
    for key in ("class_table", "output", "batch", "backend"):
        if getattr(options, key) is not None:
            given[key] = getattr(options, key)
    return replace(preset, **given, **({"letterbox": False} if options.stretch else {}))


def _pair(text: str, option: str) -> tuple[int, int]:
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.strip().isdigit() and int(part) > 0 for part in parts):
        raise UsageError(f"{option} '{text}': expected two numbers such as 1024x512")
    return int(parts[0]), int(parts[1])
