"""The commands that run one arm: run, view."""

from __future__ import annotations

import dataclasses
import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from octarm.commands import kinds
from octarm.commands.options import ArmOptions, GainOptions
from octarm.commands.terminal import surviving_output
from octarm.errors import OctarmError

if TYPE_CHECKING:
    from octarm.runs.experiment import Experiment


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class RunOptions:
    """What is run; the fields are those of an experiment, but for words that name things.

    Attributes:
        controller: the control law
        reference: the desired motion, NAME[:KEY=VALUE..]; see below
        disturbance: NAME:VALUE[,KEY=VALUE..], what acts on the arm unknown to the controller; see
            below
        metric: what is measured as well, FILE.py:NAME or MODULE:NAME
        duration: length of the run [s]
        settle: when errors and other metrics of the steady regime begin to count [s]
        seed: seed of all that is random; an undisturbed run from rest has nothing random
        start: rest, the arm hangs still; random, a place that is drawn; moving, with a speed, too
        start_share: share of what the inputs reach within which the start is drawn; tuned gains
            lose the nominal arm from about 0.2 on
        timestep: physics step [s]; that of models/octarm.xml, 0.0005 s, when not given; auto is the
            longest part of the control period that suits the fastest mode of the arm
        control_period: time between control actions [s], whole physics steps; one step when not
            given
        actuation: how input forces act: f-coeff as in eq (2), internal between neighbouring modules
        integrator: rk4, or implicitfast, which is of first order, for arms with very much damping
        engine: what steps the arm: mujoco, or lagrange, the analytic arm, compiled (extra fast)
    """

    controller: Annotated[str, kinds.CONTROLLER, kinds.EXPERIMENT] = "smc-boundary"
    reference: Annotated[str, kinds.REFERENCE, kinds.EXPERIMENT] = "sine"
    disturbance: Annotated[tuple[str, ...], kinds.DISTURBANCE, kinds.EXPERIMENT] = ()
    metric: Annotated[tuple[str, ...], kinds.METRIC, kinds.EXPERIMENT] = ()
    duration: Annotated[float, kinds.DURATION, kinds.EXPERIMENT] = 10.0
    settle: Annotated[float, kinds.SETTLE, kinds.EXPERIMENT] = 2.0
    seed: Annotated[int, kinds.N, kinds.EXPERIMENT] = 0
    start: Annotated[str, kinds.START, kinds.EXPERIMENT] = "rest"
    start_share: Annotated[float, kinds.SHARE, kinds.EXPERIMENT] = 0.1
    model: ArmOptions = ArmOptions()
    gain_options: GainOptions = GainOptions()
    timestep: Annotated[float | str | None, kinds.STEP, kinds.SIMULATION] = None
    control_period: Annotated[float | None, kinds.PERIOD, kinds.SIMULATION] = None
    actuation: Annotated[str, kinds.ACTUATION, kinds.SIMULATION] = "f-coeff"
    integrator: Annotated[str, kinds.INTEGRATOR, kinds.SIMULATION] = "rk4"
    engine: Annotated[str, kinds.ENGINE, kinds.SIMULATION] = "mujoco"

    def experiment(self) -> Experiment:
        """The experiment, with short names and the code of what is not built in."""
        from controllers import CONTROLLERS
        from octarm.declared import named
        from octarm.disturbances.spelling import DISTURBANCES, parse_disturbance
        from octarm.metrics.table import ACCUMULATORS
        from octarm.references import REFERENCES
        from octarm.runs.experiment import Experiment

        words = [(CONTROLLERS, self.controller), (REFERENCES, self.reference)]
        words += [(DISTURBANCES, text) for text in self.disturbance]
        words += [(ACCUMULATORS, word) for word in self.metric]
        (controller, reference, *_), code = named(words)
        parameters, nominal = self.model.both()
        options = vars(self) | vars(self.model)
        return Experiment(
            controller=controller,
            reference=reference,
            disturbances=tuple(map(parse_disturbance, self.disturbance)),
            gains=self.gain_options.values(self.controller),
            parameters=parameters,
            nominal=nominal,
            code=code,
            **{name: options[name] for name in _AS_GIVEN},
        )


_AS_GIVEN = (
    "duration", "settle", "seed", "start", "start_share", "timestep", "control_period", "actuation",
    "integrator", "engine", "plant_modules", "layout", "sensing",
)  # fmt: skip


def run(
    *,
    options: RunOptions = RunOptions(),
    out: Annotated[Path | None, kinds.DIR, kinds.OUTPUT] = None,
    force: Annotated[bool, kinds.OUTPUT] = False,
    view: Annotated[bool, kinds.OUTPUT] = False,
    live: Annotated[list[str] | None, kinds.LIVE, kinds.OUTPUT] = None,
) -> kinds.Work:
    """Run one controller on the arm and record it.

    Writes a run folder: run.rrd (the recording), run.npz (all arrays), run.json (what was run).

    Args:
        options: see `RunOptions`
        out: run folder to write; runs/DATE-TIME-CONTROLLER when not given
        force: replace an earlier run
        view: open the recording in the viewer when the run is done
        live: show the run in a viewer while it goes on: in a new window, or in the viewer that is
            open at HOST:PORT

    Examples:
      octarm run --view
      octarm run --duration 60 --live
      octarm run --controller afsmc --mismatch -0.3 --out runs/adaptive
      octarm run --disturbance noise:0.4 --disturbance payload:0.2,at=3
      octarm run --reference sine:amplitude=20deg,frequency=1
      octarm run --reference tip:circle,size=3cm,period=2
      octarm run --start moving --start-share 5% --seed 3
      octarm run --controller smc --gain lambda:20 --parameter mass:0.4,0.3,0.2
      octarm run --controller ./mine.py:Law --disturbance ./mine.py:Gust:5,at=1
      octarm run --arm eth --controller afsmc
      octarm run --plant-modules 15 --timestep auto --control-period 0.0001

    With tuned gains, 40 % noise and a model wrong by 30 %, laws are to keep the
    nominal arm up to a control period of 2 ms, inputs late by 1.5 ms, and inputs
    that lag by 5 ms.

    References; parameters with what they are on the nominal arm, whose sizes suit
    other arms where they are not given. A number may have a unit, as in
    sine:amplitude=20deg, and a path is that of a CSV or NPZ file:

    {references}

    Disturbances, by what they act on; keys with their defaults:

    {disturbances}
    """
    kinds.check_free(force, out and out / "run.json")
    if live is not None:
        if view or len(live) > 1:
            raise OctarmError("--live is given with --view, or twice; one viewer shows a run")
        os.environ.setdefault("RUST_LOG", "off")  # a viewer that goes away is said by octarm
    options.gain_options.values(options.controller)  # raises
    options.model.both()  # raises
    from octarm.commands import run as work

    def job() -> int:
        what, url = options.experiment(), None if live is None else "".join(live)
        return work.run(what, options.gain_options.gains, out, view, url)

    return surviving_output(job)


def view(
    *,
    controller: Annotated[str, kinds.CONTROLLER, kinds.EXPERIMENT] = "smc-boundary",
    reference: Annotated[str, kinds.REFERENCE, kinds.EXPERIMENT] = "sine",
    disturbance: Annotated[tuple[str, ...], kinds.DISTURBANCE, kinds.EXPERIMENT] = (),
    seed: Annotated[int, kinds.N, kinds.EXPERIMENT] = 0,
    start: Annotated[str, kinds.START, kinds.EXPERIMENT] = "rest",
    start_share: Annotated[float, kinds.SHARE, kinds.EXPERIMENT] = 0.1,
    arm: Annotated[str | None, kinds.ARM, kinds.MODEL] = None,
    mismatch: Annotated[float, kinds.MISMATCH, kinds.MODEL] = 0.0,
    gain_options: GainOptions = GainOptions(),
    control_period: Annotated[float | None, kinds.PERIOD, kinds.SIMULATION] = None,
) -> kinds.Work:
    """Watch the arm in MuJoCo's viewer, moved by a controller.

    In a window of dm_control, where the arm can be pushed: the space bar starts and stops, F1 shows
    the keys. A restart is the next episode: all that is random is drawn anew, and the controller
    begins anew. Nothing is recorded. The options are those of octarm run.

    Args:
        controller: the control law
        reference: the desired motion
        disturbance: NAME:VALUE[,KEY=VALUE..], what acts on the arm; see octarm run --help
        seed: seed of all that is random
        start: where episodes begin: rest, random or moving
        start_share: share of what the inputs reach within which the start is drawn
        arm: the true arm and the controller's model of it, a file or an arm that comes with octarm
        mismatch: error of the controller's model
        gain_options: see `octarm.commands.options`
        control_period: time between control actions [s]; one physics step when not given

    Examples:
      octarm view --controller afsmc
      octarm view --controller pd --disturbance noise:0.4
    """
    from octarm.recordings.viewer import check_display

    def job() -> None:
        check_display("octarm run and octarm video need none")
        os.environ["MUJOCO_GL"] = "glfw"  # before anything imports MuJoCo
        from dm_control import viewer

        from controllers import make_controller
        from octarm.simulation.policy import Policy

        what = RunOptions(
            controller=controller,
            reference=reference,
            disturbance=disturbance,
            seed=seed,
            start=start,
            start_share=start_share,
            model=ArmOptions(arm=arm, mismatch=mismatch),
            gain_options=gain_options,
            control_period=control_period,
        ).experiment()
        factory = partial(make_controller, gain_set=gain_options.gains)
        environment, law = what.begin(factory)
        title = f"{what.controller} on {what.reference}"
        try:
            viewer.launch(environment, Policy(environment, law), title=title)
        except Exception as error:
            if type(error).__name__ not in ("GLFWError", "FatalError", "RuntimeError"):
                raise
            raise OctarmError(f"the window cannot be opened: {error}") from None

    return job
