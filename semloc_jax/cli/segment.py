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
    from collections.abc import Iterator

    import numpy as np

    from semloc_jax.datasets import Drive, Frame
    from semloc_jax.perception import ClassTable
    from semloc_jax.perception.network import NetworkPreset, NetworkSegmenter

_LOG = logging.getLogger(__name__)
_REPORTED = 200
"""At most so many masks, spread over the drive, are read again for the report."""


@dataclass(frozen=True)
class Options:
    """Make masks of the images of a drive with a segmentation network in an ONNX file.

    Writes OUT/CAMERA/FRAME.png (class ids) and OUT/segment.yaml. What is there already is not made again, so that an
    interrupted run goes on where it stopped. `semloc localize DRIVE --masks OUT` uses the masks.

    How images are prepared can be written to a preset (YAML): model, class_table, width_px, height_px, letterbox,
    tiles, overlap, mean, std, value_range, swap_red_blue, channels_last, threshold, output, backend, batch.

    The exit code is 3 when images could not be read; the others are done.
    """

    drive: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DRIVE")]
    """The drive: a folder, a bag, a video; its type is guessed."""
    model: Path | None = None
    """ONNX file; default: that of the preset."""
    preset: Path | None = None
    """YAML file that says how images become the input of the network."""
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
    backend: Literal["auto", "onnxruntime", "opencv"] | None = None
    """What runs the network; default: onnxruntime where it is installed."""
    calib: Path | None = None
    """Calibration file, where the drive has none of its own."""
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
    """Segment what is missing, tell what the masks can see."""
    from semloc_jax.datasets import open_drive
    from semloc_jax.errors import SemlocError
    from semloc_jax.perception import load_class_table
    from semloc_jax.perception.network import NetworkSegmenter

    logging.basicConfig(format="%(message)s")
    preset = _preset(options)
    chosen = parse_slice(options.frames)
    if not preset.class_table:
        raise SemlocError(f"network {preset.model}: what its class ids mean is not known; give --class-table")
    table = load_class_table(preset.class_table)
    drive = open_drive(options.drive, options.calib)
    frames = drive.frames[chosen]
    if not frames:
        raise SemlocError(f"drive {drive.name}: no frames chosen of {len(drive)}; check --frames")
    cameras = _cameras(options, drive)
    folder = options.out or Path(f"masks_{Path(preset.model).stem}") / drive.name
    network = NetworkSegmenter(preset)
    _claim(folder, preset, options.overwrite)
    todo = [(f, c) for f in frames for c in cameras if options.overwrite or not _mask_path(folder, c, f).is_file()]
    num_failed = _make(network, todo, folder, len(frames) * len(cameras))
    print(_report(options, drive, table, folder, frames, cameras))
    print(f"masks: {folder}  (semloc localize {options.drive} --masks {folder})")
    return LOST if num_failed else OK


def _preset(options: Options) -> "NetworkPreset":
    """The preset with what the options say over it."""
    from semloc_jax.perception.network import NetworkPreset, load_network_preset

    preset = load_network_preset(options.preset) if options.preset is not None else NetworkPreset()
    given: dict = {"model": str(options.model)} if options.model is not None else {}
    if not (given or preset.model):
        raise UsageError("no network; give --model FILE.onnx, or a --preset with the key model")
    if options.size is not None:
        given |= dict(zip(("width_px", "height_px"), _pair(options.size, "--size"), strict=True))
    if options.tiles is not None:
        given["tiles"] = _pair(options.tiles, "--tiles")
    for key in ("class_table", "batch", "backend"):
        if getattr(options, key) is not None:
            given[key] = getattr(options, key)
    return replace(preset, **given, **({"letterbox": False} if options.stretch else {}))


def _pair(text: str, option: str) -> tuple[int, int]:
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.strip().isdigit() and int(part) > 0 for part in parts):
        raise UsageError(f"{option} '{text}': expected two numbers such as 1024x512")
    return int(parts[0]), int(parts[1])


def _cameras(options: Options, drive: "Drive") -> tuple[str, ...]:
    from semloc_jax.errors import SemlocError

    first = drive.frames[0]
    names = parse_names(options.cameras) or tuple(name for name in drive.rig.names if first.has("rgb", name))
    drive.rig.select(names)
    without = [name for name in names if not first.has("rgb", name)]
    if without or not names:
        raise SemlocError(f"drive {drive.name}: no images of {', '.join(without) or 'any camera'}; check --cameras")
    return names


def _claim(folder: Path, preset: "NetworkPreset", overwrite: bool) -> None:
    """Write the record of the folder, or check that it is that of the same network.

    Raises:
        SemlocError: the folder holds masks of another network or other settings.
    """
    import dataclasses
    import hashlib

    import yaml

    from semloc_jax.errors import SemlocError
    from semloc_jax.inputs.mask_source import RECORD

    with Path(preset.model).open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    settings = {key: list(v) if isinstance(v, tuple) else v for key, v in dataclasses.asdict(preset).items()}
    # How the work is cut in batches and by what it is run changes no mask beyond rounding.
    record = {"model_sha256": digest} | {key: v for key, v in settings.items() if key not in ("batch", "backend")}
    path = folder / RECORD
    if path.is_file() and not overwrite:
        made = yaml.safe_load(path.read_text(encoding="utf-8"))
        ours = {key: v for key, v in record.items() if key not in ("model", "class_table")}
        other = [key for key, v in ours.items() if not isinstance(made, dict) or made.get(key) != v]
        if other:
            raise SemlocError(
                f"masks {folder}: made with another {', '.join(other)}; give another --out, or --overwrite"
            )
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path.write_text(yaml.safe_dump(record, sort_keys=False), encoding="utf-8")
    except OSError as error:
        raise SemlocError(f"masks {folder}: cannot be written ({error.strerror}); give another --out") from error


def _make(network: "NetworkSegmenter", todo: "list[tuple[Frame, str]]", folder: Path, num_all: int) -> int:
    """Make and write masks; returns the number of images that could not be read."""
    import time

    from tqdm import tqdm

    started, num_failed = time.perf_counter(), 0
    done = num_all - len(todo)
    with tqdm(total=num_all, initial=done, unit="image", disable=None) as bar:
        for chunk in _batches(todo, network.batch):
            images, kept = [], []
            for frame, camera in chunk:
                image = _image(frame, camera)
                num_failed += image is None
                if image is not None:
                    images.append(image)
                    kept.append((frame, camera))
            masks = network.segment(images) if images else []
            for (frame, camera), mask in zip(kept, masks, strict=True):
                _write(mask, _mask_path(folder, camera, frame))
            bar.update(len(chunk))
    num_made = len(todo) - num_failed
    each = f", {1e3 * (time.perf_counter() - started) / num_made:.0f} ms each" if num_made else ""
    print(f"made {num_made} masks with {network.backend.name}{each}; {done} were there; {num_failed} failed")
    return num_failed


def _image(frame: "Frame", camera: str) -> "np.ndarray | None":
    """The image; None, with a word, where it cannot be read: one bad file must not end a long run."""
    from semloc_jax.errors import SemlocError

    try:
        return frame.image(camera)
    except SemlocError as error:
        _LOG.warning("left out: %s", error)
        return None


def _write(mask: "np.ndarray", path: Path) -> None:
    """Write a mask so that an interruption leaves no half of it."""
    import cv2

    from semloc_jax.errors import SemlocError

    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part.png")
    if not cv2.imwrite(str(part), mask):
        raise SemlocError(f"mask {path}: cannot be written; is the disk full?")
    part.replace(path)


def _report(
    options: Options, drive: "Drive", table: "ClassTable", folder: Path, frames: tuple, cameras: tuple[str, ...]
) -> str:
    import numpy as np

    from semloc_jax.maps import read_map
    from semloc_jax.perception import read_mask
    from semloc_jax.perception.visibility import visibility, visibility_text

    paths = [_mask_path(folder, camera, frame) for frame in frames for camera in cameras]
    paths = [path for path in paths if path.is_file()]
    spread = np.unique(np.linspace(0, len(paths) - 1, min(_REPORTED, len(paths))).astype(int)) if paths else []
    masks = [read_mask(paths[i]) for i in spread]
    fit = table.report(masks)
    in_map = None
    map_path = options.map or drive.map_path
    if map_path is not None:
        labels = [element.label for element in read_map(map_path).elements if not element.is_logical]
        in_map = {label: labels.count(label) for label in set(labels)}
    lines = [f"warning: {problem}" for problem in fit.problems]
    return "\n".join([*lines, visibility_text(visibility(table, masks), table.name, in_map)])


def _mask_path(folder: Path, camera: str, frame: "Frame") -> Path:
    return folder / camera / f"{frame.id}.png"


def _batches(items: list, size: int) -> "Iterator[list]":
    for start in range(0, len(items), size):
        yield items[start : start + size]
