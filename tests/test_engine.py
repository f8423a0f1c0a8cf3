"""The analytic arm as an engine: against MuJoCo, against mathematics, and bit for bit."""
# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)

import builtins
import dataclasses
import importlib.util
import pickle
import sys
from typing import Any

import mujoco
import numba
import numpy as np
import pytest
from numpy.random import SeedSequence
from test_disturbances import SPELLINGS
from test_disturbed_runs import ALL

from controllers import make_controller
from octarm.arm import lagrange
from octarm.arm.actuation import ACTUATIONS
from octarm.arm.mjcf import (
    build_model,
    build_slim_model,
    nominal_parameters,
    paper_order,
    read_parameters,
)
from octarm.arm.parameters import ArmParameters
from octarm.arm.recursion import kept
from octarm.checks import free_motion
from octarm.checks.mechanics import (
    lagrange_mechanics,
    mujoco_mechanics,
    random_states,
    relative_error,
)
from octarm.checks.validation import arm_with, random_arm
from octarm.disturbances.episode import Plant
from octarm.disturbances.spelling import DISTURBANCES, parse_disturbance
from octarm.simulation import lagrange_kernel
from octarm.simulation.analytic import LagrangePhysics
from octarm.simulation.environment import load
from octarm.simulation.physics import BatchPhysics
from octarm.simulation.rollout import rollout, simulate

P = nominal_parameters()


def arms_alike(n: int, modules: int = 3) -> ArmParameters:
    """n different arms: those of a smaller batch come first."""
    arms = [random_arm(np.random.default_rng(i), modules) for i in range(n)]
    fields = [arm.to_dict() for arm in arms]
    return ArmParameters(**{name: [each[name] for each in fields] for name in fields[0]})


def lively(physics: LagrangePhysics, seed: int = 0) -> None:
    """Arm i gets a state, inputs and a plant that depend on i alone."""
    n = len(physics.coordinates.names)
    rows = [np.random.default_rng([seed, i]).normal(size=(3, n)) for i in range(len(physics.q()))]
    x = np.stack(rows)
    physics.set_motion(physics.hanging() * (1.0 + 0.1 * x[:, 0]) + 0.02 * x[:, 0], x[:, 1])
    physics.set_control(5.0 * x[:, 2])


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("arms", [1, 2, 3, 4, 5, 7, 8, 15, 16, 17, 64, 1000])
def test_bits_do_not_depend_on_the_batch_nor_on_threads(arms: int, threads: int):
    parameters = arms_alike(32)
    each = ArmParameters(
        **{k: np.asarray(x)[np.arange(arms) % 32] for k, x in parameters.to_dict().items()}
    )
    physics = LagrangePhysics(each, arms, ACTUATIONS["f-coeff"](each.widths), threads=threads)
    lively(physics)
    physics.step(20)
    q, v = physics.q(), physics.v()
    for i in {0, arms // 2, arms - 1}:
        arm = each.arm(i)
        single = LagrangePhysics(arm, None, ACTUATIONS["f-coeff"](arm.widths))
        x = np.random.default_rng([0, i]).normal(size=(3, 6))
        single.set_motion(single.hanging() * (1.0 + 0.1 * x[0]) + 0.02 * x[0], x[1])
        single.set_control(5.0 * x[2])
        single.step(20)
        np.testing.assert_array_equal(single.q(), q[i])
        np.testing.assert_array_equal(single.v(), v[i])


def test_arms_that_share_their_parameters_have_the_bits_of_those_that_do_not():
    n = 37
    same = ArmParameters(**{k: np.broadcast_to(x, (n, *x.shape)) for k, x in fields(P).items()})
    motions = []
    for parameters in (P, same):
        physics = LagrangePhysics(parameters, n, ACTUATIONS["f-coeff"](P.widths))
        lively(physics)
        physics.step(10)
        motions.append(physics.q())
    np.testing.assert_array_equal(*motions)


def fields(p: ArmParameters) -> dict[str, np.ndarray]:
    return {name: np.asarray(x) for name, x in p.to_dict().items()}


def any_arm(modules: int, seed: int = 0) -> ArmParameters:
    """Modules that are bent without force, and have a backbone beside their columns."""
    draw = np.random.default_rng([seed, modules])
    arm = random_arm(draw, modules)
    along, turning = draw.uniform(0.0, 400.0, modules), draw.uniform(0.0, 0.5, modules)
    return dataclasses.replace(
        arm,
        width=draw.uniform(0.06, 0.1, modules),
        rest_angle=draw.uniform(-0.2, 0.2, modules),
        backbone_stiffness=[along, turning],
        backbone_damping=[0.01 * along, 0.01 * turning],
    )


@pytest.mark.parametrize("modules", [1, 3, 7])
def test_mujoco_is_the_analytic_model_for_any_backbone_and_any_bend_without_force(modules: int):
    arm = any_arm(modules)
    model, states = build_model(arm), random_states(arm, 50, np.random.default_rng(1))
    by_mujoco, by_lagrange = mujoco_mechanics(model, arm, states), lagrange_mechanics(arm, states)
    for name in by_mujoco:
        assert relative_error(by_mujoco[name], by_lagrange[name]) < 1e-12, name
    read = read_parameters(model)
    for name, value in fields(arm).items():
        np.testing.assert_array_equal(getattr(read, name), value)
    rest = lagrange.equilibrium(arm)
    assert np.abs(rest[modules:]).max() > 0.01  # it hangs bent
    np.testing.assert_allclose(model.key("hanging").qpos[paper_order(model)[0]], rest, atol=1e-12)


@pytest.mark.parametrize("disturbance", ["mismatch:0.2", "mismatch:0,damping=0", "drift:0.2"])
@pytest.mark.parametrize("engine", ["lagrange", "mujoco"])
def test_arms_with_a_backbone_move_alike_in_batches_and_under_changes(disturbance, engine):
    arms = [any_arm(3, seed) for seed in range(3)]
    each = ArmParameters(**{k: [fields(a)[k] for a in arms] for k in fields(arms[0])})
    change = [parse_disturbance(disturbance)]
    alone = [load(parameters=a, disturbances=change, engine="mujoco") for a in arms]
    together = load(parameters=each, batch=3, disturbances=change, engine=engine)
    push = 5.0 * np.random.default_rng(0).normal(size=(3, 6))
    for environment, tau in zip([*alone, together], [*push, push], strict=True):
        environment.reset()
        for _ in range(50):
            environment.step(tau)
    q = np.stack([environment.physics.q() for environment in alone])
    exact = engine == "mujoco"
    np.testing.assert_allclose(together.physics.q(), q, rtol=0, atol=0.0 if exact else 1e-12)
    plants = [environment.physics.plant().parameters for environment in alone]
    changed = together.physics.plant().parameters if engine == "lagrange" else None
    if changed is not None:
        for i, plant in enumerate(plants):
            for name, value in fields(plant).items():
                np.testing.assert_allclose(getattr(changed.arm(i), name), value, rtol=1e-14)


@pytest.mark.parametrize("actuation", ACTUATIONS)
@pytest.mark.parametrize("modules", [1, 2, 3, 5, 15, 30])
def test_a_step_is_that_of_mujoco(modules: int, actuation: str):
    """Also with gravity turned and forces in addition, to 1e-14.

    Solving for accelerations adds what the condition of the mass matrix, 1e6 at 30 modules, makes
    of rounding.
    """
    n, arm = 20, random_arm(np.random.default_rng(modules), modules)
    forces = ACTUATIONS[actuation](arm.widths)
    h = 1e-4 if modules > 5 else 5e-4
    engines = [
        LagrangePhysics(arm, n, forces, timestep=h),
        BatchPhysics(build_slim_model(arm, h), n, forces),
    ]
    draw = np.random.default_rng(0)
    x = draw.normal(size=(3, n, 2 * modules)) / np.sqrt(modules)
    added = 0.1 * draw.normal(size=(n, 2 * modules))
    for physics in engines:
        physics._write(Plant(arm, np.full(n, 0.3)))
        q = engines[0].hanging() * (1.0 + 0.2 * x[0])
        q[:, modules:] += 0.5 * x[0, :, modules:]
        physics.set_motion(q, x[1])
        physics.set_control(5.0 * x[2])
        physics._added[physics._qvel_index] = added.T
        physics.step()
    (q, v), (q_mujoco, v_mujoco) = ((p.q(), p.v()) for p in engines)
    condition = np.linalg.cond(lagrange.mass_matrix(arm, q)).max()
    rounding = 1e-14 if modules <= 3 else 1e-14 + 1e-17 * condition
    np.testing.assert_allclose(q, q_mujoco, rtol=0, atol=rounding)
    np.testing.assert_allclose(v, v_mujoco, rtol=0, atol=rounding * np.abs(v_mujoco).max())


@pytest.mark.parametrize("name", DISTURBANCES)
def test_under_every_disturbance_it_moves_as_mujoco_does(name: str):
    controller = make_controller("smc-boundary", P.mismatched(-0.3))
    motions = []
    for engine in ("lagrange", "mujoco"):
        disturbances = [parse_disturbance(SPELLINGS[name])]
        environment = load(disturbances=disturbances, batch=2, seed=3, engine=engine)
        rows: list[np.ndarray] = []
        simulate(environment, controller, 0.1, lambda i, rows=rows: rows.append(i.q))
        motions.append(np.stack(rows))
    assert np.ptp(motions[0], axis=0).max() > 1e-4
    np.testing.assert_allclose(*motions, rtol=0, atol=1e-11)


def test_everything_at_once_for_a_second():
    controller = make_controller("afsmc", P.mismatched(0.3))
    runs = [
        rollout(load(disturbances=ALL, seed=4, engine=engine), controller, 1.0)
        for engine in ("lagrange", "mujoco")
    ]
    for name, array in runs[0].arrays():
        size = np.abs(array).max() + 1e-3
        np.testing.assert_allclose(array, dict(runs[1].arrays())[name], rtol=0, atol=1e-9 * size)


def test_free_motion_converges_with_order_four():
    q, v = free_motion.initial_motion(P, np.random.default_rng(1))
    reference = free_motion.reference_motion(P, q, v)[10]
    end = 10 * free_motion.DURATION / free_motion.SAMPLES
    errors = []
    for steps in (400, 800, 1600):
        physics = LagrangePhysics(P, None, ACTUATIONS["internal"](P.widths), timestep=end / steps)
        physics.set_motion(q, v)
        physics.step(steps)
        errors.append(np.abs(physics.q() - reference).max())
    orders = np.diff(-np.log2(errors))
    assert np.all(np.abs(orders - 4.0) < 0.3)
    assert errors[-1] < 1e-8


def test_energy_is_kept_without_damping():
    arm = P.scaled(damping=0.0)
    q, v = free_motion.initial_motion(arm, np.random.default_rng(2))
    physics = LagrangePhysics(arm, None, ACTUATIONS["internal"](arm.widths), timestep=1e-4)
    physics.set_motion(q, v)
    before = sum(lagrange.energy(arm, q, v))
    physics.step(5000)
    kinetic, potential = lagrange.energy(arm, physics.q(), physics.v())
    assert abs(kinetic + potential - before) < 1e-7 * kinetic


def test_it_hangs_still():
    physics = load(batch=4, engine="lagrange").physics
    rest = physics.hanging()
    physics.set_motion(rest, np.zeros_like(rest))
    physics.step(100)
    np.testing.assert_allclose(physics.q(), rest, rtol=0, atol=1e-14)


def test_cosine_and_sine_are_good_to_their_last_bit():
    @numba.njit
    def values(x, cos, sin):
        for i in range(len(x)):
            cos[i], sin[i] = lagrange_kernel.cos_sin(x[i])

    x = np.concatenate([np.linspace(0.0, 7.0, 100_001), np.linspace(0.0, 200.0, 100_001)])
    x = np.concatenate([x, -x])
    cos, sin = np.empty_like(x), np.empty_like(x)
    values(x, cos, sin)
    np.testing.assert_allclose(cos, np.cos(x), rtol=0, atol=2.3e-16)
    np.testing.assert_allclose(sin, np.sin(x), rtol=0, atol=2.3e-16)
    half = len(x) // 2  # even and odd, to the last bit
    np.testing.assert_array_equal(cos[:half], cos[half:])
    np.testing.assert_array_equal(sin[:half], -sin[half:])


def test_the_model_of_the_scene_follows_the_recorded_coordinates():
    """What draws an arm asks MuJoCo's model, which the engine does not have, for coordinates."""
    run = rollout(load(engine="lagrange"), make_controller("pd", P), 0.1)
    model, physics = build_model(), load(engine="lagrange").physics
    data = mujoco.MjData(model)
    data.qpos[[0, 2, 4, 1, 3, 5]] = run.q[-1]
    mujoco.mj_forward(model, data)
    physics.set_motion(run.q[-1], run.v[-1])
    np.testing.assert_allclose(
        physics.tip_position(), data.sensor("tip_position").data, rtol=0, atol=1e-15
    )


@pytest.mark.parametrize("batch", [None, 3])
def test_copies_and_pickles_go_on_alike_and_on_their_own(batch: int | None):
    environment = load(disturbances=ALL, batch=batch, engine="lagrange", threads=2)
    environment.reset()
    physics = environment.physics
    shape = physics.q().shape
    inputs = np.random.default_rng(0).normal(size=(40, *shape))
    for tau in inputs[:17]:
        environment.step(tau)
    twins = [physics.copy(), pickle.loads(pickle.dumps(physics)), physics]
    for each in twins:
        for tau in inputs[17:]:
            each.set_control(tau)
            each.step(2)
    for twin in twins[:2]:
        np.testing.assert_array_equal(twin.q(), physics.q())
        np.testing.assert_array_equal(twin.received(), physics.received())


def test_a_repeated_run_has_the_same_digest_and_states_count():
    controller = make_controller("pd", P)
    first, again = (
        rollout(load(disturbances=ALL, engine="lagrange"), controller, 0.05) for _ in range(2)
    )
    other = rollout(load(disturbances=ALL, seed=1, engine="lagrange"), controller, 0.05)
    assert first.digest == again.digest != other.digest
    assert "q_measured" in first.signals


def test_unknown_engines_are_refused():
    with pytest.raises(ValueError, match="unknown engine 'lagrang', did you mean 'lagrange'"):
        load(engine="lagrang")


def test_without_numba_it_says_what_to_install(monkeypatch):
    real, find = builtins.__import__, importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == "numba" else find(name)
    )

    def no_numba(name: str, *rest: Any, **keys: Any) -> Any:
        if name == "numba" or name.startswith("numba."):
            raise ModuleNotFoundError("No module named 'numba'", name="numba")
        return real(name, *rest, **keys)

    for name in ("octarm.simulation.analytic", "octarm.simulation.lagrange_kernel"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.setattr(builtins, "__import__", no_numba)
    with pytest.raises(ValueError, match=r"needs the package numba: pip install 'octarm\[fast\]'"):
        load(engine="lagrange")
    assert load().physics.steps() == 0


def test_it_compiles_where_nothing_can_be_kept(monkeypatch):
    compiled = numba.njit

    def read_only(*args: Any, cache: bool = False, **options: Any) -> Any:
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return compiled(*args, **options)

    monkeypatch.setattr(numba, "njit", read_only)
    assert kept(numba.njit, lambda x: x + 1.0)(2.0) == 3.0


def test_seeds_of_arms_are_those_of_mujocos_arms():
    noise = [parse_disturbance("noise:0.4")]
    controller = make_controller("pd", P)
    for i, seed in enumerate(SeedSequence(0, spawn_key=(i,)) for i in range(2)):
        alone = rollout(load(disturbances=noise, seed=seed, engine="lagrange"), controller, 0.01)
        rows: list[np.ndarray] = []
        environment = load(disturbances=noise, batch=2, engine="lagrange")
        simulate(environment, controller, 0.01, lambda instant, rows=rows: rows.append(instant.q))
        np.testing.assert_array_equal(alone.q, np.stack(rows)[:, i])


def test_longer_arms_are_an_arm_too():
    arm = arm_with(15)
    controller = make_controller("pd", arm)
    runs = [
        rollout(load("set-point", parameters=arm, engine=e), controller, 0.05)
        for e in ("lagrange", "mujoco")
    ]
    np.testing.assert_allclose(runs[0].q, runs[1].q, rtol=0, atol=1e-11)
