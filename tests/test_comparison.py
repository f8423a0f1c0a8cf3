"""Two runs in one recording."""

import dataclasses

import numpy as np
import pytest
import rerun as rr
from recordings import described, entities, fields, swinging

from octarm.recordings.comparison import difference, write_comparison


def test_it_holds_both_runs_and_the_difference_of_their_errors(tmp_path):
    first, second = swinging(rows=2500), swinging(rows=2000)
    second = dataclasses.replace(second, q=second.q + 0.01)
    path = tmp_path / "both.rrd"
    write_comparison(path, (first, described()), (second, described()))
    for root, run in (("A", first), ("B", second)):
        assert f"/{root}/world/tube" in entities(path)
        found = fields(path, f"/{root}/signals", "signals")
        np.testing.assert_array_equal(found["tau"], run.tau)
    found = fields(path, "/difference")
    expected = np.abs(first.error[:2000]) - np.abs(second.error)
    np.testing.assert_allclose(found["slides"], expected[:, :3], atol=1e-15)
    np.testing.assert_allclose(found["bends"], expected[:, 3:], atol=1e-15)
    assert len(rr.chunk.RrdReader(path).blueprints()) == 1


def test_another_rate_is_interpolated():
    slow, fast = swinging(rows=100, rate=50.0), swinging(rows=1000, rate=500.0)
    ramp = np.tile(slow.t[:, None], (1, 6)), np.tile(fast.t[:, None], (1, 6))
    slow = dataclasses.replace(slow, q=slow.q_d + ramp[0])
    fast = dataclasses.replace(fast, q=fast.q_d + 2.0 * ramp[1])
    t, larger = difference(fast, slow)
    assert t[-1] <= slow.t[-1]
    np.testing.assert_allclose(larger, np.tile(t[:, None], (1, 6)), atol=1e-12)


def test_arms_of_other_sizes_are_refused(tmp_path):
    with pytest.raises(ValueError, match="3 and 2 modules"):
        write_comparison(tmp_path / "x.rrd", (swinging(), described()), (swinging(2), described(2)))
    assert list(tmp_path.iterdir()) == []
