"""What runs an ONNX file: onnxruntime where it is installed, else OpenCV (room: perception; host).

In: the file, batches float32[b 3 h w] or [b h w 3]. Out: the network's output array.
"""

import importlib.util
from pathlib import Path
from typing import Protocol, runtime_checkable

import cv2
import numpy as np

from semloc_jax.errors import SemlocError, install_command
from semloc_jax.perception.onnx_header import OnnxHeader, read_onnx_header

BACKENDS = ("auto", "onnxruntime", "opencv")


@runtime_checkable
class Backend(Protocol):
    """A network that is loaded."""

    name: str
    input_size_px: tuple[int, int] | None
    """(width, height) that the file states, None where it is free."""
    batch: int | None
    """Number of images that the file states, None where it is free or unknown."""

    def run(self, blob: np.ndarray) -> list[np.ndarray]:
        """Outputs of a batch: those that were asked for, in that order."""
        ...


def load_backend(
    path: str | Path, name: str = "auto", output: str = "", channels_last: bool = False, num_outputs: int = 1
) -> Backend:
    """The network of a file.

    Args:
        path: ONNX file.
        name: auto, onnxruntime or opencv.
        output: name of the output that holds the classes, or several separated by commas; empty for all that there
            are.
        channels_last: the network takes [b h w 3].
        num_outputs: how many outputs are wanted.

    Raises:
        SemlocError: the file is missing or no network, the library is not installed, or the network has other outputs.
    """
    path = Path(path)
    if name not in BACKENDS:
        raise SemlocError(f"backend '{name}': unknown; expected one of {', '.join(BACKENDS)}")
    if not path.is_file():
        raise SemlocError(f"network {path}: no such file; expected a segmentation network in ONNX format")
    has_runtime = importlib.util.find_spec("onnxruntime") is not None
    if name == "onnxruntime" and not has_runtime:
        raise SemlocError(
            f"backend onnxruntime: not installed; run: {install_command('onnx')}, or give --backend opencv"
        )
    header = read_onnx_header(path)
    outputs = _outputs(path, header, output, num_outputs)
    if name == "opencv" or not has_runtime:
        return _OpenCv(path, outputs, header, channels_last)
    return _OnnxRuntime(path, outputs, channels_last)


def _outputs(path: Path, header: OnnxHeader | None, output: str, wanted: int) -> list[str]:
    """The names of the outputs to take; empty where the file does not tell any."""
    known = [port.name for port in header.outputs] if header is not None else []
    chosen = [name.strip() for name in output.split(",") if name.strip()]
    wrong = [name for name in chosen if known and name not in known]
    if wrong:
        raise SemlocError(f"network {path}: no output '{wrong[0]}'; expected one of {', '.join(known)}")
    chosen = chosen or known
    if chosen and len(chosen) != wanted:
        raise SemlocError(
            f"network {path}: has {len(chosen)} outputs ({', '.join(chosen)}), {wanted} expected; name what holds the "
            "classes: --output NAME, or 'output:' in a preset"
        )
    return chosen


class _OpenCv:
    name = "opencv"

    def __init__(self, path: Path, outputs: list[str], header: OnnxHeader | None, channels_last: bool) -> None:
        self._path, self._outputs = path, outputs
        shape = header.inputs[0].shape if header is not None and header.inputs else ()
        self.input_size_px, self.batch = _stated(shape, channels_last) if len(shape) == 4 else (None, None)
        try:
            self._network = cv2.dnn.readNetFromONNX(str(path))
        except cv2.error as error:
            raise SemlocError(
                f"network {path}: OpenCV cannot read it ({_last_line(error)}); run: {install_command('onnx')}, or "
                "export it with a lower opset"
            ) from None

    def run(self, blob: np.ndarray) -> list[np.ndarray]:
        try:
            self._network.setInput(np.ascontiguousarray(blob))
            if len(self._outputs) < 2:  # OpenCV gives layers names of its own: the last one is the output
                return [np.asarray(self._network.forward())]
            return [np.asarray(result) for result in self._network.forward(self._outputs)]
        except cv2.error as error:
            raise _failed(self._path, blob, _last_line(error)) from None


class _OnnxRuntime:
    name = "onnxruntime"

    def __init__(self, path: Path, outputs: list[str], channels_last: bool) -> None:
        import onnxruntime

        self._path = path
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3
        try:
            self._session = onnxruntime.InferenceSession(
                str(path), options, providers=onnxruntime.get_available_providers()
            )
        except Exception as error:  # the runtime raises types of its own without a common base
            raise SemlocError(
                f"network {path}: onnxruntime cannot read it ({_last_line(error)}); export it again"
            ) from None
        first = self._session.get_inputs()[0]
        if "float" not in first.type or len(first.shape) != 4:
            raise SemlocError(f"network {path}: takes {first.type} {first.shape}; expected one float image [b 3 h w]")
        self._input, self._outputs = first.name, outputs or [self._session.get_outputs()[0].name]
        self._dtype = np.float16 if "float16" in first.type else np.float32
        self.input_size_px, self.batch = _stated(tuple(first.shape), channels_last)

    def run(self, blob: np.ndarray) -> list[np.ndarray]:
        try:
            results = self._session.run(self._outputs, {self._input: blob.astype(self._dtype)})
        except Exception as error:
            raise _failed(self._path, blob, _last_line(error)) from None
        return [np.asarray(result) for result in results]


def _stated(shape: tuple, channels_last: bool) -> tuple[tuple[int, int] | None, int | None]:
    """Width and height, and number of images, that a file states; None where it leaves them open."""
    height, width = shape[1:3] if channels_last else shape[2:4]
    is_fixed = isinstance(height, int) and isinstance(width, int)
    return (width, height) if is_fixed else None, shape[0] if isinstance(shape[0], int) else None


def _failed(path: Path, blob: np.ndarray, reason: str) -> SemlocError:
    return SemlocError(
        f"network {path}: fails on an input {list(blob.shape)} ({reason}); give --size as it was trained"
    )


def _last_line(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return lines[-1][:160] if lines else type(error).__name__
