"""Runs in words that stand alone, and the events that pictures mark."""

import numpy as np
import pytest
from recordings import arm, described

from octarm.disturbances.ledger import asked
from octarm.disturbances.spelling import parse_disturbance
from octarm.recordings.words import amount, events_of, motion_of, title_of, wrapped


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.4, "1", "40 %"),
        (0.1, "kg", "100 g"),
        (2.0, "kg", "2 kg"),
        (0.06, "s", "60 ms"),
        (3.0, "s", "3 s"),
        (0.26, "rad", "0.26 rad"),
        ([0.1, 0.3, 0.1], "1", "10 % to 30 %"),
        ([5.0, 5.0], "N", "5 N"),
        ("all", "", "all"),
    ],
)
def test_amounts_are_as_people_write_them(value, unit, text):
    assert amount(value, unit) == text


def about(*disturbances, **more):
    listed = asked([parse_disturbance(text) for text in disturbances])
    return described(disturbances=listed, **more)


def test_a_title_has_the_sizes_of_all_that_acts():
    amplitude = [0.0, 0.02, 0.0, 0.35, 0.25, 0.0]
    sine = {"name": "sine", "amplitude": amplitude, "frequency": 0.5}
    wrong = arm(3).mismatched(-0.3).to_dict()
    description = about("noise:0.4", "payload:0.1,at=3", reference=sine, nominal=wrong)
    assert title_of(description) == (
        "smc on sine (0.35, 0.25 rad and 20 mm at 0.5 Hz), noise 40 %, payload 100 g at 3 s, "
        "model -30 %"
    )
    assert title_of(about("noise:0", "payload:0")) == "smc on sine, noise 0 %, payload 0 kg"
    assert title_of(about("noise:rms=0.2")) == "smc on sine, noise 0.2 N or N m"
    assert title_of(about("mismatch:mass=1.2")) == "smc on sine, mismatch 120 %"
    right = about("actuation-delay:60ms", nominal=arm(3).to_dict())
    assert title_of(right) == "smc on sine, actuation-delay 60 ms"
    odd = arm(3).scaled(mass=0.5).to_dict()
    assert title_of(described(nominal=odd)) == "smc on sine, another model"


def test_motions_of_several_tones_and_steps():
    tones = [{"amplitude": [0.0, 0.2], "frequency": f} for f in (0.3, 0.9)]
    assert motion_of({"name": "m", "tones": tones}) == "m (0.2 rad at 0.3 Hz to 0.9 Hz)"
    step = {"name": "step", "start": [0.12, 0.0], "goal": [0.13, 0.35]}
    assert motion_of(step) == "step (by 0.35 rad and 10 mm)"
    assert motion_of({"name": "spiral", "turns": 3}) == "spiral"
    own = {"amplitude": 0.1}, {"tones": 3}, {"amplitude": "big"}, {"start": 1.0, "goal": "up"}
    for fields in own:  # of a user's own motion, where these names may mean something else
        assert motion_of({"name": "Swing", **fields, "frequency": 0.5}) == "Swing"
    many = {"name": "s", "amplitude": [0.0] * 4 + [0.1, 0.2, 0.3, 0.4], "frequency": 1.0}
    assert motion_of(many) == "s (up to 0.4 rad at 1 Hz)"


def test_events_come_in_the_order_of_time_with_their_sizes():
    description = about("payload:0.1,at=3", "pulse:2,at=1,length=0.5")
    found = events_of(description)
    assert [at for at, _, _ in found] == [1.0, 1.5, 3.0]
    assert found[2] == (3.0, "payload", "payload 100 g")
    assert found[1][2] == ""


def test_a_number_stays_beside_its_unit():
    lines = wrapped("pd on sine, noise 40 %, model -30 %", 20).split("\n")
    assert max(map(len, lines)) <= 20
    assert np.all([not line.endswith(("40", "-30", "model")) for line in lines])
