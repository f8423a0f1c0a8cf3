"""The compiled MuJoCo model holds the parameters it was built from, and nothing else."""
# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from octarm import ArmParameters
from octarm.arm import lagrange
from octarm.arm.mjcf import (
    build_model,
    build_slim_model,
    nominal_parameters,
    paper_order,
    read_parameters,
    template_model,
    world_position,
)
from octarm.arrays import coordinate_names

MODULES = pytest.mark.parametrize("n", [1, 2, 3, 5, 7, 12])
REACTIONS = ["reaction_1_{i}", "reaction_2_{i}"]
NAMED = ["body", "joint", "geom", "site", "camera", "light", "tendon", "actuator", "sensor", "key"]


def random_arm(seed: int, n: int) -> ArmParameters:
    rng = np.random.default_rng(seed)
    return ArmParameters(
        mass=rng.uniform(0.1, 0.4, n),
        inertia=rng.uniform(2e-4, 9e-4, n),
        width=rng.uniform(0.05, 0.12),
        stiffness=rng.uniform(500, 1500, (2, n)),
        damping=rng.uniform(2, 15, (2, n)),
        rest_length=rng.uniform(0.08, 0.15, n),
        gravity=rng.uniform(5, 12),
    )


def numbers(struct: object) -> dict[str, np.ndarray]:
    """Every numeric field of a MuJoCo structure."""
    values = {n: getattr(struct, n) for n in dir(struct) if not n.startswith("_")}
    return {
        name: np.asarray(value)
        for name, value in values.items()
        if isinstance(value, int | float | np.ndarray)
    }


def assert_same_model(actual: mujoco.MjModel, expected: mujoco.MjModel, rounding: float) -> None:
    for part in (lambda m: m, lambda m: m.opt, lambda m: m.stat, lambda m: m.vis.global_):
        left, right = numbers(part(actual)), numbers(part(expected))
        assert left.keys() == right.keys()
        for name in left:
            np.testing.assert_allclose(left[name], right[name], rtol=0, atol=rounding, err_msg=name)
    assert actual.names == expected.names


def state(model: mujoco.MjModel, q: np.ndarray, v: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(model)
    positions, velocities = paper_order(model)
    data.qpos[positions], data.qvel[velocities] = q, v
    mujoco.mj_forward(model, data)
    return data


def random_state(seed: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    q = np.concatenate([rng.uniform(0.04, 0.25, n), rng.uniform(-1.5, 1.5, n)])
    return q, rng.uniform(-1, 1, 2 * n) * np.repeat([0.5, 6.0], n)


def test_the_default_model_is_the_file():
    assert_same_model(build_model(), template_model(), rounding=1e-15)


def test_the_nominal_parameters_give_the_default_model():
    assert_same_model(build_model(nominal_parameters()), build_model(), rounding=0)


@MODULES
def test_further_modules_have_their_parts_where_the_file_has_those_of_its_last_one(n):
    """Sensors and motors module by module, the tip on the last plate, each rod on its own plate."""
    model = build_model(random_arm(1, n))
    sensors = [model.sensor(i).name for i in range(model.nsensor)]
    parts = ("s_{}_position", "theta_{}_position", "column_1_{}_length", "column_2_{}_length")
    first = [part.format(i) for i in range(1, n + 1) for part in parts]
    assert sensors == ["tip_position", *(x for p in first for x in (p, velocity_beside(p)))]
    motors = [model.actuator(i).name for i in range(model.nu)]
    sides = [f"{a}_{i}" for i in range(1, n + 1) for a in (1, 2)]
    assert motors == [*(f"push_{x}" for x in sides), *(f"reaction_{x}" for x in sides[2:])]
    of = {"site": model.site_bodyid, "geom": model.geom_bodyid}
    for i in range(1, n + 1):
        own, below = model.body(f"module_{i}"), model.body("base" if i == 1 else f"module_{i - 1}")
        assert own.parentid == below.id
        assert of["geom"][model.geom(f"column_1_{i}_rod").id] == own.id
        assert of["geom"][model.geom(f"column_2_{i}_sleeve").id] == below.id
        assert i == 1 or of["site"][model.site(f"reaction_{i}").id] == below.id
    assert of["site"][model.site("tip").id] == model.body(f"module_{n}").id


def velocity_beside(sensor: str) -> str:
    return f"{sensor.rpartition('_')[0]}_velocity"


@MODULES
def test_parameters_survive_the_way_through_a_model(n):
    p = random_arm(1, n)
    back = read_parameters(build_model(p))
    for field in dataclasses.fields(p):
        np.testing.assert_array_equal(
            getattr(back, field.name), getattr(p, field.name), err_msg=field.name
        )


@MODULES
def test_the_parts_have_their_names(n):
    model = build_model(random_arm(2, n))
    of_module = {
        "body": ["module_{i}"],
        "joint": ["s_{i}", "theta_{i}"],
        "tendon": ["column_1_{i}", "column_2_{i}"],
        "actuator": ["push_1_{i}", "push_2_{i}", *REACTIONS],
        "sensor": [
            f"{part}_{quantity}"
            for part, first in (
                ("s_{i}", "position"),
                ("theta_{i}", "position"),
                ("column_1_{i}", "length"),
                ("column_2_{i}", "length"),
            )
            for quantity in (first, "velocity")
        ],
    }
    others = {"body": {"world", "base"}, "sensor": {"tip_position"}}
    for kind, patterns in of_module.items():
        expected = {p.format(i=i) for p in patterns for i in range(1, n + 1)}
        expected -= {p.format(i=1) for p in REACTIONS}  # the ground bears them anyway
        assert names(model, kind) == expected | others.get(kind, set())
    assert names(model, "key") == {"hanging"}
    assert len(names(model, "camera")) >= 2


def names(model: mujoco.MjModel, kind: str) -> set[str]:
    kind_of = getattr(mujoco.mjtObj, f"mjOBJ_{kind.upper()}")
    count = {"tendon": "ntendon", "camera": "ncam", "actuator": "nu", "joint": "njnt"}
    ids = range(getattr(model, count.get(kind, f"n{kind}")))
    return {mujoco.mj_id2name(model, kind_of, i) for i in ids}


@MODULES
@pytest.mark.parametrize("kind", NAMED)
def test_nothing_is_without_a_name(n, kind):
    found = names(build_model(random_arm(3, n)), kind)
    assert found
    assert None not in found


@MODULES
def test_the_model_is_stepped_by_rk4_with_springs_and_dampers_alone(n):
    model = build_model(random_arm(4, n))
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    off = mujoco.mjtDisableBit
    assert model.opt.disableflags == (
        off.mjDSBL_CONTACT | off.mjDSBL_CONSTRAINT | off.mjDSBL_AUTORESET
    )
    assert not model.jnt_limited.any()
    assert not model.actuator_ctrllimited.any()
    for extra in ("dof_armature", "dof_damping", "dof_frictionloss", "jnt_stiffness", "qpos0"):
        np.testing.assert_array_equal(getattr(model, extra), 0.0, err_msg=extra)


@MODULES
def test_the_keyframe_is_the_equilibrium_of_both_models(n):
    p = random_arm(5, n)
    model = build_model(p)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("hanging").id)
    mujoco.mj_forward(model, data)
    assert np.max(np.abs(data.qacc)) < 1e-9
    np.testing.assert_array_equal(data.qvel, 0.0)
    q = data.qpos[paper_order(model)[0]]
    np.testing.assert_allclose(q, lagrange.equilibrium(p), rtol=0, atol=1e-13)


def test_the_keyframe_of_the_file_is_the_equilibrium_of_its_numbers():
    model = build_model()
    q = model.key("hanging").qpos[paper_order(model)[0]]
    equilibrium = lagrange.equilibrium(nominal_parameters())
    np.testing.assert_allclose(q, equilibrium, rtol=0, atol=1e-15)


@MODULES
def test_only_the_modules_have_mass(n):
    p = random_arm(6, n)
    model = build_model(p)
    modules = [model.body(f"module_{i}").id for i in range(1, n + 1)]
    assert np.sum(model.body_mass) == pytest.approx(np.sum(p.mass), rel=1e-15)
    np.testing.assert_array_equal(model.body_mass[modules], p.mass)
    np.testing.assert_array_equal(model.body_inertia[modules], np.repeat(p.inertia[:, None], 3, 1))
    np.testing.assert_array_equal(model.body_ipos[modules], 0.0)


@MODULES
def test_every_module_and_the_tip_stand_where_lagrange_says(n):
    model = build_model(random_arm(7, n))
    q, v = random_state(7, n)
    data = state(model, q, v)
    expected = world_position(lagrange.positions(q))
    bodies = np.stack([data.body(f"module_{i}").xpos for i in range(1, n + 1)])
    np.testing.assert_allclose(bodies, expected, rtol=0, atol=1e-14)
    np.testing.assert_allclose(data.sensor("tip_position").data, expected[-1], rtol=0, atol=1e-14)


@MODULES
def test_sensors_read_joints_and_column_lengths(n):
    p = random_arm(8, n)
    q, v = random_state(8, n)
    data = state(build_model(p), q, v)
    for i in range(n):
        for quantity, length, x in (("position", "length", q), ("velocity", "velocity", v)):
            assert data.sensor(f"s_{i + 1}_{quantity}").data == x[i]
            assert data.sensor(f"theta_{i + 1}_{quantity}").data == x[n + i]
            for a, side in ((1, 0.5), (2, -0.5)):
                expected = x[i] + side * p.widths[i] * x[n + i]
                found = data.sensor(f"column_{a}_{i + 1}_{length}").data
                np.testing.assert_allclose(found, expected, rtol=1e-13)


@MODULES
def test_mujoco_and_lagrange_give_the_same_accelerations(n):
    p = random_arm(9, n)
    q, v = random_state(9, n)
    model = build_model(p)
    data = state(model, q, v)
    tau = np.random.default_rng(9).uniform(-20, 20, 2 * n)
    data.ctrl[:] = *tau, *tau[2:]
    mujoco.mj_forward(model, data)
    expected = lagrange.forward_dynamics(p, q, v, lagrange.force_coefficients(p, q) @ tau)
    found = data.qacc[paper_order(model)[1]]
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.max(np.abs(expected)))


def test_coordinate_names_are_in_the_papers_order():
    assert coordinate_names(2) == ["s1", "s2", "theta1", "theta2"]


def test_the_timestep_can_be_chosen_and_is_the_files_otherwise():
    assert build_model(timestep=1e-3).opt.timestep == 1e-3
    p = random_arm(10, 2)
    assert build_model(p, timestep=1e-3).opt.timestep == 1e-3
    assert build_model(p).opt.timestep == build_model().opt.timestep


@pytest.mark.parametrize("timestep", [0.0, -1e-3, np.nan, np.inf, 1e-300, 1.0])
def test_a_timestep_that_cannot_work_is_refused(timestep):
    with pytest.raises(ValueError, match=rf"^timestep is {timestep:g} s; it must be between"):
        build_model(timestep=timestep)


def test_a_batch_of_arms_is_no_model():
    with pytest.raises(ValueError, match=r"batch axes \(4,\)"):
        build_model(random_arm(11, 3).scaled(gravity=np.ones(4)))


def test_an_arm_too_soft_to_hang_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings to a file
    with pytest.raises(ValueError, match=r"no static equilibrium was found"):
        build_model(random_arm(12, 3).scaled(stiffness=1e-12))


@pytest.mark.parametrize(
    ("factors", "longer", "wider"), [({"rest_length": 2.0}, 2, 1), ({"width": 2.0}, 1, 2)]
)
def test_pictures_follow_the_sizes_of_the_arm(factors, longer, wider):
    p = nominal_parameters()
    before, after = build_model(p), build_model(p.scaled(**factors))
    for name in ("column_1_2_sleeve", "column_2_3_sleeve", "backbone_1_sleeve"):
        was, now = before.geom(name), after.geom(name)
        np.testing.assert_allclose(now.pos[:2], was.pos[:2] * [longer, wider])
        np.testing.assert_allclose(now.size[:2], was.size[:2] * [wider, longer])


@pytest.mark.parametrize("n", [1, 3, 5])
def test_the_slim_model_moves_with_the_same_bits(n: int):
    """Every bit of the integration state, over 500 steps from random states and inputs."""
    arm, states = random_arm(n, n), []
    for build in (build_model, build_slim_model):
        model = build(arm, 1e-3)
        data, (positions, velocities) = mujoco.MjData(model), paper_order(model)
        np.testing.assert_array_equal(model.key("hanging").qpos, build_model(arm).key_qpos[0])
        data.qpos[positions], data.qvel[velocities] = random_state(n, n)
        draw, rows = np.random.default_rng(n), []
        for _ in range(500):
            data.ctrl[:] = draw.normal(size=model.nu)
            data.qfrc_applied[:] = 0.01 * draw.normal(size=2 * n)
            mujoco.mj_step(model, data)
            rows.append(np.concatenate([data.qpos, data.qvel, data.qacc, [data.time]]))
        states.append(np.stack(rows))
    np.testing.assert_array_equal(*states)
    assert np.all(np.isfinite(states[0]))


def test_the_slim_model_has_nothing_but_what_moves():
    model = build_slim_model()
    empty = (model.ngeom, model.nsensor, model.ncam, model.nlight)
    assert empty == (0, 0, 0, 0)
    assert names(model, "site") == {"reaction_2", "reaction_3", "tip"}
    assert (model.nq, model.nu, model.ntendon, model.nkey) == (6, 10, 6, 1)
