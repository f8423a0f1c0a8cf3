"""Gains by similarity: dynamically similar arms behave identically, and others do not diverge."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from controllers import CONTROLLERS, make_controller
from controllers.gain_sets import unsuited
from controllers.law import gain_fields
from controllers.recommended import SET_FOR, by_hand
from controllers.scaling import along, dimension_of, unit
from octarm.arm import lagrange
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.modes import rates
from octarm.arm.nominal import LagrangeModel
from octarm.arm.parameters import ArmParameters
from octarm.commands import cli
from octarm.errors import OctarmError
from octarm.interfaces import Motion, Reference
from octarm.references import named_reference
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout, simulate

P = nominal_parameters()
STEP = 5e-4  # [s]
FACTORS = [(3.7, 0.31, 1.9), (0.013, 2.3, 0.47)]  # of mass, length and time


def similar(p: ArmParameters, mass: float, length: float, time: float) -> ArmParameters:
    """The arm with other units of mass, length and time."""
    return p.scaled(
        mass=mass,
        inertia=mass * length**2,
        width=length,
        stiffness=mass / time**2,
        damping=mass / time,
        rest_length=length,
        gravity=length / time**2,
        tip_length=length,
        input_range=mass * length / time**2,
    )


def arm_of(modules: int, p: ArmParameters = P) -> ArmParameters:
    """An arm of the nominal one's modules, over and over."""
    i = np.arange(modules) % p.modules
    names = ("mass", "inertia", "stiffness", "damping", "rest_length")
    changed: dict[str, Any] = {name: getattr(p, name)[..., i] for name in names}
    return dataclasses.replace(p, **changed)


@dataclasses.dataclass(frozen=True)
class Similar:
    """A motion of the nominal arm, for one with other units of length and time."""

    motion: Motion
    length: float
    time: float

    def __call__(self, t: float) -> Reference:
        unit = np.repeat([self.length, 1.0], P.modules)
        q, v, a = self.motion(t / self.time)
        return Reference(q * unit, v * unit / self.time, a * unit / self.time**2)


@pytest.mark.parametrize("factors", FACTORS)
def test_the_scales_are_made_of_the_three_units(factors: tuple[float, float, float]):
    mass, length, time = factors
    one, other = LagrangeModel(P), LagrangeModel(similar(P, *factors))
    unit = np.repeat([length, 1.0], 3)
    force = mass * length / time**2 * np.repeat([1.0, length], 3)
    np.testing.assert_allclose(other.scale, one.scale * unit, rtol=1e-13)
    np.testing.assert_allclose(other.time_scale, one.time_scale * time, rtol=1e-13)
    np.testing.assert_allclose(other.force_scale, one.force_scale * force, rtol=1e-12)
    for name, value in one.descriptors.items():
        assert other.descriptors[name] == pytest.approx(value, rel=1e-9), name


def test_the_time_scale_is_that_of_the_fastest_mode():
    still = dataclasses.replace(P, damping=0.0)
    fastest = np.max(np.abs(rates(still, lagrange.equilibrium(still))))
    model = LagrangeModel(P)
    assert 1.0 / model.time_scale == pytest.approx(fastest, rel=1e-12)
    slowest = np.min(np.abs(rates(still, lagrange.equilibrium(still))))
    assert model.descriptors["mode_ratio"] == pytest.approx(fastest / slowest, rel=1e-9)


def test_the_scales_of_a_batch_are_those_of_its_arms_bit_for_bit():
    many = P.mismatched(np.array([-0.3, 0.0, 0.2]))
    together = LagrangeModel(many)
    for i in range(3):
        alone = LagrangeModel(many.arm(i))
        assert together.time_scale[i, 0] == alone.time_scale
        np.testing.assert_array_equal(together.force_scale[i], alone.force_scale)
        for name, value in alone.descriptors.items():
            np.testing.assert_array_equal(np.broadcast_to(together.descriptors[name], 3)[i], value)


@pytest.mark.parametrize("gain_set", ["tuned", "recommended"])
@pytest.mark.parametrize("name", CONTROLLERS)
def test_similar_arms_behave_identically(name: str, gain_set: str):
    """The same motion in the arm's own units, with a model that is wrong."""
    motion = named_reference("multi-sine", lagrange.equilibrium(P))
    paths: list[np.ndarray] = []
    for mass, size, t in ((1.0, 1.0, 1.0), *FACTORS):
        arm = similar(P, mass, size, t)
        environment = load(
            Similar(motion, size, t),
            parameters=arm,
            timestep=STEP * t,
            control_period=2.0 * STEP * t,
            engine="lagrange",
        )
        controller = make_controller(name, arm.mismatched(-0.3), gain_set=gain_set)
        run = rollout(environment, controller, 0.3 * t)
        assert run.status == "ok"
        paths.append(run.q / np.repeat([size, 1.0], 3))
    for path in paths[1:]:
        np.testing.assert_allclose(path, paths[0], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", CONTROLLERS)
@pytest.mark.parametrize("modules", [1, 5, pytest.param(10, marks=pytest.mark.slow)])
def test_arms_of_other_lengths_are_not_lost_with_default_gains(modules: int, name: str):
    """Heavier and lighter ones are similar to the nominal one."""
    true, mismatch = arm_of(modules), np.array([-0.3, 0.0, 0.3])
    environment = load(parameters=true, batch=3, engine="lagrange")
    errors: list[np.ndarray] = []
    simulate(
        environment,
        make_controller(name, true.mismatched(mismatch)),
        0.8,
        lambda instant: errors.append(instant.q - instant.reference.q),
    )
    assert np.all(environment.physics.intact())
    bends = np.array(errors)[len(errors) // 2 :, :, true.modules :]
    if name not in ("pd", "fuzzy"):  # whose errors grow with the weight
        # [rad], a fifth of the amplitude; with no robust term, a third: the model is wrong
        assert np.max(np.abs(bends)) < (0.12 if name == "computed-torque" else 0.07)


def test_numbers_of_other_modules_are_interpolated_along_the_arm():
    six = np.array([1.0, 2.0, 3.0, 10.0, 20.0, 30.0])
    np.testing.assert_array_equal(along(six, 3, 6), six)
    np.testing.assert_allclose(along(six, 1, 2), [2.0, 20.0])  # the middle
    np.testing.assert_allclose(along(six, 2, 4), [1.25, 2.75, 12.5, 27.5])
    twelve = along(six, 6, 12)
    np.testing.assert_allclose(twelve[:6], [1.0, 1.25, 1.75, 2.25, 2.75, 3.0])
    np.testing.assert_allclose(twelve[6:], 10.0 * twelve[:6])
    np.testing.assert_array_equal(along(np.array([4.0, 5.0]), 2, 4), [4.0, 4.0, 5.0, 5.0])
    np.testing.assert_array_equal(along(np.array(7.0), 5, 10), 7.0)
    np.testing.assert_allclose(along(np.array([six, 2 * six]), 2, 4)[1], 2 * along(six, 2, 4))
    np.testing.assert_allclose(along(np.arange(6.0), 2, 6), [0, 1, 2, 3, 4, 5])  # three kinds


@pytest.mark.parametrize(
    ("units", "exponents"),
    {
        "1": (0, 0, 0),
        "N s/m, N m s/rad": (1, -1, 1),
        "1/(N m), 1/(N m rad)": (-1, -1, 0),
        "N/sqrt(m/s), N m/sqrt(rad/s)": (1, -0.5, 0.5),
        "1/s^2": (0, 0, -2),
        "kg, kg m^2": (1, -1, 2),
        "m/s/s": (0, 1, -2),
        "(N s)^2/m": (2, -1, 2),
    }.items(),
)
def test_units_say_the_dimension(units: str, exponents: tuple[float, ...]):
    assert dimension_of(units) == exponents


@pytest.mark.parametrize("units", ["N (m", "furlong", "m^x", "N)", "sqrt", "m^", "^2", "sqrt(m"])
def test_units_that_cannot_be_read_are_a_sentence(units: str):
    with pytest.raises(OctarmError, match="they must be made of 1, N, m, rad, s, kg, such as"):
        dimension_of(units)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_gain_has_units_that_can_be_read(name: str):
    for field in gain_fields(CONTROLLERS[name]).values():
        slide, _, bend = field.units.partition(", ")
        assert unit(field.units, LagrangeModel(P)).shape in ((), (6,))
        assert dimension_of(slide) == dimension_of(field.units)
        assert not bend or dimension_of(bend.replace("N m", "N")) == dimension_of(slide)


def test_the_scales_that_gains_were_set_for_are_those_of_the_nominal_arm():
    model = LagrangeModel(P)
    for name in ("scale", "time_scale", "force_scale"):
        np.testing.assert_allclose(getattr(SET_FOR, name), getattr(model, name), rtol=1e-13)
    np.testing.assert_allclose(by_hand(model, "m/s, rad/s", 0.05, 0.8), np.repeat([0.05, 0.8], 3))


@pytest.mark.parametrize(
    "factors",
    [{"mass": [1e-300, 1.0, 1.0]}, {"mass": 1e-308, "inertia": 1e-308}, {"rest_length": 1e200}],
)
def test_an_arm_without_scales_is_refused_in_a_sentence(factors: dict[str, Any]):
    with pytest.raises(OctarmError, match="gains have no scale here"):
        make_controller("smc", P.scaled(**factors))


def test_gains_for_another_arm_say_so():
    assert unsuited("smc", None, LagrangeModel(P), STEP) == ""
    assert unsuited("smc", None, LagrangeModel(P.mismatched(-0.3)), STEP) == ""
    assert unsuited("smc", None, LagrangeModel(similar(P, 3.0, 0.2, 0.1)), 0.1 * STEP) == ""
    for arm, period, words in (
        (arm_of(5), STEP, "number of modules 5 instead of 3"),
        (P.scaled(damping=3.0), STEP, "damping ratio of the slowest mode"),
        (P.scaled(gravity=3.0), STEP, "ratio of weight to stiffness"),
        (P, 0.02, "control period times the fastest mode 3.07 instead of"),
        (P.scaled(mass=0.001, inertia=0.001), STEP, "control period times the fastest mode"),
    ):
        for choice in (None, "tuned", *["recommended"] * ("period" not in words)):
            sentence = unsuited("smc", choice, LagrangeModel(arm), period)
            assert words in sentence and "\n" not in sentence


def test_recommended_gains_are_for_no_control_period_in_particular():
    assert unsuited("smc", "recommended", LagrangeModel(P), 0.02) == ""


def test_a_run_says_that_its_gains_are_for_another_arm(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    short = ["run", "--controller", "smc-boundary", "--out", "a", "--force"]
    assert cli.main([*short, "--duration", "0.01"]) == 0
    assert capsys.readouterr().err == ""
    eight = ["mass:" + ",".join(["0.3"] * 8), "inertia:1e-4", "width:0.08", "stiffness:800"]
    other = [f"--parameter={text}" for text in [*eight, "damping:8", "rest_length:0.1"]]
    assert cli.main([*short, *other, "--duration", "0.01"]) == 0
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "number of modules 8 instead of 3" in err
    assert cli.main([*short, "--control-period", "0.02"]) == 3
    first, second = capsys.readouterr().err.splitlines()
    assert first.startswith("octarm: the tuned gains of smc-boundary were found for another arm")
    assert "its gains are for another arm or control period, try --gains" in second
