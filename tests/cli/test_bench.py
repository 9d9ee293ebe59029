"""`semloc bench`: measures in processes of its own, writes what it measured, closes its gate; wrong options refused."""

import json

import pytest

from semloc_jax.cli.main import LOST, USAGE, main
from semloc_jax.evaluation import Metric, write_metrics


@pytest.mark.slow
def test_measures_writes_and_judges(tmp_path, capsys):
    key = "semloc-xla.many-1024.over.scipy-jacobian.many-64"
    write_metrics([Metric(key, 1e5, "x", "higher", 1.0)], tmp_path / "unreachable.json")
    words = ["--quick", "--repeats", "1", "--peers", "semloc-xla,scipy-jacobian"]
    out = ["--json", str(tmp_path / "b.json"), "--plot", str(tmp_path / "b.png")]
    assert main(["bench", *words, *out, "--baseline", str(tmp_path / "unreachable.json")]) == LOST
    said = capsys.readouterr().out
    assert f"worse   {key}" in said
    assert "GFLOP/s" in said and "scipy trf, our Jacobian" in said
    data = json.loads((tmp_path / "b.json").read_text())
    rows = {(row["peer"], row["task"]): row for row in data["rows"]}
    ours, theirs = rows["semloc-xla", "many-1024"], rows["scipy-jacobian", "many-64"]
    assert 0.4 < ours["success"] < 0.8 and abs(ours["success"] - theirs["success"]) < 0.1
    assert theirs["median_ms"] > 5 * ours["median_ms"], "a fused solver beats scipy on any machine"
    assert data["machine"]["cores"] >= 1 and "jax" in data["versions"] and data["roofline"]["roofs"]["gather_mps"] > 10
    assert (tmp_path / "b.png").stat().st_size > 20000


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--peers", "ceres"], "unknown 'ceres'; expected names of semloc-analytic"),
        (["--repeats", "0"], "expected at least 1"),
        (["--core", "4096"], "not free to this process"),
        (["--json", "nowhere/b.json"], "its folder does not exist"),
    ],
)
def test_wrong_options_are_refused(capsys, words, message):
    assert main(["bench", *words]) == USAGE
    assert message in capsys.readouterr().err
