"""Where masks come from: files, a network, a function, or no network at all (room: perception; host).

In: images (BGR) and frame ids. Out: class ids, uint8[h w].
"""

import difflib
from collections.abc import Callable
from pathlib import Path
from typing import Protocol, runtime_checkable

import cv2
import numpy as np

from semloc_jax.cameras import Camera
from semloc_jax.errors import SemlocError
from semloc_jax.perception.classical_paint import ClassicalPaintSegmenter
from semloc_jax.perception.masks import read_mask

_KINDS = ("paint", "masks:FOLDER", "MODEL.onnx")


@runtime_checkable
class Segmenter(Protocol):
    """Class ids of an image."""

    def __call__(self, image: np.ndarray, frame_id: str = "") -> np.ndarray:
        """Class ids uint8[h w] of an image uint8[h w 3] (BGR); `frame_id` is what files are named after."""
        ...


class MaskFolder:
    """Masks that lie in a folder as FRAME_ID.png, made beforehand by any network."""

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)
        if not self.folder.is_dir():
            raise SemlocError(f"masks {self.folder}: no such folder; expected single-channel PNG files named by frame")

    def __call__(self, image: np.ndarray | None = None, frame_id: str = "") -> np.ndarray:
        """The mask of a frame; the image, where given, must have its size.

        Raises:
            SemlocError: there is no mask of that frame, or it is not a mask of that size.
        """
        path = self.folder / f"{frame_id}.png"
        if not path.is_file():
            names = self.frame_ids()
            hint = f"; there are {len(names)}, {names[0]} ... {names[-1]}" if names else "; the folder holds no PNG"
            raise SemlocError(f"masks {self.folder}: no mask of frame '{frame_id}'{hint}")
        return read_mask(path, None if image is None else (image.shape[1], image.shape[0]))

    def frame_ids(self) -> list[str]:
        """Frames that have a mask, sorted."""
        return sorted(path.stem for path in self.folder.glob("*.png"))


class CallableSegmenter:
    """Any function image (BGR) -> class ids, with its output checked."""

    def __init__(self, function: Callable[[np.ndarray], np.ndarray]) -> None:
        self.function = function

    def __call__(self, image: np.ndarray, frame_id: str = "") -> np.ndarray:
        """Class ids of an image.

        Raises:
            SemlocError: the function returned no integers 0...255 of the size of the image.
        """
        ids = np.asarray(self.function(image))
        if ids.shape != image.shape[:2]:
            raise SemlocError(f"segmenter: the function returned shape {ids.shape}, expected {image.shape[:2]}")
        if not np.issubdtype(ids.dtype, np.integer) or ids.min() < 0 or ids.max() > 255:
            raise SemlocError(f"segmenter: the function returned {ids.dtype}, expected integer ids 0...255")
        return ids.astype(np.uint8)


class OnnxSegmenter:
    """A segmentation network in an ONNX file, run by OpenCV on the CPU."""

    def __init__(
        self,
        path: str | Path,
        size_px: tuple[int, int] | None = None,
        mean: tuple[float, float, float] = (0.485, 0.456, 0.406),
        std: tuple[float, float, float] = (0.229, 0.224, 0.225),
        swap_red_blue: bool = True,
        threshold: float = 0.5,
    ) -> None:
        """A network image -> scores [1 classes h w] or ids [1 h w].

        Args:
            path: the ONNX file.
            size_px: (width, height) that the network takes, None for the size of the image.
            mean, std: normalisation of the channels in the order of the network, for values 0...1.
            swap_red_blue: True if the network takes RGB.
            threshold: score from which a network with one score channel says 1.

        Raises:
            SemlocError: the file is missing or no network that OpenCV can read.
        """
        path = Path(path)
        if not path.is_file():
            raise SemlocError(f"network {path}: no such file; expected a segmentation network in ONNX format")
        try:
            self.network = cv2.dnn.readNetFromONNX(str(path))
        except cv2.error as error:
            reason = str(error).strip().splitlines()[-1]
            raise SemlocError(
                f"network {path}: OpenCV cannot read it ({reason}); export it with a lower opset"
            ) from None
        self.path, self.size_px, self.threshold = path, size_px, threshold
        self.mean, self.std = np.asarray(mean, np.float32), np.asarray(std, np.float32)
        self.swap_red_blue = swap_red_blue

    def __call__(self, image: np.ndarray, frame_id: str = "") -> np.ndarray:
        """Class ids of an image; scores are brought to its size before the best class is chosen.

        Raises:
            SemlocError: the network fails on this size or returns neither scores nor ids.
        """
        size = self.size_px or (image.shape[1], image.shape[0])
        scaled = image if size == image.shape[1::-1] else cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        scaled = scaled[..., ::-1] if self.swap_red_blue else scaled
        blob = ((scaled.astype(np.float32) / 255.0 - self.mean) / self.std).transpose(2, 0, 1)[None]
        try:
            self.network.setInput(np.ascontiguousarray(blob))
            output = np.asarray(self.network.forward())
        except cv2.error as error:
            reason = str(error).strip().splitlines()[-1]
            raise SemlocError(f"network {self.path}: fails on {size[0]}x{size[1]} px ({reason}); set size_px") from None
        return ids_from_output(output, (image.shape[1], image.shape[0]), self.threshold)


def ids_from_output(output: np.ndarray, size_px: tuple[int, int], threshold: float = 0.5) -> np.ndarray:
    """Class ids uint8[h w] from what a network returns.

    Args:
        output: scores [1 classes h w] (one class: score of 1 against `threshold`) or ids [1 h w] or [h w].
        size_px: (width, height) of the image.
        threshold: for a single class.

    Raises:
        SemlocError: the output has another shape.
    """
    if output.ndim == 4 and output.shape[0] == 1 and 1 <= output.shape[1] <= 256:
        # Smooth scores before the choice: ids resized by themselves would be blocky and shifted.
        scores = [cv2.resize(score.astype(np.float32), size_px, interpolation=cv2.INTER_LINEAR) for score in output[0]]
        if len(scores) == 1:
            return (scores[0] >= threshold).astype(np.uint8)
        return np.argmax(np.stack(scores), axis=0).astype(np.uint8)
    ids = output[0] if output.ndim == 3 and output.shape[0] == 1 else output
    if ids.ndim != 2:
        raise SemlocError(
            f"network: returned shape {list(output.shape)}, expected scores [1 classes h w] or ids [1 h w]"
        )
    return cv2.resize(np.round(ids).astype(np.uint8), size_px, interpolation=cv2.INTER_NEAREST_EXACT)


def get_segmenter(name: str, camera: Camera | None = None, T_base_cam: np.ndarray | None = None) -> Segmenter:
    """The segmenter of a name: 'paint' (no network), 'masks:FOLDER' or a folder, or the path of an ONNX file.

    Args:
        name: what the user gave.
        camera: the camera of the images, for 'paint'.
        T_base_cam: its pose above the road, for 'paint'.

    Raises:
        SemlocError: the name is none of these.
    """
    if name == "paint":
        return ClassicalPaintSegmenter(camera, T_base_cam)
    if name.startswith("masks:") or Path(name).is_dir():
        return MaskFolder(name.removeprefix("masks:"))
    if name.endswith(".onnx"):
        return OnnxSegmenter(name)
    close = difflib.get_close_matches(name, ["paint"], n=1)
    hint = f"; did you mean '{close[0]}'?" if close else ""
    raise SemlocError(f"segmenter '{name}': unknown{hint}; expected one of {', '.join(_KINDS)}")
