"""Tuning: the measure, the search, and the files that come of it."""

import dataclasses
import datetime
import functools
import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from small_tuning import BUDGET, TINY

from controllers import CONTROLLERS, make_controller
from controllers.gain_sets import SHIPPED, GainSet, read_gain_set
from controllers.law import Gain, GainField, Law, Switch, gain_fields, spelled
from octarm.arm.lagrange import (
    damping_matrix,
    equilibrium,
    force_coefficients,
    inverse_dynamics,
    potential_force,
)
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.nominal import LagrangeModel
from octarm.commands import cli
from octarm.commands.kinds import GENERATION
from octarm.disturbances.actuators import ActuationDelay, Lag
from octarm.disturbances.spelling import parse_disturbance
from octarm.disturbances.streams import stream
from octarm.errors import OctarmError
from octarm.interfaces import Controller, Knob, Measurement, Reference
from octarm.metrics.forces import Chattering
from octarm.metrics.metric import Settings
from octarm.references import named_reference
from octarm.simulation.engines import ENGINES
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout, simulate
from octarm.sweeps.scenarios import (
    EVALUATION,
    LONG,
    SCENARIOS,
    SHORT,
    UNSEEN,
    Examination,
    Scenario,
    disturbances,
)
from octarm.sweeps.tune import (
    Budget,
    SearchState,
    Space,
    StateFile,
    gains_of,
    initial_population,
    next_generation,
    tune,
)
from octarm.sweeps.tune_cost import (
    Rig,
    _parts,  # pyright: ignore[reportPrivateUsage]
    costs,
    each_its_own,
)
from octarm.sweeps.workers import WorkerProcesses

P = nominal_parameters()
N = P.modules
OF_RECORD = Rig(engine="mujoco")  # on which the last trials are made


def by_hand(name: str):
    """The factory that tuning is given."""
    return functools.partial(make_controller, name, gain_set="recommended")


def scaled(name: str):
    """Makes controllers of numbers in the scales of their nominal model."""

    def make(nominal: Any, numbers: dict[str, np.ndarray]):
        scales = by_hand(name)(nominal).scales()
        return by_hand(name)(nominal, {gain: x * scales[gain] for gain, x in numbers.items()})

    return make


# The measure


@dataclasses.dataclass(frozen=True)
class Watched:
    """A law, and whether the arms of its arrays lie side by side."""

    law: Controller
    side_by_side: list[bool]

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> Any:
        return self.law.initial_state(batch_shape)

    def __call__(self, state: Any, measurement: Measurement, reference: Reference):
        command, state = self.law(state, measurement, reference)
        arrays = (*measurement[1:], *reference, command.force, *state[1:])
        self.side_by_side.extend(x.T.flags.c_contiguous for x in arrays)
        return command, state


def test_arms_lie_side_by_side_in_memory():
    seen: list[bool] = []
    costs(
        [TINY],
        lambda nominal, gains: Watched(by_hand("afsmc")(nominal, gains), seen),
        {"K_v": np.tile([1.0, 3.0], (2 * N, 1)).T},
    )
    assert seen and all(seen)  # else a law takes almost twice as long


@pytest.mark.parametrize("scenario", [*SCENARIOS, *EVALUATION])
def test_the_cost_is_the_declared_formula(scenario: Scenario):
    trial = Examination(begin=0.1, duration=0.2, scenarios=(SCENARIOS[3], scenario))
    K = np.array([[1.0], [3.0]])
    (both,) = costs([trial], by_hand("smc"), {"K": K})
    assert both.shape == (2, 2)
    acting = {
        f"mismatch:0,damping={scenario.damping}": scenario.damping != 1.0,
        f"noise:{scenario.noise},time={scenario.correlation_time}": scenario.noise,
        f"measurement-noise:{scenario.readings}": scenario.readings,
        f"actuation-delay:{scenario.delay}": scenario.delay,
        f"lag:{scenario.lag}": scenario.lag,
        f"dead-zone:{scenario.dead_zone}": scenario.dead_zone,
        f"payload:{scenario.payload}": scenario.payload,
        f"step:{scenario.push},at=1.5,on=tip-y": scenario.push,
    }
    environment = load(
        scenario.reference,
        disturbances=[parse_disturbance(text) for text, size in acting.items() if size],
        control_period=scenario.period,
        timestep="auto" if scenario.plant_modules else None,
        plant_modules=scenario.plant_modules or None,
        seed=trial.seeds()[1],
        engine="lagrange",
    )
    nominal = P.scaled(damping=scenario.damping).mismatched(scenario.mismatch)
    controller = by_hand("smc")(nominal, {"K": 3.0})
    run = rollout(environment, controller, trial.duration)
    first = round(trial.begin / scenario.period)
    steps = run.signals  # every physics step counts
    error = run.error[:, None] if "q_steps" not in steps else steps["q_steps"] - steps["q_d_steps"]
    rms = np.sqrt(np.mean(error[first:] ** 2, axis=(0, 1)))
    high_pass = Chattering({"force": run.tau[0]}, Settings(control_period=scenario.period))
    high_pass.update({"force": run.tau[:first]}, False)
    high_pass.update({"force": run.tau[first:]}, True)
    rattle = high_pass.result()["chattering"]
    e = np.sqrt(np.sum((rms[:3] / 0.0175) ** 2 + (rms[3:] / 0.3) ** 2) / 6)
    c = np.sqrt(np.sum(rattle**2) / 6) / (9.81 * (0.3 + 0.25 + 0.2))
    assert both[1, 1] == pytest.approx(e + 0.1 * c, rel=1e-6)
    assert c > 0.1 and e > 1e-4  # neither of them goes unnoticed


def test_the_mean_is_weighed_as_the_scenarios_say():
    heavy = dataclasses.replace(SCENARIOS[0], weight=3.0)
    trial = Examination(scenarios=(heavy, SCENARIOS[1]))
    np.testing.assert_allclose(trial.mean(np.array([[1.0, 5.0], [2.0, 2.0]])), [2.0, 2.0])


def test_the_scales_are_the_mean_amplitudes_of_the_references():
    slides, bends = (named_reference(name, np.zeros(6)) for name in ("sine-slides", "sine"))
    assert np.mean(getattr(slides, "amplitude")[:2]) == pytest.approx(0.0175)  # noqa: B009
    assert np.mean(getattr(bends, "amplitude")[3:5]) == pytest.approx(0.3)  # noqa: B009


def values(scenarios: tuple[Scenario, ...], field: str) -> set[Any]:
    return {getattr(scenario, field) for scenario in scenarios}


def test_the_scenarios_hold_what_they_have_to():
    """Two control periods, a delay, a lag, a payload, wrong models and noise."""
    assert len(set(SCENARIOS)) == len(SCENARIOS)
    assert values(SCENARIOS, "period") >= {0.0005, 0.002}
    assert values(SCENARIOS, "mismatch") == {-0.3, 0.0, 0.3}
    assert 0.4 in values(SCENARIOS, "noise") and 0.2 in values(SCENARIOS, "payload")
    assert 0.0015 in values(SCENARIOS, "delay") and 0.005 in values(SCENARIOS, "lag")
    balanced = SCENARIOS[:6]  # half of the full design
    for one, other in (("reference", "mismatch"), ("reference", "noise"), ("mismatch", "noise")):
        pairs = {(getattr(s, one), getattr(s, other)) for s in balanced}
        assert len(pairs) == len(values(balanced, one)) * len(values(balanced, other))


@pytest.mark.parametrize(
    "field",
    ["reference", "mismatch", "noise", "readings", "delay", "lag", "dead_zone", "payload", "push"],
)
def test_evaluation_has_nothing_that_tuning_saw(field: str):
    """But what is absent: no mismatch, no noise, no delay."""
    assert not (values(SCENARIOS, field) & values(EVALUATION, field)) - {0.0}


def test_noise_of_the_evaluation_is_of_another_kind():
    noisy = [s for s in EVALUATION if s.noise]
    assert all(s.correlation_time not in values(SCENARIOS, "correlation_time") for s in noisy)


def test_inertia_counts_in_the_fast_reference():
    """Inertial and Coriolis forces are above 20 % of each moving coordinate's Q, in rms."""
    motion = named_reference("fast-sine", equilibrium(P))
    q, v, a = (np.array(x) for x in zip(*map(motion, np.arange(0.0, 10.0, 0.01)), strict=True))
    Q = inverse_dynamics(P, q, v, a)
    inertial = Q - potential_force(P, q) - v @ damping_matrix(P).T
    share = np.sqrt(np.mean(inertial**2, axis=0) / np.mean(Q**2, axis=0))
    assert np.all(share > 0.2)
    tau = np.linalg.solve(force_coefficients(P, q), Q[..., None])[..., 0]
    assert np.max(np.abs(tau)) < 0.5 * np.max(P.input_range)


def test_what_acts_on_no_arm_is_left_out():
    assert disturbances([SCENARIOS[0], SCENARIOS[1]]) == []
    names = [d.name for d in disturbances([SCENARIOS[0], SCENARIOS[3], SCENARIOS[10]])]
    assert names == ["noise", "actuation-delay"]


def test_tuning_has_noise_that_no_experiment_has():
    own = [seed for trial in (SHORT, LONG, UNSEEN) for seed in trial.seeds()]
    drawn = {stream(seed, "noise").standard_normal() for seed in own}
    assert len(drawn) == len(own)
    evaluation = [np.random.SeedSequence(0, spawn_key=(i,)) for i in range(1000)]
    alone = [np.random.SeedSequence(i) for i in range(1000)]
    assert not drawn & {stream(s, "noise").standard_normal() for s in [*evaluation, *alone]}


def test_lost_arms_cost_the_more_the_earlier_and_touch_nobody():
    storm = Scenario(reference="sine", mismatch=0.0, noise=3.0)
    trial = Examination(begin=0.02, duration=0.1, scenarios=(storm,))
    gains = np.array([[1000.0], [50.0], [10.0], [1e300]])  # K_d; the last asks beyond all numbers
    cost = costs([trial], by_hand("computed-torque"), {"K_d": gains})[0][:, 0]
    assert cost[0] < 1.0
    assert 10.0 < cost[1] < cost[2] < cost[3] <= 20.0
    alone = costs([trial], by_hand("computed-torque"), {"K_d": gains[:1]})[0][:, 0]
    assert alone[0] == cost[0]


def test_no_candidate_gets_more_force_than_the_actuators_have():
    trial = Examination(
        begin=0.02, duration=0.1, scenarios=(Scenario(reference="sine", mismatch=0.0, noise=0.0),)
    )
    (mad,) = costs([trial], by_hand("computed-torque"), {"K_d": np.array([[1e5], [1e8]])})
    assert np.all(mad == 10.0)  # both rattle between the same limits: as bad as it gets, not lost


def test_when_all_arms_are_lost_the_bar_still_gets_to_its_end():
    seconds: list[float] = []
    gains = {"K_d": np.array([[1e300]])}
    (cost,) = costs([TINY], by_hand("computed-torque"), gains, seconds.append)
    assert np.all(cost >= 10.0)
    assert sum(seconds) == pytest.approx(TINY.seconds)


def test_each_arm_may_have_its_own_motion():
    motions = [named_reference(name, np.arange(6.0)) for name in ("sine", "multi-sine")]
    together = each_its_own(motions, np.array([1, 0, 1]))(0.3)
    for k, which in enumerate([1, 0, 1]):
        for batch, alone in zip(together, motions[which](0.3), strict=True):
            np.testing.assert_array_equal(batch[k], alone)


# What is searched


@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_controller_has_a_few_unknowns(name: str):
    controller: Any = by_hand(name)(P)
    fields = {spelled(field): field for field in gain_fields(type(controller))}
    space, scales = Space(controller, N), controller.scales()
    assert 2 <= len(space.unknowns) <= 8
    assert space.bounds.shape == (len(space.unknowns), 2)
    np.testing.assert_array_equal(np.sign(space.bounds), [[-1, 1]] * len(space.unknowns))
    turned, fixed = space.turned(np.zeros((1, len(space.unknowns)))), space.fixed()
    assert turned.keys() | fixed.keys() == space.gains.keys()
    assert not turned.keys() & fixed.keys()
    for gain, rows in turned.items():  # hand-set gains are the middle, to the digits kept
        np.testing.assert_allclose(rows[0], np.broadcast_to(space.gains[gain], 6), rtol=1e-3)
        np.testing.assert_allclose(
            space.gains[gain] * scales[gain], getattr(controller, fields[gain]), rtol=1e-12
        )


def test_a_knob_turns_its_gains_by_a_factor():
    space = Space(by_hand("afsmc")(P), N)
    names = [unknown.name for unknown in space.unknowns]
    candidate = np.zeros((2, len(names)))
    candidate[1, names.index("width of bends")] = np.log10(2.0)
    candidate[1, names.index("lambda")] = np.log10(1.2)
    turned = space.turned(candidate)
    for gain in ("phi", "scale", "dead_zone"):
        ratio = turned[gain][1] / turned[gain][0]
        np.testing.assert_allclose(ratio, [1, 1, 1, 2, 2, 2], rtol=1e-3)
    rates = np.repeat([[15.0], [18.0]], 6, axis=1) * LagrangeModel(P).time_scale
    np.testing.assert_allclose(turned["lambda"], rates, rtol=1e-3)
    np.testing.assert_array_equal(turned["K_v"][0], turned["K_v"][1])
    assert space.at_bounds(candidate[1]) == []
    candidate[1, names.index("premises")] = 3.0
    assert space.at_bounds(candidate[1]) == ["premises"]


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_gain_has_one_knob(name: str):
    gains = [gain for knob in by_hand(name)(P).knobs() for gain in knob.gains]
    assert len(gains) == len(set(gains))


def test_a_new_controller_is_tuned_by_the_knobs_of_its_gains():
    @dataclasses.dataclass(frozen=True, kw_only=True)
    class New(Law):
        stiffness: Annotated[Gain, GainField("how hard", "N/m", knob=Knob("how stiff", apart=True))]
        colour: Annotated[Gain, GainField("to look at", "1")]
        safe: Annotated[bool, Switch("for those who fear", "1")] = True

        def __call__(self, state: Any, measurement: Measurement, reference: Reference) -> Any:
            raise NotImplementedError

    space = Space(New(nominal=LagrangeModel(P), stiffness=2.0, colour=1.0), N)  # pyright: ignore
    assert [u.name for u in space.unknowns] == ["how stiff of slides", "how stiff of bends"]
    assert space.fixed() == {"colour": 1.0}
    stiffness = np.repeat(2.0, 6) * LagrangeModel(P).scale / LagrangeModel(P).force_scale
    np.testing.assert_allclose(space.gains["stiffness"], stiffness)

    @dataclasses.dataclass(frozen=True)
    class Untunable(Law):
        def __call__(self, state: Any, measurement: Measurement, reference: Reference) -> Any:
            raise NotImplementedError

    with pytest.raises(ValueError, match="Untunable has no gain that can be tuned"):
        Space(Untunable(nominal=LagrangeModel(P)), N)  # pyright: ignore[reportArgumentType]


# The search


def test_the_search_finds_the_bottom_of_a_bowl():
    bounds = np.array([[-1.0, 1.0]] * 3)
    bottom = np.array([0.3, -0.6, 0.9])
    asked: list[int] = []

    def bowl(candidates: np.ndarray) -> np.ndarray:
        asked.append(len(candidates))
        return np.sum((candidates - bottom) ** 2, axis=1)

    draw = np.random.default_rng(0)
    population = initial_population(bounds, 24, draw)
    np.testing.assert_array_equal(population[0], 0.0)
    assert np.all(np.abs(population) <= 0.5) and np.ptp(population[1:], axis=0).min() > 0.9
    state = SearchState(0, population, bowl(population))
    for g in range(60):
        before, state = state, next_generation(bowl, bounds, state, np.random.default_rng(g))
        assert np.all(state.costs <= before.costs.max()) and state.costs[0] <= before.costs.min()
        np.testing.assert_allclose(bowl(state.population), state.costs, atol=1e-12)
    np.testing.assert_allclose(state.population[0], bottom, atol=1e-3)
    assert asked == [24] * (1 + 2 * 60)  # a generation is one batch; the population costs nothing


@pytest.fixture(scope="module")
def uninterrupted():
    states: list[SearchState] = []
    return tune(by_hand("smc-boundary"), BUDGET, seed=3, keep=states.append), states


def assert_same(one: Any, other: Any) -> None:
    for field in dataclasses.fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        np.testing.assert_equal(a, b)


def test_it_is_at_least_as_good_as_the_hand_set_gains(uninterrupted):
    tuned, states = uninterrupted
    assert [state.generation for state in states] == [0, 1, 2, 3]
    best = [state.costs[0] for state in states[1:]]
    assert best == sorted(best, reverse=True)
    assert BUDGET.long.mean(tuned.long.tuned) <= BUDGET.long.mean(tuned.long.by_hand)
    assert states[-1].costs[0] < TINY.mean(tuned.short.by_hand)
    space = Space(by_hand("smc-boundary")(P), N)
    np.testing.assert_allclose(  # the first candidate was the hand-set gains
        states[0].costs[0], TINY.mean(tuned.short.by_hand), rtol=1e-9
    )
    assert tuned.gains.keys() == space.gains.keys()
    rows = {name: np.broadcast_to(gain, (1, 6)) for name, gain in tuned.gains.items()}
    make = scaled("smc-boundary")
    for examination, found in (
        (TINY, tuned.short), (BUDGET.long, tuned.long), (BUDGET.unseen, tuned.unseen),
    ):  # fmt: skip
        again = costs([examination], make, rows, rig=OF_RECORD)[0][0]
        np.testing.assert_array_equal(again, found.tuned)


def test_it_may_stop_anywhere_and_go_on_with_the_same_bits(uninterrupted, tmp_path):
    tuned, _ = uninterrupted
    file = StateFile(tmp_path / "state", {"seed": 3})
    for last in (0, 2):

        def keep(state: SearchState, last: int = last) -> None:
            file.write(state)
            if state.generation == last:
                raise KeyboardInterrupt

        start = file.read() if last else None
        with pytest.raises(KeyboardInterrupt):
            tune(by_hand("smc-boundary"), BUDGET, seed=3, state=start, keep=keep)
    seconds: list[float] = []
    again = tune(
        by_hand("smc-boundary"), BUDGET, seed=3, state=file.read(), progress=seconds.append
    )
    assert_same(again, tuned)
    assert sum(seconds) == pytest.approx(BUDGET.seconds)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("workers", [1, 2, 8])
def test_parts_hold_each_scenario_once_and_the_longest_ones_begin(engine: str, workers: int):
    trials = (SHORT, LONG, UNSEEN)
    parts = _parts(trials, 24, Rig(engine), workers)
    assert sorted((k, i) for k, places in parts for i in places) == [
        (k, i) for k, trial in enumerate(trials) for i in range(len(trial.scenarios))
    ]
    for k, places in parts:
        those = [trials[k].scenarios[i] for i in places]
        assert len({(x.period, x.plant_modules) for x in those}) == 1
    assert trials[parts[0][0]] is LONG
    kinds = {(k, x.period, x.plant_modules) for k, t in enumerate(trials) for x in t.scenarios}
    assert (len(parts) == len(kinds)) if workers == 1 else (len(parts) >= len(kinds))
    assert len(_parts(trials, 24, Rig(engine, 30), 64)) >= len(parts)  # larger plants, more parts


def test_an_unknown_engine_is_refused_and_nothing_costs_nothing():
    with pytest.raises(OctarmError, match="unknown engine 'lagrang'"):
        costs([SHORT], by_hand("pd"), {"K_d": np.ones((1, 1))}, rig=Rig("lagrang"))
    (cost,) = costs([Examination(scenarios=())], by_hand("pd"), {"K_d": np.ones((3, 1))})
    assert cost.shape == (3, 0)


@pytest.mark.slow
def test_workers_find_the_same_gains(uninterrupted):
    seconds: list[float] = []
    with WorkerProcesses(2) as workers:
        again = tune(
            by_hand("smc-boundary"), BUDGET, seed=3, progress=seconds.append, workers=workers
        )
    assert_same(again, uninterrupted[0])
    assert sum(seconds) == pytest.approx(BUDGET.seconds)


def test_the_seed_changes_the_search_and_not_the_scenarios(uninterrupted):
    tuned, states = uninterrupted
    other: list[SearchState] = []
    different = tune(by_hand("smc-boundary"), BUDGET, seed=4, keep=other.append)
    assert not np.any(other[-1].costs == states[-1].costs[0])
    np.testing.assert_array_equal(different.short.by_hand, tuned.short.by_hand)


def test_the_budget_counts_simulated_seconds():
    n = len(SCENARIOS)
    assert Budget(generations=1).search_seconds == GENERATION  # what the command line asks for
    budget = Budget.within(24000.0)
    assert budget.population == 24 and budget.generations == 24000 // (24 * n * 3)
    assert budget.search_seconds == budget.generations * 24 * n * 3.0
    last = 8 * n * 10.0 + 2 * (n + len(EVALUATION)) * 3.0
    assert budget.seconds == budget.search_seconds + last
    with pytest.raises(ValueError, match=f"budget is 400 s; it must be at least {24 * n * 3} s"):
        Budget.within(400.0)


# Files


@pytest.fixture
def _small(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Budget, "within", classmethod(lambda cls, budget: BUDGET))


@pytest.mark.usefixtures("_small")
def test_the_command_writes_gains_and_how_they_were_found(capsys):
    assert cli.main(["tune", "smc", "--out", "my.toml", "--seed", "5", "--workers", "1"]) == 0
    out, err = capsys.readouterr()
    assert "wrote my.toml" in out and "octarm run --controller smc --gains my.toml" in out
    assert err == ""
    assert [path.name for path in Path().iterdir()] == ["my.toml"]
    content = tomllib.loads(Path("my.toml").read_text())
    assert (content["controller"], content["arm"]["modules"]) == ("smc", 3)
    longest = max(values(SCENARIOS, "period")) / LagrangeModel(P).time_scale
    assert content["arm"]["control_period"] == pytest.approx(longest, rel=1e-3)
    tuning = content["tuning"]
    assert tuning["command"] == "octarm tune smc --budget 16000 --seed 5"
    assert tuning["date"] == datetime.date.today()
    assert (tuning["seed"], tuning["candidates"]) == (5, 20)
    assert tuning["objective"].startswith(
        "J = weighted mean over scenarios of sqrt(mean_j (rms_j / A_j)^2)"
    )
    assert content["versions"].keys() == {
        "python", "octarm", "mujoco", "dm-control", "numpy", "scipy"
    }  # fmt: skip
    tables = ("search", "long_trial", "evaluation")
    for trial, table in zip((BUDGET.short, BUDGET.long, BUDGET.unseen), tables, strict=True):
        table = content[table]
        rows = table["scenarios"]
        keys = [field.name for field in dataclasses.fields(Scenario)]
        again = [Scenario(**{k: row[k] for k in keys if k in row}) for row in rows]
        assert again == list(trial.scenarios)
        assert table["cost"] == pytest.approx(np.mean([row["cost"] for row in rows]))
        assert table["recommended"] == pytest.approx(np.mean([r["recommended"] for r in rows]))
        own = {k: np.broadcast_to(x, (1, 6)) for k, x in content["gains"].items()}
        found = costs([trial], scaled("smc"), own, rig=OF_RECORD)[0][0]  # the file alone suffices
        np.testing.assert_array_equal(found, [row["cost"] for row in rows])
    controller = make_controller("smc", P, gain_set="my.toml")
    for name, gain in gains_of(controller).items():
        numbers = content["gains"][name]
        np.testing.assert_allclose(gain, numbers * controller.scales()[name], rtol=1e-15)
    assert cli.main(["tune", "smc", "--out", "my.toml", "--seed", "5"]) == 2
    assert "my.toml is there already; --force replaces it" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("_small")
def test_an_interrupted_command_goes_on(capsys, monkeypatch):
    arguments = ["tune", "smc", "--seed", "5", "--workers", "1"]
    assert cli.main([*arguments, "--resume"]) == 2
    assert "nothing to resume: smc.toml.state does not exist" in capsys.readouterr().err
    write, count = StateFile.write, iter(range(9))

    def interrupted(self: StateFile, state: SearchState) -> None:
        write(self, state)
        if next(count) == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(StateFile, "write", interrupted)
    assert cli.main(arguments) == 130
    assert capsys.readouterr().err == (
        "octarm: interrupted; go on by: octarm tune smc --budget 16000 --seed 5 "
        "--out=smc.toml --resume\n"
    )
    assert [path.name for path in Path().iterdir()] == ["smc.toml.state"]
    assert cli.main(arguments) == 2
    assert "keeps a search that was interrupted" in capsys.readouterr().err
    assert cli.main(["tune", "smc", "--seed", "6", "--resume"]) == 2
    assert "belongs to a search with another seed" in capsys.readouterr().err
    assert cli.main([*arguments, "--resume"]) == 0
    resumed = Path("smc.toml").read_text()
    assert [path.name for path in Path().iterdir()] == ["smc.toml"]
    assert cli.main([*arguments, "--force"]) == 0
    assert Path("smc.toml").read_text() == resumed
    Path("smc.toml.state").write_text("{}")
    assert cli.main([*arguments, "--resume"]) == 2
    assert "smc.toml.state: it needs a value of settings" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["smcc"], "unknown controller 'smcc', did you mean 'smc'?"),
        (["smc", "--budget", "1"], "budget is 1 s; it must be at least 1224 s"),
        (["smc", "--budget", "nan"], "budget is nan s; it must be at least 1224 s"),
        (["smc", "--budget", "inf"], "budget is inf s; it must be at most 1e+08 s"),
        (["smc", "--seed", "-1"], "seed is -1; it must be at least 0"),
        (["smc", "--out", "gains.txt"], "--out is 'gains.txt'; its name must end in .toml"),
        (["smc", "--out", "no/x.toml"], "no/x.toml cannot be written: there is no folder for it"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(arguments, sentence, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["tune", *arguments]) == 2
    err = capsys.readouterr().err
    assert sentence in err and err.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_gain_set_survives_the_file(tmp_path):
    K = [1e-7, 2.0, 3.0e20, 0.1, 0.2, 0.3]
    content = {
        "controller": "smc",
        "arm": {"modules": 3.0, "damping_ratio": 0.06},
        "gains": {"lambda": 12.5, "K": K, "theta_max": float("inf")},
        "tuning": {"date": datetime.date(2026, 1, 2), "words": 'a "quoted" \\ é', "none": []},
        "search": {"good": True, "rows": [{"name": "x", "n": 1}, {"name": "y", "n": -2.5e-9}]},
    }
    whole = GainSet.model_validate(content)
    path = tmp_path / "x.toml"
    path.write_text(whole.to_toml(), encoding="utf-8")
    assert read_gain_set(path) == whole


GIVEN = GainSet(
    controller="smc", arm={"modules": 3.0}, gains={"lambda": 0.3, "K": [1, 2, 3, 4, 5, 6]}
)
LAMBDA = 0.3 / float(LagrangeModel(P).time_scale)


def written(tmp_path: Path, **changes: Any) -> Path:
    path = tmp_path / "mine.toml"
    path.write_text(GIVEN.model_copy(update=changes).to_toml())
    return path


def test_gains_come_from_the_set_then_from_the_caller(tmp_path):
    path = written(tmp_path)
    controller: Any = make_controller("smc", P, {"lambda": 44.0}, gain_set=path)
    recommended: Any = make_controller("smc", P, gain_set="recommended")
    assert controller.lambda_ == 44.0
    force = LagrangeModel(P).force_scale
    np.testing.assert_allclose(controller.K, force * [1, 2, 3, 4, 5, 6], rtol=1e-15)
    np.testing.assert_array_equal(controller.K_v, recommended.K_v)
    derived: Any = make_controller("smc", P, {"uncertainty": 0.3}, gain_set=path)
    assert derived.K is None and derived.lambda_ == pytest.approx(LAMBDA, rel=1e-15)
    content = GIVEN.model_dump()
    same: Any = make_controller("smc", P, gain_set=content)  # what a file holds
    np.testing.assert_array_equal(same.K, controller.K)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"controller": "pd"}, "the gains of .*mine.toml are those of pd, not of smc"),
        ({"gains": {"K": [1.0] * 5}}, "K has 5 values; it needs 1 or 6"),
        ({"gains": {"K_q": 1.0}}, "smc has no gain 'K_q'"),
        ({"gains": {"K": "much"}}, "K is 'much'; it must be made of numbers"),
    ],
)
def test_a_set_that_does_not_fit_is_refused(tmp_path, changes, sentence):
    with pytest.raises(ValueError, match=sentence):
        make_controller("smc", P, gain_set=written(tmp_path, **changes))


def test_what_is_no_gain_set_is_refused(tmp_path):
    path = tmp_path / "x.toml"
    for text, sentence in {
        "a = ": "x.toml: ",
        "a = 1": "x.toml: it needs a value of controller",
    }.items():
        path.write_text(text)
        with pytest.raises(ValueError, match=sentence):
            read_gain_set(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match="is not a text file"):
        read_gain_set(path)
    with pytest.raises(ValueError, match="cannot be read: No such file"):
        make_controller("smc", P, gain_set=tmp_path / "none.toml")
    with pytest.raises(ValueError, match="unknown gains 'tuend'; they are tuned, recommended, or"):
        make_controller("smc", P, gain_set="tuend")


def test_a_run_takes_its_gains_from_where_it_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    short = ["run", "--controller", "smc", "--duration", "0.01", "--out", "a", "--force"]
    assert cli.main([*short, "--gains", str(written(tmp_path))]) == 0

    def used() -> float:
        return json.loads(Path("a/run.json").read_text())["controller"]["gains"]["lambda_"]

    assert used() == pytest.approx(LAMBDA, rel=1e-15)  # SI
    assert cli.main([*short, "--gains", "recommended"]) == 0
    assert used() == pytest.approx(15.0, rel=1e-15)
    assert cli.main([*short, "--gain", "lambda:17"]) == 0
    assert used() == 17.0
    assert cli.main([*short, "--gains", "tuend"]) == 2
    assert "unknown gains 'tuend'" in capsys.readouterr().err


def test_the_shipped_gains_are_complete_and_better_than_the_recommended_ones():
    names = {path.stem for path in SHIPPED.glob("*.toml")}
    assert names in (set(), set(CONTROLLERS))  # all controllers, or none of them
    for name in names:
        own = read_gain_set(SHIPPED / f"{name}.toml")
        assert (own.controller, own.arm["modules"]) == (name, N)
        for trial in ("search", "long_trial"):
            assert own.origin[trial]["cost"] < own.origin[trial]["recommended"]
        default, given = (make_controller(name, P, gain_set=x) for x in (None, "tuned"))
        for gain, value in gains_of(default).items():
            numbers = own.gains[gain] * default.scales()[gain]
            np.testing.assert_allclose(value, numbers, rtol=1e-15)
            np.testing.assert_array_equal(value, gains_of(given)[gain])


def stressed(period: float) -> Iterator[tuple[float, list[float], list[float]]]:
    """What every law bears with gains for a period: periods, each with delays and lags [s]."""
    for step in (0.0005, 0.001, 0.002):
        if step > period:
            return
        if step > 0.0005 or period < 0.002:  # with gains for a short period alone no more is asked
            yield step, [0.0], [0.0]
        else:
            yield step, [0.0, 0.0015, 0.0], [0.0, 0.0, 0.005]


@pytest.mark.slow
@pytest.mark.parametrize("name", CONTROLLERS)
def test_default_gains_survive_what_every_law_has_to(name: str):
    """64 seeds, 40 % noise, models wrong by 30 % either way; with each delay and lag likewise."""
    longest = read_gain_set(SHIPPED / f"{name}.toml").arm["control_period"]
    period = longest * float(LagrangeModel(P).time_scale) * 1.001
    seeds = [np.random.SeedSequence(0, spawn_key=(i,)) for i in range(128)]
    for step, delays, lags in stressed(period):
        acting = [
            parse_disturbance("noise:0.4"),
            ActuationDelay(delay=np.repeat(delays, 128)),
            Lag(time_constant=np.repeat(lags, 128)[:, None]),
        ]
        environment = load(
            "sine",
            disturbances=acting if any(delays) or any(lags) else acting[:1],
            batch=128 * len(lags),
            control_period=step,
            seed=seeds * len(lags),
            engine="lagrange",
        )
        nominal = P.mismatched(np.tile(np.repeat([-0.3, 0.3], 64), len(lags)))
        simulate(environment, make_controller(name, nominal), 3.0)
        survived = environment.physics.intact().reshape(-1, 128)
        assert np.all(survived), (step, np.all(survived, axis=1))
