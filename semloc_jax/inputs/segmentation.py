"""Masks of a whole drive by a network, on disk (room: inputs; host).

In: a drive, a network. Out: FOLDER/CAMERA/FRAME.png, FOLDER/segment.yaml, and which map classes the masks show.
"""

import dataclasses
import hashlib
import logging
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import yaml
from tqdm import tqdm

from semloc_jax.datasets import Drive, Frame
from semloc_jax.errors import SemlocError
from semloc_jax.inputs.mask_files import RECORD
from semloc_jax.maps import read_map
from semloc_jax.perception import ClassTable, load_class_table, read_mask
from semloc_jax.perception.network import NetworkPreset, NetworkSegmenter
from semloc_jax.perception.visibility import mask_problems, visibility, visibility_text
from semloc_jax.storage import claim, output_path, write_text, writing

_LOG = logging.getLogger(__name__)
_REPORTED = 200
"""At most so many masks, spread over the drive, are read again for the report."""


class Segmented(NamedTuple):
    """Masks that were made.

    Args:
        folder: where they are.
        cameras: whose images were taken.
        num_failed: images that could not be read.
        text: what was made and which map classes the masks show, for people.
    """

    folder: Path
    cameras: tuple[str, ...]
    num_failed: int
    text: str


def segment_drive(
    drive: Drive,
    preset: NetworkPreset,
    chosen: slice = slice(None),
    cameras: tuple[str, ...] | None = None,
    folder: Path | None = None,
    map_path: Path | None = None,
    overwrite: bool = False,
) -> Segmented:
    """Make the masks of a drive that are missing.

    Args:
        drive: The drive.
        preset: The network and how images are prepared for it.
        chosen: Which frames.
        cameras: Names of cameras; None for all with images.
        folder: Of the masks; None for masks_MODEL/DRIVE in this folder.
        map_path: A map whose classes are looked for in the masks; None for the drive's own.
        overwrite: Make masks again that are there.

    Raises:
        SemlocError: the meaning of the class ids is not known, nothing is chosen, the folder holds masks of another
            network, or a file cannot be read or written.
    """
    if not preset.class_table:
        if not Path(preset.model).is_file():
            raise SemlocError(f"network {preset.model}: no such file; expected a segmentation network in ONNX format")
        raise SemlocError(f"network {preset.model}: what its class ids mean is not known; give --class-table")
    table = load_class_table(preset.class_table)
    frames = drive.frames[chosen]
    if not frames:
        raise SemlocError(f"drive {drive.name}: no frames chosen of {len(drive)}; check --frames")
    cameras = _cameras(cameras, drive)
    folder = folder or Path(f"masks_{Path(preset.model).stem}") / drive.name
    network = NetworkSegmenter(preset)
    _claim(folder, preset, overwrite)
    pairs = [(frame, camera) for frame in frames for camera in cameras]
    paths = [_mask_path(folder, camera, frame) for frame, camera in pairs]
    todo = [pair for pair, path in zip(pairs, paths, strict=True) if overwrite or not path.is_file()]
    num_failed, made = _make(network, todo, folder, len(pairs))
    report = _report(paths, table, map_path or drive.map_path)
    return Segmented(folder, cameras, num_failed, f"{made}\n{report}")


def _cameras(names: tuple[str, ...] | None, drive: Drive) -> tuple[str, ...]:
    first = drive.frames[0]
    names = names or tuple(name for name in drive.rig.names if first.has("rgb", name))
    drive.rig.select(names)
    without = [name for name in names if not first.has("rgb", name)]
    if without or not names:
        raise SemlocError(f"drive {drive.name}: no images of {', '.join(without) or 'any camera'}; check --cameras")
    return names


def _claim(folder: Path, preset: NetworkPreset, overwrite: bool) -> None:
    """Write the record of the folder, or check that it is that of the same network.

    Raises:
        SemlocError: the folder holds masks of another network or other settings.
    """
    with Path(preset.model).open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    settings = {key: list(v) if isinstance(v, tuple) else v for key, v in dataclasses.asdict(preset).items()}
    # Batch size and backend change masks by rounding only.
    record = {"model_sha256": digest} | {key: v for key, v in settings.items() if key not in ("batch", "backend")}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        claim(folder)
    except OSError as error:
        raise SemlocError(f"masks {folder}: cannot be written ({error.strerror}); give another --out") from error
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
        write_text(path, yaml.safe_dump(record, sort_keys=False))
    except OSError as error:
        raise SemlocError(f"masks {folder}: cannot be written ({error.strerror}); give another --out") from error


def _make(network: NetworkSegmenter, todo: Sequence[tuple[Frame, str]], folder: Path, num_all: int) -> tuple[int, str]:
    """Make and write masks; returns the number of images that could not be read, and a line for people."""
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
    made = f"made {num_made} masks with {network.backend.name}{each}; {done} were there; {num_failed} failed"
    return num_failed, made


def _image(frame: Frame, camera: str) -> np.ndarray | None:
    """The image; None, with a warning, where it cannot be read: one bad file must not end a long run."""
    try:
        return frame.image(camera)
    except SemlocError as error:
        _LOG.warning("left out: %s", error)
        return None


def _write(mask: np.ndarray, path: Path) -> None:
    """Write a mask so that an interruption leaves no half of it."""
    with writing(path) as partial:
        if not cv2.imwrite(str(partial), mask):
            raise SemlocError(f"mask {path}: cannot be written; is the disk full?")


def _report(paths: Sequence[Path], table: ClassTable, map_path: Path | None) -> str:
    """What looks wrong in the masks, and which classes they show."""
    paths = [path for path in paths if path.is_file()]
    spread = np.unique(np.linspace(0, len(paths) - 1, min(_REPORTED, len(paths))).astype(int)) if paths else []
    masks = [read_mask(paths[i]) for i in spread]
    in_map = None
    if map_path is not None:
        labels = [element.label for element in read_map(map_path).elements if not element.is_logical]
        in_map = {label: labels.count(label) for label in set(labels)}
    problems = [*table.report(masks).problems, *mask_problems(table, masks)]
    lines = [f"warning: {problem}" for problem in problems]
    return "\n".join([*lines, visibility_text(visibility(table, masks), table.name, in_map)])


def _mask_path(folder: Path, camera: str, frame: Frame) -> Path:
    return output_path(folder, camera, frame.id, suffix=".png")


def _batches(items: Sequence, size: int) -> Iterator[Sequence]:
    for start in range(0, len(items), size):
        yield items[start : start + size]
