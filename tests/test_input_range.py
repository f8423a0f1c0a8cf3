"""The input range belongs to the arm: what the loop cuts off, and what laws make of it."""

import dataclasses
import json

import numpy as np
import pytest
from arm_states import REST, P, random_instant

import octarm
from controllers import CONTROLLERS, make_controller
from octarm.arm.actuation import ACTUATIONS, GroundedActuation
from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import build_model, build_slim_model, read_parameters
from octarm.arm.nominal import LagrangeModel
from octarm.arm.parameters import ArmParameters
from octarm.commands.cli import main
from octarm.disturbances.episode import ActuatorFault
from octarm.disturbances.spelling import parse_disturbance
from octarm.errors import OctarmError
from octarm.metrics.table import Metrics
from octarm.simulation.rollout import simulate

INFINITE = (-np.inf, np.inf)
PULL_ONLY = np.array([[-30.0] * 6, [0.0] * 6])
INTEGRATING = ("smc-integral", "super-twisting", "afsmc-consequent", "afsmc")


def limited(low, high, arm: ArmParameters = P) -> ArmParameters:
    return dataclasses.replace(arm, input_range=(low, high))


def longer(modules: int) -> ArmParameters:
    """An arm like the nominal one with so many modules."""
    like = np.minimum(np.arange(modules), 2)
    each = ("mass", "inertia", "stiffness", "damping", "rest_length")
    return dataclasses.replace(P, **{name: getattr(P, name)[..., like] for name in each})


# The parameter


def test_the_nominal_range_is_that_of_the_file_and_of_all_arms_made_from_it():
    np.testing.assert_array_equal(P.input_range, [[-200.0], [200.0]])
    for n in (1, 2, 5):
        low, high = octarm.load(parameters=longer(n)).physics.input_range()
        np.testing.assert_array_equal(low, np.full(2 * n, -200.0))
        np.testing.assert_array_equal(high, np.full(2 * n, 200.0))
    same = P.mismatched(-0.3).input_range
    np.testing.assert_array_equal(same, P.input_range)


def test_an_arm_that_is_given_without_a_range_has_none():
    fields = {name: x for name, x in P.to_dict().items() if name != "input_range"}
    free = ArmParameters(**fields)
    np.testing.assert_array_equal(free.input_range, [[-np.inf], [np.inf]])
    assert json.loads(json.dumps(free.to_dict(), allow_nan=False))["input_range"]
    again = ArmParameters.from_dict(json.loads(json.dumps(free.to_dict())))
    np.testing.assert_array_equal(again.input_range, free.input_range)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ((12.0, -12.0), "input_range goes from 12 to -12; it must go from at most 0 to at least 0"),
        ((3.0, 20.0), "input_range goes from 3 to 20; it must go"),
        ((0.0, 0.0), "input_range goes from 0 to 0; it must go"),
        ((-1.0, np.nan), "input_range holds nan; it must be finite"),
        (12.0, r"input_range has shape \(\); it must be a pair \(low, high\), or \(\.\.\., 2, 6\)"),
        (np.zeros((2, 3)), r"input_range has shape \(2, 3\)"),
        (np.zeros((6, 2)), r"input_range has shape \(6, 2\)"),
        ("wide", "input_range is 'wide'; it must be made of numbers"),
    ],
)
def test_a_range_that_makes_no_sense_is_refused(given, said):
    with pytest.raises(OctarmError, match=f"^{said}"):
        dataclasses.replace(P, input_range=given)


@pytest.mark.parametrize("build", [build_model, build_slim_model])
@pytest.mark.parametrize("n", [1, 3, 6])
def test_a_model_holds_the_range_of_each_column(build, n):
    draw = np.random.default_rng(n)
    ends = np.stack([-draw.uniform(0.0, 9.0, 2 * n), draw.uniform(0.0, 9.0, 2 * n)])
    ends[:, 0] = INFINITE
    ends[1, -1] = 0.0
    arm = dataclasses.replace(longer(n), input_range=ends)
    model = build(arm)
    for i in range(1, n + 1):
        for a in (1, 2):
            column = 2 * (i - 1) + a - 1
            push = model.actuator(f"push_{a}_{i}").ctrlrange
            np.testing.assert_array_equal(push, ends[:, column])
    np.testing.assert_array_equal(read_parameters(model).input_range, ends)


# The loop


def reached(environment, steps, draw, size=60.0):
    """What random actions ask for, and what reaches the arms at every physics step."""
    environment.reset()
    physics, asked, received = environment.physics, [], []
    physics.watch = lambda arm: received.append(arm.received())
    for _ in range(steps):
        asked.append(draw.uniform(-size, size, physics.q().shape))
        environment.step(asked[-1])
        np.testing.assert_array_equal(physics.tau(), asked[-1])  # what was asked is kept apart
    return np.array(asked), np.array(received)


@pytest.mark.parametrize("actuation", ACTUATIONS)
@pytest.mark.parametrize("substeps", [1, 3])
def test_the_arm_receives_what_is_within_its_range(actuation, substeps):
    ends = np.array([[-5.0, -6.0, 0.0, -np.inf, -1.0, -9.0], [4.0, 0.0, 8.0, 3.0, np.inf, 9.0]])
    arm, draw = dataclasses.replace(P, input_range=ends), np.random.default_rng(1)
    period = 0.0005 * substeps
    environment = octarm.load(parameters=arm, actuation=actuation, control_period=period)
    spec = environment.action_spec()
    np.testing.assert_array_equal([spec.minimum, spec.maximum], ends)
    asked, received = reached(environment, 40, draw)
    np.testing.assert_array_equal(received, np.repeat(np.clip(asked, *ends), substeps, axis=0))

    free = dataclasses.replace(P, input_range=INFINITE)
    other = octarm.load(parameters=free, actuation=actuation, control_period=period)
    other.reset()
    for tau in asked:  # the same motion as under forces that were cut off by hand
        other.step(np.clip(tau, *ends))
    for state in ("q", "v"):
        same = [getattr(each.physics, state)() for each in (environment, other)]
        np.testing.assert_array_equal(*same)


FAULTS = ["actuation-delay:0.002", "dead-zone:0.5", "slew:4000", "lag:0.001", "loss:0.3"]


@pytest.mark.parametrize("batch", [None, 3])
def test_columns_that_only_pull_never_push(batch):
    arm = dataclasses.replace(P, input_range=PULL_ONLY)
    faults = list(map(parse_disturbance, FAULTS))
    environment = octarm.load(parameters=arm, disturbances=faults, batch=batch)
    _, received = reached(environment, 200, np.random.default_rng(2))
    assert received.min() >= -30.0
    assert received.max() <= 0.0
    assert np.mean(received < 0.0) > 0.3


@pytest.mark.parametrize("name", ["computed-torque", *INTEGRATING])
def test_a_pull_only_arm_is_controlled_within_its_range(name):
    """Pulling shortens the modules: a pose that columns can reach without pushing."""
    arm = dataclasses.replace(P, input_range=PULL_ONLY)
    pose = REST - np.array([0.02, 0.02, 0.02, 0.0, 0.0, 0.0]) + [0, 0, 0, 0.05, -0.05, 0.02]
    motion = octarm.references.SmoothStep(start=REST, goal=pose, begin=0.1, duration=0.8)
    environment = octarm.load(motion, parameters=arm)
    received = []
    environment.physics.watch = lambda arm: received.append(arm.received())
    run = octarm.rollout(environment, make_controller(name, arm.mismatched(-0.1)), 1.4)
    assert (run.status, len(received)) == ("ok", 2801)
    assert np.min(received) >= -30.0
    assert np.max(received) <= 0.0
    assert np.all(np.abs(run.error[-1]) < [1e-3] * 3 + [0.02] * 3)


def test_faults_act_on_what_the_range_leaves_of_the_inputs():
    """A slow actuator does not wind up beyond its range: it leaves its limit at once."""
    arm = limited(-10.0, 10.0)
    environment = octarm.load(parameters=arm, disturbances=[parse_disturbance("slew:2000")])
    environment.reset()
    for _ in range(400):
        environment.step(np.full(6, 500.0))
    assert environment.physics.received().tolist() == [10.0] * 6
    environment.step(np.full(6, -500.0))
    np.testing.assert_allclose(environment.physics.received(), 9.0)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Stuck(ActuatorFault):
    """A valve that stays open."""

    name = "stuck"

    def start(self, episode):
        return lambda step, tau: tau + 100.0


def test_no_fault_gives_more_than_the_range():
    environment = octarm.load(parameters=limited(-10.0, 10.0), disturbances=[Stuck()])
    environment.reset()
    environment.step(np.zeros(6))
    assert environment.physics.received().tolist() == [10.0] * 6


def test_the_ledger_does_not_blame_the_range_on_a_fault(tmp_path, capsys):
    out = tmp_path / "run"
    words = ["run", "--out", str(out), "--duration", "0.2", "--reference", "set-point"]
    words += ["--parameter", "input_range:-2,2", "--disturbance", "saturation:5"]
    words += ["--mismatch", "100%"]  # asks for more than the range
    assert main(words) == 0
    [row] = json.loads((out / "run.json").read_text())["disturbances"]
    assert row["delivered"]["share_changed"] == [0.0] * 6
    assert max(row["delivered"]["peak"]) == 2.0
    capsys.readouterr()


def test_a_heavy_arm_with_its_own_range_is_not_cut_off():
    """706 N of a published arm: more than the nominal range, less than that arm's own."""
    heavy = P.scaled(mass=32.0, inertia=32.0, stiffness=32.0, damping=32.0)
    shares, peaks, ends = [], [], []
    for most in (706.0, 200.0, np.inf):
        arm = limited(-most, most, heavy)
        environment = octarm.load("smooth-step:amplitude=0.35,slide=0.01", parameters=arm)
        assert environment.action_spec().maximum.tolist() == [most] * 6
        controller = make_controller("computed-torque", arm)
        run = octarm.rollout(environment, controller, 1.5)
        metrics = Metrics(control_period=0.0005, input_range=environment.physics.input_range())
        metrics.update(dict(run.arrays()))
        found = metrics.result(diverged=run.status == "diverged")
        shares.append(found["saturation_share"].max())
        peaks.append(found["peak_input"].max())
        ends.append(run.q[-1])
    assert 600.0 < peaks[0] < 706.0
    assert (shares[0], shares[2]) == (0.0, 0.0)
    assert shares[1] > 0.1
    np.testing.assert_array_equal(ends[0], ends[2])


# What a law makes of it


@pytest.mark.parametrize("n", [1, 3])
def test_the_shortfall_is_what_the_cut_off_inputs_would_have_given(n):
    draw, arm = np.random.default_rng(n), longer(n)
    q = equilibrium(arm) + 0.3 * draw.normal(size=(400, 2 * n))
    force = draw.normal(size=(400, 2 * n)) * np.repeat([20.0, 1.0], n)
    for ends in ((-12.0, 12.0), (0.0, 9.0), (-1e4, 1e4), INFINITE):
        model = LagrangeModel(dataclasses.replace(arm, input_range=ends))
        tau = np.linalg.solve(model.force_coefficients(q), force[..., None])[..., 0]
        excess = tau - np.clip(tau, *ends)
        expected = np.einsum("kij,kj->ki", model.force_coefficients(q), excess)
        found = model.shortfall(q, force)
        assert (found is None) == (not excess.any())
        if found is not None:
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
            for i in range(0, 400, 7):
                alone = model.shortfall(q[i], force[i])
                alone = np.zeros(2 * n) if alone is None else alone
                np.testing.assert_array_equal(found[i], alone)


def test_what_is_surely_within_the_range_is_within_it():
    """The quick answer is never wrong, and it is the usual one along a motion."""
    draw = np.random.default_rng(4)
    for _ in range(300):
        q = REST + draw.normal(size=6) * np.repeat([0.05, 1.0], 3)
        force = draw.normal(size=6) * np.repeat([10.0, 0.6], 3) * draw.uniform()
        tau = GroundedActuation(P.widths).inputs(q, force)
        for most in np.array([0.9, 0.999, 1.001, 3.0]) * np.max(np.abs(tau)):
            inputs = LagrangeModel(limited(-most, most))._range
            assert not (inputs._surely_within(q, force) and np.any(np.abs(tau) > most))
    run = octarm.rollout(octarm.load("sine"), make_controller("smc-boundary", P), 0.5)
    usual = LagrangeModel(P)._range
    sure = [usual._surely_within(q, f) for q, f in zip(run.q, run.force, strict=True)]
    assert np.mean(sure) > 0.9


def hard(name: str, nominal, lambda_: float):
    """Hand-set gains but for lambda [1/s], at which what winds up shows."""
    return make_controller(name, nominal, {"lambda": lambda_}, gain_set="recommended")


def overshoot(name: str, told: bool, most: float) -> float:
    """Of theta1 beyond a set-point, as a share of the way, with a range that the law is told."""
    arm = limited(-most, most)
    nominal = arm if told else limited(*INFINITE)
    run = octarm.rollout(
        octarm.load("set-point:0.2", parameters=arm), hard(name, nominal, 50.0), 0.7
    )
    way = run.q_d[-1, 3] - run.q[0, 3]
    return max(0.0, float(np.max((run.q[:, 3] - run.q_d[:, 3]) / way)))


@pytest.mark.parametrize(
    ("name", "wound_up", "mended"),
    [
        ("smc-integral", 0.02, 1e-4),  # 2.6 % and none
        ("super-twisting", 0.0299, 0.0301),
        ("afsmc-consequent", 0.006, 0.0071),
        ("afsmc", 0.006, 0.0071),
    ],
)
def test_a_set_point_with_12_newtons_is_not_overshot_more_than_without_a_limit(
    name, wound_up, mended
):
    assert overshoot(name, False, 12.0) > wound_up
    after = overshoot(name, True, 12.0)
    assert after < mended
    assert after <= overshoot(name, True, np.inf) + 1e-4


@pytest.mark.parametrize("name", INTEGRATING)
def test_what_was_out_of_reach_for_a_while_leaves_nothing_behind(name):
    """Weight holds a column at 4 N for seconds; then the pose is within reach again."""
    up = REST + np.array([0, 0, 0, 0.6, 0.3, 0])
    there = octarm.references.SmoothStep(start=REST, goal=up, begin=0.2, duration=0.4)
    back = octarm.references.SmoothStep(start=0 * REST, goal=REST - up, begin=1.0, duration=0.4)

    def motion(t):
        parts = zip(there(t), back(t), strict=True)
        return octarm.interfaces.Reference(*(x + y for x, y in parts))

    def error(nominal):
        environment = octarm.load(motion, parameters=limited(-4.0, 4.0))
        run = octarm.rollout(environment, hard(name, nominal.mismatched(-0.3), 30.0), 1.8)
        return np.abs(run.error[run.t > 1.45, 3]).max()

    told = error(limited(-4.0, 4.0))
    assert told < 2e-3
    if name == "smc-integral":
        assert error(limited(*INFINITE)) > 5.0 * told


@pytest.mark.parametrize("name", ["afsmc-consequent", "afsmc"])
def test_nothing_is_learnt_while_the_arm_cannot_follow(name):
    E = []
    for told in (False, True):
        arm = limited(-5.0, 5.0)
        nominal = arm if told else limited(*INFINITE)
        environment = octarm.load("multi-sine:amplitude=0.2,slide=0.008", parameters=arm)
        run = octarm.rollout(environment, make_controller(name, nominal), 1.5)
        E.append(np.abs(run.signals["E"][-1]).max() + np.abs(run.signals["theta"][-1]).max())
    assert E[1] < 0.9 * E[0]


@pytest.mark.parametrize("name", CONTROLLERS)
def test_where_nothing_is_cut_off_every_bit_is_as_without_a_range(name):
    free, wide = limited(*INFINITE), limited(-1e7, 1e7)
    arm = limited(-1e7, 1e7).mismatched(-0.3)
    runs = []
    for true, nominal in ((free, free.mismatched(-0.3)), (wide, arm)):
        environment = octarm.load("set-point", parameters=true)
        runs.append(octarm.rollout(environment, make_controller(name, nominal), 0.1))
    assert runs[0].digest == runs[1].digest
    one, other = (dict(run.arrays()) for run in runs)
    assert one.keys() == other.keys()
    for field, array in one.items():
        np.testing.assert_array_equal(array, other[field])


RANGES = np.array([[[-12.0], [12.0]], [[-np.inf], [np.inf]], [[-30.0], [4.0]], [[-5.0], [5.0]]])


@pytest.mark.parametrize("name", INTEGRATING)
def test_arms_of_a_batch_with_their_own_ranges_are_those_arms_alone(name):
    arms = dataclasses.replace(P, input_range=RANGES)
    states, received = [], []

    def watched(environment, nominal):
        environment.physics.watch = lambda arm: received.append(arm.received())
        taken = []
        simulate(
            environment,
            make_controller(name, nominal),
            0.15,
            lambda instant: taken.append(np.concatenate([instant.q, instant.v, instant.tau], -1)),
        )
        return np.array(taken)

    together = watched(octarm.load("set-point", parameters=arms, batch=4), arms)
    for i in range(4):
        alone = watched(octarm.load("set-point", parameters=arms.arm(i)), arms.arm(i))
        np.testing.assert_array_equal(together[:, i], alone)
        states.append(alone)
    assert not np.array_equal(states[0], states[1])
    for rows in received:
        assert np.all((rows >= RANGES[..., 0, :]) & (rows <= RANGES[..., 1, :])) or rows.ndim == 1


@pytest.mark.parametrize("name", INTEGRATING)
def test_a_law_does_not_stop_an_arm_of_a_batch_because_of_another_one(name):
    """Rows that are within their range integrate, whatever the other rows do."""
    (t, q, v), reference = random_instant(40)
    measurement, law = octarm.interfaces.Measurement(t, q, v), make_controller(name, P)
    _, state = law(law.initial_state((40,)), measurement, reference)
    _, after = law(state, measurement._replace(t=t + 1e-3), reference)
    for i in range(40):
        row = octarm.interfaces.Measurement(t, q[i], v[i])
        wanted = octarm.interfaces.Reference(*(x[i] for x in reference))
        _, state = law(law.initial_state(), row, wanted)
        _, alone = law(state, row._replace(t=t + 1e-3), wanted)
        for together, one in zip(after[1:], alone[1:], strict=True):
            np.testing.assert_array_equal(together[i], one)


# The command line


def test_a_run_with_a_range_is_recorded_and_repeated(tmp_path, capsys):
    out = tmp_path / "run"
    words = ["run", "--out", str(out), "--duration", "0.1", "--reference", "set-point:0.2"]
    words += ["--controller", "smc-integral", "--parameter", "input_range:-12,12"]
    assert main(words) == 0
    description = json.loads((out / "run.json").read_text())
    for which in ("parameters", "nominal"):
        assert description[which]["input_range"] == [[-12.0], [12.0]]
    assert max(description["metrics"]["saturation_share"]) > 0.1
    assert main(["verify", str(out)]) == 0
    description["parameters"]["input_range"] = [[-13.0], [13.0]]
    (out / "run.json").write_text(json.dumps(description))
    assert main(["verify", str(out)]) == 1
    assert main([*words[:-1], "input_range:5,12", "--force"]) == 2
    assert "input_range goes from 5 to 12" in capsys.readouterr().err
