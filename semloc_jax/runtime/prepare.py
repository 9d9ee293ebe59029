"""What has to be set before JAX is imported, and what JAX then runs on (room: runtime).

In: the environment and the processor. Out: XLA flags, a compilation cache, versions and device as text.
"""

import os
import platform
import sys
from pathlib import Path

from semloc_jax.storage.sealed import home_folder, others_can_write, private_folder

WIDTH_FLAG = "--xla_cpu_prefer_vector_width"
LIBRARIES = (
    "semloc-jax",
    "jax",
    "jaxlib",
    "equinox",
    "optimistix",
    "lineax",
    "jaxlie",
    "numpy",
    "scipy",
    "opencv-python-headless",
    "shapely",
)


def prepare_jax() -> None:
    """Set the environment for JAX: wide vectors where the processor has them, and a compilation cache.

    Whatever the user has set stays as it is, but for a cache that other users can write to: what JAX loads from it
    runs. Does nothing once JAX is loaded, which reads these only then.
    """
    if "jax" in sys.modules:
        return
    flags = os.environ.get("XLA_FLAGS", "")
    if WIDTH_FLAG not in flags and "avx512f" in cpu_features():
        os.environ["XLA_FLAGS"] = f"{flags} {WIDTH_FLAG}=512".strip()
    given = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    if given and others_can_write(Path(given)):
        print(
            f"JAX_COMPILATION_CACHE_DIR {given}: other users can write to it, and compiled programs are code; "
            f"{cache_folder()} is used instead",
            file=sys.stderr,
        )
        del os.environ["JAX_COMPILATION_CACHE_DIR"]
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        folder = cache_folder()
        if private_folder(folder) and is_writable(folder):
            os.environ["JAX_COMPILATION_CACHE_DIR"] = str(folder)
            os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0.2")
    # Loading a cached program logs, as an error, that pseudo features (prefer-no-gather) are missing on the very
    # machine that compiled it. Each kind of processor has its own folder, so a true mismatch cannot occur.
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")


def cpu_features() -> frozenset[str]:
    """Instruction sets of the processor, empty where the system does not tell."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return frozenset()
    for line in text.splitlines():
        if line.startswith(("flags", "Features")):
            return frozenset(line.split(":", 1)[1].split())
    return frozenset()


def cache_folder() -> Path:
    """Folder of compiled programs: one for each kind of processor, since a home may be shared by several."""
    import hashlib

    kind = f"{platform.machine()} {' '.join(sorted(cpu_features()))}"
    return home_folder() / f"jax-{hashlib.sha256(kind.encode()).hexdigest()[:12]}"


def is_writable(folder: Path) -> bool:
    """Whether files can be written to the folder, which is made if need be."""
    import tempfile

    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def versions() -> dict[str, str]:
    """Versions of Python, of this package and of the libraries that numbers depend on."""
    import importlib.metadata

    found = {"python": platform.python_version()}
    for name in LIBRARIES:
        try:
            found[name] = importlib.metadata.version(name)
        except importlib.metadata.PackageNotFoundError:
            found[name] = "missing"
    return found


def device() -> str:
    """What JAX computes on, e.g. `cpu (2 cores)` or `gpu NVIDIA H200`."""
    import jax

    first = jax.devices()[0]
    return f"cpu ({os.cpu_count()} cores)" if first.platform == "cpu" else f"{first.platform} {first.device_kind}"
