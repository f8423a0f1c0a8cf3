"""Numbers with units: on the command line, in disturbances and in specs."""

from __future__ import annotations

import math

import pytest

from octarm.disturbances.spelling import parse_disturbance, spelling
from octarm.errors import OctarmError
from octarm.sweeps.margin import parse_bound, parse_varied
from octarm.sweeps.spec_file import parse_spec
from octarm.units import ANY, number


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("10", "s", 10.0),
        ("10s", "s", 10.0),
        ("60ms", "s", 0.06),
        ("1.5 min", "s", 90.0),
        ("40%", "1", 0.4),
        ("-30 %", "1", -0.3),
        ("100g", "kg", 0.1),
        ("15deg", "rad", math.radians(15.0)),
        ("2e3mN", "N or N m", 2.0),
        ("5 N mm", "N or N m", 0.005),
        ("3 Nm", "N or N m", 3.0),
        ("10%/s", "1/s", 0.1),
        ("4kN/s", "N/s", 4000.0),
        ("1e-3", "1/s", 1e-3),
        ("inf", "N", math.inf),
        ("5mm", ANY, 0.005),
    ],
)
def test_a_number_is_converted_to_the_unit_of_the_program(text: str, unit: str, value: float):
    assert number("x", text, unit) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize("text", ["", "some", "1.5.1", "1e", "s", "0x10", "1,5", "--3%"])
def test_what_is_no_number_is_refused(text: str):
    with pytest.raises(OctarmError, match=r"^x is .*; it must be a number$"):
        number("x", text, "s")


def test_the_unit_of_another_quantity_is_refused():
    with pytest.raises(OctarmError, match=r"^x is '10kg'; its unit must be s, ms, us or min$"):
        number("x", "10kg", "s")
    with pytest.raises(OctarmError, match="'3 Mn'; its unit must be N, mN, kN, N m or N mm"):
        number("x", "3 Mn", "N or N m")


def test_disturbances_take_units_and_keep_si():
    assert spelling(parse_disturbance("payload:100g,at=500ms")) == "payload:0.1,at=0.5"
    assert spelling(parse_disturbance("loss:0/50%/0.5/0/0/0")) == "loss:0/0.5/0.5/0/0/0"
    assert spelling(parse_disturbance("slew:4kN/s")) == "slew:4000"
    assert spelling(parse_disturbance("drift:10%/s,of=damping")).startswith("drift:0.1,of=damping")
    with pytest.raises(OctarmError, match="mass of 'payload:3s' is '3s'; its unit must be kg or g"):
        parse_disturbance("payload:3s")


def test_a_margin_is_sought_between_numbers_with_units():
    varied = parse_varied("actuation-delay", "0ms", "60ms")
    assert (varied.low, varied.high) == (0.0, 0.06)
    assert parse_bound("tip_rms_error:10mm") == ("tip_rms_error", 0.01)
    assert parse_bound("rms_error_theta1:2deg")[1] == pytest.approx(math.radians(2.0))
    with pytest.raises(OctarmError, match="'5kg'; its unit must be m, cm, mm or um"):
        parse_bound("tip_rms_error:5kg")
    with pytest.raises(OctarmError, match="high is '60g'; its unit must be s, ms, us or min"):
        parse_varied("actuation-delay", None, "60g")


SPEC = """
duration = "4000 ms"
timestep = "250us"
[grid]
controller = ["pd"]
mismatch = ["-30%", 0.0]
[grid.disturbance]
noise = [0, "40%"]
[random.disturbance]
tilt = {low = 0.0, high = "15deg"}
[disturbance]
payload = {mass = "100g", at = "1 s"}
loss = [0, 0, "50%", 0, 0, 0]
"""


def test_a_spec_takes_units():
    spec = parse_spec(SPEC)
    assert (spec.duration, spec.timestep) == (4.0, 0.00025)
    values = {axis.name: axis.values for axis in (*spec.axes, *spec.random)}
    assert values["mismatch"] == (-0.3, 0.0)
    assert values["noise"] == (0.0, 0.4)
    assert values["tilt"] == (0.0, pytest.approx(math.radians(15.0)))
    assert spec.fixed["payload"] == {"mass": 0.1, "at": 1.0}
    assert list(spec.fixed["loss"]["share"]) == [0.0, 0.0, 0.5, 0.0, 0.0, 0.0]
    with pytest.raises(OctarmError, match=r"spec.toml, line 2: duration is '4 kg'; its unit must"):
        parse_spec(SPEC.replace("4000 ms", "4 kg"))
    with pytest.raises(OctarmError, match=r"line 8: grid.disturbance.noise is '40x'; its unit"):
        parse_spec(SPEC.replace("40%", "40x"))
