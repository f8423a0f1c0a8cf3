"""The commands on one run and a few: run, view, replay, compare, record, plot, video."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from octarm.commands import kinds
from octarm.commands.options import NOMINAL_ARM, USUAL_GAINS, ArmOptions, GainOptions
from octarm.commands.terminal import surviving_output
from octarm.errors import OctarmError

if TYPE_CHECKING:
    from octarm.runs.experiment import Experiment


def run(
    *,
    controller: Annotated[str, kinds.CONTROLLER, kinds.EXPERIMENT] = "smc-boundary",
    reference: Annotated[str, kinds.REFERENCE, kinds.EXPERIMENT] = "sine",
    disturbance: Annotated[tuple[str, ...], kinds.DISTURBANCE, kinds.EXPERIMENT] = (),
    metric: Annotated[tuple[str, ...], kinds.METRIC, kinds.EXPERIMENT] = (),
    duration: Annotated[float, kinds.DURATION, kinds.EXPERIMENT] = 10.0,
    settle: Annotated[float, kinds.SETTLE, kinds.EXPERIMENT] = 2.0,
    seed: Annotated[int, kinds.N, kinds.EXPERIMENT] = 0,
    start: Annotated[str, kinds.START, kinds.EXPERIMENT] = "rest",
    start_share: Annotated[float, kinds.SHARE, kinds.EXPERIMENT] = 0.1,
    model: ArmOptions = NOMINAL_ARM,
    gain_options: GainOptions = USUAL_GAINS,
    timestep: Annotated[float | str | None, kinds.STEP, kinds.SIMULATION] = None,
    control_period: Annotated[float | None, kinds.PERIOD, kinds.SIMULATION] = None,
    actuation: Annotated[str, kinds.ACTUATION, kinds.SIMULATION] = "f-coeff",
    integrator: Annotated[str, kinds.INTEGRATOR, kinds.SIMULATION] = "rk4",
    engine: Annotated[str, kinds.ENGINE, kinds.SIMULATION] = "mujoco",
    out: Annotated[Path | None, kinds.DIR, kinds.OUTPUT] = None,
    force: Annotated[bool, kinds.OUTPUT] = False,
    view: Annotated[bool, kinds.OUTPUT] = False,
    live: Annotated[list[str] | None, kinds.LIVE, kinds.OUTPUT] = None,
) -> kinds.Work:
    """Run one controller on the arm and record it.

    Writes a run folder: run.rrd (the recording), run.npz (all arrays), run.json (what was run).

    Args:
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
        model: see `octarm.commands.options`
        gain_options: likewise
        timestep: physics step [s]; that of models/octarm.xml, 0.0005 s, when not given; auto is the
            longest part of the control period that suits the fastest mode of the arm
        control_period: time between control actions [s], whole physics steps; one step when not
            given
        actuation: how input forces act: f-coeff as in eq (2), internal between neighbouring modules
        integrator: rk4, or implicitfast, which is of first order, for arms with very much damping
        engine: what steps the arm: mujoco, or lagrange, the analytic arm, compiled (extra fast)
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
    gains, (true, nominal) = gain_options.values(controller), model.both()
    from octarm.commands import run as work

    def job() -> int:
        what = _experiment(
            controller,
            reference,
            disturbance,
            metric,
            gains=gains,
            nominal=nominal,
            parameters=true,
            seed=seed,
            duration=duration,
            settle=settle,
            timestep=timestep,
            control_period=control_period,
            actuation=actuation,
            integrator=integrator,
            engine=engine,
            plant_modules=model.plant_modules,
            layout=model.layout,
            start=start,
            start_share=start_share,
            sensing=model.sensing,
        )
        url = None if live is None else "".join(live)
        return work.run(what, gain_options.gains, out, view, url)

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
    gain_options: GainOptions = USUAL_GAINS,
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
        from octarm.commands import view as work

        true, nominal = ArmOptions(arm=arm, mismatch=mismatch).both()
        what = _experiment(
            controller,
            reference,
            disturbance,
            gains=gain_options.values(controller),
            nominal=nominal,
            parameters=true,
            seed=seed,
            start=start,
            start_share=start_share,
            duration=1.0,  # of a run; the window stays open
            control_period=control_period,
        )
        work.view(what, gain_options.gains)

    return job


def replay(
    *runs: Annotated[Path, kinds.RUN],
    screenshot: Annotated[Path | None, kinds.file(".png")] = None,
    time: Annotated[float | None, kinds.S] = None,
    web: bool = False,
    force: bool = False,
) -> kinds.Work:
    """Open recorded runs in the rerun viewer.

    One run folder, two of them side by side with the difference of their errors, or a sweep folder,
    of which the recorded episodes are opened.

    Args:
        runs: run folder, two run folders, or a sweep folder
        screenshot: write a picture of the viewer instead of opening it; no display
        time: time shown in the picture [s]; that of the largest bend, or the
            end of a run that diverged, when not given
        web: serve the viewer to a browser on this machine; no network
        force: replace a picture that is there

    Examples:
      octarm replay runs/my-run
      octarm replay runs/smc runs/afsmc
      octarm replay runs/my-run --screenshot picture.png --time 4.5
    """
    kinds.check_free(force, screenshot)
    kinds.check_runs(*(run for run in runs if not run.is_file()), sweeps=True)
    from octarm.commands import replay as work

    job = partial(work.replay, runs, screenshot, time, web)
    return surviving_output(job) if screenshot else job


def compare(
    *runs: Annotated[Path, kinds.RUN],
    out: Annotated[Path, kinds.DIR] = Path("comparison"),
    force: bool = False,
) -> kinds.Work:
    """Put two runs or more into one page and one recording.

    First in what they differ, then their metrics and their errors over time. Runs that had
    different things to do (another arm, reference, duration, disturbance or seed) are not ranked.
    Writes a folder: comparison.html, which needs nothing beside itself, and comparison.rrd.

    Args:
        runs: run folders; the first one is A, the next B
        out: folder to write
        force: replace a comparison that is there

    Examples:
      octarm compare runs/smc runs/afsmc
      octarm compare runs/a runs/b runs/c --out comparison-of-gains
    """
    kinds.check_free(force, out / "comparison.html", out / "comparison.rrd")
    kinds.check_runs(*runs)
    if len(runs) < 2:
        raise OctarmError(f"octarm compare needs two runs or more; {len(runs)} given")
    from octarm.commands import redraw as work

    return surviving_output(work.compare, runs, out)


def record(
    run: Annotated[Path, kinds.RUN],
    /,
    *,
    out: Annotated[Path | None, kinds.file(".rrd")] = None,
    force: bool = False,
) -> kinds.Work:
    """Rebuild the recording of a run from its arrays.

    The recording is made of run.npz and run.json alone.

    Args:
        run: run folder
        out: recording to write; that of the run is made anew when not given
        force: replace another file that is there

    Examples:
      octarm record runs/my-run
    """
    kinds.check_free(force, out)
    kinds.check_runs(run)
    from octarm.commands import redraw as work

    return surviving_output(work.record, run, out)


def plot(
    run: Annotated[Path, kinds.RUN],
    /,
    *,
    out: Annotated[Path | None, kinds.DIR] = None,
    force: bool = False,
) -> kinds.Work:
    """Draw the standard figures of a run, as PNG and SVG.

    Args:
        run: run folder
        out: folder to write to; RUN-figures when not given
        force: replace figures that are there

    Examples:
      octarm plot runs/my-run --out figures
    """
    out = out or _sibling(run, "-figures")
    kinds.check_free(force, out / "tracking.png")
    kinds.check_runs(run)
    from octarm.commands import redraw as work

    return surviving_output(work.plot, run, out)


def video(
    run: Annotated[Path, kinds.RUN],
    /,
    *,
    out: Annotated[Path | None, kinds.file(".mp4")] = None,
    width: Annotated[int, kinds.N] = 960,
    height: Annotated[int, kinds.N] = 720,
    rate: Annotated[float, kinds.HZ] = 30.0,
    speed: Annotated[float, kinds.X] = 1.0,
    force: bool = False,
) -> kinds.Work:
    """Film a run with MuJoCo's renderer.

    It needs no display, but one of the libraries EGL and OSMesa; octarm doctor tells.

    Args:
        run: run folder
        out: film to write; RUN.mp4 when not given
        width: width [pixel]
        height: height [pixel]
        rate: pictures a second [Hz]
        speed: how much faster than real time the film runs
        force: replace a film that is there

    Examples:
      octarm video runs/my-run --out run.mp4 --speed 0.5
    """
    out = out or _sibling(run, ".mp4")
    kinds.check_free(force, out)
    kinds.check_runs(run)
    from octarm.recordings.video import choose_renderer

    choose_renderer()  # before anything imports MuJoCo
    from octarm.commands import redraw as work

    size = (width, height)
    return surviving_output(work.video, run, out, size=size, rate=rate, speed=speed)


def _experiment(
    controller: str,
    reference: str,
    disturbances: Sequence[str],
    metrics: Sequence[str] = (),
    **others: Any,
) -> Experiment:
    """The experiment that words name, with short names and the code of what is not built in."""
    from controllers import CONTROLLERS
    from octarm.declared import named
    from octarm.disturbances.spelling import DISTURBANCES, parse_disturbance
    from octarm.metrics.declared import ACCUMULATORS
    from octarm.references import REFERENCES
    from octarm.runs.experiment import Experiment

    words = [(CONTROLLERS, controller), (REFERENCES, reference)]
    words += [(DISTURBANCES, text) for text in disturbances]
    words += [(ACCUMULATORS, word) for word in metrics]
    names, code = named(words)
    return Experiment(
        controller=names[0],
        reference=names[1],
        disturbances=tuple(map(parse_disturbance, disturbances)),
        code=code,
        **others,
    )


def _sibling(folder: Path, ending: str) -> Path:
    """A name like the run folder's; the folder itself holds the run and nothing else."""
    return folder.resolve().with_name(folder.resolve().name + ending)
