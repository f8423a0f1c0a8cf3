"""Sensor faults against their closed forms, on what the controller receives."""
# pyright: reportArgumentType=false
# (fields take anything array-like)

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import SeedSequence
from scipy import stats

from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import nominal_parameters
from octarm.disturbances.episode import Episode, SensorFault
from octarm.disturbances.sensors import MeasurementDelay, MeasurementNoise, Quantisation
from octarm.references import named_reference

P = nominal_parameters()
STEP = 5e-4  # [s]
SCALE = np.concatenate([P.rest_length, np.ones(3)])  # [m], [rad]
RARE = 1e-6  # chance of a statistical test to fail, were its seed another one
NEUTRAL = [MeasurementDelay(delay=0.0), MeasurementNoise(rms=0.0), Quantisation(resolution=0.0)]
ACTIVE = [
    MeasurementDelay(delay=0.0035),
    MeasurementNoise(rms=0.01, correlation_time=0.002),
    Quantisation(resolution=0.01),
]

Motion = tuple[np.ndarray, np.ndarray]


def name_of(fault: SensorFault) -> str:
    return fault.name


def episode(seeds: SeedSequence | list[SeedSequence], timestep: float = STEP) -> Episode:
    return Episode(
        parameters=P,
        timestep=timestep,
        reference=named_reference("sine", equilibrium(P)),
        seeds=seeds,
        batch_shape=(len(seeds),) if isinstance(seeds, list) else (),
    )


def motion(steps: int, shape: tuple[int, ...] = (6,), seed: int = 0) -> Motion:
    """Any states, each different from all others."""
    draw = np.random.default_rng(seed)
    return draw.normal(size=(steps, *shape)), draw.normal(size=(steps, *shape))


def readings(
    fault: SensorFault,
    true: Motion,
    every: int = 1,
    timestep: float = STEP,
    seeds: SeedSequence | list[SeedSequence] | None = None,
    times: int = 1,
) -> Motion:
    """What the controller gets at its instants, shapes (T, ..., 2N), asked so many times each."""
    q, v = true
    if seeds is None:
        seeds = SeedSequence(0) if q.ndim == 2 else SeedSequence(0).spawn(q.shape[1])
    process = fault.start(episode(seeds, timestep))
    out = []
    for k in range(len(q)):
        process.record(k, q[k], v[k])
        if k % every == 0:
            out.append([process(k, q[k], v[k]) for _ in range(times)][-1])
    return np.stack([o[0] for o in out]), np.stack([o[1] for o in out])


def noise(fault: SensorFault, steps: int, timestep: float = STEP, **options) -> Motion:
    """What is added to an arm that stands at zero."""
    still = np.zeros((steps, 6))
    return readings(fault, (still, still), timestep=timestep, **options)


def bits(x: np.ndarray) -> np.ndarray:
    """Tells -0 from 0."""
    return np.ascontiguousarray(x).view(np.int64)


def same(one: Motion, other: Motion) -> None:
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(bits(a), bits(b))


@pytest.mark.parametrize("late", [0, 1, 7, 10, 23])
@pytest.mark.parametrize("every", [1, 5])
def test_readings_are_as_old_as_asked_from_the_first_on(late: int, every: int):
    """Also where the delay is no multiple of the control period, and however often one looks."""
    true = motion(60)
    for times in (1, 3):
        read = readings(MeasurementDelay(delay=late * STEP), true, every, times=times)
        then = np.maximum(np.arange(0, 60, every) - late, 0)  # at first, the state at the start
        same(read, (true[0][then], true[1][then]))


@pytest.mark.parametrize("timestep", [2.5e-4, 5e-4, 1e-3])
@pytest.mark.parametrize("delay", [0.003, 0.011])
def test_cross_correlation_peaks_at_the_delay_for_any_timestep(delay: float, timestep: float):
    q, v = motion(2000)
    for true, read in zip(
        (q, v), readings(MeasurementDelay(delay=delay), (q, v), 1, timestep), strict=True
    ):
        peak = [np.sum(true[: 2000 - lag] * read[lag:]) for lag in range(60)]
        assert np.argmax(peak) * timestep == pytest.approx(delay)


def test_readings_between_two_steps_are_those_of_a_cubic_motion_for_each_arm():
    asked = np.array([0.0, 0.0002, 0.0003, 0.00125, 0.0014, 0.0375])
    fault = MeasurementDelay(delay=asked)
    process = fault.start(episode(SeedSequence(0).spawn(6)))
    achieved = (process.steps + process.rest) * STEP
    np.testing.assert_allclose(achieved, asked, rtol=1e-12)
    a, b, c, d = np.random.default_rng(3).normal(size=(4, 6, 6))

    def true(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        t = t[..., None]
        return a + t * (b + t * (c + t * d)), b + t * (2.0 * c + t * 3.0 * d)

    t = np.repeat(STEP * np.arange(100)[:, None], 6, axis=1)
    read = readings(fault, true(t))
    begun = t - asked >= 0.0
    for found, expected in zip(read, true(t - asked), strict=True):
        np.testing.assert_allclose(found[begun], expected[begun], rtol=0, atol=1e-11)
    whole = np.array([0, 5])
    then = np.maximum(np.arange(100)[:, None] - np.array([0, 75]), 0)
    same(
        [x[:, whole] for x in read],
        [x[then, whole] for x in true(t)],
    )


def test_readings_before_the_delay_has_passed_are_those_of_the_start():
    q, v = motion(5)
    read = readings(MeasurementDelay(delay=0.0013), (q, v))
    for found, true in zip(read, (q, v), strict=True):
        np.testing.assert_array_equal(found[:3], true[[0, 0, 0]])
        assert np.all(found[3] != true[0])


def test_memory_is_as_long_as_the_longest_delay():
    process = MeasurementDelay(delay=[0.0, 0.005]).start(episode(SeedSequence(0).spawn(2)))
    sizes = []
    for k in range(300):
        process.record(k, np.ones((2, 6)), np.ones((2, 6)))
        process(k, np.ones((2, 6)), np.ones((2, 6)))
        sizes.append(len(pickle.dumps(process)))
    assert max(sizes) - min(sizes) < 16
    assert max(sizes) < 1000 + 12 * 2 * 2 * 6 * 8


def test_noise_has_the_rms_asked_on_every_coordinate_and_velocity():
    rms, rate, holds = np.array([0.001, 0.002, 0.01, 0.02, 0.1, 0.5]), 40.0, 4000
    fault = MeasurementNoise(rms=rms, rate=rate, correlation_time=0.002)
    q, v = noise(fault, 4 * holds, every=4)
    low, high = stats.chi2.ppf([RARE, 1.0 - RARE], holds)
    for x, wanted in ((q, rms * SCALE), (v, rate * rms * SCALE)):
        power = np.sum((x / wanted) ** 2, axis=0)
        assert np.all((low < power) & (power < high))
        assert np.all(np.abs(np.sum(x / wanted, axis=0)) < 5.0 * np.sqrt(holds))
        assert stats.kstest((x / wanted).ravel(), "norm").pvalue > RARE
    process = fault.start(episode(SeedSequence(0)))
    np.testing.assert_allclose(process.rms_q, rms * SCALE)
    np.testing.assert_allclose(process.rms_v, rate * rms * SCALE)


@pytest.mark.parametrize("correlation_time", [STEP, 0.002, 0.0013])
def test_noise_is_held_for_its_correlation_time_and_then_drawn_anew(correlation_time: float):
    x = np.hstack(noise(MeasurementNoise(rms=1.0, correlation_time=correlation_time), 4000))
    changes = np.any(x[1:] != x[:-1], axis=1)
    t = STEP * np.arange(4000)
    hold = np.floor(t / correlation_time + 1e-6)
    np.testing.assert_array_equal(changes, hold[1:] != hold[:-1])
    draws = x[np.flatnonzero(np.append(True, changes))]
    draws = draws / np.std(draws, axis=0)
    bound = 5.0 / np.sqrt(len(draws))
    cross = draws.T @ draws / len(draws) - np.eye(12)  # coordinates and velocities, one another
    assert np.max(np.abs(cross)) < bound
    for lag in (1, 2, 5):
        assert np.max(np.abs(draws[lag:].T @ draws[:-lag] / len(draws))) < bound


def test_noise_is_a_function_of_time_and_of_the_arm_alone():
    """Not of the control period, the number of looks, the timestep, the batch or its order."""
    fault = MeasurementNoise(rms=0.01, correlation_time=0.002)
    seeds = SeedSequence(7).spawn(3)
    plain = [noise(fault, 400, seeds=seed) for seed in seeds]
    for every, times in ((1, 3), (4, 1), (7, 2)):
        same(noise(fault, 400, every=every, times=times, seeds=seeds[0]), _every(plain[0], every))
    same(_every(noise(fault, 800, timestep=STEP / 2, seeds=seeds[0]), 2), plain[0])
    for order in ([0, 1, 2], [2, 0], [1]):
        zero = np.zeros((400, len(order), 6))
        together = readings(fault, (zero, zero), seeds=[seeds[i] for i in order])
        for row, i in enumerate(order):
            same((together[0][:, row], together[1][:, row]), plain[i])
    between = np.corrcoef(plain[0][0][::4].ravel(), plain[1][0][::4].ravel())[0, 1]
    assert abs(between) < 5.0 / np.sqrt(600)


def _every(x: Motion, nth: int) -> Motion:
    return x[0][::nth], x[1][::nth]


def test_noise_has_a_stream_of_its_own():
    one = episode(SeedSequence(3))
    normal = one.streams("measurement-noise")[0].standard_normal(12)
    q, v = noise(MeasurementNoise(rms=1.0, rate=1.0), 1, seeds=SeedSequence(3))
    np.testing.assert_array_equal(np.hstack([q[0], v[0]]), np.tile(SCALE, 2) * normal)
    again = MeasurementNoise(rms=1.0, rate=1.0).start(one.changed(occurrence=2))
    assert np.all(again(0, np.zeros(6), np.zeros(6))[0] != q[0])


def test_quantised_readings_are_the_nearest_multiples():
    resolution, rate = np.array([1e-4, 1e-3, 1e-2, 1e-2, 0.1, 1.0]), 8.0
    fault = Quantisation(resolution=resolution, rate=rate)
    true = motion(20000)
    read = readings(fault, true)
    for x, y, step in zip(true, read, (resolution * SCALE, rate * resolution * SCALE), strict=True):
        counts = y / step
        np.testing.assert_allclose(counts, np.rint(counts), atol=1e-9)
        error = (y - x) / step
        assert np.max(np.abs(error)) <= 0.5 + 1e-9
        fine = error[:, :4]  # far finer than the signal, so the error is uniform
        for j in range(4):
            assert stats.kstest(fine[:, j] + 0.5, "uniform").pvalue > RARE
            assert np.sqrt(12.0) * np.std(fine[:, j]) == pytest.approx(1.0, abs=0.02)
    again = readings(fault, read)
    for x, y in zip(again, read, strict=True):
        np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("fault", NEUTRAL, ids=name_of)
def test_neutral_values_change_no_bit(fault: SensorFault):
    q, v = motion(50)
    q[::5] *= -0.0
    v[::7] *= -0.0
    same(readings(fault, (q, v)), (q, v))


@pytest.mark.parametrize(
    "fault",
    [
        MeasurementNoise(rms=[0.0, 0.1, 0.0, 0.1, 0.1, 0.0]),
        Quantisation(resolution=[0.0, 0.1, 0.0, 0.1, 0.1, 0.0]),
    ],
    ids=name_of,
)
def test_masked_coordinates_change_no_bit(fault: SensorFault):
    true = motion(50)
    read = readings(fault, true)
    same(
        (read[0][:, [0, 2, 5]], read[1][:, [0, 2, 5]]),
        (true[0][:, [0, 2, 5]], true[1][:, [0, 2, 5]]),
    )
    for x, y in zip(true, read, strict=True):
        assert np.all(x[:, [1, 3, 4]] != y[:, [1, 3, 4]])


def test_without_a_rate_velocities_are_exact():
    true = motion(50)
    for fault in (MeasurementNoise(rms=0.1, rate=0.0), Quantisation(resolution=0.1, rate=0.0)):
        q, v = readings(fault, true)
        same((q, v), (q, true[1]))
        assert np.all(q != true[0])


FIELDS = {
    MeasurementDelay: {"delay": (st.floats(0.0, 0.02), 0)},
    MeasurementNoise: {
        "rms": (st.floats(0.0, 0.1), 6),
        "rate": (st.floats(0.0, 200.0), 0),
        "correlation_time": (st.floats(STEP, 0.02), 0),
    },
    Quantisation: {"resolution": (st.floats(0.0, 0.1), 6), "rate": (st.floats(0.0, 200.0), 0)},
}


@pytest.mark.parametrize("kind", FIELDS, ids=name_of)
@settings(max_examples=20, deadline=None)
@given(data=st.data(), seed=st.integers(0, 100), arms=st.integers(1, 7), contiguous=st.booleans())
def test_an_arm_is_its_row_of_a_batch_bit_for_bit(
    kind: type[SensorFault], data: st.DataObject, seed: int, arms: int, contiguous: bool
):
    fields = {}
    for name, (values, columns) in FIELDS[kind].items():
        each = data.draw(st.sampled_from([1, columns])) if columns else 1
        rows = data.draw(
            st.lists(st.lists(values, min_size=each, max_size=each), min_size=arms, max_size=arms)
        )
        fields[name] = np.array(rows) if columns else np.array(rows)[:, 0]
    q, v = motion(50, (arms, 6), seed)
    if contiguous:  # along the arms, as a sweep has it
        q, v = (np.ascontiguousarray(x.transpose(0, 2, 1)).transpose(0, 2, 1) for x in (q, v))
    every, seeds = data.draw(st.integers(1, 5)), SeedSequence(seed).spawn(arms)
    together = readings(kind(**fields), (q, v), every, seeds=seeds)
    for i in range(arms):
        own = kind(**{name: value[i] for name, value in fields.items()})
        alone = readings(own, (q[:, i], v[:, i]), every, seeds=seeds[i])
        same(alone, (together[0][:, i], together[1][:, i]))


@pytest.mark.parametrize(
    "fault", [*ACTIVE, MeasurementDelay(delay=[0.001, 0.0, 0.004])], ids=name_of
)
def test_arrays_stay_as_they_are_and_contiguous_along_the_arms(fault: SensorFault):
    process = fault.start(episode(SeedSequence(0).spawn(3)))
    for k, (q, v) in enumerate(zip(*motion(30, (6, 3)), strict=True)):
        true = (q.T, v.T)
        for x in true:
            x.setflags(write=False)
        process.record(k, *true)
        read = process(k, *true)
        for x, y in zip(true, read, strict=True):
            assert y.T.flags.c_contiguous
            assert y.shape == x.shape and not np.shares_memory(x, y)


@pytest.mark.parametrize("fault", ACTIVE, ids=name_of)
def test_every_start_is_fresh_and_a_copy_goes_on_alone(fault: SensorFault):
    q, v = motion(40)
    first = readings(fault, (q, v))
    process = fault.start(episode(SeedSequence(0)))
    for k in range(20):
        process.record(k, q[k], v[k])
        process(k, q[k], v[k])
    for other in (copy.deepcopy(process), pickle.loads(pickle.dumps(process))):
        for k in range(20, 40):
            other.record(k, q[k], v[k])
            same(other(k, q[k], v[k]), (first[0][k], first[1][k]))
    same(readings(fault, (q, v)), first)


@pytest.mark.parametrize(
    ("kind", "fields", "message"),
    [
        (
            MeasurementDelay,
            {"delay": -1.0},
            "delay of measurement-delay is -1 s; it must be at least 0 s",
        ),
        (
            MeasurementDelay,
            {"delay": np.inf},
            "delay of measurement-delay holds inf; it must be finite",
        ),
        (
            MeasurementNoise,
            {"rms": -0.1},
            "rms of measurement-noise is -0.1; it must be at least 0",
        ),
        (
            MeasurementNoise,
            {"rms": 0.1, "correlation_time": 0.0},
            "time of measurement-noise is 0 s; it must be above 0 s",
        ),
        (
            Quantisation,
            {"resolution": "fine"},
            "resolution of quantisation is 'fine'; it must be made of numbers",
        ),
        (
            Quantisation,
            {"resolution": 0.1, "rate": -1.0},
            "rate of quantisation is -1 1/s; it must be at least 0 1/s",
        ),
    ],
)
def test_bad_values_are_refused_in_one_sentence(kind, fields: dict, message: str):
    with pytest.raises(ValueError, match=f"^{message}$"):
        kind(**fields)


def test_values_that_do_not_suit_the_arm_are_refused():
    one = episode(SeedSequence(0))
    with pytest.raises(ValueError, match=r"rms of measurement-noise has shape \(5,\)"):
        MeasurementNoise(rms=np.ones(5)).start(one)
    with pytest.raises(ValueError, match=r"delay of measurement-delay has shape \(2,\)"):
        MeasurementDelay(delay=[0.0, 0.1]).start(one)
    with pytest.raises(ValueError, match="must be at least the physics step"):
        MeasurementNoise(rms=0.1, correlation_time=STEP / 2).start(one)


def test_the_scale_is_the_rest_length_of_each_module_of_each_arm():
    two = P.scaled(rest_length=[[1.0, 1.0, 1.0], [2.0, 3.0, 4.0]])
    seeds = SeedSequence(0).spawn(2)
    both = Episode(
        parameters=two,
        timestep=STEP,
        reference=named_reference("sine", equilibrium(P)),
        seeds=seeds,
        batch_shape=(2,),
    )
    steps = Quantisation(resolution=0.5, rate=2.0).start(both)
    np.testing.assert_allclose(steps.step_q[:, :3], 0.5 * two.rest_length)
    np.testing.assert_array_equal(steps.step_q[:, 3:], 0.5)
    np.testing.assert_allclose(steps.step_v, 2.0 * steps.step_q)
