"""A kill at the start of a run leaves nothing of an earlier one that a later --resume would take for its own."""

import pytest

from semloc_jax.cli.main import FAILED, main
from semloc_jax.errors import SemlocError

VERBS = {
    "localize": ("results.jsonl", "semloc_jax.reports.run_inputs.begun"),
    "track": ("state.npz", "semloc_jax.reports.run_inputs.begun"),
    "map": ("parts/old.npz", "semloc_jax.reports.map_request.begun"),
}


@pytest.mark.parametrize("verb", VERBS)
def test_what_an_earlier_run_left_goes_before_a_new_one_is_noted(simulated_road, tmp_path, monkeypatch, verb):
    name, noting = VERBS[verb]
    old, seen = tmp_path / name, []
    old.parent.mkdir(exist_ok=True)
    old.write_text("old")

    def kill(*_, **__):
        seen.append(old.exists() and old.read_text())
        raise SemlocError("killed here")

    monkeypatch.setattr(noting, kill)
    assert main([verb, str(simulated_road), "--masks", "sem", "--out", str(tmp_path)]) == FAILED
    assert seen in ([False], [""])
