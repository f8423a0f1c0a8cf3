"""Gains by similarity: dynamically similar arms behave identically, and others do not diverge."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from controllers import CONTROLLERS, make_controller
from octarm.arm import lagrange
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.modes import rates
from octarm.arm.nominal import LagrangeModel
from octarm.arm.parameters import ArmParameters
from octarm.interfaces import Motion, Reference
from octarm.references import named_reference
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout

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
@pytest.mark.parametrize("factors", FACTORS)
@pytest.mark.parametrize("name", CONTROLLERS)
def test_similar_arms_behave_identically(
    name: str, factors: tuple[float, float, float], gain_set: str
):
    """The same motion in the arm's own units, with a model that is wrong."""
    mass, length, time = factors
    motion = named_reference("multi-sine", lagrange.equilibrium(P))
    paths: list[np.ndarray] = []
    for arm, unit, t in ((P, 1.0, 1.0), (similar(P, mass, length, time), length, time)):
        environment = load(
            Similar(motion, unit, t),
            parameters=arm,
            timestep=STEP * t,
            control_period=2.0 * STEP * t,
            engine="lagrange",
        )
        controller = make_controller(name, arm.mismatched(-0.3), gain_set=gain_set)
        run = rollout(environment, controller, 0.4 * t)
        assert run.status == "ok"
        paths.append(run.q / np.repeat([unit, 1.0], 3))
    np.testing.assert_allclose(paths[1], paths[0], rtol=0.0, atol=1e-9)
