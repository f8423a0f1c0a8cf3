"""Actuator faults against their closed forms, on what the plant receives."""
# pyright: reportArgumentType=false
# (fields take anything array-like)

import copy
import dataclasses
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.random import SeedSequence

from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import nominal_parameters
from octarm.disturbances.actuators import (
    ActuationDelay,
    DeadZone,
    Lag,
    LossOfEffectiveness,
    Saturation,
    SlewLimit,
)
from octarm.disturbances.episode import ActuatorFault, Episode
from octarm.references import named_reference

P = nominal_parameters()
STEP = 5e-4  # [s]
NEUTRAL = [
    LossOfEffectiveness(share=0.0),
    LossOfEffectiveness(share=1.0, at=100.0),
    DeadZone(width=0.0),
    Saturation(limit=np.inf),
    Lag(time_constant=0.0),
    SlewLimit(rate=np.inf),
    ActuationDelay(delay=0.0),
]
ACTIVE = [
    LossOfEffectiveness(share=0.3, at=0.004),
    DeadZone(width=2.0),
    Saturation(limit=3.0),
    Lag(time_constant=0.003),
    SlewLimit(rate=900.0),
    ActuationDelay(delay=0.0035),
]


def name_of(fault: ActuatorFault) -> str:
    return fault.name


def episode(arms: int | None = None, timestep: float = STEP) -> Episode:
    return Episode(
        parameters=P,
        timestep=timestep,
        reference=named_reference("sine", equilibrium(P)),
        seeds=SeedSequence(0) if arms is None else SeedSequence(0).spawn(arms),
        batch_shape=() if arms is None else (arms,),
    )


def received(fault: ActuatorFault, tau: np.ndarray, timestep: float = STEP) -> np.ndarray:
    """What the plant gets when these are asked, one after another, shape (T, ..., 2N)."""
    process = fault.start(episode(tau.shape[1] if tau.ndim == 3 else None, timestep))
    return np.stack([process(k, tau[k]) for k in range(len(tau))])


def held(steps: int, period: int, shape: tuple[int, ...] = (6,), seed: int = 0) -> np.ndarray:
    """Random inputs, each held for a control period of so many physics steps."""
    draws = np.random.default_rng(seed).normal(scale=5.0, size=(steps // period + 1, *shape))
    return np.repeat(draws, period, axis=0)[:steps]


def bits(x: np.ndarray) -> np.ndarray:
    """Tells -0 from 0."""
    return np.ascontiguousarray(x).view(np.int64)


@pytest.mark.parametrize("late", [0, 1, 7, 10, 23])
def test_an_impulse_arrives_once_and_as_late_as_asked(late: int):
    """Also where the delay is no multiple of the control period, 5 steps here."""
    tau = np.zeros((60, 6))
    tau[5:10] = 1.0 + np.arange(6.0)
    out = received(ActuationDelay(delay=late * STEP), tau)
    wanted = np.zeros_like(tau)
    wanted[5 + late : 10 + late] = tau[5:10]
    np.testing.assert_array_equal(out, wanted)


def test_nothing_acts_before_the_delay_has_passed():
    tau = held(40, 5) + 100.0
    out = received(ActuationDelay(delay=13 * STEP), tau)
    np.testing.assert_array_equal(out[:13], 0.0)
    np.testing.assert_array_equal(out[13:], tau[:-13])


@pytest.mark.parametrize("timestep", [2.5e-4, 5e-4, 1e-3])
@pytest.mark.parametrize("delay", [0.003, 0.011])
def test_cross_correlation_peaks_at_the_delay_for_any_timestep(delay: float, timestep: float):
    asked = held(4000, round(0.002 / timestep))[:, 0]
    out = received(ActuationDelay(delay=delay), np.repeat(asked[:, None], 6, axis=1), timestep)
    lags = np.arange(60)
    peak = [np.dot(asked[: 4000 - lag], out[lag:, 0]) for lag in lags]
    assert lags[np.argmax(peak)] * timestep == pytest.approx(delay)


def test_what_arrives_is_exact_in_its_integral_for_any_delay_of_each_arm():
    asked = np.array([0.0, 0.0002, 0.0003, 0.00125, 0.0014, 0.0375])
    process = ActuationDelay(delay=asked).start(episode(6))
    np.testing.assert_allclose((process.steps + process.rest) * STEP, asked, rtol=1e-12)
    tau = held(100, 4, (6, 6))
    out = np.stack([process(k, tau[k]) for k in range(100)])
    t = STEP * np.arange(101)
    zero = np.zeros((1, 6, 6))
    given, come = (STEP * np.cumsum(np.concatenate([zero, x]), axis=0) for x in (tau, out))
    for i, j in np.ndindex(6, 6):
        expected = np.interp(t - asked[i], t, given[:, i, j])  # 0 before the start
        np.testing.assert_allclose(come[:, i, j], expected, rtol=0, atol=1e-14)
    for i, late in ((0, 0), (5, 75)):  # whole steps lose no bit
        np.testing.assert_array_equal(out[late:, i], tau[: 100 - late, i])


def test_a_delay_of_a_fraction_of_a_step_changes_no_bit_of_another_arm():
    tau = held(100, 4, (3, 6))
    delays = [0.002, 0.00125, 0.0007]
    process = ActuationDelay(delay=delays).start(episode(3))
    together = np.stack([process(k, tau[k]) for k in range(100)])
    for i, delay in enumerate(delays):
        alone = received(ActuationDelay(delay=delay), tau[:, i])
        np.testing.assert_array_equal(bits(alone), bits(together[:, i]))


def test_a_delay_between_two_steps_is_between_their_responses():
    """The audit's case: 1.25 ms, which was 1.0 ms when delays were rounded."""
    tau = np.zeros((8, 6))
    tau[2:] = 4.0
    out = received(ActuationDelay(delay=0.00125), tau)[:, 0]
    np.testing.assert_allclose(out, [0, 0, 0, 0, 2, 4, 4, 4], atol=1e-15)


def test_memory_is_as_long_as_the_longest_delay():
    process = ActuationDelay(delay=[0.0, 0.005]).start(episode(2))
    sizes = []
    for k in range(300):
        process(k, np.ones((2, 6)))
        sizes.append(len(pickle.dumps(process)))
    assert max(sizes) - min(sizes) < 16
    assert max(sizes) < 1000 + 12 * 2 * 6 * 8


def test_lag_is_the_exponential_at_every_step_whatever_the_step():
    T = np.array([0.002, 0.005, 0.01, 0.02, 0.05, 0.1])
    for timestep in (2.5e-4, 1e-3, 4e-3):
        t = timestep * np.arange(1, 200)[:, None]  # a step's value is that of its end
        out = received(Lag(time_constant=T), np.full((199, 6), 4.0), timestep)
        np.testing.assert_allclose(out, 4.0 * (1.0 - np.exp(-t / T)), rtol=1e-12)


def test_lag_from_one_held_input_to_the_next():
    """y(t) = tau + (y0 - tau) exp(-t / T) after every change of the input."""
    T, tau = 0.004, held(200, 8)
    out = received(Lag(time_constant=T), tau)
    start = out[7:-1:8]  # the value before each change but the first
    for j in range(8):
        left = np.exp(-(j + 1) * STEP / T)
        now = out[8 + j :: 8]
        asked = tau[8 + j :: 8]
        np.testing.assert_allclose(now, asked + left * (start[: len(now)] - asked), atol=1e-12)


def test_slew_ramps_at_the_rate_and_then_follows():
    for timestep in (2.5e-4, 1e-3):
        t = timestep * np.arange(1, 400)[:, None]
        rate = np.array([50.0, 100.0, 200.0, 400.0, 800.0, 1e4])
        out = received(SlewLimit(rate=rate), np.full((399, 6), -5.0), timestep)
        np.testing.assert_allclose(out, -np.minimum(rate * t, 5.0), rtol=1e-12)
        np.testing.assert_array_equal(out[rate * t > 5.0 + 1e-9], -5.0)


def test_slew_is_never_faster_and_always_towards_what_is_asked():
    tau, rate = held(500, 4), 2000.0
    out = received(SlewLimit(rate=rate), tau)
    before = np.concatenate([np.zeros((1, 6)), out[:-1]])
    assert np.max(np.abs(out - before)) <= rate * STEP * (1 + 1e-12)
    close = np.abs(tau - before) < rate * STEP
    np.testing.assert_array_equal(out[close], tau[close])
    far = out[~close] - before[~close]
    np.testing.assert_allclose(far, np.sign((tau - before)[~close]) * rate * STEP, rtol=1e-9)
    assert 0.05 < close.mean() < 0.95


def test_dead_zone_and_saturation_point_by_point():
    tau = np.repeat(np.linspace(-8.0, 8.0, 161)[:, None], 6, axis=1)
    width = np.array([0.0, 0.5, 1.0, 2.0, 4.0, 10.0])
    dead = received(DeadZone(width=width), tau)
    for x, row in zip(tau[:, 0], dead, strict=True):
        wanted = [0.0 if abs(x) < w else x - np.copysign(w, x) for w in width]
        np.testing.assert_allclose(row, wanted, atol=1e-15)
    limited = received(Saturation(limit=width), tau)
    np.testing.assert_array_equal(limited, [[max(-w, min(w, x)) for w in width] for x in tau[:, 0]])
    np.testing.assert_allclose(dead + limited, tau, atol=1e-15)


@pytest.mark.parametrize(("at", "first"), [(0.0, 0), (0.01, 20), (0.0101, 21)])
def test_effectiveness_is_lost_from_its_time_on_and_on_its_columns_only(at: float, first: int):
    tau = held(50, 5)
    out = received(LossOfEffectiveness(share=[0.0, 0.4, 0.0, 0.0, 1.0, 0.0], at=at), tau)
    np.testing.assert_array_equal(bits(out[:first]), bits(tau[:first]))
    np.testing.assert_allclose(out[first:, 1], 0.6 * tau[first:, 1], rtol=1e-15)
    np.testing.assert_array_equal(out[first:, 4], 0.0)
    others = [0, 2, 3, 5]
    np.testing.assert_array_equal(bits(out[:, others]), bits(tau[:, others]))


@pytest.mark.parametrize("fault", NEUTRAL, ids=name_of)
def test_neutral_values_change_no_bit(fault: ActuatorFault):
    tau = held(60, 3)
    tau[::7] *= -0.0
    np.testing.assert_array_equal(bits(received(fault, tau)), bits(tau))


@pytest.mark.parametrize("fault", ACTIVE, ids=name_of)
def test_it_acts_on_every_column(fault: ActuatorFault):
    tau = held(60, 3)
    assert np.all(np.max(np.abs(received(fault, tau) - tau), axis=0) > 0.3)


FIELDS = {
    LossOfEffectiveness: {"share": (st.floats(0.0, 1.0), 6), "at": (st.floats(0.0, 0.02), 0)},
    DeadZone: {"width": (st.floats(0.0, 6.0), 6)},
    Saturation: {"limit": (st.floats(0.0, 9.0) | st.just(np.inf), 6)},
    Lag: {"time_constant": (st.floats(0.0, 0.05), 6)},
    SlewLimit: {"rate": (st.floats(1.0, 5e4) | st.just(np.inf), 6)},
    ActuationDelay: {"delay": (st.floats(0.0, 0.02), 0)},
}


@pytest.mark.parametrize("kind", FIELDS, ids=name_of)
@settings(max_examples=15, deadline=None)
@given(data=st.data(), seed=st.integers(0, 100), arms=st.integers(1, 9), contiguous=st.booleans())
def test_an_arm_is_its_row_of_a_batch_bit_for_bit(
    kind: type[ActuatorFault], data: st.DataObject, seed: int, arms: int, contiguous: bool
):
    fields = {}
    for name, (values, columns) in FIELDS[kind].items():
        each = data.draw(st.sampled_from([1, columns])) if columns else 1
        rows = data.draw(
            st.lists(st.lists(values, min_size=each, max_size=each), min_size=arms, max_size=arms)
        )
        fields[name] = np.array(rows) if columns else np.array(rows)[:, 0]
    tau = held(50, 3, (arms, 6), seed)
    if contiguous:  # along the arms, as a sweep has it
        tau = np.ascontiguousarray(tau.transpose(0, 2, 1)).transpose(0, 2, 1)
    together = received(kind(**fields), tau)
    for i in range(arms):
        alone = received(kind(**{name: value[i] for name, value in fields.items()}), tau[:, i])
        np.testing.assert_array_equal(bits(alone), bits(together[:, i]))


@pytest.mark.parametrize("fault", [*ACTIVE, ActuationDelay(delay=[0.001, 0.0, 0.004])], ids=name_of)
def test_arrays_stay_as_they_are_and_contiguous_along_the_arms(fault: ActuatorFault):
    process = fault.start(episode(3))
    for k, tau in enumerate(held(30, 3, (6, 3))):
        asked = tau.T
        asked.setflags(write=False)
        out = process(k, asked)
        assert out.T.flags.c_contiguous
        assert out.shape == asked.shape and not np.shares_memory(out, asked)


@pytest.mark.parametrize("fault", ACTIVE, ids=name_of)
def test_every_start_is_fresh_and_a_copy_goes_on_alone(fault: ActuatorFault):
    tau = held(40, 3)
    first = received(fault, tau)
    process = fault.start(episode())
    for k in range(20):
        process(k, tau[k])
    for other in (copy.deepcopy(process), pickle.loads(pickle.dumps(process))):
        rest = np.stack([other(k, tau[k]) for k in range(20, 40)])
        np.testing.assert_array_equal(rest, first[20:])
    np.testing.assert_array_equal(received(fault, tau), first)


@pytest.mark.parametrize(
    ("kind", "fields", "message"),
    [
        (
            LossOfEffectiveness,
            {"share": 1.2},
            r"share of loss is 1.2; it must be at most 1, did you mean 1.2%\?",
        ),
        (DeadZone, {"width": -1.0}, "width of dead-zone is -1 N; it must be at least 0 N"),
        (Saturation, {"limit": -np.inf}, "limit of saturation holds -inf; it must be finite"),
        (Saturation, {"limit": [1.0, np.nan]}, "limit of saturation holds nan; it must be finite"),
        (
            Saturation,
            {"limit": "high"},
            "limit of saturation is 'high'; it must be made of numbers",
        ),
        (Lag, {"time_constant": np.inf}, "time of lag holds inf; it must be finite"),
        (SlewLimit, {"rate": 0.0}, "rate of slew is 0 N/s; it must be above 0 N/s"),
        (
            ActuationDelay,
            {"delay": 11.0},
            r"delay of actuation-delay is 11 s; it must be at most 10 s, did you mean 11ms\?",
        ),
    ],
)
def test_bad_values_are_refused_in_one_sentence(kind, fields: dict, message: str):
    with pytest.raises(ValueError, match=f"^{message}$"):
        kind(**fields)


def test_values_that_do_not_suit_the_arm_are_refused():
    with pytest.raises(ValueError, match=r"limit of saturation has shape \(5,\)"):
        Saturation(limit=np.ones(5)).start(episode())
    with pytest.raises(ValueError, match=r"delay of actuation-delay has shape \(2,\)"):
        ActuationDelay(delay=[0.0, 0.1]).start(episode(3))


@pytest.mark.parametrize("kind", [Saturation, SlewLimit])
def test_no_limit_is_as_good_as_one_and_read_only(kind):
    name = dataclasses.fields(kind)[0].name
    assert getattr(kind(**{name: np.inf}), name) == np.inf
    several = getattr(kind(**{name: [[1.0], [np.inf]]}), name)
    np.testing.assert_array_equal(several, [[1.0], [np.inf]])
    assert not several.flags.writeable
