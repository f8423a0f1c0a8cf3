"""Plants of more modules than the model: what is measured of them, and how inputs move them."""
# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)

import pickle
from typing import Any

import mujoco
import numpy as np
import pytest

from controllers import make_controller
from octarm.arm import lagrange
from octarm.arm.actuation import ACTUATIONS
from octarm.arm.groups import Groups
from octarm.arm.kinematics import arc_tip, tip, tip_force
from octarm.arm.mjcf import build_model, nominal_parameters, paper_order
from octarm.arm.parameters import ArmParameters
from octarm.arm.rod import LAYOUTS, Rod, arm_from_rod
from octarm.disturbances.spelling import parse_disturbance
from octarm.errors import OctarmError
from octarm.interfaces import Instant
from octarm.simulation.engines import ENGINES
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout, simulate

ARM = nominal_parameters()
TAU = np.array([4.0, -3.0, 2.0, 5.0, -4.0, 3.0])
EVERYTHING = [
    "pulse:1.5,on=tip-y,at=0.005,length=0.02",
    "noise:0.4",
    "payload:0.1,at=0.01",
    "random-mismatch:0.2",
    "drift:0.5",
    "measurement-noise:0.001",
    "actuation-delay:0.001",
]
each_layout = pytest.mark.parametrize("layout", LAYOUTS)


def bent(groups: Groups, seed: int, *batch: int) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and velocities of a plant in motion."""
    x, v = np.random.default_rng(seed).normal(size=(2, *batch, 2 * groups.plant.modules))
    straight = np.concatenate([groups.plant.rest_length, np.zeros(groups.plant.modules)])
    return straight * (1.0 + 0.1 * x) + 0.15 * (straight == 0.0) * x, v


def law(name: str, gain_set: str = "recommended", mismatch: float = 0.0) -> Any:
    return make_controller(name, ARM.mismatched(mismatch), gain_set=gain_set)


@pytest.mark.parametrize("modules", [3, 6, 15])
@each_layout
def test_the_chain_of_a_uniform_rod_is_that_of_the_rod(modules: int, layout: str):
    plant = Groups.of(arm_from_rod(Rod(), 3), modules, layout).plant
    rod = arm_from_rod(Rod(), modules, layout)
    for name, value in rod.to_dict().items():
        if name != "input_range":
            wanted = np.broadcast_to(value, np.shape(getattr(plant, name)))
            np.testing.assert_allclose(getattr(plant, name), wanted, rtol=1e-12, err_msg=name)


@each_layout
def test_a_group_has_the_length_mass_and_compliance_of_its_module(layout: str):
    groups = Groups.of(ARM, 15, layout)
    plant = groups.plant
    assert plant.rest_length.sum() + plant.tip_length == pytest.approx(0.36)
    assert plant.mass.sum() == pytest.approx(ARM.mass.sum())
    held = plant.inertia.sum() + (0.0 if layout == "paper" else 0.5 * ARM.inertia[0] / 5.0)
    assert held == pytest.approx(ARM.inertia.sum())  # the base holds the first half element
    # Under Q_M, small and without weight, measured coordinates give as the model's do.
    light, model = plant.scaled(gravity=1.0), ARM
    K_N, K_M = lagrange.stiffness_matrix(light), lagrange.stiffness_matrix(model)
    compliance = groups.matrix @ np.linalg.solve(K_N, groups.matrix.T)
    slides, bends = np.split(np.diag(compliance) * np.diag(K_M), 2)
    np.testing.assert_allclose(bends, 1.0, rtol=1e-12)
    if layout == "paper":
        np.testing.assert_allclose(slides, 1.0, rtol=1e-12)
    else:  # half weights: of what a border gives, a quarter of twice as much, and no rigid piece
        assert np.all(np.abs(slides[:-1] - 1.0) < 0.1) and 0.8 < slides[-1] < 0.9


def test_sums_over_groups_have_half_weights_at_the_borders_of_the_centred_layout():
    s, h = np.random.default_rng(0).random(9), 0.36 / 9.0
    q = np.concatenate([s, np.arange(9.0)])
    bends = [3.0, 12.0, 21.0]
    paper, centred = (Groups.of(ARM, 9, layout).measured(q) for layout in LAYOUTS)
    sums = s.reshape(3, 3).sum(axis=1)
    np.testing.assert_allclose(paper, [*sums, *bends], rtol=1e-14)
    wanted = [sums[0] + s[3] / 2, sums[1] - s[3] / 2 + s[6] / 2, sums[2] - s[6] / 2 + h / 2]
    np.testing.assert_allclose(centred, [*wanted, *bends], rtol=1e-14)
    velocity = Groups.of(ARM, 9, "centred").rates(q)
    np.testing.assert_allclose(velocity, [*wanted[:2], wanted[2] - h / 2, *bends], rtol=1e-14)


@each_layout
def test_unloaded_groups_are_as_long_as_modules(layout: str):
    arm = ArmParameters.from_dict(ARM.to_dict() | {"rest_length": [0.1, 0.14, 0.12]})
    groups = Groups.of(arm, 12, layout)
    straight = np.concatenate([groups.plant.rest_length, np.zeros(12)])
    np.testing.assert_allclose(groups.measured(straight)[:3], arm.rest_length, rtol=1e-14)
    assert groups.tip(straight) == pytest.approx([0.36, 0.0])


@each_layout
@pytest.mark.parametrize("actuation", ACTUATIONS)
def test_motors_do_the_work_of_inputs_on_what_is_measured(layout: str, actuation: str):
    groups = Groups.of(ARM, 15, layout)
    q, v = bent(groups, 1)
    measured = groups.measured(q)
    T = np.kron(np.eye(3), np.ones((1, 2)))
    T = np.vstack([T, np.kron(np.eye(3), [0.04, -0.04])])
    F = lagrange.force_coefficients(ARM, measured) if actuation == "f-coeff" else T
    force = ACTUATIONS[actuation](ARM.widths).force(measured, TAU)
    np.testing.assert_allclose(force, F @ TAU, rtol=1e-12, atol=1e-12)
    model = build_model(groups.plant)
    data, (place, speed) = mujoco.MjData(model), paper_order(model)
    data.qpos[place], data.qvel[speed], data.ctrl[:] = q, v, groups.ctrl(force)
    mujoco.mj_forward(model, data)
    exerted = data.qfrc_actuator[speed]
    np.testing.assert_allclose(exerted, groups.matrix.T @ F @ TAU, rtol=1e-12, atol=1e-12)
    assert exerted @ v == pytest.approx(force @ groups.rates(v), rel=1e-12)


@each_layout
def test_forces_on_groups_come_back_from_the_plant(layout: str):
    groups = Groups.of(ARM, 15, layout)
    force = np.random.default_rng(2).normal(size=(7, 6))
    np.testing.assert_allclose(groups.mean_force(groups.force(force)), force, rtol=1e-12)
    for product in (groups.force, groups.ctrl):  # alone and in a batch
        np.testing.assert_array_equal(product(force), [product(row) for row in force])


@each_layout
def test_maps_give_the_same_bits_alone_and_in_a_batch(layout: str):
    groups = Groups.of(ARM, 15, layout)
    q, _ = bent(groups, 3, 5)
    for part in (groups.measured, groups.rates, groups.tip, groups.mean_force):
        np.testing.assert_array_equal(part(np.asfortranarray(q)), [part(row) for row in q])
    sizes = ArmParameters.from_dict(
        ARM.to_dict() | {"rest_length": np.outer(np.arange(1.0, 6.0), ARM.rest_length)}
    )
    many = Groups.of(sizes, 15, layout)
    for i in range(5):
        one = Groups.of(sizes.arm(i), 15, layout)
        np.testing.assert_array_equal(many.measured(q)[i], one.measured(q[i]))
        np.testing.assert_array_equal(many.tip(q)[i], one.tip(q[i]))
        for name in one.plant.to_dict():
            same = getattr(one.plant, name)
            np.testing.assert_array_equal(getattr(many.plant.arm(i), name), same)


@pytest.mark.parametrize("engine", ENGINES)
@each_layout
def test_the_energy_balance_closes(layout: str, engine: str):
    h, groups = 1e-4, Groups.of(ARM, 15, layout)
    environment = load(plant_modules=15, layout=layout, timestep=h, engine=engine)
    environment.reset()
    physics = environment.physics
    physics.set_control(TAU)
    B, powers, energies = lagrange.damping_matrix(groups.plant), [], []
    for _ in range(1001):
        q, v, x = physics.q(), physics.v(), physics.plant_v()
        force = lagrange.force_coefficients(ARM, q) @ TAU
        powers.append(force @ v - x @ B @ x)
        energies.append(sum(lagrange.energy(groups.plant, physics.plant_q(), x)))
        physics.step()
    work = np.trapezoid(powers, dx=h)
    assert abs(np.sum(np.abs(powers)) * h) > 0.05
    assert energies[-1] - energies[0] == pytest.approx(work, abs=3e-6)


@each_layout
def test_inputs_are_of_second_order_in_the_step(layout: str):
    ends = []
    for h in (2e-4, 1e-4, 5e-5, 1.25e-5):
        environment = load(plant_modules=9, layout=layout, timestep=h, engine="lagrange")
        environment.reset()
        environment.physics.set_control(TAU)
        environment.physics.step(round(0.05 / h))
        ends.append(environment.physics.plant_q())
    errors = [np.max(np.abs(end - ends[-1])) for end in ends[:-1]]
    assert errors[1] < 1e-9 and errors[2] < 0.3 * errors[1]


@each_layout
def test_engines_agree_under_all_that_acts(layout: str):
    runs = [
        rollout(
            load(
                plant_modules=15, layout=layout, timestep=1e-4, engine=engine,
                disturbances=[parse_disturbance(text) for text in EVERYTHING],
            ),
            law("computed-torque"),
            0.04,
        )
        for engine in ENGINES
    ]  # fmt: skip
    for name, array in runs[0].arrays():
        if name != "force":
            other = dict(runs[1].arrays())[name]
            np.testing.assert_allclose(array, other, rtol=1e-9, atol=1e-9, err_msg=name)
    assert runs[0].signals["plant_q"].shape == (400, 30)
    np.testing.assert_allclose(
        Groups.of(ARM, 15, layout).measured(runs[0].signals["plant_q"]), runs[0].q, atol=1e-15
    )


@pytest.mark.parametrize("engine", ENGINES)
@each_layout
def test_an_arm_has_the_same_bits_alone_and_in_a_batch(layout: str, engine: str):
    options: dict[str, Any] = {
        "plant_modules": 6, "layout": layout, "timestep": 1e-4, "engine": engine,
        "disturbances": [parse_disturbance(text) for text in EVERYTHING],
    }  # fmt: skip
    seeds = [np.random.SeedSequence(0, spawn_key=(i,)) for i in range(20)]
    places: list[list[np.ndarray]] = []

    def note(x: Instant) -> None:
        assert x.plant_q is not None and x.plant_tip is not None
        places[-1].append(np.concatenate([x.q, x.v, x.plant_q, x.plant_tip], axis=-1))

    for threads in (1, 2):
        places.append([])
        environment = load(batch=20, seed=seeds, threads=threads, **options)
        simulate(environment, law("smc-boundary"), 0.02, note)
    np.testing.assert_array_equal(places[0], places[1])
    for i in (0, 7, 19):
        run = rollout(load(seed=seeds[i], **options), law("smc-boundary"), 0.02)
        alone = [run.q, run.v, run.signals["plant_q"], run.signals["plant_tip"]]
        np.testing.assert_array_equal(np.concatenate(alone, -1), np.stack(places[0])[:, i])


@pytest.mark.parametrize("engine", ENGINES)
def test_a_plant_of_as_many_modules_is_the_arm(engine: str):
    runs = [
        rollout(load(engine=engine, plant_modules=n), law("smc-boundary"), 0.05) for n in (None, 3)
    ]
    assert runs[0].digest == runs[1].digest and "plant_q" not in runs[1].signals
    environment = load(engine=engine)  # seen through groups of one module each
    environment.physics.see_through(Groups.of(ARM, 3))
    through = rollout(environment, law("smc-boundary"), 0.05)
    for name in ("q", "v", "tau"):
        one, other = getattr(runs[0], name), getattr(through, name)
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("engine", ENGINES)
@each_layout
def test_arms_of_different_size_have_plants_of_different_size(layout: str, engine: str):
    arms = ArmParameters.from_dict(
        ARM.to_dict()
        | {
            "rest_length": np.outer([1.0, 1.3], ARM.rest_length),
            "stiffness": np.multiply.outer([1.0, 0.8], ARM.stiffness),
            "tip_length": [0.0, 0.01],
        }
    )
    options: dict[str, Any] = {
        "plant_modules": 6, "layout": layout, "timestep": 1e-4, "engine": engine,
        "disturbances": [parse_disturbance("step:1,on=tip-y")],
    }  # fmt: skip
    seeds = [np.random.SeedSequence(i) for i in range(2)]
    environment = load(batch=2, seed=seeds, parameters=arms, **options)
    environment.reset()
    physics = environment.physics
    physics.set_control(np.tile(TAU, (2, 1)))
    physics.step(50)
    for i in range(2):
        single = load(seed=seeds[i], parameters=arms.arm(i), **options)
        single.reset()
        single.physics.set_control(TAU)
        single.physics.step(50)
        for part in ("q", "v", "plant_q", "disturbance", "hanging"):
            alone, row = (getattr(x, part)() for x in (single.physics, physics))
            np.testing.assert_array_equal(row[i], alone)
        tips = physics.tip_position()[i], single.physics.tip_position()
        np.testing.assert_allclose(*tips, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_copy_goes_on_as_the_original(engine: str):
    environment = load(
        plant_modules=9, layout="centred", timestep=1e-4, engine=engine,
        disturbances=[parse_disturbance("noise:0.4")],
    )  # fmt: skip
    environment.reset()
    original = environment.physics
    original.set_control(TAU)
    original.step(20)
    copies = [original.copy(), pickle.loads(pickle.dumps(original))]
    for physics in (original, *copies):
        physics.step(20)
    for physics in copies:
        assert len(physics.coordinates.names) == 6
        for part in ("q", "v", "plant_q", "tau"):
            np.testing.assert_array_equal(getattr(physics, part)(), getattr(original, part)())


def test_the_tip_is_pushed_where_it_is():
    groups = Groups.of(ARM, 15, "centred")
    q, v = bent(groups, 4)
    (x, y), eps = (0.7, -1.3), 1e-6
    push = np.array([x, y])
    power = push @ (groups.tip(q + eps * v) - groups.tip(q - eps * v)) / (2.0 * eps)
    assert tip_force(q, x, y, 0.5 * 0.36 / 15.0) @ v == pytest.approx(power, rel=1e-8)
    environment = load(
        plant_modules=15, layout="centred", timestep=1e-4,
        disturbances=[parse_disturbance("step:2,on=tip-y")],
    )  # fmt: skip
    environment.reset()
    physics = environment.physics
    physics.step()
    rest = physics.plant_rest()
    added = physics.data.qfrc_applied[paper_order(physics.model.ptr)[1]]
    np.testing.assert_allclose(added, tip_force(rest, 0.0, 2.0, 0.012), rtol=1e-12)
    np.testing.assert_allclose(physics.tip_position()[2], -groups.tip(rest)[0], atol=1e-6)


def test_arcs_are_what_many_modules_come_to():
    q = np.array([0.13, 0.11, 0.12, 0.5, -0.8, 0.0])
    exact = np.array(arc_tip(q))
    np.testing.assert_array_equal(np.stack(arc_tip(np.stack([q, q])), -1)[1], exact)
    errors: dict[str, list[float]] = {}
    for layout in LAYOUTS:
        for n in (8, 16, 32):
            arm = ArmParameters.from_dict(ARM.to_dict() | {"rest_length": q[:3]})
            groups = Groups.of(arm, 3 * n, layout)
            bends = groups.each_module(q[3:] / n)
            place = groups.tip(np.concatenate([groups.plant.rest_length, bends]))
            errors.setdefault(layout, []).append(float(np.hypot(*(place - exact))))
    paper, centred = np.log2([np.divide(errors[x][:-1], errors[x][1:]) for x in LAYOUTS])
    np.testing.assert_allclose(paper, 1.0, atol=0.1)
    np.testing.assert_allclose(centred, 2.0, atol=0.1)
    assert np.hypot(*(np.array(tip(q)) - exact)) > 0.01  # of three modules


def test_groups_share_what_is_drawn_and_payloads_are_at_the_last_plate():
    environment = load(
        plant_modules=15, timestep=1e-4,
        disturbances=[parse_disturbance(x) for x in ("random-mismatch:0.3", "payload:0.2")],
    )  # fmt: skip
    environment.reset()
    environment.physics.step()
    plant = environment.physics.plant().parameters
    mass = plant.mass - 0.2 * (np.arange(15) == 14)
    factors = mass / np.repeat(ARM.mass / 5.0, 5)
    assert np.ptp(factors) > 0.03
    np.testing.assert_allclose(factors, np.repeat(factors[::5], 5), rtol=1e-12)


def test_the_step_must_suit_the_plant():
    with pytest.raises(OctarmError, match=r"decays at .* it must be at most 0\.000362 s"):
        load(plant_modules=15).reset()
    environment = load(plant_modules=15, timestep="auto", control_period=5e-4)
    assert environment.physics.timestep() == pytest.approx(2.5e-4)


@pytest.mark.parametrize(
    ("modules", "layout", "sentence"),
    [
        (10, "paper", "the plant is to have 10 modules; it must be a multiple of the arm's 3, at"),
        (2, "centred", "the plant is to have 2 modules; it must be a multiple of the arm's 3"),
        (102, "paper", "at most 100"),
        (15, "center", "unknown layout 'center', did you mean 'centred'?"),
        (None, "center", "unknown layout 'center', did you mean 'centred'?"),
        (None, "centred", "plant_modules must say of how many"),
        (7.5, "paper", "plant_modules is 7.5; it must be a whole number"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(modules: Any, layout: str, sentence: str):
    with pytest.raises(OctarmError, match="(?s)" + sentence.replace("?", r"\?")):
        load(plant_modules=modules, layout=layout)


# Worst slide [mm] and bend [mrad] after 1 s of the default sine; None where tracking is lost.
LIMITS: list[tuple[str, str, float, int, float, float, float]] = [
    ("smc-boundary", "recommended", 0.0, 15, 1e-4, 3.0, 25.0),
    ("smc-boundary", "recommended", -0.3, 15, 1e-4, 1.5, 35.0),
    ("computed-torque", "recommended", 0.0, 15, 1e-4, 1.5, 10.0),
    ("afsmc", "tuned", 0.0, 15, 1e-4, 0.01, 1.0),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "gains", "mismatch", "n", "period", "slide", "bend"), LIMITS)
def test_fast_loops_hold_a_plant_that_is_not_their_model(
    name: str, gains: str, mismatch: float, n: int, period: float, slide: float, bend: float
):
    environment = load(plant_modules=n, timestep="auto", control_period=period, engine="lagrange")
    run = rollout(environment, law(name, gains, mismatch), 2.0)
    slides, bends = np.split(np.max(np.abs(run.error[run.t > 1.0]), axis=0), 2)
    assert run.status == "ok" and np.max(slides) < 1e-3 * slide and np.max(bends) < 1e-3 * bend


@pytest.mark.slow
@pytest.mark.parametrize(("name", "n", "period"), [("smc-boundary", 15, 5e-4), ("afsmc", 30, 3e-4)])
def test_tuned_gains_lose_such_a_plant_at_the_usual_period(name: str, n: int, period: float):
    environment = load(plant_modules=n, timestep="auto", control_period=period, engine="lagrange")
    run = rollout(environment, law(name, "tuned"), 1.0)
    on_arm = rollout(load(engine="lagrange"), law(name, "tuned"), 1.0)
    late = run.t > 0.5
    assert np.max(np.abs(on_arm.error[on_arm.t > 0.5, 3:])) < 2e-3
    assert run.status == "diverged" or np.max(np.abs(run.error[late, 3:])) > 0.01


@pytest.mark.slow
@pytest.mark.parametrize(
    ("layout", "lumped", "arcs"), [("paper", 28.1, 8.05), ("centred", 35.3, 0.83)]
)
def test_where_groups_track_the_tip_is_near_the_end_of_arcs(
    layout: str, lumped: float, arcs: float
):
    environment = load(plant_modules=15, layout=layout, timestep=1e-4, engine="lagrange")
    run = rollout(environment, law("super-twisting", "tuned"), 4.0)
    late = run.t > 2.0
    assert np.max(np.abs(run.error[late])) < 5e-5
    for kinematics, distance in ((tip, lumped), (arc_tip, arcs)):
        apart = run.signals["plant_tip"] - np.stack(kinematics(run.q_d), axis=-1)
        assert 1e3 * np.max(np.hypot(*apart[late].T)) == pytest.approx(distance, rel=0.01)


@each_layout
@pytest.mark.parametrize("arms", [1, 2, 65])
def test_sums_over_groups_are_added_in_order_whatever_the_batch(layout: str, arms: int):
    groups = Groups.of(ARM, 30, layout)
    v = np.random.default_rng(0).normal(size=(arms, 60))
    expected = np.zeros((arms, 6))
    for row, weights in enumerate(groups.matrix):
        for column in np.flatnonzero(weights):
            expected[:, row] += weights[column] * v[:, column]
    for same in (v, np.asfortranarray(v)):
        np.testing.assert_array_equal(groups.rates(same), expected)
    np.testing.assert_array_equal([groups.rates(one) for one in v], expected)
    np.testing.assert_array_equal(groups.rates(np.stack([v, v]))[1], expected)
    assert not np.signbit(groups.rates(np.full((arms, 60), -0.0))).any()
    for place, other in zip(tip(v), np.array([tip(one) for one in v]).T, strict=True):
        np.testing.assert_array_equal(place, other)


def test_tips_of_the_plant_can_be_left_out():
    environment = load(plant_modules=9, batch=2, control_period=0.001, timestep=0.0005)
    environment.reset()
    environment.step(np.zeros((2, 6)))
    q, received, tips = environment.physics.within()
    assert tips is not None and tips.shape == (2, 2, 2)
    environment.physics.plant_tips = False
    environment.reset()
    environment.step(np.zeros((2, 6)))
    again = environment.physics.within()
    assert again[2] is None
    np.testing.assert_array_equal(again[0], q)
    np.testing.assert_array_equal(again[1], received)
