"""Whole runs under disturbances: what MuJoCo and the controller really received.

Nothing here asks a disturbance what it did. Forces, inputs and parameters are read from MuJoCo's
own data and model at every physics step, readings from what the controller was called with.
"""
# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)

import functools
import itertools
import pickle
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pytest
from dm_control.suite.wrappers import action_noise, action_scale
from numpy.random import SeedSequence
from test_disturbances import SPELLINGS

from controllers import CONTROLLERS, make_controller
from octarm.arm.actuation import GroundedActuation
from octarm.arm.lagrange import damping_matrix, energy, equilibrium, forward_dynamics, positions
from octarm.arm.mjcf import nominal_parameters, paper_order, read_parameters
from octarm.arm.parameters import ArmParameters
from octarm.disturbances.episode import Disturbance, Episode, PlantChange
from octarm.disturbances.forces import tip_force
from octarm.disturbances.spelling import parse_disturbance
from octarm.interfaces import Command, Measurement, Reference
from octarm.references import named_reference
from octarm.simulation.environment import load
from octarm.simulation.physics import ArmPhysics
from octarm.simulation.rollout import rollout

P = nominal_parameters()
DT = 5e-4  # [s], the physics step when nothing else is said
ALL = [parse_disturbance(text) for text in SPELLINGS.values()]
READINGS = ALL[-3:]


class Listener:
    """Asks for what a law says, and keeps what it was shown."""

    def __init__(self, law: Callable[[Measurement, Reference], np.ndarray]) -> None:
        self.law = law
        self.shown: list[Measurement] = []

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> None:
        del batch_shape
        self.shown.clear()

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        self.shown.append(Measurement(measurement.t, measurement.q.copy(), measurement.v.copy()))
        return Command(self.law(measurement, reference), {}), state


def towards(measurement: Measurement, reference: Reference) -> np.ndarray:
    """A linear law that keeps the arm near its reference."""
    e, e_dot = measurement.q - reference.q, measurement.v - reference.v
    return -np.repeat([100.0, 3.0], 3) * e - np.repeat([5.0, 0.1], 3) * e_dot


def shaking(measurement: Measurement, reference: Reference) -> np.ndarray:
    """Broad-band: other numbers at every control instant."""
    del reference
    draw = np.random.default_rng(round(1e6 * measurement.t))
    return draw.uniform(-0.3, 0.3, 6) * np.repeat([3.0, 0.3], 3)


class Run(NamedTuple):
    """A run as MuJoCo and the controller saw it; row k of the former is physics step k.

    Attributes:
        q: true coordinates before the steps and after the last one, shape (K + 1, 2N).
        v: true velocities, likewise.
        added: qfrc_applied during the steps, shape (K, 2N).
        received: input forces that the motors exerted, shape (K, 2N).
        asked: input forces that were asked for, shape (K, 2N).
        plants: parameters in the model during the steps.
        angle: of gravity in the model during the steps, shape (K,).
        shown: what the controller was shown, for each control instant.
        period: physics steps in a control period.
    """

    q: np.ndarray
    v: np.ndarray
    added: np.ndarray
    received: np.ndarray
    asked: np.ndarray
    plants: list[ArmParameters]
    angle: np.ndarray
    shown: list[Measurement]
    period: int

    def readings(self) -> tuple[np.ndarray, np.ndarray]:
        """q and v as shown to the controller, and as they were, each of shape (T, 4N)."""
        shown = np.array([[*m.q, *m.v] for m in self.shown])
        true = np.concatenate([self.q, self.v], axis=1)[: -1 : self.period]
        return shown, true


def run(
    disturbances: Sequence[Disturbance | str],
    steps: int,
    *,
    law: Callable[[Measurement, Reference], np.ndarray] = towards,
    period: int = 1,
    dt: float = DT,
    seed: int = 3,
    reference: str = "sine",
) -> Run:
    """A run of so many physics steps; none may be left over at the end of a period."""
    listed = [parse_disturbance(d) if isinstance(d, str) else d for d in disturbances]
    changing = any(isinstance(d, PlantChange) for d in listed)
    environment = load(
        reference, disturbances=listed, timestep=dt, control_period=period * dt, seed=seed
    )
    physics = environment.physics
    listener = Listener(law)
    dof = paper_order(physics.model.ptr)[1]
    rows: list[tuple] = []
    states: list[np.ndarray] = []

    def watch(physics: ArmPhysics) -> None:
        states.append(np.array([physics.q(), physics.v()]))
        if len(states) == 1:
            return  # the episode begins
        data, model = physics.data.ptr, physics.model.ptr
        np.testing.assert_array_equal(data.ctrl[6:], data.ctrl[2:6])
        gravity = model.opt.gravity
        rows.append(
            (
                data.qfrc_applied[dof].copy(),
                data.ctrl[:6].copy(),
                physics.tau(),
                read_parameters(model) if changing or len(states) == 2 else rows[-1][3],
                np.arctan2(gravity[0], -gravity[2]),
            )
        )

    physics.watch = watch
    trajectory = rollout(environment, listener, steps * dt)
    assert trajectory.status == "ok", trajectory.message
    added, received, asked, plants, angle = zip(*rows, strict=True)
    assert len(rows) == steps
    q, v = np.swapaxes(np.array(states), 0, 1)
    return Run(
        q=q,
        v=v,
        added=np.array(added),
        received=np.array(received),
        asked=np.array(asked),
        plants=list(plants),
        angle=np.array(angle),
        shown=listener.shown,
        period=period,
    )


def best_lag(out: np.ndarray, source: np.ndarray, lags: int) -> int:
    """Where the cross-correlation of two signals, shape (K, m), is largest [rows]."""
    a, b = (x - x.mean(axis=0) for x in (out, source))
    return int(np.argmax([np.sum(a[k:] * b[: len(b) - k]) for k in range(lags)]))


# Forces: qfrc_applied


@functools.cache
def noisy_run() -> Run:
    return run(["noise:0.4,time=0.01,on=s1+s2+s3+theta1+theta2"], 16_000, period=10)


def amplitude() -> np.ndarray:
    """Of the input signal, by exact tracking: the inverse dynamics of the arm along the sine."""
    motion = named_reference("sine", equilibrium(P))
    return Episode(
        parameters=P, timestep=DT, reference=motion, seeds=SeedSequence(0)
    ).input_amplitude


def test_noise_has_its_power_and_is_held_on_its_coordinates_only():
    added = noisy_run().added
    holds = added.reshape(800, 20, 6)  # 10 ms each
    np.testing.assert_array_equal(np.ptp(holds, axis=1), 0.0)
    assert np.all(np.any(np.diff(holds[:, 0], axis=0)[:, :5] != 0.0, axis=1))
    rms = np.sqrt(np.mean(holds[:, 0] ** 2, axis=0))
    # A sample rms of n normal numbers is off by 1 in sqrt(2 n).
    np.testing.assert_allclose(rms[:5], 0.4 * amplitude()[:5], rtol=4.0 / np.sqrt(1600))
    np.testing.assert_array_equal(added[:, 5], 0.0)


def test_noise_has_the_spectrum_and_the_corner_of_numbers_held_for_10_ms():
    parts = noisy_run().added[:, :5].reshape(20, 800, 5)  # 0.4 s each
    density = np.mean(np.abs(np.fft.rfft(parts, axis=1)) ** 2, axis=0) * 2.0 * DT / 800
    density /= (0.4 * amplitude()[:5]) ** 2
    frequency = np.fft.rfftfreq(800, DT)
    expected = 2.0 * 0.01 * np.sinc(frequency * 0.01) ** 2
    for low, high in ((1.0, 20.0), (20.0, 40.0), (40.0, 49.0), (120.0, 170.0)):
        band = (frequency > low) & (frequency < high)
        # 20 parts, 5 coordinates, and as many frequencies; four standard deviations.
        bound = 4.0 / np.sqrt(20 * 5 * np.count_nonzero(band))
        found = np.mean(density[band], axis=None) / np.mean(expected[band])
        assert found == pytest.approx(1.0, rel=bound), (low, high)
    at_corner = np.abs(frequency - 44.3) < 6.0
    assert np.mean(density[at_corner]) / 0.02 == pytest.approx(0.5, rel=0.2)


def test_exact_tracking_needs_the_amplitude_that_noise_is_a_share_of():
    """Whatever tracks exactly has this input; what does not, has another one."""
    environment = load(control_period=1e-3)
    exact = rollout(environment, make_controller("computed-torque", P), 4.0)
    force = exact.force[exact.t >= 2.0]  # one period
    np.testing.assert_allclose(np.sqrt(2.0) * force.std(axis=0), amplitude(), rtol=2e-3)


def test_a_sine_is_one_line_on_one_coordinate():
    added = run(["sine:0.05,frequency=12.5,phase=0.4,on=s2"], 1600, period=4).added
    t = DT * np.arange(1600)
    expected = 0.05 * np.sin(2.0 * np.pi * 12.5 * t + 0.4)
    np.testing.assert_allclose(added[:, 1], expected, atol=1e-15)
    np.testing.assert_array_equal(np.delete(added, 1, axis=1), 0.0)
    spectrum = np.abs(np.fft.rfft(added[:, 1])) / 800
    assert spectrum[10] == pytest.approx(0.05)  # 12.5 Hz times 0.8 s
    assert np.all(np.delete(spectrum, 10) < 1e-12)


@pytest.mark.parametrize(("at", "length"), [(0.01, 0.02), (0.0123, 0.0101), (0.0, 0.0003)])
def test_a_pulse_gives_its_impulse_when_it_should(at: float, length: float):
    added = run([f"pulse:0.3,at={at},length={length},on=theta1"], 80, period=4).added
    assert np.sum(added[:, 3]) * DT == pytest.approx(0.3 * length, rel=1e-12)
    assert np.max(added) <= 0.3
    acts = np.flatnonzero(added[:, 3])
    assert acts[0] == int(at / DT + 1e-9) and acts[-1] == int(np.ceil((at + length) / DT) - 1)
    np.testing.assert_array_equal(np.delete(added, 3, axis=1), 0.0)


@pytest.mark.parametrize(("on", "direction"), [("tip-x", (0, 0, -1)), ("tip-y", (1, 0, 0))])
def test_a_step_on_the_tip_is_what_mujoco_makes_of_a_force_there(on: str, direction):
    found = run([f"step:0.4,at=0.01,on={on}"], 300, period=3)
    environment = load()
    physics, model = environment.physics, environment.physics.model.ptr
    site, dof = model.site("tip").id, paper_order(model)[1]
    environment.reset()
    np.testing.assert_array_equal(found.added[:20], 0.0)
    for k in range(20, 300, 7):
        middle = found.q[k] + 0.5 * DT * found.v[k]  # where the step takes it
        physics.set_motion(middle, found.v[k])
        mujoco.mj_forward(model, physics.data.ptr)
        jacobian = np.zeros((3, 6))
        mujoco.mj_jacSite(model, physics.data.ptr, jacobian, None, site)
        expected = 0.4 * (np.array(direction) @ jacobian)[dof]
        np.testing.assert_allclose(found.added[k], expected, atol=1e-14)


# The arm: MuJoCo's model


def test_a_payload_is_picked_up_by_the_model_and_stretches_the_arm():
    found = run(["payload:0.2,at=0.0103"], 3000, period=4, law=lambda m, r: np.zeros_like(m.q))
    mass, load_mass = np.array([p.mass for p in found.plants]), np.array([0.0, 0.0, 0.2])
    np.testing.assert_array_equal(mass[:21], np.tile(P.mass, (21, 1)))
    np.testing.assert_array_equal(mass[21:], np.tile(P.mass + load_mass, (2979, 1)))
    stretch = found.q[-500:].mean(axis=0) - found.q[0]
    np.testing.assert_allclose(stretch[:3], 0.2 * P.gravity / P.stiffness.sum(axis=0), rtol=5e-3)


def test_parameters_are_off_by_what_was_asked():
    plant = run(["mismatch:0.2,inertia=0.5,rest_length=1.1,tilt=0.05", "tilt:0.02"], 4)
    for p, angle in zip(plant.plants, plant.angle, strict=True):
        np.testing.assert_allclose(p.mass, 1.2 * P.mass, rtol=1e-15)
        np.testing.assert_allclose(p.inertia, 0.6 * P.inertia, rtol=1e-15)
        np.testing.assert_allclose(p.stiffness, 1.1 * P.stiffness, rtol=1e-15)
        np.testing.assert_allclose(p.damping, 1.2 * P.damping, rtol=1e-15)
        np.testing.assert_allclose(p.rest_length, 1.1 * P.rest_length, rtol=1e-15)
        assert angle == pytest.approx(0.07, rel=1e-12)


def test_random_parameters_are_drawn_within_their_share_and_by_the_seed():
    ratios = []
    for seed in range(12):
        p = run(["random-mismatch:0.2"], 1, seed=seed).plants[0]
        fields = ("mass", "inertia", "stiffness", "damping")
        ratios.append([np.ravel(getattr(p, n) / getattr(P, n)) - 1.0 for n in fields])
    flat = np.array([np.concatenate(row) for row in ratios])
    assert len(np.unique(flat)) == flat.size
    assert np.all(np.abs(flat) <= 0.2) and np.max(np.abs(flat)) > 0.18
    # 216 uniform numbers
    assert np.std(flat) == pytest.approx(0.2 / np.sqrt(3.0), rel=4 * 0.45 / np.sqrt(flat.size))


def test_drifts_follow_time_and_act_before_the_load():
    found = run(["payload:0.1", "drift:2,of=mass,limit=0.05", "cyclic-drift:0.3,period=0.1"], 120)
    for k, p in enumerate(found.plants):
        t = 0.01 * (k // 20)  # a grid of 10 ms
        expected = P.mass * (1.0 + min(2.0 * t, 0.05)) + [0.0, 0.0, 0.1]
        np.testing.assert_allclose(p.mass, expected, rtol=1e-14)
        swing = 1.0 + 0.3 * np.sin(2.0 * np.pi * t / 0.1)
        np.testing.assert_allclose(p.stiffness, P.stiffness * swing, rtol=1e-14)


# The inputs: what the columns' forces in MuJoCo's ctrl amount to


def test_inputs_arrive_as_the_faults_say():
    asked = run([], 60, law=shaking, period=3).asked
    plain = run([], 60, law=shaking, period=3).received
    np.testing.assert_allclose(plain, asked, atol=1e-13)
    loss = run(["loss:0/0/0.5/0/0/1,at=0.0101"], 60, law=shaking, period=3)
    kept = np.where(np.arange(60)[:, None] >= 21, [1, 1, 0.5, 1, 1, 0], 1.0)
    np.testing.assert_allclose(loss.received, kept * loss.asked, atol=1e-13)
    dead = run(["dead-zone:1.5"], 60, law=shaking, period=3)
    expected = np.sign(dead.asked) * np.maximum(np.abs(dead.asked) - 1.5, 0.0)
    np.testing.assert_allclose(dead.received, expected, atol=1e-13)
    limited = run(["saturation:2/2/2/1/1/inf"], 60, law=shaking, period=3)
    bound = np.array([2, 2, 2, 1, 1, np.inf])
    np.testing.assert_allclose(limited.received, np.clip(limited.asked, -bound, bound), atol=1e-13)
    assert np.any(np.abs(limited.asked) > 2.0)


def test_slow_inputs_follow_as_fast_as_they_can():
    slow = run(["slew:800"], 60, law=shaking, period=3)
    y, most = np.zeros(6), 800.0 * DT
    for received, wanted in zip(slow.received, slow.asked, strict=True):
        y = y + np.clip(wanted - y, -most, most)
        np.testing.assert_allclose(received, y, atol=1e-13)
    lag = run(["lag:0.004"], 60, law=shaking, period=3)
    y = np.zeros(6)
    for received, wanted in zip(lag.received, lag.asked, strict=True):
        y = wanted + np.exp(-DT / 0.004) * (y - wanted)
        np.testing.assert_allclose(received, y, atol=1e-13)


@pytest.mark.parametrize(("delay", "late"), [(0.0, 0), (0.0035, 7), (0.0125, 25), (0.02, 40)])
def test_inputs_are_as_late_as_asked_also_between_control_instants(delay: float, late: int):
    found = run([f"actuation-delay:{delay}"], 400, law=shaking, period=4)
    assert best_lag(found.received, found.asked, 100) == late
    np.testing.assert_array_equal(found.received[:late], 0.0)  # the first samples
    np.testing.assert_allclose(found.received[late:], found.asked[: 400 - late], atol=1e-13)


@pytest.mark.parametrize("kind", ["actuation-delay", "measurement-delay"])
def test_a_delay_of_a_fraction_of_a_step_is_that_of_finer_steps(kind):
    """Ten times as fine, 1.25 ms are whole steps; the error of the coarse ones is of 2nd order."""

    def tip(delay: float, timestep: float) -> np.ndarray:
        environment = load(
            disturbances=[parse_disturbance(f"{kind}:{delay}")],
            timestep=timestep,
            control_period=2e-3,
        )
        law = make_controller("pd", P, gain_set="recommended")
        return rollout(environment, law, 1.0).q

    fine = tip(0.00125, 5e-5)
    off = [np.max(np.abs(tip(delay, 5e-4) - fine)) for delay in (0.001, 0.00125, 0.0015)]
    assert off[1] < 0.03 * min(off[0], off[2])


# The readings: what the controller was called with


@pytest.mark.parametrize(("delay", "late"), [(0.0, 0), (0.0035, 7), (0.0125, 25), (0.02, 40)])
def test_readings_are_as_late_as_asked_from_the_first_on(delay: float, late: int):
    found = run([f"measurement-delay:{delay}"], 400, law=shaking, period=4)
    shown, true = found.readings()
    past = np.maximum(np.arange(0, 400, 4) - late, 0)
    states = np.concatenate([found.q, found.v], axis=1)
    np.testing.assert_array_equal(shown, states[past])
    every = run([f"measurement-delay:{delay}"], 400, law=shaking)
    shown, true = every.readings()
    assert best_lag(shown[:, 6:], true[:, 6:], 100) == late  # velocities look most like noise


def test_readings_have_their_noise_and_masked_ones_none():
    found = run(["measurement-noise:0/0.01/0.01/0.01/0.01/0,time=0.002"], 8000, period=4)
    shown, true = found.readings()
    rms = np.sqrt(np.mean((shown - true) ** 2, axis=0))
    scale = np.array([0, *P.rest_length[1:], 1.0, 1.0, 0])
    expected = 0.01 * np.concatenate([scale, 100.0 * scale])
    np.testing.assert_allclose(rms, expected, rtol=4.0 / np.sqrt(2 * 2000))
    for j in (0, 5, 6, 11):
        np.testing.assert_array_equal(shown[:, j], true[:, j])
    noise = (shown - true)[:, expected > 0.0]
    cross = np.corrcoef(np.concatenate([noise[1:], noise[:-1]], axis=1).T)
    assert np.max(np.abs(cross - np.eye(len(cross)))) < 5.0 / np.sqrt(2000)


def test_the_tip_is_where_the_readings_have_it():
    """The true tip would tell what the sensors do not."""
    environment = load(disturbances=READINGS, control_period=2e-3)
    timestep = environment.reset()
    for _ in range(30):
        seen = timestep.observation
        x, y = positions(seen["q"])[-1]
        np.testing.assert_allclose(seen["tip_position"], [y, -x], atol=1e-15)
        off = environment.physics.tip_position()[::2] - seen["tip_position"]
        assert np.max(np.abs(off)) > 1e-5
        timestep = environment.step(np.full(6, 0.5))


def test_readings_are_rounded():
    found = run(["quantisation:0.001/0.001/0.001/0.01/0.01/0"], 400, period=2)
    shown, true = found.readings()
    step = np.array([*1e-3 * P.rest_length, 0.01, 0.01])
    step = np.concatenate([step, [np.inf], 100.0 * step, [np.inf]])
    rounded = np.isfinite(step)
    counts = shown[:, rounded] / step[rounded]
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-9)
    assert np.all(np.abs(shown - true)[:, rounded] <= 0.5 * step[rounded] * (1.0 + 1e-9))
    np.testing.assert_array_equal(shown[:, ~rounded], true[:, ~rounded])


def test_what_comes_after_the_end_of_time_never_comes():
    found = run(
        ["payload:1,at=1e300s", "pulse:1,at=1e300s", "step:1,at=1e12s", "loss:1,at=1e9s"], 20
    )
    assert found.plants[-1].to_dict() == P.to_dict()
    np.testing.assert_array_equal(found.added, 0.0)
    np.testing.assert_allclose(found.received, found.asked, atol=1e-13)


# All together


def gravity_force(p: ArmParameters, q: np.ndarray, angle: float) -> np.ndarray:
    """What turning gravity by an angle adds to the generalised force."""
    total, n = np.zeros(2 * p.modules), p.modules
    for i in range(1, n + 1):
        weight = p.mass[i - 1] * p.gravity
        part = np.concatenate([q[:i], q[n : n + i]])
        f = tip_force(part, weight * (np.cos(angle) - 1.0), weight * np.sin(angle))
        total[:i] += f[:i]
        total[n : n + i] += f[i:]
    return total


def test_the_arm_moves_as_the_analytic_model_says_under_what_was_delivered():
    """Fourth-order Runge-Kutta on eqs (1)-(5); disturbances are held over a step, not F(q) tau."""
    found = run(ALL, 200, period=2)
    actuation = GroundedActuation(P.widths)
    worst = 0.0
    for k in range(200):
        p, angle, q0 = found.plants[k], found.angle[k], found.q[k]
        # from_model takes the vertical part of gravity alone.
        p = ArmParameters(**{**p.to_dict(), "gravity": p.gravity / np.cos(angle)})
        tau, held = found.received[k], found.added[k]

        def slope(y: np.ndarray, p=p, angle=angle, tau=tau, held=held) -> np.ndarray:
            force = actuation.force(y[:6], tau) + held + gravity_force(p, y[:6], angle)
            return np.concatenate([y[6:], forward_dynamics(p, y[:6], y[6:], force)])

        y = np.concatenate([q0, found.v[k]])
        k1 = slope(y)
        k2 = slope(y + 0.5 * DT * k1)
        k3 = slope(y + 0.5 * DT * k2)
        k4 = slope(y + DT * k3)
        y = y + DT / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        after = np.concatenate([found.q[k + 1], found.v[k + 1]])
        worst = max(worst, float(np.max(np.abs(y - after))))
    assert worst < 1e-11


def test_energy_goes_where_it_is_delivered():
    """Work of inputs and disturbances, and what changed parameters store, less what is damped."""
    changes = ["mismatch:0.2", "drift:0.5,of=stiffness+rest_length", "payload:0.2,at=0.1"]
    pushes = ["noise:0.4", "sine:0.3,frequency=3,on=tip-y", "step:-0.2,on=s2"]
    found = run([*changes, *pushes, "loss:0.3", "lag:0.01"], 800, period=4)
    actuation = GroundedActuation(P.widths)
    stored = [sum(energy(found.plants[0], found.q[0], found.v[0]))]
    supplied = damped = brought = 0.0
    for k, p in enumerate(found.plants):
        (q0, q1), (v0, v1) = found.q[k : k + 2], found.v[k : k + 2]
        brought += sum(energy(p, q0, v0)) - stored[-1]
        B, middle = damping_matrix(p), 1.5 * (q1 - q0) / DT - 0.25 * (v0 + v1)
        halfway = 0.5 * (q0 + q1) + DT / 8.0 * (v0 - v1)
        power = [
            actuation.force(q, found.received[k]) @ v
            for q, v in ((q0, v0), (halfway, middle), (q1, v1))
        ]
        supplied += found.added[k] @ (q1 - q0) + DT / 6.0 * (power @ np.array([1.0, 4.0, 1.0]))
        damped += DT / 6.0 * (v0 @ B @ v0 + 4.0 * middle @ B @ middle + v1 @ B @ v1)
        stored.append(sum(energy(p, q1, v1)))
    assert min(abs(supplied), damped, abs(brought)) > 0.01  # [J]
    left = stored[-1] - stored[0] - (supplied + brought - damped)
    assert abs(left) < 2e-6 * damped


@pytest.mark.parametrize("kind", ["forces", "changes"])
def test_halving_the_timestep_changes_no_disturbance(kind: str):
    """No force on the tip, which follows the arm."""
    texts = {
        "forces": ["noise:0.4,time=0.003", "pulse:0.3,at=0.01,length=0.02", "step:1,on=s1"],
        "changes": ["random-mismatch:0.2", "drift:0.5", "payload:0.2,at=0.0125"],
    }[kind]
    coarse, fine = (run(texts, n, dt=dt) for n, dt in ((60, DT), (120, DT / 2)))
    np.testing.assert_array_equal(coarse.added, fine.added[::2])
    np.testing.assert_array_equal(coarse.added, fine.added[1::2])
    for p, same in zip(coarse.plants, fine.plants[::2], strict=True):
        assert p.to_dict() == same.to_dict()


def test_the_run_converges_when_the_timestep_is_halved():
    """Delays and lags in seconds, noise in time: nothing acts once a step."""
    texts = [text for text in SPELLINGS.values() if not text.startswith(("dead", "quant"))]

    def end(dt: float) -> np.ndarray:
        steps = round(0.1 / dt)
        return run(texts, steps, dt=dt, period=round(0.005 / dt)).q[-1]

    ends = [end(dt) for dt in (1e-3, 5e-4, 2.5e-4)]
    first, second = (np.max(np.abs(b - a)) for a, b in itertools.pairwise(ends))
    assert first < 2e-3 and 0.3 < second / first < 0.7  # lag and tip force hold for a step


@pytest.mark.parametrize("period", [2, 5, 10])
def test_the_control_period_changes_no_realisation(period: int):
    texts = ["noise:0.4,time=0.0035", "random-mismatch:0.2", "drift:0.5", "payload:0.2,at=0.0112"]
    every, seldom = run(texts, 60), run(texts, 60, period=period)
    np.testing.assert_array_equal(every.added, seldom.added)
    assert [p.to_dict() for p in every.plants] == [p.to_dict() for p in seldom.plants]
    noise = ["measurement-noise:0.01,time=0.0015"]
    (shown, true), (other, its) = (
        run(noise, 60).readings(),
        run(noise, 60, period=period).readings(),
    )
    np.testing.assert_allclose((shown - true)[::period], other - its, atol=1e-13)


@pytest.mark.parametrize("name", ["noise", "random-mismatch", "measurement-noise"])
def test_what_is_random_does_not_depend_on_what_else_acts(name: str):
    own = parse_disturbance(SPELLINGS[name])
    in_the_way = {  # of comparing, as it adds to the same numbers
        "noise": ("sine", "pulse", "step"),
        "random-mismatch": ("mismatch", "drift", "cyclic-drift", "payload", "tilt"),
        "measurement-noise": ("measurement-delay", "quantisation"),
    }[name]
    others = [d for d in ALL if d.name not in (name, *in_the_way)]
    alone, together = run([own], 60), run([*others, own], 60)
    if name == "noise":
        np.testing.assert_array_equal(alone.added, together.added)
    elif name == "random-mismatch":
        assert alone.plants[0].to_dict() == together.plants[0].to_dict()
    else:
        (shown, true), (other, its) = alone.readings(), together.readings()
        np.testing.assert_allclose(shown - true, other - its, atol=1e-13)


def test_every_controller_meets_the_same_noise():
    texts = ["noise:0.4,time=0.002", "pulse:0.1,on=theta2,at=0.003", "measurement-noise:1e-4"]
    listed = [parse_disturbance(text) for text in texts]
    runs = {
        name: rollout(
            load(disturbances=listed, seed=7), make_controller(name, P.mismatched(-0.3)), 0.02
        )
        for name in CONTROLLERS
    }
    first = runs["pd"]
    assert np.all(np.std(first.disturbance, axis=0) > 0.0)
    for found in runs.values():
        np.testing.assert_array_equal(found.disturbance, first.disturbance)
        noise = found.signals["q_measured"] - found.q
        np.testing.assert_allclose(noise, first.signals["q_measured"] - first.q, atol=1e-15)
    assert len({found.digest for found in runs.values()}) == len(runs)
    other = rollout(load(disturbances=listed, seed=8), make_controller("pd", P), 0.02)
    assert not np.any(other.disturbance[:, :3] == first.disturbance[:, :3])


# Repetition, copies, wrappers


def test_an_episode_that_is_asked_for_again_is_the_same_and_has_the_same_arm():
    environment = load(disturbances=ALL, seed=5)
    controller = make_controller("smc-boundary", P)
    runs = []
    for duration in (0.05, 0.01, 0.05):
        environment.task.next_episode = 0
        runs.append(rollout(environment, controller, duration))
    fresh = rollout(load(disturbances=ALL, seed=5), controller, 0.05)
    assert runs[0].digest == runs[2].digest == fresh.digest
    np.testing.assert_array_equal(runs[0].signals["q_measured"], fresh.signals["q_measured"])
    np.testing.assert_array_equal(runs[1].q, fresh.q[:20])
    environment.physics.reset()  # without a new episode
    model, plain = environment.physics.model.ptr, load().physics.model.ptr
    for name in ("body_mass", "body_subtreemass", "tendon_stiffness", "tendon_lengthspring"):
        np.testing.assert_array_equal(getattr(model, name), getattr(plain, name))
    np.testing.assert_array_equal(model.opt.gravity, plain.opt.gravity)
    environment.physics.step(3)


def test_another_process_gives_the_same_run():
    texts = list(SPELLINGS.values())
    program = (
        "from octarm import load, rollout\n"
        "from octarm.disturbances.spelling import parse_disturbance\n"
        "from octarm.arm.mjcf import nominal_parameters\n"
        "from controllers import make_controller\n"
        f"listed = [parse_disturbance(text) for text in {texts!r}]\n"
        "controller = make_controller('pd', nominal_parameters())\n"
        "print(rollout(load(disturbances=listed, seed=5), controller, 0.03).digest)\n"
    )
    command = [sys.executable, "-W", "ignore", "-c", program]
    root = Path(__file__).resolve().parent.parent
    out = subprocess.run(command, capture_output=True, text=True, check=True, cwd=root)
    here = rollout(load(disturbances=ALL, seed=5), make_controller("pd", P), 0.03)
    assert out.stdout.strip() == here.digest


@pytest.mark.parametrize(
    "duplicate",
    [ArmPhysics.copy, lambda p: p.copy(share_model=True), lambda p: pickle.loads(pickle.dumps(p))],
    ids=["copy", "shared", "pickle"],
)
def test_a_copy_goes_on_alike_and_on_its_own(duplicate):
    """Also with a load that is picked up later, and limits that stay those of the arm."""
    longer = parse_disturbance("mismatch:0,rest_length=1.1")
    environment = load(disturbances=[*ALL, longer], control_period=1e-3)
    environment.reset()
    physics = environment.physics
    inputs = np.random.default_rng(0).normal(size=(50, 6))
    for tau in inputs[:17]:  # parameters drift on: it is not at a step that writes all of them
        environment.step(tau)
    other = duplicate(physics)
    states = []
    for each in (other, physics):
        for tau in inputs[17:]:
            each.set_control(tau)
            each.step(2)
        states.append((each.integration_state(), each.model.body_mass.copy(), each.received()))
    for one, its in zip(*states, strict=True):
        np.testing.assert_array_equal(one, its)
    assert other.limits == physics.limits
    assert physics.model.body_mass[-1] > P.mass[-1]  # by now


def test_wrappers_meet_new_episodes_and_the_same_ones_again():
    controller = make_controller("pd", P)
    noisy: Any = action_noise.Wrapper(load(), scale=1e-3)
    first, second = (rollout(noisy, controller, 0.02) for _ in range(2))
    assert not np.any(first.tau == second.tau)
    noisy.task.next_episode = 0
    assert rollout(noisy, controller, 0.02).digest == first.digest
    noisy = action_noise.Wrapper(load(disturbances=ALL), scale=1e-3)
    first = rollout(noisy, controller, 0.02)
    assert np.std(first.tau - rollout(load(disturbances=ALL), controller, 0.02).tau) > 0.0
    scaled: Any = action_scale.Wrapper(load(disturbances=ALL), -1.0, 1.0)
    assert list(scaled.observation_spec())[:2] == ["q", "v"]  # before the first episode
    assert rollout(scaled, controller, 0.02).status == "ok"
    assert load(disturbances=ALL, batch=2).observation_spec()["q"].shape == (2, 6)
