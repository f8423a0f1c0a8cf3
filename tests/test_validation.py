"""The report passes for right arms, and every kind of wrong entry fails in its own row."""
# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)

import json
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from octarm.arm import lagrange, modes
from octarm.arm.file import read_arm
from octarm.arm.mjcf import build_model, nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.checks import forced_motion, free_motion, mechanics, validation
from octarm.checks.validation import arm_with, random_arm, validate
from octarm.tolerances import Check, CheckTable

STATES = 50


def failures(report: CheckTable) -> set[str]:
    return {check.what for check in report.checks if not check.passed}


@pytest.fixture(scope="module")
def nominal() -> CheckTable:
    return validate(nominal_parameters(), states=STATES)


@pytest.fixture
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shorter free motions, where the row that must fail is another one."""
    monkeypatch.setattr(free_motion, "DURATION", 0.2)
    monkeypatch.setattr(forced_motion, "DURATION", 0.1)


# Right arms.


def test_the_nominal_arm_passes(nominal: CheckTable):
    assert failures(nominal) == set()
    assert nominal.passed


@pytest.mark.parametrize("modules", [1, 5])
def test_arms_of_other_lengths_pass(modules: int):
    assert failures(validate(arm_with(modules), states=STATES)) == set()


@pytest.mark.parametrize("damping", [1.0, 3.0])
def test_random_arms_pass_also_when_overdamped(damping: float):
    p = random_arm(np.random.default_rng(1), 2).scaled(damping=damping)
    assert failures(validate(p, states=STATES, seed=1)) == set()


@pytest.mark.slow
@pytest.mark.parametrize("arm", ["i-support", "fabric"])
def test_published_arms_pass(arm: str):
    assert failures(validate(read_arm(arm), states=STATES)) == set()


@pytest.mark.slow
@pytest.mark.parametrize("damping", [20.0])
def test_much_damping_passes(damping: float):
    assert failures(validate(nominal_parameters().scaled(damping=damping), states=STATES)) == set()


@pytest.mark.usefixtures("brief")
def test_the_same_seed_gives_the_same_report():
    p = arm_with(1)
    first, again, other = (validate(p, states=5, seed=s).checks for s in (3, 3, 4))
    assert first == again
    assert first != other


@pytest.mark.usefixtures("brief")
def test_progress_names_each_part_before_it_starts():
    parts = []
    validate(arm_with(1), states=5, progress=parts.append)
    assert parts == [
        "5 random states",
        "static equilibrium",
        "small motions",
        "free motion",
        "forced motion",
        "energy",
    ]


@pytest.mark.parametrize("states", [0, -1])
def test_too_few_states_are_refused(states: int):
    with pytest.raises(ValueError, match="number of states"):
        validate(arm_with(1), states=states)


# Wrong entries in the analytic model.


def patch_entry(
    monkeypatch: pytest.MonkeyPatch, function: str, entry: tuple[int, ...], factor: float
) -> None:
    right = getattr(lagrange, function)

    def wrong(*arguments):
        out = right(*arguments)
        out[(..., *entry)] *= factor
        return out

    monkeypatch.setattr(lagrange, function, wrong)


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize(
    ("function", "entry", "rows"),
    [
        ("mass_matrix", (0, 2), {"inertia matrix D", "accelerations"}),
        ("mass_matrix", (2, 0), {"inertia matrix D", "accelerations"}),
        ("coriolis_matrix", (1, 2), {"bias: Coriolis force and gravity"}),
        ("inverse_dynamics", (2,), {"inverse dynamics", "accelerations"}),
        (
            "force_coefficients",
            (2, 2),
            {"F_coeff, by forces and couples on the bodies", "actuators: F_coeff tau"},
        ),
        ("damping_matrix", (0, 0), {"dampers"}),
        ("stiffness_matrix", (3, 3), {"springs"}),
        ("potential_force", (0,), {"potential force G"}),
        (
            "potential_hessian",
            (2, 2),
            {"frequencies of small undamped oscillations"},
        ),
        ("positions", (1, 0), {"positions of the modules"}),
    ],
)
def test_a_wrong_analytic_entry_fails_in_its_row(
    monkeypatch: pytest.MonkeyPatch, function: str, entry: tuple[int, ...], rows: set[str]
):
    patch_entry(monkeypatch, function, entry, 1.0 + 1e-4)
    report = validate(arm_with(2), states=STATES)
    assert rows <= failures(report)
    assert not report.passed


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize(("row", "part"), [("kinetic energy", 0), ("potential energy", 1)])
def test_a_wrong_energy_fails_in_its_row(monkeypatch: pytest.MonkeyPatch, row: str, part: int):
    right = lagrange.energy

    def wrong(*arguments):
        energies = list(right(*arguments))
        energies[part] = energies[part] * (1.0 + 1e-3)
        return tuple(energies)

    monkeypatch.setattr(lagrange, "energy", wrong)
    failed = failures(validate(arm_with(2), states=STATES))
    assert any(what.startswith(row) for what in failed)
    assert "energy drift without damping" in failed


@pytest.mark.usefixtures("brief")
def test_the_printed_mass_matrix_fails(monkeypatch: pytest.MonkeyPatch):
    right = lagrange.mass_matrix

    def printed(p: ArmParameters, q: np.ndarray) -> np.ndarray:
        out = right(p, q)
        out[..., 0, 4] = 0.0  # the entry that eq (3) lacks
        out[..., 2, 3] *= q[..., 2] / q[..., 1]  # s3 for s2
        return out

    monkeypatch.setattr(lagrange, "mass_matrix", printed)
    failed = failures(validate(nominal_parameters(), states=STATES))
    assert {
        "inertia matrix D",
        "accelerations",
        "free motion against DOP853, RK4",
        "order of convergence, RK4",
    } <= failed


# Wrong entries in MuJoCo's model.


def wrong_gravity(model: mujoco.MjModel) -> None:
    model.opt.gravity[:] *= 1.0 + 1e-6


def wrong_mass(model: mujoco.MjModel) -> None:
    model.body("module_2").mass *= 1.0 + 1e-6


def wrong_damping(model: mujoco.MjModel) -> None:
    model.tendon_damping[model.tendon("column_2_1").id] *= 1.0 + 1e-6


def wrong_stiffness(model: mujoco.MjModel) -> None:
    model.tendon_stiffness[model.tendon("column_1_1").id] *= 1.0 + 1e-6


def wrong_moment(model: mujoco.MjModel) -> None:
    model.wrap_prm[model.tendon_adr[model.tendon("column_1_2").id] + 1] *= 1.0 + 1e-6


def wrong_keyframe(model: mujoco.MjModel) -> None:
    model.key("hanging").qpos[0] += 1e-9


def wrong_armature(model: mujoco.MjModel) -> None:
    model.dof_armature[1] = 1e-9


@pytest.mark.usefixtures("brief")
@pytest.mark.parametrize(
    ("spoil", "rows"),
    [
        (
            wrong_gravity,
            {
                "bias: Coriolis force and gravity",
                "potential force G",
                "potential energy, about its offset",
                "equilibrium, acceleration left",
            },
        ),
        (wrong_mass, {"inertia matrix D", "bias: Coriolis force and gravity", "kinetic energy"}),
        (wrong_damping, {"dampers", "inverse dynamics", "accelerations"}),
        (wrong_stiffness, {"springs", "potential force G", "accelerations"}),
        (wrong_moment, {"tendon moments T", "actuators: F_coeff tau", "springs", "dampers"}),
        (wrong_armature, {"inertia matrix D"}),
        (wrong_keyframe, {"equilibrium, keyframe"}),
    ],
)
def test_a_wrong_entry_in_mujoco_fails_in_its_row(
    monkeypatch: pytest.MonkeyPatch,
    spoil: Callable[[mujoco.MjModel], None],
    rows: set[str],
):
    def build_wrong(parameters: ArmParameters) -> mujoco.MjModel:
        model = build_model(parameters)
        spoil(model)
        return model

    monkeypatch.setattr(validation, "build_model", build_wrong)
    assert rows <= failures(validate(arm_with(2), states=STATES))


def test_stepping_rk4_in_halves_is_euler_and_fails(monkeypatch: pytest.MonkeyPatch):
    def step_in_halves(model: mujoco.MjModel, data: mujoco.MjData, count: int) -> None:
        for _ in range(count):
            mujoco.mj_step1(model, data)
            mujoco.mj_step2(model, data)

    monkeypatch.setattr(mujoco, "mj_step", step_in_halves)
    failed = failures(validate(arm_with(1), states=5))
    assert "order of convergence, RK4" in failed
    assert "free motion against DOP853, RK4" in failed
    assert "energy drift without damping" in failed


# What the report stands on.


def test_one_module_oscillates_as_two_springs_on_a_mass():
    p = arm_with(1)
    k = p.stiffness[:, 0].sum()
    slide, hinge = np.sqrt(k / p.mass[0]), np.sqrt(k * (0.5 * p.width[0]) ** 2 / p.inertia[0])
    frequencies = 2.0 * np.pi * free_motion.undamped_frequencies(p)
    np.testing.assert_allclose(frequencies, sorted([slide, hinge]), rtol=1e-14)
    fastest = modes.rates(p, lagrange.equilibrium(p))
    c = p.damping[:, 0].sum()
    np.testing.assert_allclose(fastest.real.min(), -0.5 * c / p.mass[0], rtol=1e-12)


def test_slow_modes_are_measured_with_steps_that_the_fastest_mode_bears():
    p = arm_with(2).scaled(stiffness=np.array([1.0, 3e3]))
    frequencies = free_motion.undamped_frequencies(p)
    # A 200th of the longest period is beyond what RK4 bears of the shortest one.
    assert 1.0 / frequencies[0] / 200 > np.sqrt(8.0) / (2.0 * np.pi * frequencies[-1])
    measured = free_motion.measured_frequencies(build_model(p), p)
    np.testing.assert_allclose(measured, frequencies, rtol=1e-6)


def test_a_step_too_long_for_the_reference_is_taken_back():
    p = arm_with(3).scaled(damping=20.0)
    q, v = free_motion.initial_motion(p, np.random.default_rng(1))
    times = np.linspace(0.0, 0.2, 3)
    assert np.isfinite(free_motion.reference_motion(p, q, v, times=times)).all()


def test_the_reference_of_one_module_is_the_closed_form():
    p = arm_with(1).scaled(damping=0.0)
    still = lagrange.equilibrium(p)
    start = np.array([0.02, 0.3])
    motion = free_motion.reference_motion(p, still + start, np.zeros(2))
    t = np.linspace(0.0, free_motion.DURATION, free_motion.SAMPLES + 1)[:, None]
    k = p.stiffness[:, 0].sum() * np.array([1.0, 0.25 * p.width[0] ** 2])
    w = np.sqrt(k / np.array([p.mass[0], p.inertia[0]]))
    np.testing.assert_allclose(motion, still + start * np.cos(w * t), rtol=0.0, atol=1e-10)


def test_a_reference_that_diverges_ends_as_nan(monkeypatch: pytest.MonkeyPatch):
    right, calls = lagrange.forward_dynamics, list[None]()

    def pushed(p: ArmParameters, q: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
        calls.append(None)
        return right(p, q, v, force + 3.0 * lagrange.damping_matrix(p) @ v)

    monkeypatch.setattr(lagrange, "forward_dynamics", pushed)
    p = arm_with(2)
    motion = free_motion.reference_motion(p, lagrange.equilibrium(p) + 0.01, np.ones(4))
    assert np.isnan(motion[-1]).all()
    assert len(calls) < 20_000


def test_relative_error_is_per_state_and_passes_nan_on():
    expected = np.array([[1.0, 100.0], [0.0, 1e-3]])
    measured = expected + np.array([[0.0, 1e-6], [1e-9, 0.0]])
    assert mechanics.relative_error(measured, expected) == pytest.approx(1e-6)
    assert mechanics.relative_error(np.zeros((2, 3)), np.zeros((2, 3))) == 0.0
    assert mechanics.relative_error(np.ones((1, 1)), np.zeros((1, 1))) == 1.0
    measured[1, 1] = np.nan
    assert np.isnan(mechanics.relative_error(measured, expected))


# Other arms.


def test_arm_with_cuts_and_extends_the_nominal_arm():
    nominal = nominal_parameters()
    assert arm_with(3).to_dict() == nominal.to_dict()
    np.testing.assert_array_equal(arm_with(2).stiffness, nominal.stiffness[:, :2])
    longer = arm_with(7)
    assert longer.modules == 7
    np.testing.assert_allclose(longer.mass[[0, 3, 6]], nominal.mass)
    assert (np.diff(longer.mass) < 0.0).all()
    with pytest.raises(ValueError, match="at least 1"):
        arm_with(0)


@pytest.mark.parametrize("modules", [1, 3, 6])
def test_random_arms_hang_stably_and_suit_rk4_at_1_ms(modules: int):
    rng = np.random.default_rng(2)
    for _ in range(50):
        p = random_arm(rng, modules)
        rates = modes.rates(p, lagrange.equilibrium(p))
        assert rates.real.max() < 0.0
        z = 1e-3 * rates
        growth = 1.0 + z * (1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0)))
        assert np.abs(growth).max() < 1.0
        assert (p.stiffness[0] != p.stiffness[1]).all()
        assert (p.damping[0] != p.damping[1]).all()


# The report itself.


@pytest.mark.parametrize(
    ("check", "passed"),
    [
        (Check("error", 1e-13, 1e-12), True),
        (Check("error", 1e-12, 1e-12), True),
        (Check("error", 2e-12, 1e-12), False),
        (Check("error", np.nan, 1e-12), False),
        (Check("error", np.inf, 1e-12), False),
        (Check("order", 4.0, 4.3, 3.7), True),
        (Check("order", 3.6, 4.3, 3.7), False),
        (Check("order", np.nan, 4.3, 3.7), False),
    ],
)
def test_a_check_passes_inside_its_bounds_only(check: Check, passed: bool):
    assert check.passed is passed


def test_a_report_with_nan_fails_and_is_still_json(nominal: CheckTable):
    report = CheckTable("lost", nominal.parameters, 1, 0, (Check("lost", np.nan, 1.0),))
    assert not report.passed
    row = json.loads(json.dumps(report.to_dict(), allow_nan=False))["checks"][0]
    assert row == {
        "what": "lost",
        "measured": None,
        "low": None,
        "high": 1.0,
        "unit": "1",
        "passed": False,
    }
    assert "FAIL" in str(report)
    assert "1 of 1 checks FAILED" in str(report)


def test_the_report_in_json_says_what_was_compared(nominal: CheckTable):
    content = json.loads(json.dumps(nominal.to_dict(), allow_nan=False))
    assert content["passed"] is True
    assert content["states"] == STATES
    again = ArmParameters.from_dict(content["parameters"])
    assert again.to_dict() == nominal.parameters
    assert len(content["checks"]) == len(nominal.checks)


def test_the_table_is_aligned_and_has_every_row(nominal: CheckTable):
    lines = str(nominal).splitlines()
    assert lines[0] == nominal.title
    assert "3 modules" in nominal.title
    header = next(line for line in lines if line.startswith("what"))
    rows = [line for line in lines if line.endswith("pass")]
    assert len(rows) == len(nominal.checks)
    assert len({line.index("pass") for line in rows}) == 1
    for check, row in zip(nominal.checks, rows, strict=True):
        assert row.startswith(check.what)
        assert row[header.index("allowed") :].startswith(check.allowed)
    assert lines[-1] == f"all {len(nominal.checks)} checks passed"
