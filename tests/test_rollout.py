"""The loop: what is recorded is what happened, and a diverging run ends at once."""

import dataclasses
import re

import numpy as np
import pytest
from arm_states import UNLIMITED
from dm_control.suite.wrappers import action_noise

from controllers import make_controller
from octarm.arm.lagrange import force_coefficients, forward_dynamics
from octarm.arm.mjcf import nominal_parameters
from octarm.disturbances.spelling import parse_disturbance
from octarm.errors import OctarmError
from octarm.interfaces import Command
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout
from octarm.simulation.trajectory import Trajectory


@dataclasses.dataclass(frozen=True)
class Probe:
    """Remembers what it was shown; pushes with a force that depends on the call count."""

    seen: list = dataclasses.field(default_factory=list)
    bad_call: int = -1

    def initial_state(self, batch_shape=()):
        return 0

    def __call__(self, state, measurement, reference):
        self.seen.append((measurement, reference))
        force = 0.1 * np.sin(0.1 * state + np.arange(6.0))
        if state == self.bad_call:
            force[4] = np.nan
        return Command(force, {"calls": np.array([float(state)])}), state + 1


def test_the_controller_sees_whole_periods_and_its_own_state():
    probe = Probe()
    run = rollout(load(control_period=0.002), probe, 0.1)
    assert len(run) == len(probe.seen) == 50
    np.testing.assert_array_equal(run.t, 0.002 * np.arange(50))
    np.testing.assert_array_equal(run.t, [m.t for m, _ in probe.seen])
    np.testing.assert_array_equal(run.q, [m.q for m, _ in probe.seen])
    np.testing.assert_array_equal(run.v_d, [r.v for _, r in probe.seen])
    np.testing.assert_array_equal(run.signals["calls"][:, 0], np.arange(50))


def test_the_recorded_inputs_give_the_recorded_force():
    run = rollout(load(), Probe(), 0.02)
    force = np.einsum("tij,tj->ti", force_coefficients(nominal_parameters(), run.q), run.tau)
    np.testing.assert_allclose(force, run.force, rtol=1e-12, atol=1e-14)


def test_the_arm_moves_as_the_analytic_model_says():
    """One RK4 step under a held tau, against RK4 on the analytic equations with F_coeff(q) tau."""
    step, p = 1e-4, nominal_parameters()
    run = rollout(load(timestep=step), Probe(), 0.02)

    def rate(x):
        force = force_coefficients(p, x[:6]) @ tau
        return np.concatenate([x[6:], forward_dynamics(p, x[:6], x[6:], force)])

    for k in range(100, 110):
        x, tau = np.concatenate([run.q[k], run.v[k]]), run.tau[k]
        k1 = rate(x)
        k2 = rate(x + 0.5 * step * k1)
        k3 = rate(x + 0.5 * step * k2)
        k4 = rate(x + step * k3)
        moved = x + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        np.testing.assert_allclose(run.q[k + 1], moved[:6], atol=1e-13)
        np.testing.assert_allclose(run.v[k + 1], moved[6:], atol=1e-11)


def test_two_runs_are_equal_bit_for_bit_and_a_changed_parameter_is_not():
    p = nominal_parameters()
    arms = [p, p, p.scaled(width=1.0 + 1e-12)]
    runs = [rollout(load(parameters=a), make_controller("smc-boundary", p), 0.2) for a in arms]
    for (name, first), (_, second) in zip(runs[0].arrays(), runs[1].arrays(), strict=True):
        np.testing.assert_array_equal(first, second, err_msg=name)
    assert runs[0].digest == runs[1].digest != runs[2].digest


def test_a_wrapped_environment_runs_and_the_inputs_it_received_are_recorded():
    quiet = rollout(load(), Probe(), 0.01)
    wrapped = action_noise.Wrapper(load(seed=4), scale=0.001)
    noisy = rollout(wrapped, Probe(), 0.01)  # pyright: ignore[reportArgumentType]
    spread = np.std(noisy.tau[0] - quiet.tau[0])
    assert 0.05 < spread < 1.5  # scale times the range of 400 N is 0.4 N


@pytest.mark.parametrize("gain", ["K", "K_v", "lambda"])
def test_a_gain_a_thousand_times_too_large_ends_the_run_at_once(gain: str):
    p = UNLIMITED
    recommended = make_controller("smc-boundary", p, gain_set="recommended")
    value = getattr(recommended, "lambda_" if gain == "lambda" else gain)
    gains = {gain: 1000.0 * value}
    controller = make_controller("smc-boundary", p, gains, gain_set="recommended")
    run = rollout(load(parameters=p), controller, 1.0)
    assert run.status == "diverged"
    assert re.match(r"diverged at t = 0\.00\d+ s: (s|theta)\d (is|moves at) ", run.message)
    assert 1 <= len(run) < 20
    for name, array in run.arrays():
        assert np.all(np.isfinite(array)), name


def test_a_force_that_is_not_a_number_ends_the_run_and_is_named():
    run = rollout(load(), Probe(bad_call=7), 1.0)
    assert run.status == "diverged"
    assert run.message == "diverged at t = 0.0035 s: the controller's force on theta2 is nan"
    assert len(run) == 8
    assert np.all(np.isfinite(run.q))


class Spoilt(action_noise.Wrapper):
    """An environment whose arm or action is spoilt at every step."""

    def __init__(self, environment, spoil):
        super().__init__(environment)
        self._spoil = spoil

    def step(self, action):
        return self._env.step(self._spoil(self._env.physics, action))


def spoil_state(physics, action):
    physics.data.qpos[3] = np.nan
    return action


def spoil_action(physics, action):
    return 1e20 + 0.0 * action


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (spoil_state, r"diverged at t = [\d.e-]+ s: (s|theta)\d is nan"),
        (spoil_action, r"diverged at t = [\d.e-]+ s: (s|theta)\d most, .*mjWARN_BADCTRL"),
    ],
)
def test_a_state_or_input_that_mujoco_refuses_ends_the_run(spoil, message):
    strong = dataclasses.replace(UNLIMITED, input_range=(-1e30, 1e30))
    spoilt = Spoilt(load(parameters=strong), spoil)
    run = rollout(spoilt, Probe(), 0.1)  # pyright: ignore[reportArgumentType]
    assert run.status == "diverged"
    assert re.match(message, run.message), run.message
    assert len(run) == 1


def test_a_force_of_wrong_shape_is_refused():
    class Narrow(Probe):
        def __call__(self, state, measurement, reference):
            return Command(np.zeros(5), {}), state

    with pytest.raises(ValueError, match=r"force has shape \(5,\); the arm needs \(6,\)"):
        rollout(load(), Narrow(), 0.1)
    with pytest.raises(ValueError, match="duration is nan s; it must be positive"):
        rollout(load(), Probe(), float("nan"))


def test_an_episode_that_ends_by_its_own_duration_ends_the_run_well():
    run = rollout(load(duration=0.01), Probe(), 1.0)
    assert (run.status, len(run)) == ("ok", 20)


def test_the_twin_on_disk_is_equal_and_equal_runs_give_equal_bytes(tmp_path):
    run = rollout(load(), Probe(), 0.02)
    run.save(tmp_path / "a.npz")
    run.save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    back = Trajectory.load(tmp_path / "a.npz")
    for (name, first), (_, second) in zip(run.arrays(), back.arrays(), strict=True):
        np.testing.assert_array_equal(first, second, err_msg=name)
    assert (back.status, back.message, back.digest) == (run.status, run.message, run.digest)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.npz", "b.npz"]


def test_the_layer_of_the_first_command_is_kept(tmp_path):
    p = nominal_parameters()
    run = rollout(load(), make_controller("smc-boundary", p, {"phi": 0.25}), 0.005)
    np.testing.assert_array_equal(run.layer, np.full(6, 0.25))
    run.save(tmp_path / "a.npz")
    np.testing.assert_array_equal(Trajectory.load(tmp_path / "a.npz").layer, run.layer)
    assert rollout(load(), make_controller("smc", p), 0.005).layer is None


@pytest.mark.parametrize("name", ["q", "layer", "digest", "q_measured"])
def test_a_signal_with_the_name_of_another_field_is_refused_at_once(name):
    class Named(Probe):
        def __call__(self, state, measurement, reference):
            return Command(np.zeros(6), {name: np.zeros(6)}), state

    environment = load(disturbances=[parse_disturbance("measurement-noise:0.001")])
    with pytest.raises(ValueError, match=f"a signal cannot be called '{name}'"):
        rollout(environment, Named(), 1.0)


def test_a_trajectory_is_read_only_and_checks_itself(tmp_path):
    run = rollout(load(), Probe(), 0.005)
    with pytest.raises(ValueError, match="read-only"):
        run.q[0] = 0.0
    with pytest.raises(ValueError, match="a signal cannot be called 'tau'"):
        dataclasses.replace(run, signals={"tau": run.tau})
    with pytest.raises(ValueError, match="q has 9 rows; t has 10"):
        dataclasses.replace(run, q=run.q[:-1])
    (tmp_path / "x.npz").write_bytes(b"nonsense")
    with pytest.raises(ValueError, match="is not a trajectory file"):
        Trajectory.load(tmp_path / "x.npz")
    with pytest.raises(OctarmError, match=r"y\.npz cannot be read: No such file"):
        Trajectory.load(tmp_path / "y.npz")
