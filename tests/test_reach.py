"""Every module of the package is reached by a verb or a public name; what is not, is deleted or waits with a reason."""

import re

import semloc_jax
from semloc_jax.bench.peer import PEERS
from semloc_jax.cli.main import VERBS
from tests.test_architecture import _all_imports, _files, _module_name

WAITING = {
    "semloc_jax.residuals.preintegration": "the inertial window of visual-inertial odometry will use it",
    "semloc_jax.solvers.gnc": "loop closures of a map that is built may be wrong; graphs of today have none",
}
"""Modules that nobody uses yet, with their reason."""
_BY_NAME = re.compile(r'"(semloc_jax(?:\.\w+)+)"')
"""A module that is loaded by its name."""


def _doors() -> set[str]:
    """Modules that a user reaches by a word: verbs, public names, peers of the benchmark."""
    rooms = [*(f"cli.{verb.replace('-', '_')}" for verb in VERBS), *semloc_jax._ROOMS]
    peers = [f"bench.{peer.module}" for peer in PEERS]
    return {"semloc_jax", "semloc_jax.cli.main", *(f"semloc_jax.{name}" for name in (*rooms, *peers))}


def unreached(doors: set[str]) -> set[str]:
    """Modules that no chain of imports from a door leads to; pages of a room (`__init__`) do not count."""
    sources = {_module_name(path): path for path in _files()}
    edges: dict[str, set[str]] = {name: set() for name in sources}
    for item in _all_imports():
        edges[item.module].add(item.target)
    for name, path in sources.items():
        edges[name].update(_BY_NAME.findall(path.read_text(encoding="utf-8")))
    seen, ahead = set(), list(doors)
    while ahead:
        name = ahead.pop()
        if name in sources and name not in seen:
            seen.add(name)
            ahead.extend(edges[name])
    return {name for name, path in sources.items() if name not in seen and path.name != "__init__.py"}


def test_every_module_is_reached():
    forgotten = unreached(_doors()) - set(WAITING)
    assert not forgotten, f"no verb and no public name leads to {sorted(forgotten)}; use them or delete them"


def test_what_waits_is_not_in_use():
    """An entry goes when its module is used."""
    assert set(WAITING) <= unreached(_doors())


def test_a_door_less_leaves_its_module_out():
    assert "semloc_jax.cli.doctor" in unreached(_doors() - {"semloc_jax.cli.doctor"})
