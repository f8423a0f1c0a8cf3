"""Channels, phases, notes and pictures of what a run holds."""

import numpy as np
import pytest
from recordings import described, layer, swinging

from octarm.recordings.channels import Phases, bounds_of, channels_of
from octarm.recordings.heat_map import HeatMap
from octarm.recordings.words import notes_of, title_of

LIMITS = [("saturation", 20.0), ("saturation-2", 15.0)]


def channels_and_rows(**signals):
    rows = dict(swinging(**signals).arrays())
    return channels_of(rows, described(), None, disturbed=True), rows


def test_channels_have_a_name_for_each_number():
    channels, rows = channels_and_rows(theta=np.zeros((2500, 6, 5)), odd=np.zeros((2500, 4)))
    for channel in channels.values():
        assert channel.values(rows).shape == (2500, len(channel.names))
    assert channels["theta"].names[5] == "s2_1"
    columns = [f"column_{a}_{i}" for i in (1, 2, 3) for a in (1, 2)]
    assert list(channels["tau"].names) == columns
    assert channels["q"].units == {"slides": " [m]", "bends": " [rad]"}
    assert channels["s"].units == {"slides": " [m/s]", "bends": " [rad/s]"}


def test_bounds_are_those_of_the_layer_and_the_saturation():
    limits = [{"name": name, "asked": {"limit": x}} for name, x in LIMITS]
    bounds = bounds_of(described(disturbances=limits), layer())
    np.testing.assert_array_equal(bounds["s"].values, [0.05] * 3 + [0.8] * 3)
    np.testing.assert_allclose(bounds["error"].values, [0.005] * 3 + [0.08] * 3)
    assert bounds["error"].lines(slice(3, 6)) == pytest.approx([0.08, -0.08])
    np.testing.assert_array_equal(bounds["tau"].values, 15.0)
    unlimited = [{"name": "saturation", "asked": {"limit": "inf"}}]
    assert bounds_of(described(disturbances=unlimited), np.zeros(6)) == {}


def states_at(watch, s, tau=None):
    tau = np.zeros((len(s), 2)) if tau is None else tau
    return watch.changes({"t": 0.2 * np.arange(len(s)), "tau": tau, "s": s, "switching": -s})


def test_a_coordinate_slides_inside_its_layer():
    watch = Phases(["s1", "theta1"], np.array([0.1, 0.1]), None)
    s = np.array([[0.3, 0.0], [0.1, 0.0], [0.05, 0.2]])
    found = states_at(watch, s)
    assert found["each/s1"] == [(0, "reaching"), (1, "sliding")]
    assert found["each/theta1"] == [(0, "sliding"), (2, "reaching")]
    assert found["surface"] == [(0, "reaching"), (1, "sliding"), (2, "reaching")]
    assert states_at(watch, s[2:]) == {}  # nothing changes between blocks


def test_without_a_layer_it_slides_once_s_has_changed_its_sign():
    watch = Phases(["s1", "theta1"], None, None)
    found = states_at(watch, np.array([[2.0, 1.0], [1.0, 1.0], [-0.1, 1.0]]))
    assert found["each/s1"] == [(0, "reaching"), (2, "sliding")]
    found = states_at(watch, np.array([[5.0, -1.0]]))
    assert found == {"each/theta1": [(0, "sliding")], "surface": [(0, "sliding")]}


def test_without_a_robust_part_nothing_slides():
    watch = Phases(["s1", "theta1"], None, None)
    assert watch.changes({"tau": np.zeros((3, 2)), "s": np.ones((3, 2))}) == {}


def test_inputs_are_saturated_at_their_limit():
    watch = Phases(["s1", "theta1"], None, np.array([1.0, 2.0]))
    tau = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.9]])
    found = watch.changes({"tau": tau})
    assert found == {"inputs": [(0, "free"), (1, "saturated"), (2, "free")]}


def test_a_heat_map_of_a_long_run_keeps_few_instants_and_shows_the_change():
    channel = channels_and_rows(theta=np.zeros((2500, 6, 2)))[0]["theta"]
    heat = HeatMap(channel, 6)
    for k in range(40):
        t = (np.arange(500) + 500 * k) * 1e-3
        rising = np.tile(t[:, None], (1, 12)) * np.array([1.0, -1.0] * 6) + 7.0
        heat.add(t, rising)
    picture = heat.picture().astype(int)
    assert len(heat._t) <= 1440
    first, last = picture[3, 0], picture[3, -1]
    assert np.ptp(first) < 12  # no change yet
    assert last[0] > 2 * last[2]  # risen: orange
    fallen = picture[10, -1]
    assert fallen[2] > 2 * fallen[0]


def test_notes_tell_what_was_run_and_what_came_of_it():
    metrics = {"rms_error": [0.001] * 5 + [None], "tip_rms_error": 0.002}
    listed = [{"name": "payload", "asked": {"mass": 0.2}, "delivered": {"mass": {"end": 0.4}}}]
    text = described(metrics=metrics, disturbances=listed)
    pages = notes_of(text)
    assert title_of(text) == "smc on sine, payload 200 g"
    assert "| rms_error | 0.001 |" in pages["notes"]
    assert "–" in pages["notes"]
    assert "## payload 200 g" in pages["ledger"]
    assert "| asked | mass [kg] | 0.2 |" in pages["ledger"]
    assert "| delivered | mass [kg] | end 0.4 |" in pages["ledger"]
