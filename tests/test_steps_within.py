"""Metrics of what happens between control instants, and of the inputs that the arm received."""

import dataclasses
import itertools

import numpy as np
import pytest

import octarm
from controllers import make_controller
from octarm.arm.kinematics import tip
from octarm.commands.cli import main
from octarm.disturbances.spelling import parse_disturbance
from octarm.interfaces import Command, Measurement, Reference
from octarm.metrics.table import METRICS, SETTLED_AFTER, Metrics, as_json
from octarm.simulation.engines import ENGINES
from octarm.simulation.rollout import ArmRecorder
from octarm.sweeps.shards import measure

STEP = 5e-4
RIPPLES = [("pd", 4e-3), ("smc-integral", 4e-3)]  # seen at control instants: a fraction of them


def environment(*faults: str, **options):
    return octarm.load(disturbances=[parse_disturbance(text) for text in faults], **options)


def law(name: str, gains: str = "tuned"):
    return make_controller(name, octarm.nominal_parameters(), gain_set=gains)


def metrics_of(env, run) -> dict[str, np.ndarray]:
    """The metrics of a recorded run, as those who run it measure them."""
    metrics = Metrics(
        control_period=env.control_timestep(),
        input_range=env.physics.reachable_inputs(),
        layer=run.layer,
        actuation=env.physics.actuation,
    )
    metrics.update(dict(run.arrays()))
    return metrics.result()


class Pushing:
    """Asks for the same forces all the time."""

    def __init__(self, *force: float) -> None:
        self._force = np.array(force)

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> None:
        return None

    def __call__(self, state: None, measurement: Measurement, reference: Reference):
        return Command(np.broadcast_to(self._force, measurement.q.shape).copy()), None


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("name", "period"), RIPPLES)
def test_errors_are_those_of_every_physics_step(name, period, engine):
    env = environment(control_period=period, engine=engine)
    motion = []
    env.physics.watch = lambda physics: motion.append(physics.q())
    run = octarm.rollout(env, law(name, "recommended"), 3.0)
    q = np.array(motion[:-1])  # nobody knows what becomes of the last state
    t = STEP * np.arange(len(q))
    q_d = np.array([env.task.reference(at).q for at in t])
    late = t > SETTLED_AFTER - 0.5 * STEP
    e = (q - q_d)[late]
    far = np.hypot(*(np.subtract(a, b) for a, b in zip(tip(q), tip(q_d), strict=True)))[late]
    amplitude = 0.5 * np.ptp(q_d[late], axis=0)
    middle = 0.5 * (q_d[late].max(axis=0) + q_d[late].min(axis=0))
    reach = np.maximum(q[late].max(axis=0) - middle, middle - q[late].min(axis=0))
    moving = amplitude > 0.0
    expected = {
        "rms_error": np.sqrt(np.mean(e * e, axis=0)),
        "peak_error": np.max(np.abs(e), axis=0),
        "steady_error": np.mean(e, axis=0),
        "tip_rms_error": np.sqrt(np.mean(far * far)),
        "tip_peak_error": np.max(far),
        "overshoot": np.where(moving, 100.0 * (reach / np.where(moving, amplitude, 1) - 1), np.nan),
    }
    found = metrics_of(env, run)
    for key, value in expected.items():
        np.testing.assert_allclose(found[key], value, rtol=1e-12, atol=1e-15, err_msg=key)
    seen = np.sqrt(np.mean(np.square(run.error[run.t >= SETTLED_AFTER]), axis=0))
    assert np.max(found["rms_error"] / seen) > 4.0


@pytest.mark.parametrize("engine", ENGINES)
def test_a_batch_measures_each_arm_as_if_it_were_alone(engine):
    faults = ["noise:0.4", "lag:0.002", "measurement-delay:0.001"]
    options = {"control_period": 2e-3, "engine": engine}
    seeds = [np.random.SeedSequence(5, spawn_key=(i,)) for i in range(3)]
    batch = environment(*faults, batch=3, seed=seeds, **options)
    together = measure(batch, law("smc-boundary"), 2.5).metrics
    for i, seed in enumerate(seeds):
        env = environment(*faults, seed=seed, **options)
        alone = measure(env, law("smc-boundary"), 2.5).metrics
        env = environment(*faults, seed=seed, **options)
        recorded = metrics_of(env, octarm.rollout(env, law("smc-boundary"), 2.5))
        for name, value in alone.items():
            assert value.tobytes() == together[name][i : i + 1].tobytes(), name
        np.testing.assert_array_equal(alone["rms_error_theta2"][0], recorded["rms_error"][4])
        np.testing.assert_array_equal(alone["work_s1"][0], recorded["work"][0])


def test_with_one_step_a_period_errors_are_those_of_control_instants_bit_for_bit():
    env = environment("lag:0.001")
    run = octarm.rollout(env, law("afsmc"), 2.5)
    assert "q_steps" not in run.signals and run.signals["received"].shape == (5000, 1, 6)
    rows = {name: x for name, x in run.arrays() if name != "received"}
    plain = Metrics(control_period=STEP, layer=run.layer)
    plain.update(rows)
    for name, value in metrics_of(env, run).items():
        if "error" in name or "shoot" in name or name in ("settling_time", "reaching_time"):
            assert value.tobytes() == plain.result()[name].tobytes(), name


def test_nothing_between_loop_and_arm_changes_no_metric():
    env = environment()
    found = metrics_of(env, octarm.rollout(env, law("smc-boundary"), 2.5))
    for name in METRICS:
        if name.startswith("asked_"):
            arrived, asked = found[name.removeprefix("asked_")], found[name]
            np.testing.assert_allclose(arrived, asked, rtol=1e-9, atol=1e-13, err_msg=name)


def test_a_loss_takes_its_share_of_the_work():
    env = environment("loss:0.5")
    found = metrics_of(env, octarm.rollout(env, law("pd"), 2.5))
    for name in ("work", "energy", "force_effort", "effort", "peak_input", "chattering"):
        np.testing.assert_allclose(
            found[name], 0.5 * found[f"asked_{name}"], rtol=1e-9, atol=1e-13, err_msg=name
        )


@pytest.mark.parametrize("period", [STEP, 2e-3])
def test_what_a_saturation_lets_pass(period):
    env = environment("saturation:2", control_period=period)
    physics, actuation = env.physics, env.physics.actuation
    states, inputs = [], []

    def watch(physics):
        states.append(physics.q())
        inputs.append(physics.received())

    physics.watch = watch
    found = metrics_of(env, octarm.rollout(env, law("pd"), 2.5))
    q, tau = np.array(states), np.array(inputs)[1:]
    work = actuation.force(q[:-2], tau[:-1]) * np.diff(q[:-1], axis=0)
    np.testing.assert_allclose(found["work"], work.sum(axis=0), rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(found["energy"], np.abs(work).sum(axis=0), rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(found["effort"], np.sqrt(np.mean(tau * tau, axis=0)), rtol=1e-12)
    np.testing.assert_array_equal(found["peak_input"], np.abs(tau).max(axis=0))
    share = np.mean(np.abs(tau) >= 2.0, axis=0)
    np.testing.assert_array_equal(found["saturation_share"], share)
    assert found["peak_input"].max() == 2.0 and found["asked_peak_input"].max() > 20.0
    assert found["work"].sum() > 0.0 > found["asked_work"].sum()  # as asked, it would have braked


@pytest.mark.parametrize("limit", ["saturation:0.5", "range"])
def test_columns_that_are_always_cut_are_saturated_all_the_time(limit):
    arm, faults = None, [limit]
    if limit == "range":
        arm = dataclasses.replace(octarm.nominal_parameters(), input_range=(-0.5, 0.5))
        faults = []
    env = environment(*faults, parameters=arm, control_period=1e-3, actuation="internal")
    push = Pushing(3.0, 3.0, 3.0, 0.0, 0.0, 0.0)
    found = metrics_of(env, octarm.rollout(env, push, 0.5))
    np.testing.assert_array_equal(found["saturation_share"], 1.0)
    np.testing.assert_array_equal(found["asked_saturation_share"], 1.0)
    np.testing.assert_array_equal(found["peak_input"], 0.5)
    assert found["asked_peak_input"].min() > 1.0


@pytest.mark.parametrize("period", [STEP, 2e-3, 5e-3])
def test_a_lag_is_seen_at_every_physics_step(period):
    T, force = 0.01, np.array([0.5, 0.5, 0.5, 0.0, 0.0, 0.0])
    env = environment(f"lag:{T}", control_period=period, actuation="internal")
    found = metrics_of(env, octarm.rollout(env, Pushing(*force), 0.5))
    tau = 0.25 * -np.expm1(-STEP * np.arange(1, 1001) / T)  # half of the force is each column's
    np.testing.assert_allclose(found["effort"], np.sqrt(np.mean(tau * tau)), rtol=1e-12)
    np.testing.assert_allclose(found["peak_input"], tau[-1], rtol=1e-12)
    np.testing.assert_allclose(found["force_effort"][:3], 2.0 * found["effort"][::2], rtol=1e-12)
    np.testing.assert_allclose(found["asked_effort"], 0.25, rtol=1e-12)


def test_the_readings_do_not_blur_what_the_arm_received():
    env = environment("measurement-delay:0.01", control_period=1e-3)
    run = octarm.rollout(env, law("pd"), 2.5)
    q, tau = run.signals["q_steps"].reshape(-1, 6), run.signals["received"].reshape(-1, 6)
    force = env.physics.actuation.force(q, tau)
    found = metrics_of(env, run)
    np.testing.assert_allclose(found["force_effort"], np.sqrt(np.mean(force**2, axis=0)), rtol=1e-9)
    assert np.any(np.abs(found["asked_force_effort"] / found["force_effort"] - 1.0) > 1e-4)


def test_the_recorded_steps_join_to_one_motion():
    env = environment(control_period=2e-3)
    run = octarm.rollout(env, law("smc-integral"), 0.2)
    steps, desired = run.signals["q_steps"], run.signals["q_d_steps"]
    assert steps.shape == desired.shape == (100, 4, 6)
    np.testing.assert_array_equal(steps[:, 0], run.q)
    np.testing.assert_array_equal(desired[:, 0], run.q_d)
    np.testing.assert_array_equal(run.signals["received"][:, 3], run.tau)
    jumps = np.abs(np.diff(steps.reshape(-1, 6), axis=0)).max(axis=1)
    assert np.all(jumps > 0.0) and jumps.max() < 10.0 * np.median(jumps)


def test_a_run_folder_holds_all_that_its_metrics_were_made_of(tmp_path):
    folder = tmp_path / "run"
    options = ["--control-period", "0.002", "--disturbance", "lag:0.001", "--duration", "2.5"]
    assert main(["run", "--controller", "smc-boundary", *options, "--out", str(folder)]) == 0
    run, description = octarm.read_run(folder)
    env = environment("lag:0.001", control_period=2e-3)
    env.reset()
    for name, value in metrics_of(env, run).items():
        assert description["metrics"][name] == as_json({name: value})[name], name
    assert main(["verify", str(folder)]) == 0


def test_an_arm_that_is_lost_amid_a_period_is_recorded():
    env = environment("actuation-delay:0.06", control_period=0.01)
    run = octarm.rollout(env, law("smc-boundary"), 5.0)
    assert run.status == "diverged"
    assert np.isfinite(run.signals["q_steps"]).all()
    assert run.signals["received"].shape == (len(run), 20, 6)


def test_how_a_run_of_many_steps_is_cut_changes_no_bit():
    env = environment("noise:0.4", control_period=1.5e-3)  # 2 s is no control instant
    blocks = []
    recorder = ArmRecorder(env, lambda rows: blocks.append({k: x.copy() for k, x in rows.items()}))
    recorder.run(law("smc-boundary"), 2.6)
    recorder.flush()
    rows = {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}

    def found(*cuts: int) -> dict[str, np.ndarray]:
        metrics = Metrics(control_period=1.5e-3, actuation=env.physics.actuation)
        for start, end in itertools.pairwise([0, *cuts, len(rows["t"])]):
            metrics.update({name: x[start:end] for name, x in rows.items()})
        return metrics.result()

    whole = found()
    for cuts in [(1, 2, 3), (500, 1333, 1334), (1000,)]:
        for name, value in found(*cuts).items():
            assert value.tobytes() == whole[name].tobytes(), name
    steps = STEP * np.arange(3 * len(rows["t"]))
    late = (rows["q_steps"] - rows["q_d_steps"]).reshape(-1, 6)[steps >= SETTLED_AFTER]
    np.testing.assert_allclose(whole["steady_error"], late.mean(axis=0), rtol=1e-9, atol=1e-15)
