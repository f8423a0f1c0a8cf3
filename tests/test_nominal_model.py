"""The nominal model as an object: what it says of itself, and what laws need of it."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from arm_states import random_instant

from controllers import CONTROLLERS, make_controller
from octarm.arm import lagrange
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.nominal import LagrangeModel
from octarm.arm.parameters import ArmParameters
from octarm.interfaces import NominalModel
from octarm.simulation.environment import load

P = nominal_parameters().mismatched(-0.3)
MODEL = LagrangeModel(P)
LAGRANGE = (
    "inverse_dynamics",
    "mass_matrix",
    "kinetic_energy",
    "potential_force",
    "force_coefficients",
    "equilibrium",
)


@pytest.mark.parametrize("name", LAGRANGE)
def test_it_is_the_analytic_model(name: str):
    (_, q, v), (_, v_r, a) = random_instant(20)
    arguments = {
        "inverse_dynamics": (q, v, a, v_r),
        "kinetic_energy": (q, v),
        "equilibrium": (),
    }.get(name, (q,))
    expected = getattr(lagrange, name)(P, *arguments)
    np.testing.assert_array_equal(getattr(MODEL, name)(*arguments), expected)


def test_it_says_what_its_coordinates_are():
    assert MODEL.names == ("s1", "s2", "s3", "theta1", "theta2", "theta3")
    assert MODEL.units == ("m", "m", "m", "rad", "rad", "rad")
    assert (MODEL.modules, MODEL.coordinates) == (3, 6)
    np.testing.assert_array_equal(MODEL.scale, [0.12, 0.12, 0.12, 1.0, 1.0, 1.0])
    np.testing.assert_array_equal(MODEL.input_range, load().physics.input_range())


def test_the_largest_inertia_is_that_of_the_straight_arm():
    q = random_instant(500)[0].q
    D_ii = np.diagonal(MODEL.mass_matrix(q), axis1=-2, axis2=-1)
    assert np.all(D_ii <= MODEL.largest_inertia(q) * (1.0 + 1e-12))
    straight = np.abs(q) * [1, 1, 1, 0, 0, 0]
    D_ii = np.diagonal(MODEL.mass_matrix(straight), axis1=-2, axis2=-1)
    np.testing.assert_allclose(MODEL.largest_inertia(q), D_ii, rtol=1e-12)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_parameters_stand_for_the_analytic_model(name: str):
    one, other = make_controller(name, P), make_controller(name, MODEL)
    instant = random_instant(5)
    force, same = (law(law.initial_state((5,)), *instant)[0].force for law in (one, other))
    np.testing.assert_array_equal(force, same)


@dataclasses.dataclass
class Spied:
    """A model that is not of the package, and hands on what the contract names, nothing else."""

    model: NominalModel

    def __getattr__(self, name: str) -> Any:
        assert name in vars(NominalModel), f"a law asks for {name}"
        return getattr(self.model, name)


DERIVED = [(name, {"uncertainty": 0.2}) for name in CONTROLLERS if name.startswith("smc")]


@pytest.mark.parametrize(("name", "gains"), [*((name, {}) for name in CONTROLLERS), *DERIVED])
def test_a_law_asks_for_nothing_beyond_the_contract(name: str, gains: dict):
    model: Any = Spied(MODEL)
    law, instant = make_controller(name, model, gains), random_instant(5)
    command, _ = law(law.initial_state((5,)), *instant)
    assert np.all(np.isfinite(command.force))


LAYERED = {"smc-boundary", "smc-integral", "fsmc", "afsmc-consequent", "afsmc"}


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_law_with_a_boundary_layer_states_its_half_width(name: str):
    law: Any = make_controller(name, P)
    command, _ = law(law.initial_state(), *random_instant(1))
    assert (command.layer is not None) == (name in LAYERED)
    if name in LAYERED:
        np.testing.assert_array_equal(command.layer, law.phi)


def test_a_batch_of_models_is_the_models_one_by_one():
    many = nominal_parameters().mismatched(np.array([-0.3, 0.0, 0.2]))
    (_, q, v), (_, v_r, a) = random_instant(3)
    u = np.array(0.2)
    together = LagrangeModel(many).largest_error(u, q, v, a, v_r)
    inertia = LagrangeModel(many).largest_inertia(q)
    for i in range(3):
        alone = LagrangeModel(many.arm(i))
        row = alone.largest_error(u, q[i], v[i], a[i], v_r[i])
        np.testing.assert_array_equal(together[i], row)
        np.testing.assert_array_equal(inertia[i], alone.largest_inertia(q[i]))
    assert isinstance(many.arm(0), ArmParameters)
