"""The physics step against the arm: refused where it is too long, or chosen."""

import dataclasses
import functools

import numpy as np
import pytest

from controllers import make_controller
from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.modes import longest_step
from octarm.checks.verify import check_run
from octarm.commands.app import parse
from octarm.disturbances.episode import Plant, PlantChange, PlantProcess
from octarm.disturbances.plant import CyclicDrift, Drift, Mismatch, Payload, RandomMismatch
from octarm.disturbances.varied import parse_varied
from octarm.errors import OctarmError
from octarm.runs.folder import read_description
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout
from octarm.simulation.steps import StepError, fitting_step
from octarm.sweeps.execute import sweep
from octarm.sweeps.margin import MarginRuns
from octarm.sweeps.plan import with_step
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.store import SPEC, read_sweep

NOMINAL = nominal_parameters()
STIFF = NOMINAL.scaled(damping=150.0)
LIMIT = float(longest_step(STIFF, equilibrium(STIFF)))  # 79 us


def test_a_step_is_refused_just_above_the_longest_stable_one():
    load(parameters=STIFF, timestep=0.999 * LIMIT)
    with pytest.raises(
        StepError,
        match=r"timestep is 7.86\d+e-05 s; the fastest mode of the arm decays at 3.54e\+04 1/s, so "
        r"that with rk4 it must be at most 7.85e-05 s; 'auto' chooses one",
    ):
        load(parameters=STIFF, timestep=1.001 * LIMIT)


def test_a_light_arm_is_refused_instead_of_diverging_by_itself():
    with pytest.raises(StepError, match=r"swings at .* Hz|decays at"):
        load(parameters=NOMINAL.scaled(mass=1e-6, inertia=1e-6))


def test_a_heavily_damped_arm_runs_with_a_step_that_is_chosen():
    environment = load(parameters=STIFF, timestep="auto")
    assert environment.physics.timestep() == pytest.approx(5e-5)
    assert environment.control_timestep() == pytest.approx(5e-4)
    run = rollout(environment, make_controller("pd", STIFF), 0.05)
    assert run.status == "ok" and np.abs(run.error).max() < 0.5


@pytest.mark.parametrize("period", [None, 5e-4, 1e-3, 7e-4, 0.01, 1e-4])
@pytest.mark.parametrize("longest", [1.0, 1.1e-3, 4e-4, 7.8e-5, 1.3e-6])
def test_a_chosen_step_is_a_stable_part_of_the_control_period(longest: float, period):
    step, control = fitting_step(longest, period)
    assert control == (5e-4 if period is None else period)
    assert step <= min(longest / 1.1, 5e-4) * (1.0 + 1e-9)
    parts = round(control / step)
    assert control / step == pytest.approx(parts) and str(parts).rstrip("0") in ("1", "2", "5")
    assert 2.6 * step > min(longest / 1.1, 5e-4, control)  # no longer one would do


def test_the_nominal_arm_keeps_its_step():
    assert load(timestep="auto").physics.timestep() == load().physics.timestep()


def test_what_cannot_be_chosen_is_said():
    with pytest.raises(OctarmError, match=r"needs steps below 1.07e-08 s; .* at least 1e-07 s"):
        load(parameters=NOMINAL.scaled(mass=1e-6, inertia=1e-6), timestep="auto")
    with pytest.raises(OctarmError, match=r"timestep is 'quick'; it must be a number .* 'auto'"):
        load(timestep="quick")
    with pytest.raises(OctarmError, match=r"unknown integrator 'rk5', did you mean 'rk4'"):
        load(integrator="rk5")


@pytest.mark.parametrize(
    "disturbance",
    [
        Mismatch(damping=150.0),
        Mismatch(stiffness=1e6),
        Drift(rate=1e-6, limit=0.9999999, of="damping+mass"),
        Drift(rate=-1e-9, limit=0.999999999, of="inertia"),
        CyclicDrift(share=0.9999999, of="inertia+mass"),
        RandomMismatch(share=0.9999999999),
    ],
    ids=lambda d: d.name,
)
def test_every_arm_that_a_disturbance_may_make_is_looked_at(disturbance):
    if isinstance(disturbance, Drift) and disturbance.rate > 0.0:  # heavier and damped: slower
        load(disturbances=[disturbance])
        return
    arm = NOMINAL.scaled(damping=1e4) if isinstance(disturbance, RandomMismatch) else NOMINAL
    with pytest.raises(StepError):
        load(parameters=arm, disturbances=[disturbance])


def test_a_payload_slows_the_arm_down_and_is_allowed():
    load(parameters=STIFF, timestep=0.99 * LIMIT, disturbances=[Payload(mass=0.2, at=1.0)])


def test_extremes_of_several_disturbances_are_combined():
    light, damped = CyclicDrift(share=0.7, of="inertia+mass"), Mismatch(damping=9.0)
    for one in (light, damped):
        load(disturbances=[one])
    with pytest.raises(StepError):
        load(disturbances=[light, damped])


def test_the_arm_of_a_batch_is_named():
    damping = Mismatch(damping=np.array([1.0, 150.0, 2.0]))
    with pytest.raises(StepError, match=r"^arm 1: timestep is 0.0005 s") as caught:
        load(batch=3, disturbances=[damping])
    assert caught.value.arm == 1


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Jam(PlantChange):
    """A user's own change of the arm, which does not say how far it goes."""

    name = "jam"

    def start(self, episode):
        at = 7
        return PlantProcess(lambda step: step in (0, at), functools.partial(self._apply, at))

    @staticmethod
    def _apply(at: int, step: int, plant: Plant) -> Plant:
        by = 150.0 if step >= at else 1.0
        return plant._replace(parameters=plant.parameters.scaled(damping=by))


def test_a_change_that_states_no_extremes_is_looked_at_when_it_happens():
    environment = load(disturbances=[Jam()])
    with pytest.raises(StepError, match=r"7.85e-05"):
        rollout(environment, make_controller("pd", NOMINAL), 0.05)
    rollout(load(disturbances=[Jam()], timestep=5e-5), make_controller("pd", NOMINAL), 0.001)


# The implicit integrator


def test_implicitfast_bears_much_damping_at_the_usual_step_and_is_accurate_there():
    """Of the swing of a second, .1 % where RK4 diverges; RK4 at 50 us is the reference."""
    from octarm.references import Sine

    rest = equilibrium(STIFF)
    motion = Sine(center=rest, amplitude=np.repeat([0.003, 0.1], 3), frequency=1.0)
    controller = make_controller("pd", STIFF)
    common = {"parameters": STIFF, "control_period": 1e-3}
    exact = rollout(load(motion, timestep=5e-5, **common), controller, 0.5)
    fast = rollout(load(motion, integrator="implicitfast", **common), controller, 0.5)
    swing = np.ptp(exact.q, axis=0)
    assert np.max(np.abs(fast.q - exact.q) / swing) < 1e-3
    assert fast.digest != exact.digest


def test_implicitfast_has_a_longest_step_too():
    light = NOMINAL.scaled(mass=1e-6, inertia=1e-6, damping=0.0)
    with pytest.raises(StepError, match=r"swings at .* with implicitfast it must be at most"):
        load(parameters=light, integrator="implicitfast")


# Commands


def test_a_run_records_its_step_and_integrator_and_verify_repeats_them(tmp_path):
    words = ["run", "--duration", "0.01", "--controller", "pd"]
    words += ["--disturbance", "mismatch:0,damping=150"]
    out = tmp_path / "run"
    assert parse([*words, "--timestep", "auto", "--out", str(out)])() == 0
    said = read_description(out)
    assert (said["timestep"], said["control_period"]) == pytest.approx((5e-5, 5e-4))
    assert said["integrator"] == "rk4"
    assert check_run(out, make_controller).identical
    out = tmp_path / "implicit"
    assert parse([*words, "--integrator", "implicitfast", "--out", str(out)])() == 0
    assert read_description(out)["integrator"] == "implicitfast"
    assert check_run(out, make_controller).identical
    with pytest.raises(StepError):
        parse([*words, "--out", str(tmp_path / "no")])()
    assert not (tmp_path / "no").exists()


SWEEP = """
episodes = 2
duration = 0.01
[grid]
controller = ["pd", "smc-boundary"]
[grid.disturbance]
mismatch.damping = [1.0, 150.0]
"""


def test_a_sweep_whose_step_is_too_long_for_an_episode_does_not_begin(tmp_path):
    with pytest.raises(OctarmError, match=r"^episode 2: timestep is 0.0005 s; .* 7.85e-05 s"):
        sweep(parse_spec(SWEEP), make_controller, tmp_path / "sweep")
    assert not (tmp_path / "sweep").exists()


def test_a_sweep_chooses_one_step_for_all_its_episodes_and_keeps_it(tmp_path):
    spec = parse_spec('timestep = "auto"' + SWEEP)
    assert with_step(spec, probes=True) == with_step(spec)
    sweep(spec, make_controller, tmp_path / "sweep")
    kept = parse_spec((tmp_path / "sweep" / SPEC).read_text())
    assert (kept.timestep, kept.control_period) == pytest.approx((5e-5, 5e-4))
    assert set(read_sweep(tmp_path / "sweep")["status"].to_pylist()) == {"ok"}
    sweep(spec, make_controller, tmp_path / "sweep", resume=True)  # the same one again


def test_every_drawn_arm_of_a_sweep_is_looked_at(tmp_path):
    drawn = "batch = 4\n[random.disturbance]\nmismatch.damping = { low = 1.0, high = 12.0 }\n"
    text = "episodes = 40\nduration = 0.01\ntimestep = 0.001\n" + drawn + "[grid]\n"
    spec = parse_spec(text + 'controller = ["pd", "smc"]\n')
    with pytest.raises(OctarmError, match=r"^episode \d+: timestep is 0.001 s"):
        with_step(spec)
    chosen = with_step(dataclasses.replace(spec, timestep="auto", control_period=1e-3))
    assert chosen.timestep == pytest.approx(5e-4)


def test_a_margin_has_one_step_for_all_its_arms():
    def runs(timestep) -> MarginRuns:
        return MarginRuns(
            factory=functools.partial(make_controller, "pd"),
            varied=parse_varied("mismatch:damping=150", 0.0, 3.0),
            bounds=[("tip_rms_error", 1.0)],
            timestep=timestep,
        )

    with pytest.raises(StepError, match=r"^arm \d: timestep is 0.0005 s"):
        runs(None).rehearse()
    chosen = runs("auto").rehearse(2)
    assert (chosen.timestep, chosen.control_period) == pytest.approx((5e-5, 5e-4))
    assert chosen.rehearse() is chosen
