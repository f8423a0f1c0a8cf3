"""The measures of whole runs: streaming, batches, divergence, and the control rate."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from octarm.interfaces import Rows
from octarm.metrics import table as metrics
from octarm.metrics.metric import STEADY
from octarm.metrics.table import METRICS, Metrics, as_json, columns

PERIOD = 1e-2
ROWS = 420  # past SETTLED_AFTER, and past 255
LAYER = 0.6


def noisy(rows: int = ROWS, batch: tuple[int, ...] = (), modules: int = 3, seed: int = 0) -> Rows:
    """Arms that do all there is to measure, now and then."""
    draw, n = np.random.default_rng(seed), 2 * modules
    t = PERIOD * np.arange(rows)
    shape = (rows, *batch, n)
    fading = np.exp(-t).reshape(-1, *[1] * (len(shape) - 1))
    q_d = 0.3 * np.sin(np.pi * t.reshape(fading.shape) + draw.uniform(0.0, 6.0, (*batch, n)))
    q_d[..., n - 1] = 0.05
    s = draw.normal(size=shape) * fading + draw.choice([0.0, 2.0], (*batch, n))
    return {
        "t": t,
        "q": q_d + draw.normal(size=shape) * fading * draw.choice([1e-3, 0.1], (*batch, n)),
        "q_d": q_d,
        "tau": np.clip(draw.normal(size=shape), -1.5, 1.5),
        "force": draw.normal(size=shape),
        "s": s,
        "reaching_bound": np.full((*shape[:-1], 1), 2.5),
    }


def take(rows: Rows, cut: slice | np.ndarray) -> Rows:
    """Some of the rows."""
    return {name: array[cut] for name, array in rows.items()}


def batch_first(rows: Rows) -> Rows:
    """The same rows with the arms contiguous in memory, as sweeps have it."""

    def turned(array: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(np.swapaxes(array, -1, -2)).swapaxes(-1, -2)

    return {name: array if name == "t" else turned(array) for name, array in rows.items()}


def arm(rows: Rows, i: int) -> Rows:
    """One arm of a batch."""
    return {name: array if name == "t" else array[:, i] for name, array in rows.items()}


def without(rows: Rows, *names: str) -> Rows:
    return {name: array for name, array in rows.items() if name not in names}


def measure(*blocks: Rows, diverged: np.ndarray | bool = False, **options) -> dict:
    whole = Metrics(
        **{"control_period": PERIOD, "input_range": (-1.5, 1.5), "layer": LAYER} | options
    )
    for block in blocks:
        whole.update(block)
    return whole.result(diverged=diverged)


def assert_same_bits(found: dict, expected: dict) -> None:
    assert list(found) == list(expected)
    for name, value in expected.items():
        assert found[name].shape == value.shape, name
        assert found[name].tobytes() == value.tobytes(), name


def test_every_metric_is_described_and_has_its_shape():
    found = measure(noisy(batch=(5,)))
    assert list(found) == list(METRICS)
    for name, meaning in METRICS.items():
        assert found[name].shape == ((5,) if meaning.of == "arm" else (5, 6)), name
        assert meaning.unit_for("m") and len(meaning.units) <= (
            2 if meaning.of == "coordinate" else 1
        )
        assert meaning.waits_for in ("", *METRICS)
        assert meaning.text and "\n" not in meaning.text
    single = measure(noisy())
    assert all(single[n].shape == (() if m.of == "arm" else (6,)) for n, m in METRICS.items())


def test_the_random_arms_leave_nothing_untested():
    found = measure(noisy(batch=(64,)))
    for name in ("settling_time", "reaching_time", "step_overshoot"):
        assert 0.0 < np.mean(np.isnan(found[name])) < 1.0, name
    for name in ("saturation_share", "layer_share", "sliding_violations", "settled"):
        assert np.nanmin(found[name]) < np.nanmax(found[name]), name


@given(st.lists(st.integers(0, ROWS), max_size=12), st.sampled_from([(), (1,), (3,)]))
@settings(max_examples=25, deadline=None)
def test_how_the_run_is_cut_changes_no_bit(cuts, batch):
    block = noisy(batch=batch)
    edges = [0, *sorted(cuts), ROWS]
    parts = [take(block, slice(a, b)) for a, b in itertools.pairwise(edges)]
    assert_same_bits(measure(*parts), measure(block))


@pytest.mark.parametrize("size", [1, 18, 100, 1_000_000])
def test_the_size_of_the_parts_within_changes_no_bit(size, monkeypatch):
    block = noisy(batch=(3,))
    expected = measure(block)
    monkeypatch.setattr(metrics, "_NUMBERS_A_PART", size)
    assert_same_bits(measure(block), expected)


def test_one_row_at_a_time_changes_no_bit():
    block = noisy(batch=(2,))
    rows = [take(block, slice(i, i + 1)) for i in range(ROWS)]
    assert_same_bits(measure(*rows), measure(block))


@pytest.mark.parametrize("modules", [1, 3, 5])
@pytest.mark.parametrize("arms", [1, 7, 257])
def test_an_arm_alone_is_its_row_of_the_batch_bit_for_bit(modules, arms):
    block = noisy(260, (arms,), modules, seed=arms)
    plain, turned = measure(block), measure(batch_first(block))
    assert_same_bits(turned, plain)
    for i in {0, arms // 2, arms - 1}:
        alone = measure(arm(block, i))
        assert_same_bits(alone, {name: value[i] for name, value in plain.items()})


def test_arms_may_share_their_reference():
    block = noisy(batch=(4,))
    shared = block["q_d"][:, :1]
    full = np.repeat(shared, 4, axis=1)
    assert_same_bits(measure({**block, "q_d": shared}), measure({**block, "q_d": full}))


def test_limits_may_differ_from_arm_to_arm():
    block = noisy(batch=(3,))
    draw = np.random.default_rng(5)
    most, layer, band = draw.uniform(0.01, 1.5, (3, 3, 6))
    options = {"input_range": (-most, 2.0 * most), "layer": layer, "band": band}
    found = measure(block, **options)
    for i in range(3):
        limits = (-most[i], 2.0 * most[i])
        alone = measure(arm(block, i), input_range=limits, layer=layer[i], band=band[i])
        assert_same_bits(alone, {name: value[i] for name, value in found.items()})


def test_a_loop_may_reuse_its_memory():
    block = noisy(batch=(2,))
    memory = {name: np.copy(array[:1]) for name, array in block.items()}
    whole = Metrics(control_period=PERIOD, input_range=(-1.5, 1.5), layer=LAYER)
    for i in range(ROWS):
        for name, kept in memory.items():
            kept[...] = block[name][i : i + 1]
        whole.update(memory)
    for kept in memory.values():
        kept[...] = np.nan
    assert_same_bits(whole.result(), measure(block))


def test_asking_for_the_result_changes_nothing():
    block, whole = noisy(), Metrics(control_period=PERIOD, input_range=(-1.5, 1.5), layer=LAYER)
    for i in range(0, ROWS, 60):
        whole.update(take(block, slice(i, i + 60)))
        for value in whole.result().values():
            if value.ndim:
                value += 1.0
    assert_same_bits(whole.result(), measure(block))


def test_a_diverged_arm_has_no_numbers_and_leaves_the_others_alone():
    block = noisy(batch=(3,))
    found = measure(block, diverged=np.array([False, True, False]))
    intact = measure(block)
    for name, value in found.items():
        assert np.all(np.isnan(value[1])), name
        for i in (0, 2):
            assert value[i].tobytes() == intact[name][i].tobytes(), name
    assert all(np.all(np.isnan(value)) for value in measure(noisy(), diverged=True).values())


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -1e308])
@pytest.mark.parametrize("where", ["q", "tau", "force"])
@pytest.mark.parametrize("row", [0, 100, ROWS - 1])
def test_what_was_not_finite_has_no_numbers_even_when_nobody_says_so(bad, where, row):
    block = noisy(batch=(3,))
    block[where][row, 1, 4] = bad
    found, intact = measure(block), measure(noisy(batch=(3,)))
    for name, value in found.items():
        assert not np.any(np.isinf(value)), name
        assert np.all(np.isnan(value[1])) or np.isfinite(bad), name
        for i in (0, 2):
            assert value[i].tobytes() == intact[name][i].tobytes(), name


def test_a_run_that_is_too_short_has_no_steady_regime():
    found = measure(noisy(150))
    steady = [name for name, meaning in METRICS.items() if STEADY in meaning.text]
    assert {"rms_error", "overshoot", "tip_rms_error", "chattering", "layer_share"} <= set(steady)
    for name in steady:
        assert np.all(np.isnan(found[name])), name
    for name in ("effort", "force_effort", "energy", "peak_input", "control_rate"):
        assert np.all(np.isfinite(found[name])), name


def test_without_a_sliding_variable_nothing_is_said_of_it():
    found = measure(without(noisy(), "s", "reaching_bound"))
    missing = {"reaching_time", "reaching_bound", "layer_share", "sliding_violations"}
    assert set(found) == set(METRICS) - missing
    assert set(measure(noisy(), layer=None)) == set(METRICS) - {"layer_share"}


def test_the_promised_reaching_time_is_the_first():
    block = noisy(batch=(2,))
    bound = np.linspace(3.0, 0.0, ROWS)[:, None, None] * np.array([[1.0], [2.0]])
    found = measure({**block, "reaching_bound": bound})
    np.testing.assert_array_equal(found["reaching_bound"], [3.0, 6.0])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"control_period": 0.0}, "control period holds 0; it must be above 0 and finite"),
        ({"control_period": np.nan}, "control period holds nan"),
        ({"input_range": ([-1.0, 1.0], 2.0)}, r"input range is \(\[-1.0, 1.0\], 2.0\); it must ho"),
        ({"input_range": (-1.0, np.nan)}, r"input range is \(-1.0, nan\); it must hold 0"),
        ({"layer": -1.0}, "layer holds -1; it must be at least 0 and finite"),
        ({"band": np.inf}, "band holds inf"),
        ({"corner": 0.0}, "corner holds 0"),
        ({"settle": -0.1}, "settle holds -0.1; it must be at least 0 and finite"),
    ],
)
def test_settings_that_make_no_sense_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Metrics(**{"control_period": PERIOD} | options)


def test_settings_that_do_not_fit_the_arms_are_refused():
    with pytest.raises(ValueError, match=r"layer has shape \(4,\); it must broadcast to \(2, 6\)"):
        measure(noisy(batch=(2,)), layer=np.ones(4))


def test_there_is_no_result_of_nothing():
    with pytest.raises(ValueError, match="nothing to measure"):
        Metrics(control_period=PERIOD).result()
    assert_same_bits(measure(take(noisy(), slice(0, 0)), noisy()), measure(noisy()))


def smooth(period: float, duration: float = 6.0) -> Rows:
    """A motion that is smooth in time, at any control rate."""
    t = period * np.arange(round(duration / period))
    x, fade = t[:, None], np.exp(-3.0 * t)[:, None]
    size, pace = np.array([0.02, 0.015, 0.01, 0.35, 0.25, 0.2]), np.arange(6.0)
    q_d = 0.1 + size * np.sin(np.pi * x + pace)
    q_d[:, 5] = 0.2  # a step, seen from where q begins
    e = size * (0.02 * np.sin((7.0 + pace) * x) + 0.01) + 0.3 * size * fade
    e[:, 0], e[:, 5] = 0.1 * fade[:, 0], -0.2 * fade[:, 0] * np.cos(9.0 * t)
    force = size * (5.0 * np.sin(np.pi * x) + 2.0 * np.sin((250.0 + 30.0 * pace) * x)) + 30.0 * fade
    s = 3.0 * fade + 0.4 * np.sin((5.0 + pace) * x) + np.array([0, 0, 0, 0, 0, 2.0])
    tau = np.clip(5.0 * np.sin((3.0 + pace) * x), -4.0, 4.0)
    fields = {"t": t, "q": q_d + e, "q_d": q_d, "tau": tau, "force": force, "s": s}
    return {**fields, "reaching_bound": 0.0 * x + 1.0}


def test_halving_the_control_period_changes_nothing_but_what_says_so():
    coarse, fine, true = (
        measure(smooth(h), control_period=h, input_range=(-4.0, 4.0), layer=0.3)
        for h in (5e-4, 2.5e-4, 6.25e-5)
    )
    assert list(coarse) == list(METRICS)
    for name in METRICS:
        limit, near, nearer = true[name], coarse[name], fine[name]
        scale = np.maximum(np.abs(limit), 1e-3)
        if name == "switching_activity":
            np.testing.assert_allclose(nearer, near / 2.0, rtol=0.01)
        elif name == "control_rate":
            np.testing.assert_allclose(nearer, 2.0 * near)
        else:
            np.testing.assert_array_equal(np.isnan(near), np.isnan(limit), err_msg=name)
            for value, allowed in ((near, 0.01), (nearer, 0.005)):
                off = np.nan_to_num(np.abs(value - limit) / scale)
                np.testing.assert_array_less(off, allowed, err_msg=name)


def test_halving_the_period_of_a_force_that_switches_at_every_instant():
    found = []
    for period in (1e-3, 5e-4, 2.5e-4, 1.25e-4):
        block = smooth(period, 4.0)
        switching = np.where(np.arange(len(block["t"])) % 2, 1.0, -1.0)[:, None] * np.ones(6)
        found.append(measure({**block, "force": switching}, control_period=period))
    chattering = np.array([one["chattering"][0] for one in found])
    variation = np.array([one["total_variation"][0] for one in found])
    steps = np.abs(np.diff(chattering))
    assert np.all(steps[1:] < 0.3 * steps[:-1]) and chattering[-1] == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(variation[1:], 2.0 * variation[:-1])


def test_metrics_are_plain_numbers_in_json():
    results = measure(noisy())
    plain = as_json(results)
    assert list(plain) == list(results)
    for name, values in results.items():
        np.testing.assert_array_equal(np.array(plain[name], dtype=float), values)  # None is NaN
    assert plain["step_overshoot"] == [None] * 6 and isinstance(plain["control_rate"], float)


@pytest.mark.parametrize("rows", [1, ROWS])
def test_a_diverged_run_has_no_numbers(rows):
    block = take(noisy(), slice(0, rows))
    block["tau"][-1] = np.nan
    plain = as_json(measure(block, diverged=True))
    assert plain["effort"] == plain["settling_time"] == [None] * 6
    assert plain["tip_rms_error"] is None


def test_a_table_has_a_column_for_each_number_with_its_unit():
    held = {column.name: column for column in columns(["a", "b"], ["m", "rad"])}
    assert held["rms_error_a"][:5] == ("rms_error_a", "rms_error", "a", 0, "m")
    assert held["rms_error_b"].metadata == {"metric": "rms_error", "of": "b", "unit": "rad"}
    assert [held[f"{name}_b"].unit for name in ("force_effort", "energy")] == ["N m", "J"]
    assert held["effort_tau2"].unit == "N" and held["tip_rms_error"].of == ""
    numbers = [1 if metric.of == "arm" else 2 for metric in METRICS.values()]
    assert len(held) == sum(numbers)
