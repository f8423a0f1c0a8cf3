"""Chains of modules against the rod that they stand for."""

import dataclasses

import mujoco
import numpy as np
import pytest

from octarm.arm import lagrange
from octarm.arm.kinematics import tip_force, tip_position
from octarm.arm.mjcf import build_model, paper_order, read_parameters
from octarm.arm.rod import LAYOUTS, Rod, arm_from_rod
from octarm.checks import rod_study, rod_theory
from octarm.errors import OctarmError

ROD = Rod()
TAPERED = Rod(EA=(300.0, 150.0), EI=(0.5, 0.2), density=(3.0, 1.0), rotary_inertia=(4e-3, 1e-3))
STILL = np.zeros(2)
MANY = (5, 10, 20, 40)


def orders(errors: list[float]) -> np.ndarray:
    """Observed orders between numbers of modules that double."""
    return np.log2(np.abs(errors[:-1]) / np.abs(errors[1:]))


def deflection(
    rod: Rod, modules: int, layout: str, force: np.ndarray, gravity: np.ndarray
) -> float:
    return rod_study.static_tip(arm_from_rod(rod, modules, layout), force, gravity)[1]


@pytest.mark.parametrize("n", [1, 2, 3, 5, 10, 15, 40])
def test_a_small_tip_load_bends_a_chain_as_the_closed_forms_say(n):
    beam = ROD.length**3 / (3.0 * 0.384)
    factors = {"paper": 1 - 3 / (2 * n) + 1 / (2 * n * n), "centred": 1 - 1 / (4 * n * n)}
    for layout, factor in factors.items():
        compliance = rod_study.tip_compliance(arm_from_rod(ROD, n, layout))
        np.testing.assert_allclose(compliance, beam * factor, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("rod", [ROD, TAPERED], ids=["uniform", "tapered"])
@pytest.mark.parametrize(
    ("force", "gravity"),
    [((0.0, 0.01), (0.0, 0.0)), ((0.0, 0.0), (0.0, 9.81))],
    ids=["small load", "weight"],
)
def test_the_paper_s_layout_is_first_order_and_the_centred_one_second(rod, force, gravity):
    loads = np.array(force), np.array(gravity)
    exact = rod_theory.static_tip(rod, *loads)[1]
    for layout, order in (("paper", 1.0), ("centred", 2.0)):
        errors = [deflection(rod, n, layout, *loads) - exact for n in MANY]
        np.testing.assert_allclose(orders(errors)[-1], order, atol=0.06)


@pytest.mark.parametrize(
    ("case", "layout", "percent"),
    [  # errors of N = 1, 2, 3, 5, 10, 20, 40
        ("load", "paper", [-100, -62.5, -44.4, -28, -14.5, -7.37, -3.72]),
        ("load", "centred", [-25, -6.25, -2.78, -1.0, -0.25, -0.06, -0.02]),
        ("across", "paper", [-100, -49.4, -30.3, -16.5, -7.47, -3.52, -1.70]),
        ("across", "centred", [-100, -24.2, -10.6, -3.79, -0.94, -0.24, -0.06]),
        ("along", "paper", [100, 50, 33.3, 20, 10, 5, 2.5]),
        ("along", "centred", [0.0] * 7),
    ],
)
def test_static_errors_are_those_of_an_independent_computation(case, layout, percent):
    force = np.array([0.0, 1e-4]) if case == "load" else STILL
    gravity = {"load": STILL, "across": np.array([0.0, 9.81]), "along": np.array([9.81, 0.0])}[case]
    place, zero = (0, ROD.length) if case == "along" else (1, 0.0)
    exact = rod_theory.static_tip(ROD, force, gravity)[place] - zero
    chains = [arm_from_rod(ROD, n, layout) for n in (1, 2, 3, 5, 10, 20, 40)]
    tips = np.array([rod_study.static_tip(p, force, gravity)[place] for p in chains]) - zero
    np.testing.assert_allclose(100.0 * (tips / exact - 1.0), percent, atol=0.051)


def test_a_rod_without_bending_is_a_bar_under_its_weight():
    weight = 0.75 * 9.81
    tip = rod_theory.static_tip(ROD, np.array([2.0, 0.0]), np.array([9.81, 0.0]))
    stretch = (2.0 + 0.5 * weight) * ROD.length / 240.0
    np.testing.assert_allclose(tip, [ROD.length + stretch, 0.0, 0.0], rtol=1e-11, atol=1e-14)


def test_a_slender_rod_s_frequencies_are_those_of_the_euler_beam():
    slender = Rod(rotary_inertia=1e-9)
    roots = np.array([1.8751040687, 4.6940911330, 7.8547574382])  # cos x cosh x = -1
    scale = np.sqrt(0.384 / (0.75 / 0.36)) / ROD.length**2 / (2.0 * np.pi)
    found = rod_theory.bending_frequencies(slender, 3)
    np.testing.assert_allclose(found, roots**2 * scale, rtol=1e-6)


@pytest.mark.parametrize(
    ("layout", "percent"),  # of f1 to f3, for N = 3, 5, 10
    [
        ("paper", [[4.8, -7.0, -31.4], [1.5, -3.9, -14.9], [0.27, -2.0, -5.9]]),
        ("centred", [[5.6, -1.3, -9.4], [2.0, 0.3, -8.0], [0.50, 0.15, -1.8]]),
    ],
)
def test_frequencies_converge_to_those_of_a_rayleigh_beam(layout, percent):
    theory = rod_theory.bending_frequencies(ROD, 3)
    chains = [rod_study.frequencies(arm_from_rod(ROD, n, layout)) for n in (3, 5, 10)]
    errors = [100.0 * (bending[:3] / theory - 1.0) for bending, _ in chains]
    np.testing.assert_allclose(errors, percent, atol=0.06)


def test_axial_frequencies_of_the_centred_chain_are_second_order():
    theory = rod_theory.axial_frequencies(ROD, 2)
    chains = [rod_study.frequencies(arm_from_rod(ROD, n, "centred")) for n in MANY]
    for k in (0, 1):
        errors = [axial[k] / theory[k] - 1.0 for _, axial in chains]
        np.testing.assert_allclose(orders(errors)[-1], 2.0, atol=0.05)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("rod", [ROD, TAPERED], ids=["uniform", "tapered"])
def test_mujoco_s_chain_has_the_tip_and_the_tip_s_forces_of_the_analytic_one(rod, layout):
    p = arm_from_rod(rod, 5, layout)
    model = build_model(p)
    data = mujoco.MjData(model)
    positions, velocities = paper_order(model)
    rng = np.random.default_rng(4)
    for _ in range(20):
        q = np.concatenate([p.rest_length * rng.uniform(0.5, 2.0, 5), rng.uniform(-1.0, 1.0, 5)])
        data.qpos[positions] = q
        mujoco.mj_forward(model, data)
        place = data.site("tip").xpos
        np.testing.assert_allclose(tip_position(q, p.entries.tip_length), place, atol=1e-14)
        force = np.zeros(model.nv)
        push = np.array([0.3, 0.0, -0.7])  # in the world frame: y across, -x along
        body = model.body("module_5").id
        mujoco.mj_applyFT(model, data, push, np.zeros(3), place, body, force)
        expected = tip_force(q, 0.7, 0.3, p.entries.tip_length)
        np.testing.assert_allclose(force[velocities], expected, atol=1e-14)


def test_a_compiled_chain_gives_its_parameters_back():
    p = arm_from_rod(TAPERED, 4, "centred")
    again = read_parameters(build_model(p))
    for field in dataclasses.fields(p):
        there, back = getattr(p, field.name), getattr(again, field.name)
        np.testing.assert_allclose(back, np.broadcast_to(there, back.shape), rtol=1e-15)


def test_a_chain_has_the_mass_and_the_compliance_of_its_rod():
    for n in (1, 4, 9):
        for layout in LAYOUTS:
            p = arm_from_rod(TAPERED, n, layout)
            np.testing.assert_allclose(np.sum(p.mass), 2.0 * TAPERED.length, rtol=1e-13)
            total = np.sum(p.rest_length) + p.tip_length
            np.testing.assert_allclose(total, TAPERED.length, rtol=1e-14)
    stretch = np.sum(1.0 / np.sum(arm_from_rod(TAPERED, 7).stiffness, axis=0))
    np.testing.assert_allclose(stretch, TAPERED.length * np.log(2.0) / 150.0, rtol=1e-12)


def test_a_chain_of_no_modules_an_unknown_layout_and_a_wrong_rod_are_refused():
    with pytest.raises(OctarmError, match="0 modules; it must be 1 to 100"):
        arm_from_rod(ROD, 0)
    with pytest.raises(OctarmError, match=r"'centered'.*centred"):
        arm_from_rod(ROD, 3, "centered")
    with pytest.raises(OctarmError, match="EI holds -1; it must be finite and above 0"):
        Rod(EI=(1.0, -1.0))
    with pytest.raises(OctarmError, match="must be a number"):
        Rod(length=(1.0, 2.0))  # pyright: ignore[reportArgumentType]
    with pytest.raises(OctarmError, match="tapers"):
        rod_theory.bending_frequencies(TAPERED, 1)


def test_the_equilibrium_of_a_hanging_chain_is_its_static_shape():
    p = arm_from_rod(ROD, 6, "centred")
    q = lagrange.equilibrium(p)
    tip = rod_study.static_tip(p, STILL, np.array([9.81, 0.0]))
    np.testing.assert_allclose(np.sum(q[:6]) + p.tip_length, tip[0], rtol=1e-12)
