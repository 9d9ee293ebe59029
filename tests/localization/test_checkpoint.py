"""States in files: bit for bit, whole or not at all, and refused where they do not fit."""

import jax
import numpy as np
import pytest

from semloc_jax.errors import SemlocError
from semloc_jax.fusion.clock import ClockConfig, unknown_offset
from semloc_jax.fusion.kalman import KalmanFusion
from semloc_jax.fusion.measurements import PoseMeasurement
from semloc_jax.fusion.noise_scale import unknown_noise
from semloc_jax.localization import health, map_faults
from semloc_jax.localization.beginning import new_track
from semloc_jax.localization.checkpoint import Checkpoint, load, save
from semloc_jax.localization.initialization import no_fixes
from semloc_jax.localization.map_faults import TrustConfig
from semloc_jax.localization.track_state import TrackerState


def template(num_elements=5, num_tracks=1, seed=None) -> TrackerState:
    track = new_track(KalmanFusion(), PoseMeasurement(0.0, np.eye(4), np.eye(6)), 0.0)
    state = TrackerState(
        time_s=np.float64(0.0),
        status=np.int64(0),
        tracks=(track,) * num_tracks,
        coasting=(track.fusion,),
        searched_s=np.float64(0.0),
        fixes=no_fixes(),
        trust=map_faults.full_trust(num_elements),
        counters=health.no_counts(),
        stance=np.zeros(3),
        digest=np.uint32(0),
        driven_m=np.float64(0.0),
        noise=unknown_noise(),
        clock=unknown_offset(ClockConfig()),
    )
    if seed is None:
        return state
    rng = np.random.default_rng(seed)

    def drawn(leaf):
        if np.issubdtype(np.asarray(leaf).dtype, np.integer):
            return rng.integers(0, 2**31, size=np.shape(leaf)).astype(np.asarray(leaf).dtype)[()]
        return np.float64(rng.normal()) if np.ndim(leaf) == 0 else rng.normal(size=leaf.shape)

    # Types survive as well: a checksum of 32 bits, counts and a status are no floats.
    state = jax.tree.map(drawn, state)._replace(digest=np.uint32(0xFFFFFFFE))
    seen = np.array([0, 3]), *rng.uniform(20.0, 90.0, size=(2, 2))
    return state._replace(
        trust=map_faults.updated(map_faults.full_trust(num_elements), *seen[1:], TrustConfig(), seen[0])
    )


def test_a_state_comes_back_bit_for_bit(tmp_path):
    state = template(num_tracks=3, seed=1)._replace(coasting=())
    save(Checkpoint(state, 42, True), tmp_path / "state.npz")
    found = load(tmp_path / "state.npz", template())
    assert (found.next_frame, found.is_initialised) == (42, True)
    assert jax.tree.structure(found.state) == jax.tree.structure(state)
    for one, two in zip(jax.tree.leaves(state), jax.tree.leaves(found.state), strict=True):
        assert np.asarray(one).dtype == np.asarray(two).dtype
        assert np.asarray(one).tobytes() == np.asarray(two).tobytes()
    assert [path.name for path in tmp_path.iterdir()] == ["state.npz"]


def test_a_state_of_another_map_is_refused(tmp_path):
    save(Checkpoint(template(num_elements=7), 1, False), tmp_path / "state.npz")
    with pytest.raises(SemlocError, match="does not fit.*7 elements, expected 5.*resume with the map"):
        load(tmp_path / "state.npz", template())


def test_a_missing_or_torn_file_is_said_in_one_line(tmp_path):
    with pytest.raises(SemlocError, match="no such file; give --resume"):
        load(tmp_path / "state.npz", template())
    (tmp_path / "state.npz").write_bytes(b"PK\x03\x04 torn")
    with pytest.raises(SemlocError, match="does not fit"):
        load(tmp_path / "state.npz", template())
