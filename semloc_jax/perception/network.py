"""A segmentation network and all around it: size, letterbox, tiles, normalisation, ids (room: perception; host).

In: an ONNX file and a preset (YAML). Out: class ids uint8[h w] at the size of the image, unshifted.
"""

import dataclasses
import difflib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from jaxtyping import Float

from semloc_jax.errors import SemlocError
from semloc_jax.perception.network_backends import Backend, load_backend


@dataclass(frozen=True)
class NetworkPreset:
    """How images become the input of a network and its output class ids; a YAML file may state any of it.

    Args:
        model: the ONNX file.
        class_table: what the ids mean: a preset or a YAML file.
        width_px, height_px: size of the network's input; 0 for what the file states, else the size of the image.
        letterbox: keep the shape of the image and fill the rest with the mean colour; False stretches it.
        tiles: columns and rows in which the image is cut; more show small things larger.
        overlap: share by which tiles reach into their neighbours, so that no pixel is decided at the border of a tile.
        mean, std: normalisation of the channels in the order of the network, for values 0 ... `value_range`.
        value_range: 1 for networks that take 0 ... 1, 255 for those that take bytes.
        swap_red_blue: the network takes red green blue.
        channels_last: the network takes [b h w 3].
        threshold: score from which a network with one score says 1.
        output: name of the output; several, separated by commas, with `bits`; empty where the file has no other.
        bits: what each output adds to the id where it says 1: networks with one output for each class (TwinLite).
        backend: auto, onnxruntime or opencv.
        batch: images (or tiles) that go in at once.
    """

    model: str = ""
    class_table: str = ""
    width_px: int = 0
    height_px: int = 0
    letterbox: bool = True
    tiles: tuple[int, int] = (1, 1)
    overlap: float = 0.15
    mean: tuple[float, float, float] = (0.485, 0.456, 0.406)
    std: tuple[float, float, float] = (0.229, 0.224, 0.225)
    value_range: float = 1.0
    swap_red_blue: bool = True
    channels_last: bool = False
    threshold: float = 0.5
    output: str = ""
    bits: tuple[int, ...] = ()
    backend: str = "auto"
    batch: int = 1

    def __post_init__(self) -> None:
        sizes = (self.width_px, self.height_px, *self.tiles, self.batch)
        if min(sizes) < 0 or min(*self.tiles, self.batch) < 1 or not 0.0 <= self.overlap < 0.5 or min(self.std) <= 0:
            raise SemlocError(
                f"network preset: size {sizes[:2]}, tiles {self.tiles}, overlap {self.overlap}, std {self.std}, batch "
                f"{self.batch}; expected sizes >= 0, tiles and batch >= 1, overlap below 0.5 and std above 0"
            )


@dataclass(frozen=True)
class _Tile:
    """Part of an image that goes into the network, and the part of it whose mask is used; left, top, right, bottom."""

    seen: tuple[int, int, int, int]
    kept: tuple[int, int, int, int]


def load_network_preset(path: str | Path) -> NetworkPreset:
    """The preset of a YAML file; a relative `model` or `class_table` file is looked for beside it.

    Raises:
        SemlocError: the file is missing, has an unknown key or a value of another kind.
    """
    path = Path(path)
    where = f"network preset {path}"
    if not path.is_file():
        raise SemlocError(f"{where}: no such file; expected YAML with the keys model, class_table, width_px ...")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError, ValueError, RecursionError) as error:
        raise SemlocError(f"{where}: not readable as YAML; check the file") from error
    if not isinstance(content, dict):
        raise SemlocError(f"{where}: holds no keys; expected model, class_table, width_px ...")
    defaults = {field.name: field.default for field in dataclasses.fields(NetworkPreset)}
    values = {key: _value(key, given, defaults, where) for key, given in content.items()}
    for key in ("model", "class_table"):
        beside = path.parent / str(values.get(key, ""))
        if values.get(key) and beside.is_file():
            values[key] = str(beside)
    return NetworkPreset(**values)


class NetworkSegmenter:
    """Class ids of images by a network in an ONNX file."""

    def __init__(self, preset: NetworkPreset) -> None:
        """Load a network.

        Raises:
            SemlocError: no model is named, or it cannot be read.
        """
        if not preset.model:
            raise SemlocError("network preset: names no model; expected the path of an ONNX file")
        self.preset = preset
        self.backend: Backend = load_backend(
            preset.model, preset.backend, preset.output, preset.channels_last, len(preset.bits) or 1
        )
        stated, given = self.backend.input_size_px, (preset.width_px, preset.height_px)
        if stated is not None and min(given) > 0 and given != stated:
            raise SemlocError(
                f"network {preset.model}: takes {stated[0]}x{stated[1]} px, {given[0]}x{given[1]} are asked"
            )
        self.size_px = given if min(given) > 0 else stated
        self.batch = self.backend.batch or preset.batch

    def __call__(self, image: np.ndarray, frame_id: str = "") -> np.ndarray:
        """Class ids uint8[h w] of an image uint8[h w 3] (BGR).

        Raises:
            SemlocError: the network fails on it.
        """
        return self.segment([image])[0]

    def segment(self, images: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Class ids of several images, which go through the network in batches of tiles.

        Raises:
            SemlocError: the network fails, or returns neither scores nor ids.
        """
        masks = [np.zeros(image.shape[:2], np.uint8) for image in images]
        jobs = [(index, tile) for index, image in enumerate(images) for tile in _tiles(image, self.preset)]
        for chunk in _chunks(jobs, self.batch):
            for (index, tile), ids in zip(chunk, self._segment_tiles(images, chunk), strict=True):
                left, top, right, bottom = tile.kept
                x, y = left - tile.seen[0], top - tile.seen[1]
                masks[index][top:bottom, left:right] = ids[y : y + bottom - top, x : x + right - left]
        return masks

    def scores(self, image: np.ndarray, size_px: tuple[int, int]) -> Float[np.ndarray, "h w n"]:
        """Shares of the classes at every pixel of an image that is scaled to `size_px`, in one piece, 0 ... 1.

        Args:
            image: uint8[h w 3] (BGR).
            size_px: (width, height) of what comes out.

        Raises:
            SemlocError: the network fails on it, or gives ids in place of scores.
        """
        blob, move = self._blob(image, self.size_px or image.shape[1::-1])
        batch = np.stack([blob] * (self.backend.batch or 1))
        (output, *_) = self.backend.run(batch.transpose(0, 2, 3, 1) if self.preset.channels_last else batch)
        if output.ndim != 4 or np.issubdtype(output.dtype, np.integer):
            raise SemlocError(
                f"network {self.preset.model}: gives {output.dtype}{list(output.shape)}; expected scores "
                "[b classes h w]; name their output (--output), or export it without the best class chosen inside"
            )
        raw = (output.transpose(0, 3, 1, 2) if self.preset.channels_last else output)[0].astype(np.float32)
        shares = np.exp(raw - raw.max(axis=0)) if len(raw) > 1 else np.clip(raw, 0.0, 1.0)
        shares = shares / shares.sum(axis=0) if len(raw) > 1 else shares
        to_image = _to_output(raw.shape[1:], blob.shape[:0:-1], move)
        at_size = np.array([image.shape[1] / size_px[0], image.shape[0] / size_px[1]])
        to_output = to_image @ np.array(
            [[at_size[0], 0.0, 0.5 * at_size[0] - 0.5], [0.0, at_size[1], 0.5 * at_size[1] - 0.5], [0.0, 0.0, 1.0]]
        )
        return np.stack([_warped(plane, to_output, size_px) for plane in shares], axis=-1)

    def _segment_tiles(self, images: Sequence[np.ndarray], chunk: list[tuple[int, _Tile]]) -> list[np.ndarray]:
        """Class ids of each tile; where the network takes any size, those of one size go together."""
        parts = [_cut(images[index], tile.seen) for index, tile in chunk]
        sizes = [self.size_px or part.shape[1::-1] for part in parts]
        found: dict[int, np.ndarray] = {}
        for size in dict.fromkeys(sizes):
            members = [i for i, other in enumerate(sizes) if other == size]
            found |= dict(zip(members, self._run([parts[i] for i in members], size), strict=True))
        return [found[i] for i in range(len(parts))]

    def _run(self, parts: Sequence[np.ndarray], size_px: tuple[int, int]) -> list[np.ndarray]:
        """Class ids of each part, at its size."""
        blobs, moves = zip(*(self._blob(part, size_px) for part in parts), strict=True)
        missing = self.batch - len(blobs) if self.backend.batch else 0
        batch = np.stack([*blobs, *[blobs[-1]] * missing])
        outputs = self.backend.run(batch.transpose(0, 2, 3, 1) if self.preset.channels_last else batch)
        found = [self._ids(output, parts, size_px, moves, len(batch)) for output in outputs]
        if not self.preset.bits:
            return found[0]
        pairs = [list(zip(self.preset.bits, layers, strict=True)) for layers in zip(*found, strict=True)]
        return [sum(np.uint8(bit) * (ids == 1) for bit, ids in layers).astype(np.uint8) for layers in pairs]

    def _ids(
        self, output: np.ndarray, parts: Sequence[np.ndarray], size_px: tuple[int, int], moves: Sequence, num: int
    ) -> list[np.ndarray]:
        """Class ids of each part from one output of the network."""
        if output.shape[:1] != (num,) or output.ndim not in (3, 4):
            raise SemlocError(
                f"network {self.preset.model}: returned {list(output.shape)} for {num} images; expected scores "
                "[b classes h w] or ids [b h w]; name the right --output, or `output` in the preset"
            )
        if output.ndim == 4 and self.preset.channels_last:
            output = output.transpose(0, 3, 1, 2)
        if output.ndim == 4 and output.shape[1] == 1 and np.issubdtype(output.dtype, np.integer):
            output = output[:, 0]  # the best class was chosen inside: whole numbers are no scores
        return [
            ids_at_image(output[i], parts[i].shape[1::-1], size_px, moves[i], self.preset.threshold)
            for i in range(len(parts))
        ]

    def _blob(self, part: np.ndarray, size_px: tuple[int, int]) -> tuple[np.ndarray, tuple[float, float, float, float]]:
        """Network input float32[3 h w] of a part, and scale and shift from its pixels to those of the input."""
        (width, height), (w, h) = size_px, part.shape[1::-1]
        sx, sy = width / w, height / h
        if self.preset.letterbox:
            sx = sy = min(sx, sy)
        inner = (min(max(round(w * sx), 1), width), min(max(round(h * sy), 1), height))
        left, top = (width - inner[0]) // 2, (height - inner[1]) // 2
        is_smaller = inner[0] < w or inner[1] < h
        scaled = cv2.resize(part, inner, interpolation=cv2.INTER_AREA if is_smaller else cv2.INTER_LINEAR)
        scaled = (scaled[..., ::-1] if self.preset.swap_red_blue else scaled).astype(np.float32)
        canvas = np.zeros((height, width, 3), np.float32)  # zero is the mean colour after normalisation
        values = scaled * np.float32(self.preset.value_range / 255.0)
        canvas[top : top + inner[1], left : left + inner[0]] = (values - np.float32(self.preset.mean)) / np.float32(
            self.preset.std
        )
        return canvas.transpose(2, 0, 1), (inner[0] / w, inner[1] / h, float(left), float(top))


def ids_at_image(
    output: np.ndarray,
    image_px: tuple[int, int],
    input_px: tuple[int, int],
    move: tuple[float, float, float, float],
    threshold: float = 0.5,
) -> np.ndarray:
    """Class ids uint8[h w] at the pixels of an image from what the network returned for it.

    Scores are interpolated where the image's pixels lie in them and the best class is chosen there: ids resized by
    themselves would be blocky, and every resizing that forgets half a pixel would shift them.

    Args:
        output: scores [classes h w] (one class: score against `threshold`) or ids [h w].
        image_px: (width, height) of the image.
        input_px: (width, height) of the network's input.
        move: scale x, scale y, left, top: pixel (u, v) of the image is at (u + 0.5) scale + left - 0.5 of the input.
        threshold: for a single class.
    """
    to_output = _to_output(output.shape[-2:], input_px, move)
    if output.ndim == 2:
        flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
        ids = np.clip(np.round(output), 0, 255).astype(np.uint8)
        return cv2.warpAffine(ids, to_output, image_px, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    if not 1 <= len(output) <= 256:
        raise SemlocError(f"network: returned {len(output)} classes; expected 1 to 256")
    best = _warped(output[0], to_output, image_px)
    if len(output) == 1:
        return (best >= threshold).astype(np.uint8)
    ids = np.zeros(best.shape, np.uint8)
    for index in range(1, len(output)):
        plane = _warped(output[index], to_output, image_px)
        better = plane > best
        ids[better], best[better] = index, plane[better]
    return ids


def _to_output(
    shape: tuple[int, ...], input_px: tuple[int, int], move: tuple[float, float, float, float]
) -> Float[np.ndarray, "2 3"]:
    """Where pixels of the image are in what a network returned, [rows columns], for its input of `input_px`."""
    kx, ky = shape[1] / input_px[0], shape[0] / input_px[1]
    sx, sy, left, top = move
    return np.array([[sx * kx, 0.0, (0.5 * sx + left) * kx - 0.5], [0.0, sy * ky, (0.5 * sy + top) * ky - 0.5]])


def _warped(plane: np.ndarray, to_plane: np.ndarray, size_px: tuple[int, int]) -> np.ndarray:
    """A plane of scores at other pixels, bilinear."""
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    plane = np.ascontiguousarray(plane, dtype=np.float32)
    return cv2.warpAffine(plane, to_plane, size_px, flags=flags, borderMode=cv2.BORDER_REPLICATE)


def _tiles(image: np.ndarray, preset: NetworkPreset) -> Iterator[_Tile]:
    """Tiles whose kept parts cover the image once."""
    height, width = image.shape[:2]
    columns, rows = min(preset.tiles[0], width), min(preset.tiles[1], height)
    xs, ys = np.linspace(0, width, columns + 1).astype(int), np.linspace(0, height, rows + 1).astype(int)
    reach_x = round(preset.overlap * width / columns) if columns > 1 else 0
    reach_y = round(preset.overlap * height / rows) if rows > 1 else 0
    # Every tile has one size, so that they fit one batch: those at the border reach further inside.
    size_x = min(int(np.diff(xs).max()) + 2 * reach_x, width)
    size_y = min(int(np.diff(ys).max()) + 2 * reach_y, height)
    for y0, y1 in zip(ys[:-1].tolist(), ys[1:].tolist(), strict=True):
        for x0, x1 in zip(xs[:-1].tolist(), xs[1:].tolist(), strict=True):
            left = min(max(x0 - reach_x, 0), width - size_x)
            top = min(max(y0 - reach_y, 0), height - size_y)
            yield _Tile((left, top, left + size_x, top + size_y), (x0, y0, x1, y1))


def _cut(image: np.ndarray, box: tuple[int, int, int, int]) -> np.ndarray:
    left, top, right, bottom = box
    return image[top:bottom, left:right]


def _chunks(items: list, size: int) -> Iterator[list]:
    for start in range(0, len(items), size):
        yield items[start : start + size]


def _value(key: Any, given: Any, defaults: dict[str, Any], where: str) -> Any:
    """A value of the kind of its default."""
    if key not in defaults:
        close = difflib.get_close_matches(str(key), list(defaults), n=1)
        hint = f"; did you mean '{close[0]}'?" if close else ""
        raise SemlocError(f"{where}: unknown key '{key}'{hint}; keys: {', '.join(defaults)}")
    default = defaults[key]
    try:
        if isinstance(default, tuple):
            values = tuple((type(default[0]) if default else int)(item) for item in given)
            if default and len(values) != len(default):
                raise ValueError(f"{len(values)} values")
            return values
        if isinstance(default, bool) != isinstance(given, bool) or isinstance(default, str) != isinstance(given, str):
            raise ValueError(f"a {type(given).__name__}")
        return type(default)(given)
    except (TypeError, ValueError, OverflowError) as error:
        raise SemlocError(f"{where}: {key} is {given!r} ({error}); expected something like {default!r}") from error
