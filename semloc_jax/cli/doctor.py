"""`semloc doctor`: versions, device and numerical self-tests of this machine (room: cli)."""

import importlib.util
import os
from dataclasses import dataclass

from semloc_jax.cli.main import FAILED, OK
from semloc_jax.errors import install_command
from semloc_jax.runtime import prepare as runtime

MODULES = {"rerun": "viz", "onnxruntime": "onnx", "rosbags": "bags", "pyarrow": "argoverse", "pyogrio": "gis"}
"""Libraries that are not required, and the extra that brings each."""


@dataclass(frozen=True)
class Options:
    """Check this machine: versions, device, cache, and whether compiled code computes what it should.

    The exit code is 1 when a self-test fails.
    """


def run(options: Options) -> int:
    """Print what was found, one line each."""
    from semloc_jax import native

    for name, version in runtime.versions().items():
        print(f"      {name:<24}{version}")
    for module, extra in MODULES.items():
        is_there = importlib.util.find_spec(module) is not None
        state = "installed" if is_there else f"not installed ({install_command(extra)})"
        print(f"      {module:<24}{state}")
    print(f"      {'device':<24}{runtime.device()}")
    print(f"      {'native kernels':<24}{native.status().text}")
    print(f"      {'XLA_FLAGS':<24}{os.environ.get('XLA_FLAGS') or 'not set'}")
    print(
        f"      {'compilation cache':<24}{os.environ.get('JAX_COMPILATION_CACHE_DIR') or 'off: no folder to write to'}"
    )

    from semloc_jax.bench.selftest import run_checks

    checks = run_checks()
    for check in checks:
        print(f"{'ok' if check.is_ok else 'WRONG':<6}{check.name:<40}{check.found}")
    wrong = [check for check in checks if not check.is_ok]
    for check in wrong:
        print(f"to do: {check.remedy}")
    return FAILED if wrong else OK
