"""Every module of the package is reached by a verb or a public name; what is not, is deleted or waits with a reason."""

import ast
import re
from collections import defaultdict
from functools import cache

import pytest

import semloc_jax
from semloc_jax.bench.peer import PEERS
from semloc_jax.cli.main import TEACHING, VERBS
from tests.test_architecture import PACKAGE, _all_imports, _files, _module_name

WAITING: dict[str, str] = {}
"""Modules that nobody uses yet, with their reason."""
_BY_NAME = re.compile(r'"(semloc_jax(?:\.\w+)+)"')
"""A module that is loaded by its name."""


def _doors() -> set[str]:
    """Modules that a user reaches by a word: verbs, public names, peers of the benchmark."""
    verbs = (*VERBS, *("_".join(words) for words in TEACHING))
    rooms = [*(f"cli.{verb.replace('-', '_')}" for verb in verbs), *semloc_jax._ROOMS]
    peers = [f"bench.{peer.module}" for peer in PEERS]
    return {"semloc_jax", "semloc_jax.cli.main", *(f"semloc_jax.{name}" for name in (*rooms, *peers))}


def _behind_doors() -> dict[tuple[str, str], str]:
    """The module of every (room, name) that a room loads on first use; see `semloc_jax.door`."""
    found = {}
    for path in _files():
        if path.name != "__init__.py":
            continue
        room = _module_name(path)
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "door":
                shown = ast.literal_eval(node.args[1]) if isinstance(node.args[1], ast.Dict) else {}
                found |= {(room.split(".")[-1], name): f"{room}.{m}" for m, names in shown.items() for name in names}
    return found


def _names_of_rooms(text: str) -> set[tuple[str, str]]:
    """Every (room, name) that a module may use: `viz.save`, `from semloc_jax.viz import save`."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            found.add((node.value.id, node.attr))
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {(node.module.split(".")[-1], alias.name) for alias in node.names}
    return found


def unreached(doors: set[str]) -> set[str]:
    """Modules that no chain of imports from a door leads to; pages of a room (`__init__`) do not count."""
    edges, seen, ahead = _edges(), set(), list(doors)
    while ahead:
        name = ahead.pop()
        if name in edges and name not in seen:
            seen.add(name)
            ahead.extend(edges[name])
    pages = {_module_name(path) for path in _files() if path.name == "__init__.py"}
    return edges.keys() - seen - pages


@cache
def _edges() -> dict[str, set[str]]:
    """The modules that each module imports, names, or uses a name of."""
    sources = {_module_name(path): path for path in _files()}
    edges: dict[str, set[str]] = {name: set() for name in sources}
    for item in _all_imports():
        edges[item.module].add(item.target)
    behind = _behind_doors()
    for name, path in sources.items():
        text = path.read_text(encoding="utf-8")
        edges[name].update(_BY_NAME.findall(text))
        edges[name].update(behind[used] for used in _names_of_rooms(text) if used in behind)
    return edges


def test_every_module_is_reached():
    forgotten = unreached(_doors()) - set(WAITING)
    assert not forgotten, f"no verb and no public name leads to {sorted(forgotten)}; use them or delete them"


def test_what_waits_is_not_in_use():
    """An entry goes when its module is used."""
    assert set(WAITING) <= unreached(_doors())


def test_a_door_less_leaves_its_module_out():
    assert "semloc_jax.cli.doctor" in unreached(_doors() - {"semloc_jax.cli.doctor"})


def test_a_name_behind_the_door_of_a_room_leads_to_its_module():
    assert _behind_doors()["viz", "points_from_above"] == "semloc_jax.viz.point_map"
    assert "semloc_jax.viz.point_map" in unreached(_doors() - {"semloc_jax.cli.map"})


def loaded_with(module: str) -> set[str]:
    """What is imported with a module, libraries included, but for what stands behind doors."""
    seen: set[str] = set()
    ahead = [module]
    while ahead:
        name = ahead.pop()
        if name not in seen:
            seen.add(name)
            ahead += [name.rpartition(".")[0] or name, *_at_import()[name]]
    return seen


@cache
def _at_import() -> defaultdict[str, set[str]]:
    edges: defaultdict[str, set[str]] = defaultdict(set)
    for item in _all_imports():
        if item.at_import and not item.for_types_only:
            edges[item.module].add(item.target)
    return edges


@pytest.mark.parametrize(("module", "most"), [("semloc_jax.reports.track", 400), ("semloc_jax.reports.frames", 240)])
def test_a_run_loads_nothing_that_only_others_need(module, most):
    """A tracker loaded 424 modules of ours, 53 of them a simulation that only a run with faults needs."""
    loaded = loaded_with(module)
    heavy = {"semloc_jax.simulation", "semloc_jax.learning", "semloc_jax.explorer", "semloc_jax.mapping"}
    assert not loaded & {*heavy, "optimistix", "lineax", "scipy.optimize", "scipy.ndimage"}
    assert 100 < len(loaded) < most


@pytest.mark.parametrize("verb", ["track", "localize"])
def test_a_verb_asks_for_a_simulation_only_where_a_fault_is_wanted(verb):
    """What `run` itself imports it loads in every run."""
    tree = ast.parse((PACKAGE / "cli" / f"{verb}.py").read_text(encoding="utf-8"))
    run = next(node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == "run")
    named = {node.module for node in ast.walk(run) if isinstance(node, ast.ImportFrom)}
    assert named and not any(loaded_with(name) & {"semloc_jax.simulation"} for name in named)
