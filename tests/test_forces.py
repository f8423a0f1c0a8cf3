"""Forces act as declared: on what they name, as large, as long and as random as they say."""
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false
# (mujoco ships no type stubs; fields are arrays of any kind)

import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from octarm.arm.kinematics import tip_force
from octarm.arm.lagrange import equilibrium, inverse_dynamics
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.disturbances.episode import Episode
from octarm.disturbances.forces import BandLimitedNoise, PulseForce, SineForce, StepForce
from octarm.disturbances.streams import HeldNoise, stream
from octarm.references import SetPoint, Sine, named_reference

P = nominal_parameters()
REST = equilibrium(P)
SINE = named_reference("sine", REST)
SEEDS = np.random.SeedSequence(7).spawn(50)


def episode(timestep: float = 5e-4, arms: int | None = None, seeds=SEEDS) -> Episode:
    one = arms is None
    return Episode(
        parameters=P,
        timestep=timestep,
        reference=SINE,
        seeds=seeds[0] if one else seeds[:arms],
        batch_shape=() if one else (arms,),
    )


def delivered(force, start: Episode, steps) -> np.ndarray:
    """What acts at these steps, shape (steps, ..., 2N)."""
    process = force.start(start)
    q = np.broadcast_to(REST, (*start.batch_shape, 6))
    return np.array([process(k, q) for k in steps])


def random_q(shape: tuple[int, ...] = (), seed: int = 0, modules: int = 3) -> np.ndarray:
    draw = np.random.default_rng(seed)
    s = draw.uniform(0.05, 0.25, (*shape, modules))
    return np.concatenate([s, draw.uniform(-1.5, 1.5, (*shape, modules))], axis=-1)


# Sines


def test_a_sine_is_one_spectral_line_on_one_coordinate():
    steps, frequency, amplitude = 8000, 3.25, 0.4  # 13 periods in 4 s
    force = delivered(
        SineForce(amplitude=amplitude, frequency=frequency, phase=0.6, on="theta2"),
        episode(),
        range(steps),
    )
    spectrum = np.abs(np.fft.rfft(force[:, 4])) / (steps / 2)
    assert np.argmax(spectrum) == 13
    assert spectrum[13] == pytest.approx(amplitude, rel=1e-12)
    spectrum[13] = 0.0
    assert np.max(spectrum) < 1e-12 * amplitude
    assert not np.any(np.delete(force, 4, axis=1))


def test_the_phase_of_a_sine_stays_what_it_is():
    steps = np.arange(4000)
    sine = SineForce(amplitude=2.0, frequency=1.7, phase=-0.3, at=0.25, length=1.5, on="s1+theta3")
    t = 5e-4 * steps
    inside = (steps >= 500) & (steps < 3500)
    expected = np.where(inside, 2.0 * np.sin(2 * np.pi * 1.7 * (t - 0.25) - 0.3), 0.0)
    force = delivered(sine, episode(), steps)
    np.testing.assert_allclose(force[:, 0], expected, atol=1e-12)
    np.testing.assert_array_equal(force[:, 0], force[:, 5])
    assert not np.any(force[:, 1:5])


def test_a_sine_is_the_same_for_any_timestep():
    sine = SineForce(amplitude=1.0, frequency=11.0, at=0.1)
    coarse = delivered(sine, episode(1e-3), range(1000))
    fine = delivered(sine, episode(2.5e-4), range(4000))
    np.testing.assert_allclose(coarse, fine[::4], atol=1e-12)


def test_a_sine_that_the_timestep_cannot_carry_is_refused():
    with pytest.raises(ValueError, match="frequency of sine is 1000 Hz; it must be below half"):
        SineForce(amplitude=1.0, frequency=1000.0).start(episode())


# Pulses and steps


@pytest.mark.parametrize("timestep", [5e-4, 1e-3, 7e-4, 3e-3, 1 / 3000])
@pytest.mark.parametrize(("at", "length"), [(0.0, 0.1), (0.2, 0.1), (0.1234, 0.0567), (0.3, 2e-5)])
def test_a_pulse_has_its_impulse_at_any_timestep(timestep: float, at: float, length: float):
    pulse = PulseForce(amplitude=5.0, at=at, length=length, on="s2")
    force = delivered(pulse, episode(timestep), range(round(0.5 / timestep)))
    assert np.sum(force[:, 1]) * timestep == pytest.approx(5.0 * length, rel=1e-9)
    t = timestep * np.arange(len(force))
    assert not np.any(force[(t + timestep < at - 1e-9) | (t > at + length + 1e-9)])
    whole = (t >= at - 1e-9) & (t + timestep <= at + length + 1e-9)
    np.testing.assert_array_equal(force[whole, 1], 5.0)
    assert not np.any(np.delete(force, 1, axis=1))


def test_a_pulse_of_whole_steps_takes_exactly_those():
    force = delivered(PulseForce(amplitude=3.0, at=0.1, length=0.2), episode(), range(1000))
    np.testing.assert_array_equal(np.flatnonzero(force[:, 3]), np.arange(200, 600))


def test_a_step_stays():
    force = delivered(StepForce(amplitude=-3.0, at=0.1, on="all"), episode(), range(0, 10**6, 100))
    assert not np.any(force[:2])
    np.testing.assert_array_equal(force[2:], -3.0)


def test_a_force_on_the_tip_follows_the_arm():
    process = StepForce(amplitude=2.0, on="tip-y").start(episode())
    for k, q in enumerate(random_q((5,))):
        np.testing.assert_array_equal(process(k, q), tip_force(q, 0.0, 2.0))


def test_unknown_places_are_refused():
    with pytest.raises(ValueError, match="did you mean 'tip-x'"):
        StepForce(amplitude=1.0, on="tipx")
    with pytest.raises(ValueError, match="unknown coordinate 'theta4'"):
        StepForce(amplitude=1.0, on="theta4").start(episode())
    with pytest.raises(ValueError, match="on of noise is 'tip-x'"):
        BandLimitedNoise(ratio=1.0, on="tip-x")


# Noise


def test_the_input_amplitude_is_that_of_the_force_that_the_motion_needs():
    """A sliding mass: |2k - m w^2 + 2 c i w| times the amplitude, for any of these phases."""
    arm = ArmParameters(
        mass=[0.3],
        inertia=[1e-3],
        width=0.08,
        stiffness=[[500.0], [500.0]],
        damping=[[6.0], [6.0]],
        rest_length=[0.12],
        gravity=9.81,
    )
    for frequency, phase in ((0.5, 0.0), (1.5, 0.7), (4.0, 2.0)):
        motion = Sine(
            center=equilibrium(arm),
            amplitude=np.array([0.02, 0.0]),
            frequency=frequency,
            phase=phase,
        )
        start = Episode(parameters=arm, timestep=1e-3, reference=motion, seeds=SEEDS[0])
        w = 2.0 * np.pi * frequency
        expected = 0.02 * abs(1000.0 - 0.3 * w * w + 12.0j * w)
        np.testing.assert_allclose(start.input_amplitude, [expected, 0.0], rtol=1e-12, atol=1e-12)


def test_the_input_amplitude_of_an_arm_is_its_row_in_a_batch():
    factor = np.array([0.7, 1.0, 1.3])[:, None]
    many = P.scaled(mass=factor, stiffness=factor[..., None])
    batch = Episode(
        parameters=many, timestep=1e-3, reference=SINE, seeds=SEEDS[:3], batch_shape=(3,)
    )
    times = 0.01 * np.arange(1000)
    for i, f in enumerate(factor.ravel()):
        arm = P.scaled(mass=f, stiffness=f)
        own = Episode(parameters=arm, timestep=2e-4, reference=SINE, seeds=SEEDS[i])
        np.testing.assert_array_equal(own.input_amplitude, batch.input_amplitude[i])
        Q = np.array([inverse_dynamics(arm, *SINE(t)) for t in times])
        np.testing.assert_allclose(own.input_amplitude, 2**0.5 * np.std(Q, axis=0), rtol=1e-9)


def test_noise_is_white_normal_and_as_strong_as_asked():
    """10 000 holds of each coordinate, at a level of 1e-4 split over what is tested."""
    start, holds = episode(), 10_000
    force = delivered(BandLimitedNoise(ratio=0.4), start, range(0, 20 * holds, 20))
    sigma = 0.4 * start.input_amplitude
    z = force / sigma
    level = 1e-4 / 30
    low, high = stats.chi2.interval(1.0 - level, holds)
    power = np.sum(z * z, axis=0)
    assert np.all((low < power) & (power < high))
    for j in range(6):
        assert stats.kstest(z[:, j], "norm").pvalue > level
    bound = stats.norm.isf(level / 2)
    lags = np.array([np.mean(z[lag:] * z[: holds - lag], axis=0) for lag in (1, 2, 3)])
    assert np.max(np.abs(lags)) * holds**0.5 < bound
    cross = (z.T @ z / holds)[np.triu_indices(6, 1)]
    assert np.max(np.abs(cross)) * holds**0.5 < bound


def test_noise_has_the_spectrum_of_held_numbers():
    """One-sided density 2 sigma^2 t_c sinc^2(f t_c), half of it left at 0.443 / t_c."""
    t_c, dt, windows, length = 0.01, 1e-3, 100, 2000
    noise = BandLimitedNoise(rms=3.0, correlation_time=t_c)
    force = delivered(noise, episode(dt), range(windows * length))
    parts = force.reshape(windows, length, 6) * np.hanning(length)[:, None]
    density = np.mean(np.abs(np.fft.rfft(parts, axis=1)) ** 2, axis=(0, 2))
    density *= 2.0 * dt / np.sum(np.hanning(length) ** 2)
    f = np.fft.rfftfreq(length, dt)
    # The sampled hold: the sum over its aliases has the closed form of a periodic sinc.
    discrete = np.sin(np.pi * f[1:] * t_c) / (t_c / dt * np.sin(np.pi * f[1:] * dt))
    expected = 2.0 * 9.0 * t_c * discrete**2
    for low, high in ((1, 10), (10, 30), (35, 50), (50, 80)):
        band = (f[1:] > low) & (f[1:] < high)
        ratio = np.mean(density[1:][band]) / np.mean(expected[band])
        # 600 windows and at least 10 independent bins: a relative deviation of at most 1.3 %
        assert ratio == pytest.approx(1.0, abs=0.05)
    flat = np.mean(density[(f > 1) & (f < 5)])
    near = np.abs(f - 0.443 / t_c) < 2.0
    assert np.mean(density[near]) / flat == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("t_c", [0.01, 0.0075, 0.05])
def test_noise_is_the_same_for_any_timestep(t_c: float):
    noise = BandLimitedNoise(ratio=0.4, correlation_time=t_c)
    fine = delivered(noise, episode(2.5e-4), range(12_000))
    for every in (2, 3, 4, 10):
        coarse = delivered(noise, episode(every * 2.5e-4), range(12_000 // every))
        np.testing.assert_array_equal(coarse, fine[::every])
    changes = 1 + np.flatnonzero(np.any(np.diff(fine, axis=0) != 0.0, axis=1))
    np.testing.assert_array_equal(changes, np.arange(1, len(changes) + 1) * round(t_c / 2.5e-4))


def test_noise_does_not_depend_on_how_often_it_is_asked_for():
    noise = BandLimitedNoise(ratio=0.4)
    every = delivered(noise, episode(), range(8000))
    twice = delivered(noise, episode(), np.repeat(np.arange(8000), 2))
    np.testing.assert_array_equal(twice[::2], every)
    np.testing.assert_array_equal(twice[1::2], every)
    some = np.unique(np.random.default_rng(0).integers(0, 8000, 40))
    np.testing.assert_array_equal(delivered(noise, episode(), some), every[some])
    process = noise.start(episode())
    process(5000, REST)
    with pytest.raises(ValueError, match="at step 10 after step 5000"):
        process(10, REST)


@pytest.mark.parametrize("t_c", [0.01, np.array([0.004, 0.01, 0.0333, 0.01, 5e-4])])
def test_each_arm_has_its_own_noise_alone_or_in_a_batch(t_c):
    ratio = np.array([0.1, 0.4, 0.0, 0.7, 0.2])
    noise = BandLimitedNoise(ratio=ratio[:, None], correlation_time=t_c)
    steps = np.arange(0, 3000, 3)
    batch = delivered(noise, episode(arms=5), steps)
    for i in range(5):
        own = BandLimitedNoise(ratio=ratio[i], correlation_time=np.broadcast_to(t_c, 5)[i])
        np.testing.assert_array_equal(delivered(own, episode(seeds=SEEDS[i:]), steps), batch[:, i])
    assert not np.any(batch[:, 2])
    z = batch[:, [0, 1, 3, 4], 0] / ratio[[0, 1, 3, 4]]
    assert np.max(np.abs(np.corrcoef(z.T) - np.eye(4))) < 0.5


def test_a_mask_leaves_the_other_coordinates_alone():
    everywhere = delivered(BandLimitedNoise(ratio=0.4), episode(), range(2000))
    masked = delivered(BandLimitedNoise(ratio=0.4, on="s2+theta1"), episode(), range(2000))
    np.testing.assert_array_equal(masked[:, [1, 3]], everywhere[:, [1, 3]])
    assert not np.any(np.delete(masked, [1, 3], axis=1))


def test_rms_may_differ_between_coordinates():
    rms = np.array([1.0, 0.0, 3.0, 0.1, 0.2, 0.0])
    unit = delivered(BandLimitedNoise(rms=1.0), episode(), range(500))
    np.testing.assert_array_equal(
        delivered(BandLimitedNoise(rms=rms), episode(), range(500)), rms * unit
    )


def test_noise_is_the_same_in_another_process():
    code = (
        "import numpy as np;"
        "from octarm.disturbances.streams import HeldNoise, stream;"
        "g = [stream(np.random.SeedSequence(11, spawn_key=(2,)), 'noise')];"
        "noise = HeldNoise(g, np.ones(6), 0.01, 1e-3);"
        "print(b''.join(noise(k).tobytes() for k in range(2000)).hex())"
    )
    outcome = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    generator = stream(np.random.SeedSequence(11, spawn_key=(2,)), "noise")
    noise = HeldNoise([generator], np.ones(6), 0.01, 1e-3)
    here = np.array([noise(k) for k in range(2000)])
    there = np.frombuffer(bytes.fromhex(outcome.stdout.strip())).reshape(2000, 6)
    np.testing.assert_array_equal(here, there)
    plain = stream(np.random.SeedSequence(11, spawn_key=(2,)), "noise").standard_normal((200, 6))
    np.testing.assert_array_equal(here[::10], plain)  # draw h is the h-th of the stream


def test_noise_that_cannot_be_is_refused():
    with pytest.raises(ValueError, match=r"is 0.0001 s; it must be at least the physics step"):
        BandLimitedNoise(ratio=0.4, correlation_time=1e-4).start(episode())
    for fields in ({}, {"ratio": 0.4, "rms": 1.0}):
        with pytest.raises(ValueError, match="either a ratio or an rms"):
            BandLimitedNoise(**fields)
    still = Episode(parameters=P, timestep=1e-3, reference=SetPoint(q=REST), seeds=SEEDS[0])
    with pytest.raises(ValueError, match="which is zero for this reference; give an rms"):
        BandLimitedNoise(ratio=0.4).start(still)
    np.testing.assert_array_equal(BandLimitedNoise(ratio=0.0).start(still)(0, REST), 0.0)
    with pytest.raises(ValueError, match="ratio of noise is -1; it must be at least 0"):
        BandLimitedNoise(ratio=-1.0)
    with pytest.raises(ValueError, match="ratio of noise has shape"):
        BandLimitedNoise(ratio=[0.1, 0.2]).start(episode())
    with pytest.raises(ValueError, match=r"time of noise has shape \(2,\)"):
        BandLimitedNoise(ratio=0.1, correlation_time=[0.1, 0.2]).start(episode())


# Batches


@pytest.mark.parametrize("on", ["s2", "all", "tip-x", "tip-y"])
@pytest.mark.parametrize("kind", [SineForce, PulseForce, StepForce])
def test_one_arm_equals_its_row_bit_for_bit(kind, on: str):
    draw = np.random.default_rng(5)
    q = random_q((300, 4))
    fields = {"amplitude": np.array([0.0, 1.3, -2.0, 0.7]), "at": np.array([0.0, 0.03, 0.01, 0.2])}
    if kind is SineForce:
        fields |= {"frequency": draw.uniform(1, 9, 4), "phase": draw.uniform(-3, 3, 4)}
    if kind is not StepForce:
        fields["length"] = np.array([0.05, 0.0123, 1.0, 0.2])
    process = kind(**fields, on=on).start(episode(1e-3, arms=4))
    batch = np.array([process(k, np.asfortranarray(q[k])) for k in range(300)])
    for i in range(4):
        own = kind(**{name: value[i] for name, value in fields.items()}, on=on)
        process = own.start(episode(1e-3, seeds=SEEDS[i:]))
        single = np.array([process(k, q[k, i]) for k in range(300)])
        np.testing.assert_array_equal(single, batch[:, i])
        assert not np.any(single) == (i == 0)
