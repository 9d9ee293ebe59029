"""Whatever a file holds, a reader reads it or refuses it in one line: no traceback, no crash, no hang, no gigabyte.

SEMLOC_FUZZ is the number of inputs of the slow test (10,000 where it is not set).
"""

import gc
import json
import os
import random
import shutil
import sys
from collections import Counter
from pathlib import Path

import pytest

from semloc_jax.errors import SemlocError, UsageError
from tests.fuzz.mutations import STRUCTURED, mutate
from tests.fuzz.own_files import own_files
from tests.fuzz.readers import Reader, readers
from tests.fuzz.recordings import needs, recordings
from tests.fuzz.sandbox import Outcome, run

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
REFUSALS = (SemlocError, UsageError, OSError)
GOOD = ("read", "refused")


@pytest.fixture(scope="module")
def every(simulated_road, tmp_path_factory) -> list[Reader]:
    needs()
    given = os.environ.get("SEMLOC_DATA")
    data = Path(given) if given and Path(given).is_dir() else None
    place = tmp_path_factory.mktemp("sound")
    found = [*readers(simulated_road, data, place), *recordings(simulated_road, data, place)]
    found += own_files(simulated_road, place)
    for reader in found:  # sound, it is read; and what a first reading loads is there before processes are forked
        own = place / "read" / reader.name.replace("/", "_")
        own.mkdir(parents=True)  # two of one name would meet here
        reader.read(reader.damaged(reader.file.read_bytes(), own))
    gc.collect()
    gc.freeze()  # a collection in a child would copy the memory that it shares
    return found


def _fuzzed(every: list[Reader], count: int, place: Path) -> tuple[Counter, list[tuple[str, int, Outcome]]]:
    """How often what happened, and the bad ones with reader and seed; inputs are dealt to the readers in turn."""
    counts: Counter[str] = Counter()
    bad = []
    for seed in range(count):
        if seed and seed % 1000 == 0:  # a long run shows with -s how far it is
            print(seed, dict(counts), file=sys.stderr, flush=True)
        reader = every[seed % len(every)]
        content = mutate(reader.file.read_bytes(), reader.file.suffix, random.Random(seed))
        own = place / str(seed)
        own.mkdir()
        given = reader.damaged(content, own)
        outcome = run(lambda given=given, reader=reader: reader.read(given), REFUSALS)
        counts[outcome.kind] += 1
        if outcome.kind not in GOOD:
            bad.append((reader.name, seed, outcome))
            print(f"{reader.name} seed {seed}: {outcome.kind}: {outcome.said}", file=sys.stderr, flush=True)
        else:
            shutil.rmtree(own)
    return counts, bad


def test_every_reader_reads_its_sound_input(every):
    """That they do is seen where they are made ready."""
    assert len({reader.name for reader in every}) == len(every)


def test_mutations_change_what_they_are_given():
    document = json.dumps({"features": [{"a": 1.5, "b": [1, 2, 3]}] * 3}).encode()
    for kind in ("", *STRUCTURED):
        changed = [mutate(document, kind, random.Random(seed)) != document for seed in range(40)]
        assert sum(changed) > 30, kind


def test_a_sandbox_tells_what_happened():
    def forever():
        while True:
            pass

    assert run(lambda: 1, REFUSALS).kind == "read"
    assert run(lambda: [][1], REFUSALS).kind == "traceback"
    assert run(lambda: os.abort(), REFUSALS).kind == "crash"
    assert run(lambda: bytearray(b"x") * (3 << 29), REFUSALS).kind == "memory"
    refused = run(lambda: (_ for _ in ()).throw(SemlocError("no")), REFUSALS)
    assert refused == Outcome("refused", "no")


def test_a_sample_of_damaged_inputs(every, tmp_path):
    counts, bad = _fuzzed(every, len(every), tmp_path)
    assert not bad, "\n".join(f"{name} seed {seed}: {outcome.kind}: {outcome.said}" for name, seed, outcome in bad)
    assert counts["refused"] > 0 and counts["read"] > 0


@pytest.mark.slow
def test_ten_thousand_damaged_inputs(every, tmp_path):
    count = int(os.environ.get("SEMLOC_FUZZ", "10000"))
    counts, bad = _fuzzed(every, count, tmp_path)
    print(dict(counts), file=sys.stderr)
    assert not bad, "\n".join(f"{name} seed {seed}: {outcome.kind}: {outcome.said}" for name, seed, outcome in bad)
    assert sum(counts.values()) == count
