"""Disturbances together: their spelling, their random streams, and what they do to one another."""

import copy
import dataclasses
import json
import pickle
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import nominal_parameters
from octarm.disturbances.active import ActiveDisturbances
from octarm.disturbances.episode import Disturbance, Episode
from octarm.disturbances.forces import BandLimitedNoise, SineForce, StepForce
from octarm.disturbances.ledger import asked
from octarm.disturbances.plant import Payload, RandomMismatch
from octarm.disturbances.sensors import MeasurementNoise
from octarm.disturbances.spelling import (
    DISTURBANCES,
    from_dict,
    from_entry,
    help_text,
    parse_disturbance,
    to_dict,
)
from octarm.disturbances.streams import stream
from octarm.fields import field_kinds
from octarm.references import named_reference

P = nominal_parameters()
REST = equilibrium(P)
SINE = named_reference("sine", REST)
SEEDS = np.random.SeedSequence(23).spawn(4)
DT = 1e-3

# One spelling each, none of them neutral.
SPELLINGS = {
    "noise": "noise:0.4,time=0.003",
    "sine": "sine:0.1,frequency=2,on=theta1",
    "pulse": "pulse:5,at=0.02,length=0.0105,on=tip-y",
    "step": "step:-0.3,at=0.01,on=s2+theta3",
    "mismatch": "mismatch:0.2,stiffness=0.9,tilt=0.1",
    "random-mismatch": "random-mismatch:0.2",
    "drift": "drift:0.1,of=stiffness+damping",
    "cyclic-drift": "cyclic-drift:0.3,period=1",
    "payload": "payload:0.2,at=0.03",
    "tilt": "tilt:0.1",
    "actuation-delay": "actuation-delay:0.003",
    "dead-zone": "dead-zone:0.5",
    "saturation": "saturation:1/1/1/2/2/inf",
    "slew": "slew:30",
    "lag": "lag:0.02",
    "loss": "loss:0/0/0.5/0/0/0.1",
    "measurement-delay": "measurement-delay:0.0025",
    "measurement-noise": "measurement-noise:0.001,time=0.002",
    "quantisation": "quantisation:0.001",
}


def episode(arms: int | None = None, seeds=SEEDS, timestep: float = DT) -> Episode:
    return Episode(
        parameters=P,
        timestep=timestep,
        reference=SINE,
        seeds=seeds[0] if arms is None else seeds[:arms],
        batch_shape=() if arms is None else (arms,),
    )


def ride(disturbances, start: Episode, steps: int = 60, period: int = 3) -> dict[str, np.ndarray]:
    """All that comes of them along a made-up motion under made-up inputs, one row a step."""
    active = ActiveDisturbances(disturbances, start)
    # Arm i of four moves as it does alone: motion and inputs are picked by its seed.
    arms = [SEEDS.index(seed) for seed in np.atleast_1d(np.array(start.seeds, dtype=object))]
    draw = np.random.default_rng(0)
    q_all = REST + 0.1 * draw.normal(size=(steps + 1, 4, 6))
    v_all, tau_all = draw.normal(size=(2, steps + 1, 4, 6))
    pick = arms if start.batch_shape else arms[0]
    rows: dict[str, list[np.ndarray]] = {}
    for k in range(steps):
        q, v, tau = (np.asfortranarray(x[k, pick]) for x in (q_all, v_all, tau_all))
        row: dict[str, Any] = {"force": active.force(k, q), "tau": active.received(k, tau)}
        active.record(k, q, v)
        if k % period == 0:
            row["q"], row["v"] = active.sensed(k, q, v)
        plant = active.plant(k)
        if plant is not None:
            fields = dataclasses.asdict(plant.parameters)
            fields["angle"] = plant.gravity_angle
            for name, value in fields.items():
                core = getattr(P, name).shape if name != "angle" else ()
                row[f"plant.{name}"] = np.broadcast_to(value, (*start.batch_shape, *core))
        row["changed"] = np.full(start.batch_shape, plant is not None)
        for name, value in row.items():
            rows.setdefault(name, []).append(np.array(value))
    return {name: np.array(values) for name, values in rows.items()}


def assert_equal(one: dict[str, np.ndarray], other: dict[str, np.ndarray], row=...) -> None:
    assert one.keys() == other.keys()
    for name in one:
        its = other[name] if row is ... else other[name][:, row]
        np.testing.assert_array_equal(one[name], its, err_msg=name)


# Names and spelling


def test_every_disturbance_has_a_spelling_that_is_written_down():
    assert list(SPELLINGS) == list(DISTURBANCES)
    assert all(cls.name == name for name, cls in DISTURBANCES.items())
    text = help_text()
    for name, cls in DISTURBANCES.items():
        assert f"{name}:" in text
        assert (cls.__doc__ or "").splitlines()[0].rstrip(".:") in " ".join(text.split())
        for field, kind in field_kinds(cls).items():
            assert (kind.key or field) in text.lower()
    assert max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize("name", SPELLINGS)
def test_json_brings_the_same_disturbance_back(name: str):
    disturbance = parse_disturbance(SPELLINGS[name])
    assert type(disturbance) is DISTURBANCES[name]
    written = json.dumps(to_dict(disturbance), allow_nan=False)
    again = from_dict(json.loads(written))
    assert json.dumps(to_dict(again)) == written
    for field in dataclasses.fields(disturbance):  # pyright: ignore[reportArgumentType]
        np.testing.assert_array_equal(getattr(again, field.name), getattr(disturbance, field.name))
    assert_equal(ride([again], episode()), ride([disturbance], episode()))


def test_arrays_survive_json():
    rms = np.random.default_rng(0).random((4, 6))
    noise = BandLimitedNoise(rms=rms, correlation_time=np.array([0.1, 1 / 3, 0.01, 1.0]))
    again = from_dict(json.loads(json.dumps(to_dict(noise))))
    assert isinstance(again, BandLimitedNoise)
    np.testing.assert_array_equal(np.asarray(again.rms), rms)
    np.testing.assert_array_equal(again.correlation_time, noise.correlation_time)


@pytest.mark.parametrize("name", SPELLINGS)
def test_every_disturbance_does_something_and_only_what_its_family_does(name: str):
    plain, disturbed = ride([], episode()), ride([parse_disturbance(SPELLINGS[name])], episode())
    place = list(SPELLINGS).index(name)
    family = [{"force"}, {"plant"}, {"tau"}, {"q", "v"}][sum(place >= i for i in (4, 10, 16))]
    changed = {n for n in plain if not np.array_equal(plain[n], disturbed[n])}
    changed |= {n.partition(".")[0] for n in disturbed.keys() - plain.keys()}
    assert changed - {"changed"} == family
    assert ("changed" in changed) == (family == {"plant"})


def test_values_go_where_they_belong():
    sine = parse_disturbance("sine:-1.5e-1,on=s1+theta3,at=2")
    assert isinstance(sine, SineForce)
    assert (sine.amplitude, sine.at, sine.on, sine.frequency) == (-0.15, 2.0, "s1+theta3", 1.0)
    noise = parse_disturbance("noise:rms=1/2/3/4/5/6,time=0.1")
    assert isinstance(noise, BandLimitedNoise)
    np.testing.assert_array_equal(np.asarray(noise.rms), [1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    assert (noise.ratio, noise.correlation_time) == (None, 0.1)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("paylod:0.2", "unknown disturbance 'paylod', did you mean 'payload'? the nearest of"),
        ("", "unknown disturbance ''; the nearest of 19 are "),
        ("payload", "'payload' is incomplete; it must read payload:MASS,at=0"),
        ("payload:", "'payload:' is incomplete; it must read payload:MASS,at=0"),
        ("payload:at=3", "'payload:at=3' is incomplete; it must read payload:MASS,at=0"),
        ("payload:0.2,att=3", "payload has no key 'att', did you mean 'at'? known are mass, at"),
        ("payload:0.2,at=3,at=3", "'payload:0.2,at=3,at=3' gives at twice"),
        ("payload:0.2,mass=3", "'payload:0.2,mass=3' gives mass twice"),
        ("payload:0.2,3", "'payload:0.2,3' has '3'; it must read payload:MASS,at=0"),
        ("payload:much", "mass of 'payload:much' is 'much'; it must be a number"),
        ("payload:nan", "mass of payload holds nan; it must be finite"),
        ("payload:1/2", "'payload:1/2' gives mass 2 numbers; it takes one"),
        ("payload:-1", "mass of payload is -1 kg; it must be at least 0 kg"),
        ("step:1,on=tip-z", "on of step is 'tip-z', did you mean 'tip-y'? known are all"),
        ("step:1,on=s1+s1", "on of step is 's1+s1'; it must name s1 once"),
        ("noise:0.4,rms=1", "noise needs either a ratio or an rms, and not both"),
    ],
)
def test_misspelt_disturbances_are_refused_in_a_sentence(text: str, sentence: str):
    with pytest.raises(ValueError) as refusal:
        parse_disturbance(text)
    assert str(refusal.value).startswith(sentence)
    assert "\n" not in str(refusal.value)


def test_wrong_descriptions_are_refused():
    for description, sentence in (
        ({"name": "payload"}, "payload needs the field 'mass'"),
        ({"name": "payload", "mass": 1.0, "tme": 2.0}, "payload has no field 'tme'"),
        ({"name": "payload", "mass": None}, "mass of payload holds nan"),
        ({"mass": 1.0}, "unknown disturbance 'None'"),
    ):
        with pytest.raises(ValueError, match=sentence):
            from_dict(description)


# What is drawn of them


@pytest.mark.parametrize(
    ("text", "events"),
    [
        ("payload:0.2,at=3", [(3.0, "payload 0.2")]),
        ("step:-1,at=2", [(2.0, "step -1")]),
        ("sine:0.1", [(0.0, "sine 0.1")]),
        ("sine:0.1,at=1,length=2", [(1.0, "sine 0.1"), (3.0, "")]),
        ("pulse:5,at=0.5,length=0.25", [(0.5, "pulse 5"), (0.75, "")]),
        ("loss:0.3,at=1", [(1.0, "loss 0.3")]),
        ("loss:0/0/0.5/0/0/0,at=1", [(1.0, "loss")]),
        ("noise:0.4", []),
        ("lag:0.01", []),
    ],
)
def test_it_says_when_it_begins_and_ends(text: str, events: list[tuple[float, str]]):
    assert [*parse_disturbance(text).events()] == events


def test_it_says_what_it_carries_turns_and_bounds():
    assert parse_disturbance("payload:0.2,at=3").carried() == (0.2, 3.0)
    assert parse_disturbance("tilt:0.1").gravity_angle() == 0.1
    assert parse_disturbance("mismatch:0.2,tilt=-0.3").gravity_angle() == -0.3
    bound = parse_disturbance("saturation:1/1/1/2/2/inf").input_bound()
    np.testing.assert_array_equal(np.asarray(bound), [1.0, 1.0, 1.0, 2.0, 2.0, np.inf])
    several = Payload(mass=np.array([0.1, 0.2]), at=1.0)
    assert several.carried() is None  # of one arm only
    for name in set(SPELLINGS) - {"payload", "tilt", "mismatch", "saturation"}:
        other = parse_disturbance(SPELLINGS[name])
        assert (other.carried(), other.gravity_angle(), other.input_bound()) == (None, 0.0, None)


@pytest.mark.parametrize("name", SPELLINGS)
def test_an_entry_of_a_run_brings_it_back(name: str):
    disturbance = parse_disturbance(SPELLINGS[name])
    first, second = asked([disturbance, disturbance])
    assert (first["name"], second["name"]) == (name, f"{name}-2")
    for entry in (first, second):
        assert to_dict(from_entry(json.loads(json.dumps(entry)))) == to_dict(disturbance)


# Random streams


def test_a_stream_depends_on_the_seed_and_the_name_alone():
    seed = np.random.SeedSequence(5, spawn_key=(1, 2))
    first = stream(seed, "noise").random(8)
    stream(seed, "payload").random(100)
    seed.spawn(3)
    np.testing.assert_array_equal(stream(seed, "noise").random(8), first)
    others = [stream(seed, "noise-2"), stream(np.random.SeedSequence(5), "noise")]
    others += [np.random.default_rng(seed), *map(np.random.default_rng, seed.spawn(2))]
    assert all(not np.any(other.random(8) == first) for other in others)


def test_other_disturbances_change_no_draws():
    noise = BandLimitedNoise(ratio=0.4, correlation_time=0.003)
    drawn = [noise, RandomMismatch(share=0.2), MeasurementNoise(rms=0.01)]
    alone = [ride([d], episode()) for d in drawn]
    step = StepForce(amplitude=0.0)
    together = ride([*drawn[::-1], step, Payload(mass=0.0, at=0.01)], episode())
    np.testing.assert_array_equal(together["force"], alone[0]["force"])
    np.testing.assert_array_equal(together["plant.mass"][0], alone[1]["plant.mass"][0])
    np.testing.assert_array_equal(together["q"], alone[2]["q"])


def test_two_of_a_kind_have_streams_and_names_of_their_own():
    noise = BandLimitedNoise(rms=1.0)
    active = ActiveDisturbances([noise, StepForce(amplitude=2.0, on="all"), noise], episode())
    assert [name for name, _ in active.forces] == ["noise", "noise-2", "step"]
    rows = []
    for k in range(0, 20_000, 10):
        total = active.force(k, REST)
        first, second, step = active.shares.values()
        np.testing.assert_array_equal(total, first + second + step)
        np.testing.assert_array_equal(step, 2.0)
        rows.append(np.concatenate([first, second]))
    cross = np.corrcoef(np.array(rows).T)
    assert np.max(np.abs(cross - np.eye(12))) < 0.12  # of 2000 holds: 5 standard deviations
    alone = ActiveDisturbances([noise], episode())
    alone.force(19_990, REST)
    np.testing.assert_array_equal(alone.shares["noise"], active.shares["noise"])


def test_measurement_delays_do_not_stack():
    delay = parse_disturbance("measurement-delay:0.01")
    with pytest.raises(ValueError, match="measurement-delay is given twice"):
        ActiveDisturbances([delay, delay], episode())


def test_nothing_in_the_realisation_depends_on_the_control_period():
    """The controller's period sets when it reads, and nothing else."""
    listed = [parse_disturbance(text) for text in SPELLINGS.values()]
    every = ride(listed, episode(), period=1)
    for period in (2, 5):
        seldom = ride(listed, episode(), period=period)
        for name in every:
            step = period if name in "qv" else 1
            np.testing.assert_array_equal(seldom[name], every[name][::step], err_msg=name)


# Together


def test_nothing_acts_when_nothing_is_listed():
    active = ActiveDisturbances([], episode(4))
    q, v, tau = np.random.default_rng(0).normal(size=(3, 4, 6))
    assert active.received(0, tau) is tau
    assert active.plant(0) is None
    active.record(0, q, v)
    assert active.sensed(0, q, v)[0] is q
    np.testing.assert_array_equal(active.force(0, q), np.zeros((4, 6)))


def test_the_order_of_listing_does_not_matter():
    listed = [parse_disturbance(text) for text in SPELLINGS.values()]
    assert_equal(ride(listed, episode()), ride(listed[::-1], episode()))


def test_what_the_caller_gets_cannot_be_changed_by_it():
    active = ActiveDisturbances([BandLimitedNoise(rms=1.0), StepForce(amplitude=1.0)], episode())
    for array in (active.force(0, REST), *active.shares.values()):
        with pytest.raises(ValueError, match="read-only"):
            array += 1.0


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))])
@pytest.mark.parametrize("arms", [None, 4])
def test_a_copy_goes_on_alike_and_on_its_own(duplicate, arms: int | None):
    start = episode(arms)
    active = ActiveDisturbances([parse_disturbance(text) for text in SPELLINGS.values()], start)
    shape = (100, *start.batch_shape, 6)
    q, v, tau = REST + 0.1 * np.random.default_rng(0).normal(size=(3, *shape))

    def go(which: ActiveDisturbances, steps: range) -> list[np.ndarray]:
        out = []
        for k in steps:
            out += [which.force(k, q[k]), which.received(k, tau[k])]
            which.record(k, q[k], v[k])
            out += which.sensed(k, q[k], v[k])
            out += [plant.parameters.mass] if (plant := which.plant(k)) else []
        return out

    go(active, range(50))
    other = duplicate(active)
    first, second = go(active, range(50, 100)), go(other, range(50, 100))
    assert len(first) == len(second)
    for x, y in zip(first, second, strict=True):
        np.testing.assert_array_equal(x, y)


# Any of them, for every arm its own

share = st.floats(0.0, 0.9)
small = st.floats(-0.9, 0.9)
positive = st.floats(0.001, 0.05)
factor = st.floats(0.2, 2.0)
time = st.sampled_from([0.0, 0.0007, 0.004, 0.0101, 0.05])
limit = st.sampled_from([0.1, 1.0, np.inf])
FIELDS: dict[str, dict[str, Any]] = {
    "noise": {"ratio": share, "correlation_time": positive},
    "sine": {"amplitude": small, "frequency": st.floats(0.1, 400.0), "phase": small, "at": time},
    "pulse": {"amplitude": small, "at": time, "length": positive},
    "step": {"amplitude": small, "at": time},
    "mismatch": {"mismatch": small, "inertia": factor, "rest_length": factor, "tilt": small},
    "random-mismatch": {"share": share, "rest_length": share, "tilt": share},
    "drift": {"rate": small, "limit": share},
    "cyclic-drift": {"share": share, "period": st.floats(0.1, 9.0), "phase": small},
    "payload": {"mass": share, "at": time},
    "tilt": {"angle": small},
    "actuation-delay": {"delay": time},
    "dead-zone": {"width": share},
    "saturation": {"limit": limit},
    "slew": {"rate": limit},
    "lag": {"time_constant": time},
    "loss": {"share": share, "at": time},
    "measurement-delay": {"delay": time},
    "measurement-noise": {"rms": share, "rate": share, "correlation_time": positive},
    "quantisation": {"resolution": share, "rate": share},
}
NEUTRAL = {"noise": "0", "sine": "0", "pulse": "0", "step": "0", "mismatch": "0", "tilt": "0"}
NEUTRAL |= {"random-mismatch": "0", "drift": "0", "cyclic-drift": "0", "payload": "0"}
NEUTRAL |= {"actuation-delay": "0", "dead-zone": "0", "saturation": "inf", "slew": "inf"}
NEUTRAL |= {"lag": "0", "loss": "0", "measurement-delay": "0", "measurement-noise": "0"}
NEUTRAL |= {"quantisation": "0"}
PLACES = st.sampled_from(["theta1", "s1+theta2", "all", "tip-x", "tip-y"])


@st.composite
def descriptions(draw: st.DrawFn, arms: int) -> list[tuple[str, dict[str, Any]]]:
    """Names of disturbances, and for each field a list of one value an arm, or words."""
    names = draw(st.lists(st.sampled_from(list(FIELDS)), min_size=1, max_size=6, unique=True))
    listed = []
    for name in names:
        values: dict[str, Any] = {
            field: draw(st.lists(numbers, min_size=arms, max_size=arms))
            for field, numbers in FIELDS[name].items()
        }
        if name in ("sine", "pulse", "step"):
            values["on"] = draw(PLACES)
        listed.append((name, values))
    return listed


def built(listed: list[tuple[str, dict[str, Any]]], arm: int | None) -> list[Disturbance]:
    """The disturbances of the whole batch, or of one of its arms."""
    out = []
    for name, values in listed:
        each = {n for n, k in field_kinds(DISTURBANCES[name]).items() if getattr(k, "each", False)}
        fields = {}
        for n, value in values.items():
            if isinstance(value, list):
                column = np.array(value)[:, None] if n in each else np.array(value)
                value = column if arm is None else value[arm]
            fields[n] = value
        out.append(DISTURBANCES[name](**fields))
    return out


@settings(max_examples=60, deadline=None)
@given(listed=descriptions(arms=3))
def test_any_combination_is_finite_repeatable_and_the_same_in_a_batch(listed):
    batch = ride(built(listed, None), episode(3))
    assert_equal(ride(built(listed, None), episode(3)), batch)
    assert all(np.all(np.isfinite(values)) for values in batch.values())
    for i in range(3):
        alone = ride(built(listed, i), episode(seeds=SEEDS[i:]))
        # The plant of a batch changes whenever that of one of its arms does: compare the latest.
        for name in ("force", "tau", "q", "v"):
            np.testing.assert_array_equal(alone[name], batch[name][:, i], err_msg=name)
        for name in (n for n in batch if n.startswith("plant.")):
            mine, its = (latest(run, name) for run in (alone, batch))
            np.testing.assert_array_equal(mine, its[:, i], err_msg=name)


def latest(run: dict[str, np.ndarray], name: str) -> np.ndarray:
    """The plant at every step, from its values at the steps at which it changed."""
    changed = run["changed"].reshape(len(run["changed"]), -1)[:, 0]
    return run[name][np.cumsum(changed) - 1]


@settings(max_examples=30, deadline=None)
@given(listed=descriptions(arms=1), neutral=st.lists(st.sampled_from(list(NEUTRAL)), unique=True))
def test_a_neutral_disturbance_changes_no_bit(listed, neutral: list[str]):
    """So that a sweep may put cells with and without a disturbance into one batch."""
    acts = built(listed, 0)
    names = [name for name, _ in listed]
    idle = [parse_disturbance(f"{n}:{NEUTRAL[n]}") for n in neutral if n not in names]
    plain, more = ride(acts, episode()), ride([*idle, *acts], episode())
    for name in ("force", "tau", "q", "v"):
        np.testing.assert_array_equal(plain[name], more[name], err_msg=name)
        np.testing.assert_array_equal(np.signbit(plain[name]), np.signbit(more[name]))
    if "plant.mass" in more:
        for name in (n for n in more if n.startswith("plant.")):
            undisturbed = 0.0 if name == "plant.angle" else getattr(P, name.removeprefix("plant."))
            own = latest(plain, name) if name in plain else undisturbed
            its = latest(more, name)
            np.testing.assert_array_equal(np.broadcast_to(own, its.shape), its, err_msg=name)
