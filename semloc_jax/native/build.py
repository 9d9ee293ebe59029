"""Build and load the kernels (room: native; host).

In: C++ sources, the system's compiler. Out: custom calls registered with JAX, or the reason why there are none.
The library is built once for each version of the sources and of jaxlib and each kind of processor, and kept.
"""

import ctypes
import functools
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

SOURCES = Path(__file__).parent / "src"
CALLS = (
    "semloc_normal_equations",
    "semloc_accumulate",
    "semloc_lookup",
    "semloc_pack",
    "semloc_damped_step",
    "semloc_visible_weight",
    "semloc_robust_cost",
)
SWITCH = "SEMLOC_NATIVE"
"""Environment variable; 0 turns the kernels off."""
# The parts of -ffast-math that loops need to be vectorised. The flag itself would make every process that loads the
# library round subnormal numbers to zero, and would take NaN for a number.
_ARITHMETIC = "-fno-math-errno -fno-trapping-math -fno-signed-zeros -fassociative-math -freciprocal-math"
_FLAGS = f"-std=c++17 -O3 -march=native -mprefer-vector-width=512 {_ARITHMETIC} -fPIC -shared -w".split()
_TIMEOUT_S = 120


@dataclass(frozen=True)
class NativeStatus:
    """Whether the kernels are in use, and why not."""

    available: bool
    text: str


def is_available() -> bool:
    """Whether the kernels are built, loaded and registered; the first call builds them if need be."""
    return status().available


def status() -> NativeStatus:
    """Builds, loads and registers the kernels on the first call; never raises."""
    return _loaded()[0]


def library() -> ctypes.CDLL | None:
    """The kernels that are called without XLA; None where there are none."""
    return _loaded()[1]


@functools.cache
def _loaded() -> tuple[NativeStatus, ctypes.CDLL | None]:
    if os.environ.get(SWITCH, "1") == "0":
        return NativeStatus(False, f"off: {SWITCH}=0"), None
    try:
        path, text = _library_file()
        loaded = ctypes.CDLL(str(path))
        _register(loaded)
    except _NotBuilt as reason:
        return NativeStatus(False, str(reason)), None
    except OSError as error:
        return NativeStatus(False, f"not loaded: {error}"), None
    return NativeStatus(True, text), loaded


class _NotBuilt(Exception):
    pass


def _library_file() -> tuple[Path, str]:
    compiler = os.environ.get("CXX") or shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    path = _cache_folder() / f"kernels-{_fingerprint()}.so"
    if path.is_file():
        return path, f"loaded from {path}"
    if compiler is None:
        raise _NotBuilt("not built: no C++ compiler found (Debian: apt-get install g++); pure JAX is used")
    _compile(compiler, path)
    return path, f"built with {compiler}"


def _compile(compiler: str, path: Path) -> None:
    import jax.ffi

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, partial = tempfile.mkstemp(dir=path.parent, suffix=".so")
    except OSError as error:
        raise _NotBuilt(f"not built: cannot write to {path.parent} ({error.strerror})") from error
    os.close(handle)
    command = [compiler, *_FLAGS, f"-I{jax.ffi.include_dir()}", str(SOURCES / "calls.cc"), "-o", partial]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False)
        if done.returncode != 0:
            first = next((line for line in done.stderr.splitlines() if "error" in line), "no message")
            raise _NotBuilt(f"not built: {compiler} failed ({first.strip()})")
        # Renamed when complete: processes that start together never load half a file.
        os.replace(partial, path)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise _NotBuilt(f"not built: {compiler}: {error}") from error
    finally:
        Path(partial).unlink(missing_ok=True)


def _register(library: ctypes.CDLL) -> None:
    import jax

    for name in CALLS:
        jax.ffi.register_ffi_target(name, jax.ffi.pycapsule(getattr(library, name)), platform="cpu")


def _cache_folder() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()) / "semloc_jax" / "native"


def _fingerprint() -> str:
    import jaxlib

    parts = [jaxlib.__version__, " ".join(_FLAGS), platform.machine(), processor()]
    parts += [source.read_text() for source in sorted(SOURCES.iterdir())]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:16]


def processor() -> str:
    """Instruction sets: a home may be shared by machines of several kinds."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith(("flags", "Features"))), "")
