"""What runs an ONNX file: onnxruntime where it is installed, else OpenCV (room: perception; host).

In: the file, batches float32[b 3 h w] or [b h w 3]. Out: the network's output array.
"""

import importlib.util
from pathlib import Path
from typing import Protocol, runtime_checkable

import cv2
import numpy as np

from semloc_jax.errors import SemlocError

BACKENDS = ("auto", "onnxruntime", "opencv")


@runtime_checkable
class Backend(Protocol):
    """A network that is loaded."""

    name: str
    input_size_px: tuple[int, int] | None
    """(width, height) that the file states, None where it is free."""
    batch: int | None
    """Number of images that the file states, None where it is free or unknown."""

    def run(self, blob: np.ndarray) -> np.ndarray:
        """Output of a batch."""
        ...


def load_backend(path: str | Path, name: str = "auto", output: str = "", channels_last: bool = False) -> Backend:
    """The network of a file.

    Args:
        path: ONNX file.
        name: auto, onnxruntime or opencv.
        output: name of the output that holds the classes; empty for the first.
        channels_last: the network takes [b h w 3].

    Raises:
        SemlocError: the file is missing or no network, or the library is not installed.
    """
    path = Path(path)
    if name not in BACKENDS:
        raise SemlocError(f"backend '{name}': unknown; expected one of {', '.join(BACKENDS)}")
    if not path.is_file():
        raise SemlocError(f"network {path}: no such file; expected a segmentation network in ONNX format")
    has_runtime = importlib.util.find_spec("onnxruntime") is not None
    if name == "onnxruntime" and not has_runtime:
        raise SemlocError('backend onnxruntime: not installed; pip install "semloc-jax[onnx]", or --backend opencv')
    if name == "opencv" or not has_runtime:
        return _OpenCv(path, output)
    return _OnnxRuntime(path, output, channels_last)


class _OpenCv:
    name = "opencv"
    input_size_px: tuple[int, int] | None = None
    batch: int | None = None

    def __init__(self, path: Path, output: str) -> None:
        self._path, self._output = path, output
        try:
            self._network = cv2.dnn.readNetFromONNX(str(path))
        except cv2.error as error:
            raise SemlocError(
                f"network {path}: OpenCV cannot read it ({_last_line(error)}); pip install "
                '"semloc-jax[onnx]", or export it with a lower opset'
            ) from None

    def run(self, blob: np.ndarray) -> np.ndarray:
        try:
            self._network.setInput(np.ascontiguousarray(blob))
            return np.asarray(self._network.forward(self._output) if self._output else self._network.forward())
        except cv2.error as error:
            raise _failed(self._path, blob, _last_line(error)) from None


class _OnnxRuntime:
    name = "onnxruntime"

    def __init__(self, path: Path, output: str, channels_last: bool) -> None:
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
        outputs = [item.name for item in self._session.get_outputs()]
        if output and output not in outputs:
            raise SemlocError(f"network {path}: no output '{output}'; expected one of {', '.join(outputs)}")
        if "float" not in first.type or len(first.shape) != 4:
            raise SemlocError(f"network {path}: takes {first.type} {first.shape}; expected one float image [b 3 h w]")
        self._input, self._outputs = first.name, [output or outputs[0]]
        self._dtype = np.float16 if "float16" in first.type else np.float32
        height, width = first.shape[1:3] if channels_last else first.shape[2:4]
        is_fixed = isinstance(height, int) and isinstance(width, int)
        self.input_size_px = (width, height) if is_fixed else None
        self.batch = first.shape[0] if isinstance(first.shape[0], int) else None

    def run(self, blob: np.ndarray) -> np.ndarray:
        try:
            (result,) = self._session.run(self._outputs, {self._input: blob.astype(self._dtype)})
        except Exception as error:
            raise _failed(self._path, blob, _last_line(error)) from None
        return np.asarray(result)


def _failed(path: Path, blob: np.ndarray, reason: str) -> SemlocError:
    return SemlocError(
        f"network {path}: fails on an input {list(blob.shape)} ({reason}); give --size as it was trained"
    )


def _last_line(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return lines[-1][:160] if lines else type(error).__name__
