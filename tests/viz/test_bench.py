"""The picture of a benchmark draws every curve that was measured and refuses a file without any."""

import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.viz.bench import benchmark_figure


def rows():
    for peer, cost in (("semloc-xla", 0.5), ("optimistix", 4.0)):
        for starts, points in ((64, 1000), (256, 1000), (64, 128)):
            yield {
                "peer": peer,
                "text": peer.upper(),
                "kind": "many",
                "starts": starts,
                "points": points,
                "median_ms": cost * points / 1000,
                "peak_mib": 500.0 + starts,
            }


ROOFLINE = {
    "roofs": {"matmul_gflops": 160.0, "stream_gbps": 39.0, "cache_gbps": 75.0, "gather_mps": 450.0},
    "flop_a_point": 180,
    "bytes_a_point": 24,
    "paths": [{"path": "SEMLOC-XLA", "evaluation_us": 23.0, "gflops": 7.8, "share_of_peak": 0.05}],
}


def test_curves_are_those_of_the_rows():
    figure = benchmark_figure({"rows": list(rows()), "roofline": ROOFLINE})
    starts, points, memory, roof = figure.axes
    curves = {line.get_label(): line.get_xydata().tolist() for line in starts.get_lines()}
    assert curves == {"SEMLOC-XLA": [[64, 0.5], [256, 0.5]], "OPTIMISTIX": [[64, 4.0], [256, 4.0]]}
    assert points.get_lines()[0].get_xydata().tolist() == [[128, 0.064], [1000, 0.5]]
    assert memory.get_lines()[0].get_ydata().tolist() == [564, 756]
    assert any("23 us" in text.get_text() for text in roof.texts)


def test_nothing_to_draw_is_refused():
    with pytest.raises(SemlocError, match="no measurements"):
        benchmark_figure({"rows": [], "roofline": ROOFLINE})
