"""How much effort the compiler takes in the processes of the tests. Imports no JAX: its flags are read once."""

import os

_LITTLE = (
    "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
)
"""Compiles in a third to a half of the time that the effort for users takes; what it compiles runs half as fast. Each
of the parts that LLVM compiles side by side costs, and the other cores have test processes of their own."""


def is_little() -> bool:
    """Whether the tests of this process compile quickly."""
    return os.environ.get("SEMLOC_LITTLE_EFFORT", "1") != "0"


def take_little_effort() -> None:
    """Compile quickly in this process and in those it starts, unless SEMLOC_LITTLE_EFFORT=0.

    Most programs of the tests run once or twice, so that compiling them is most of what the tests cost. The
    quickstart and the slow notebooks (see `environment_of_users`) and the slow tests of `.ci/run` run what is compiled
    as it is for users.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    if is_little() and _LITTLE not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {_LITTLE}".strip()


def environment_of_users() -> dict[str, str]:
    """The environment of a process in which programs are compiled as they are for users."""
    flags = os.environ.get("XLA_FLAGS", "").replace(_LITTLE, "")
    return os.environ | {"XLA_FLAGS": " ".join(flags.split())}
