"""Channels, states, notes and pictures of what a run holds."""

import numpy as np
from recordings import described, swinging

from octarm.recordings.channels import bounds_of, channels_of, values_of
from octarm.recordings.heat_map import HeatMap
from octarm.recordings.notes import notes_of, title_of
from octarm.recordings.states import Event, States, events


def test_channels_and_values_have_the_same_names_and_widths():
    run = swinging(theta=np.zeros((2500, 6, 5)), odd=np.zeros((2500, 4)))
    channels = channels_of(run, disturbed=True)
    values = values_of(run, disturbed=True)
    assert set(channels) == set(values)
    for name, channel in channels.items():
        assert values[name].shape == (2500, len(channel.names))
    assert channels["theta"].names[5] == "s2_1"
    assert channels["tau"].names == [f"column_{a}_{i}" for i in (1, 2, 3) for a in (1, 2)]
    assert channels["q"].unit("bends") == " [rad]"


def test_bounds_are_those_of_the_gains_and_the_saturation():
    limits = [{"name": "saturation", "asked": {"limit": 15.0}}]
    bounds = bounds_of(described(disturbances=limits), 6)
    np.testing.assert_allclose(bounds["error"], [0.005] * 3 + [0.08] * 3)
    np.testing.assert_array_equal(bounds["tau"], 15.0)
    assert bounds_of({}, 6) == {}


def states_at(watch, s, tau=None):
    tau = np.zeros((len(s), 2)) if tau is None else tau
    return watch.changes(tau, {"s": s, "switching": -s})


def test_a_coordinate_slides_inside_its_layer():
    watch = States(["s1", "theta1"], np.array([0.1, 0.1]), None)
    s = np.array([[0.3, 0.0], [0.1, 0.0], [0.05, 0.2]])
    found = states_at(watch, s)
    assert found["each/s1"] == [(0, "reaching"), (1, "sliding")]
    assert found["each/theta1"] == [(0, "sliding"), (2, "reaching")]
    assert found["surface"] == [(0, "reaching"), (1, "sliding"), (2, "reaching")]
    assert states_at(watch, s[2:]) == {}  # nothing changes between blocks


def test_without_a_layer_it_slides_once_s_has_changed_its_sign():
    watch = States(["s1", "theta1"], None, None)
    found = states_at(watch, np.array([[2.0, 1.0], [1.0, 1.0], [-0.1, 1.0]]))
    assert found["each/s1"] == [(0, "reaching"), (2, "sliding")]
    found = states_at(watch, np.array([[5.0, -1.0]]))
    assert found == {"each/theta1": [(0, "sliding")], "surface": [(0, "sliding")]}


def test_without_a_robust_part_nothing_slides():
    watch = States(["s1", "theta1"], None, None)
    assert watch.changes(np.zeros((3, 2)), {"s": np.ones((3, 2))}) == {}


def test_inputs_are_saturated_at_their_limit():
    watch = States(["s1", "theta1"], None, np.array([1.0, 2.0]))
    tau = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.9]])
    found = watch.changes(tau, {})
    assert found == {"inputs": [(0, "free"), (1, "saturated"), (2, "free")]}


def test_events_come_and_go_in_the_order_of_time():
    listed = [
        {"name": "pulse", "asked": {"amplitude": 2.0, "at": 3.0, "length": 0.5}},
        {"name": "payload", "asked": {"mass": 0.2, "at": 1.0}},
        {"name": "noise", "asked": {"ratio": 0.4}},
        {"name": "step", "asked": {"amplitude": 1.0, "at": 2.0, "length": "inf"}},
    ]
    assert events(listed) == [
        Event(1.0, "payload", "payload 0.2"),
        Event(2.0, "step", "step 1"),
        Event(3.0, "pulse", "pulse 2"),
        Event(3.5, "pulse", ""),
    ]


def test_a_heat_map_of_a_long_run_keeps_few_instants_and_shows_the_change():
    channel = channels_of(swinging(theta=np.zeros((2500, 6, 2))), disturbed=False)["theta"]
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
    assert title_of(text) == "smc on sine, payload"
    assert "| rms_error | 0.001 |" in pages["notes"]
    assert "–" in pages["notes"]
    assert "**payload**\n\n- asked: mass 0.2\n- delivered: mass end 0.4" in pages["ledger"]
