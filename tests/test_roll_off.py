"""The roll-off of a law's force: against the filter's equation, and on plants of more modules."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from controllers import CONTROLLERS, make_controller
from octarm.arm.groups import Groups
from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import nominal_parameters
from octarm.checks.sampled_loop import LinearPlant, Loop, linear_law
from octarm.commands.cli import main
from octarm.errors import OctarmError
from octarm.interfaces import Command, Measurement, Reference
from octarm.references import SetPoint
from octarm.roll_off import RolledOff, fields_of
from octarm.runs.folder import gains_of
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout, simulate
from octarm.sweeps.shards import run_shard
from octarm.sweeps.spec_file import parse_spec

ARM = nominal_parameters()
REST = equilibrium(ARM)
SOFT = [name for name in CONTROLLERS if name not in ("smc", "super-twisting")]


@dataclasses.dataclass(frozen=True)
class Given:
    """A law whose force is a function of time."""

    def initial_state(self, batch_shape=()):
        return None

    def __call__(self, state, measurement, reference):
        t = np.full(6, measurement.t)
        return Command(np.sin(90.0 * t) + np.arange(6.0)), None


def rolled(law: Any, corner: Any) -> RolledOff:
    return RolledOff(law=law, roll_off=np.asarray(corner), scale=np.ones(()))


def law_of(name: str, corner: Any = None, gains: str = "recommended") -> Any:
    given = {} if corner is None else {"roll_off": corner}
    return make_controller(name, ARM, given, gain_set=gains)


def instant(t: float, q: np.ndarray = REST, v: np.ndarray | None = None) -> tuple:
    zero = np.zeros_like(q)
    rest = np.broadcast_to(REST, q.shape)
    return Measurement(t, q, zero if v is None else v), Reference(rest, zero, zero)


def test_the_force_obeys_the_equation_of_the_filter_whatever_the_periods():
    """f' = omega (Q - f) between calls, by an integrator that knows nothing of exponentials."""
    corner = np.linspace(5.0, 60.0, 6)
    law, asked = rolled(Given(), corner), Given()
    times = np.cumsum([0.0, 1e-3, 5e-3, 2e-4, 0.0, 3e-3])
    state, f, before = law.initial_state(), None, 0.0
    for t in times:
        command, state = law(state, *instant(t))
        Q = asked(None, *instant(t))[0].force
        if f is None:
            f = Q
        elif t > before:
            rate = lambda _, x, Q=Q: 2.0 * np.pi * corner * (Q - x)  # noqa: E731
            f = solve_ivp(rate, (before, t), f, rtol=1e-11, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(command.force, f, rtol=1e-8, atol=1e-9)
        before = t


def test_a_corner_far_above_the_rate_changes_nothing_and_far_below_holds_the_first_force():
    law = Given()
    for corner, like in ((1e9, 0.01), (1e-9, 0.0)):
        state = rolled(law, corner).initial_state()
        for t in (0.0, 0.004, 0.01):
            command, state = rolled(law, corner)(state, *instant(t))
        np.testing.assert_allclose(command.force, law(None, *instant(like))[0].force, atol=1e-6)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_batch_has_the_bits_of_its_arms(name: str):
    law = law_of(name, 40.0)
    q, v = np.random.default_rng(1).normal(size=(2, 3, 5, 6))
    q = REST + 1e-3 * q
    many, alone = law.initial_state((5,)), [law.initial_state() for _ in range(5)]
    for k in range(3):
        command, many = law(many, *instant(5e-4 * k, np.asfortranarray(q[k]), v[k]))
        for i in range(5):
            one, alone[i] = law(alone[i], *instant(5e-4 * k, q[k, i], v[k, i]))
            np.testing.assert_array_equal(command.force[i], one.force)


@pytest.mark.parametrize("name", ["smc-boundary", "smc-integral", "afsmc"])
def test_the_linear_loop_has_the_filter_that_the_law_has(name: str):
    """Slopes of the filtered law by differences, against the filter put behind the law's slopes."""
    period, plant = 7e-4, LinearPlant.of(ARM)
    rolled_off, law = law_of(name, 25.0), linear_law(law_of(name), plant.rest, period)
    a = np.broadcast_to(rolled_off.decay(period), 6)[:, None]
    phi, gamma = plant.sampled(period)
    F, C = (1.0 - a) * law.F @ plant.M, (1.0 - a) * law.C
    held, none = a * np.eye(6), np.zeros((len(law.S), 6))
    whole = np.block([
        [phi + gamma @ F, gamma @ C, gamma @ held],
        [law.R @ plant.M, law.S, none],
        [F, C, held],
    ])  # fmt: skip
    loop = Loop(plant, rolled_off)
    one, other = (np.abs(np.linalg.eigvals(x)) for x in (whole, loop.matrix(period)))
    one, other = (np.sort(x[x > 1e-3])[::-1] for x in (one, other))
    np.testing.assert_allclose(one[:12], other[:12], rtol=1e-4)


def plant_of(modules: int) -> LinearPlant:
    groups = Groups.of(ARM, modules)
    return LinearPlant.of(groups.plant, groups.matrix)


def test_where_a_finer_plant_alternates_the_roll_off_prolongs_the_period():
    """Corners as multiples of the model's highest mode, 15.7 Hz; a corner below it undoes it."""
    plant, hertz = plant_of(15), 15.65
    for name in ("smc-boundary", "computed-torque"):
        plain = Loop(plant, law_of(name)).longest_period()
        four = Loop(plant, law_of(name, 4.0 * hertz)).longest_period()
        far = Loop(plant, law_of(name, 128.0 * hertz)).longest_period()
        assert four > 5.0 * plain and 1.0 <= far / plain < 1.3
    loose = [Loop(plant, law_of("pd", x, "tuned")).longest_period() for x in (0.5 * hertz, None)]
    assert loose[0] == 0.0 < loose[1]


def sizes(law: Any, modules: int, period: float, count: int) -> np.ndarray:
    """How fast the groups move at control instants, let go a tiny way from rest."""
    environment = load(
        SetPoint(q=REST), control_period=period, timestep="auto", plant_modules=modules,
        engine="lagrange",
    )  # fmt: skip
    environment.reset()
    physics, groups = environment.physics, Groups.of(ARM, modules)
    rest, speeds = physics.plant_rest(), []
    move = groups.spread(1e-9 * np.random.default_rng(0).normal(size=6))
    physics.set_motion(rest + move, np.zeros_like(rest))
    state, zero, stay = law.initial_state(), np.zeros(6), groups.measured(rest)
    still = Reference(stay, zero, zero)  # where the model would hang elsewhere
    bias = law.law(None, Measurement(0.0, stay, zero), still)[0].force
    for k in range(count):
        v = physics.v()
        speeds.append(float(np.linalg.norm(v * np.repeat([1.0, 0.04], 3))))
        if speeds[-1] > 1e-4:
            break
        measured = Measurement(k * period, physics.q(), v)
        command, state = law(state, measured, still)
        environment.step(physics.actuation.inputs(physics.q(), command.force - bias))
    return np.array(speeds)


@pytest.mark.parametrize(("name", "modules"), [("smc-boundary", 9), ("computed-torque", 15)])
def test_simulation_grows_just_beyond_the_longest_period_and_not_below(name: str, modules: int):
    law = law_of(name, 60.0)
    longest = Loop(plant_of(modules), law).longest_period()
    below = sizes(law, modules, 0.95 * longest, 1500)
    assert below[-1] < 0.1 * below.max()
    beyond = 1.05 * longest
    above = sizes(law, modules, beyond, 2500)
    late = np.log(above[len(above) // 2 :])
    rate = float(np.polyfit(np.arange(len(late)), late, 1)[0])
    assert above[-1] > 1e-6
    assert rate == pytest.approx(np.log(Loop(plant_of(modules), law).radius(beyond)), rel=0.05)


@pytest.mark.slow
def test_with_it_a_law_holds_fifteen_modules_at_the_usual_period():
    for corner, holds in ((60.0, True), (None, False)):
        environment = load(
            plant_modules=15, timestep="auto", control_period=5e-4, engine="lagrange"
        )
        run = rollout(environment, law_of("computed-torque", corner), 2.0)
        worst = np.max(np.abs(run.error[run.t > 1.0, 3:]), initial=0.0)
        assert (run.status == "ok" and worst < 0.03) == holds


@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_law_takes_a_roll_off_and_says_so_among_its_gains(name: str):
    plain, law = law_of(name), law_of(name, 40.0)
    assert gains_of(law) == gains_of(plain) | {"roll_off": 40.0}
    assert fields_of(law)["nominal"] is law.law.nominal
    assert law.knobs() == plain.knobs() and law.scales().keys() == {*plain.scales(), "roll_off"}
    given = {name.rstrip("_"): value for name, value in gains_of(law).items()}
    again = make_controller(name, ARM, given)
    assert isinstance(again, RolledOff) and gains_of(again) == gains_of(law)


def test_the_corner_of_a_gain_set_suits_similar_arms():
    """As a number in the model's time scale: four times the stiffness is twice as fast."""
    law = law_of("pd", 40.0)
    fast = ARM.scaled(stiffness=4.0, damping=2.0, gravity=4.0)
    numbers = {name: np.asarray(x) / law.scales()[name] for name, x in fields_of(law).items()
               if name != "nominal"}  # fmt: skip
    content = {
        "controller": "pd", "arm": {},
        "gains": {name: np.asarray(x).tolist() for name, x in numbers.items()},
    }  # fmt: skip
    corner: Any = gains_of(make_controller("pd", fast, gain_set=content))["roll_off"]
    assert corner == pytest.approx(80.0)


@pytest.mark.parametrize(
    ("corner", "sentence"),
    [
        (0.0, "roll_off holds 0; it must be above 0"),
        (-3.0, "roll_off holds -3; it must be above 0"),
        (np.inf, "roll_off holds inf; it must be finite"),
        ([1.0, 2.0], "roll_off has 2 values; it needs 1 or 6"),
        ("fast", "roll_off is 'fast'; it must be made of numbers"),
    ],
)
def test_a_corner_that_is_none_is_refused_in_a_sentence(corner: Any, sentence: str):
    with pytest.raises(OctarmError, match=sentence):
        law_of("smc-boundary", corner)


def test_one_arm_of_a_batch_runs_as_alone():
    seen: list[np.ndarray] = []
    law = law_of("super-twisting", 40.0)
    simulate(load(batch=3, engine="lagrange"), law, 0.02, lambda x: seen.append(x.q[1]))
    run = rollout(load(engine="lagrange"), law, 0.02)
    np.testing.assert_array_equal(run.q, seen)


def test_a_run_and_a_sweep_have_it_and_come_out_again(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["run", "--controller", "pd", "--duration", "0.02", "--out", "a", "--roll-off", "40"]
    assert main(words) == 0 and main(["verify", "a"]) == 0
    description = json.loads(Path("a/run.json").read_text())
    assert description["controller"]["gains"]["roll_off"] == 40.0
    description["controller"]["gains"]["roll_off"] = 50.0
    Path("a/run.json").write_text(json.dumps(description))
    assert main(["verify", "a"]) == 1
    text = 'controller = "pd"\nduration = 0.02\nengine = "lagrange"\n'
    digests = []
    for more in ("", "[gains.pd]\nroll_off = 40.0\n"):
        spec = parse_spec(text + more)
        digests += run_shard(spec, 0, make_controller)["digest"].to_pylist()
    assert digests[0] != digests[1]
    assert main([*words[:-1], "0", "--force"]) == 2
    assert "roll_off holds 0; it must be above 0" in capsys.readouterr().err
