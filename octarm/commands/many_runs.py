"""The commands on many runs: sweep, report, margin, tune."""

from __future__ import annotations

import dataclasses
import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from octarm.commands import kinds
from octarm.commands.options import ArmOptions, GainOptions, ModelOptions
from octarm.commands.terminal import surviving_output
from octarm.errors import OctarmError

if TYPE_CHECKING:
    from octarm.disturbances.varied import Varied


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepOptions:
    """With what a sweep is run.

    Attributes:
        out: folder to write; needed, but for --dry-run
        workers: processes, one thread each; one a core when not given
        resume: go on with the sweep that was begun in the folder
        force: replace a sweep that is there
        dry_run: print the number of episodes, and the time and disk they take; run nothing
        cluster: run on the dask cluster with the scheduler of this address, or on `local`, one of
            this machine
        wait_for_workers: how long the cluster may have no worker, at the beginning or later [s]
        engine: what steps the arms, mujoco or lagrange, which is many times as fast; it takes the
            place of the spec's
    """

    out: Annotated[Path | None, kinds.DIR] = None
    workers: Annotated[int | None, kinds.whole(1, 4096)] = None
    resume: bool = False
    force: bool = False
    dry_run: bool = False
    cluster: Annotated[str | None, kinds.kind("ADDRESS")] = None
    wait_for_workers: Annotated[float, kinds.S] = 60.0
    engine: Annotated[str | None, kinds.ENGINE] = None


def sweep(
    spec: Annotated[Path, kinds.kind("SPEC.toml")], /, *, options: SweepOptions = SweepOptions()
) -> kinds.Work:
    """Run thousands of episodes as a spec has it.

    Writes a folder: spec.toml, manifest.json (what was run where), episodes/*.parquet with a row of
    measures of each episode; in Python, octarm.read_sweep(DIR) gives the table. The table depends
    on the spec alone, not on the number of workers, and interruptions cost nothing but the shards
    that are being run.

    Episodes that [record] of the spec selects, the worst, median or first diverged one of each
    controller by tip_rms_error, or by their numbers, are then run again into DIR/recorded/.

    Args:
        spec: TOML file; scripts/disturbance_sweep.toml is one, and octarm new experiment writes one
        options: see `SweepOptions`

    Examples:
      octarm sweep scripts/disturbance_sweep.toml --dry-run
      octarm sweep scripts/disturbance_sweep.toml --out runs/noise --workers 8
      octarm sweep scripts/disturbance_sweep.toml --out runs/noise --resume
    """
    from octarm.formats import read_toml

    read_toml(spec)  # raises, before anything that takes longer is imported
    from octarm.commands import sweep as work

    if options.dry_run:
        return partial(work.dry_run, spec, options)
    return surviving_output(work.sweep, spec, options)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class ReportOptions:
    """What a report is of.

    Attributes:
        baseline: controller that the others are compared with, episode by episode; the spec's first
            one when not given
        metric: metric, or column of the table (rms_error, rms_error_theta3); rms_error,
            tip_rms_error, chattering, effort and overshoot when not given
        columns: print instead what each column of the sweep's table means, its unit, and which
            values are better; of any sweep without SWEEP
        run_code: also look at the loops of controllers of your own, whose code is run if it is what
            it was
        out: folder to write; report in the sweep's when not given
        force: replace a report that is there
    """

    baseline: Annotated[str | None, kinds.CALLED] = None
    metric: Annotated[tuple[str, ...], kinds.COLUMN] = ()
    columns: bool = False
    run_code: bool = False
    out: Annotated[Path | None, kinds.DIR] = None
    force: bool = False


def report(
    sweep: Annotated[Path | None, kinds.kind("SWEEP")] = None,
    /,
    *,
    options: ReportOptions = ReportOptions(),
) -> kinds.Work:
    """Turn a sweep into a page with tables and figures.

    Medians with intervals, paired differences, failures, and whether the sampled loops about rest
    predict them. Writes a folder: report.html (needs
    nothing beside itself), figures/ as PNG and SVG, and the tables as CSV. The same sweep gives the
    same files.

    Args:
        sweep: folder of the sweep
        options: see `ReportOptions`

    Examples:
      octarm report runs/noise --baseline smc-boundary --metric tip_rms_error
      octarm report --columns
    """
    if sweep is None and not options.columns:
        raise OctarmError("octarm report needs SWEEP, folder of the sweep")
    if sweep is not None and not os.path.isfile(sweep / "manifest.json"):
        raise OctarmError(f"{sweep} is not a sweep: it has no manifest.json")
    if sweep is None or options.columns:
        from octarm.commands import report as work

        return partial(work.columns, sweep)
    kinds.check_free(options.force, (options.out or sweep / "report") / "report.html")
    from octarm.commands import report as work

    return surviving_output(work.report, sweep, options)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class MarginOptions:
    """What a margin is sought of, and by which runs.

    Attributes:
        disturbance: NAME or NAME:KEY=VALUE,.. for what varies, also nominal-mismatch;
            NAME:VALUE[,KEY=VALUE..] for what acts as well; octarm run --help lists them
        bound: a column of octarm sweep and its largest absolute value; all are to be met
        low: value to begin with, which is to be borne; 0 when not given
        high: value up to which is tried, greater or smaller than low; a usual one when not given
        seeds: number of seeds
        share: share of the seeds that have to meet the bounds; 1 for all of them
        metric: what is measured as well, FILE.py:NAME or MODULE:NAME; for a bound of your own
        arm: the true arms and the controllers' models of them, as in octarm run; the nominal arm
            when not given
        reference: the desired motion, NAME[:KEY=VALUE..], as in octarm run
        duration: length of each run [s]
        settle: when errors and other metrics of the steady regime begin to count [s]
        timestep: physics step [s], or auto for one that suits the fastest mode of all arms
        control_period: time between control actions [s]
        seed: seed of all that is random
        start: where runs begin, as in octarm run: rest, random or moving
        start_share: share of what the inputs reach within which the start is drawn
        engine: what steps the arms, mujoco or lagrange; lagrange where it is installed, when not
            given
        csv: also write the table to this file
        json: also write everything: the margins of each seed, and the coarse grid
        force: replace files that are there
    """

    disturbance: Annotated[tuple[str, ...], kinds.VARIED, kinds.SOUGHT] = ()
    bound: Annotated[tuple[str, ...], kinds.BOUND, kinds.SOUGHT] = ()
    low: Annotated[str | None, kinds.AMOUNT, kinds.SOUGHT] = None
    high: Annotated[str | None, kinds.AMOUNT, kinds.SOUGHT] = None
    seeds: Annotated[int, kinds.COUNT, kinds.SOUGHT] = 36
    share: Annotated[float, kinds.SHARE, kinds.SOUGHT] = 0.9
    metric: Annotated[tuple[str, ...], kinds.METRIC, kinds.SOUGHT] = ()
    arm: Annotated[tuple[str, ...], kinds.ARM, kinds.MODEL] = ()
    model: ModelOptions = ModelOptions()
    gain_options: GainOptions = GainOptions()
    reference: Annotated[str, kinds.REFERENCE, kinds.RUNS] = "sine"
    duration: Annotated[float, kinds.DURATION, kinds.RUNS] = 6.0
    settle: Annotated[float, kinds.SETTLE, kinds.RUNS] = 2.0
    timestep: Annotated[float | str | None, kinds.STEP, kinds.RUNS] = None
    control_period: Annotated[float | None, kinds.PERIOD, kinds.RUNS] = None
    seed: Annotated[int, kinds.N, kinds.RUNS] = 0
    start: Annotated[str, kinds.START, kinds.RUNS] = "rest"
    start_share: Annotated[float, kinds.SHARE, kinds.RUNS] = 0.1
    engine: Annotated[str | None, kinds.ENGINE, kinds.RUNS] = None
    csv: Annotated[Path | None, kinds.file(), kinds.OUTPUT] = None
    json: Annotated[Path | None, kinds.file(), kinds.OUTPUT] = None
    force: Annotated[bool, kinds.OUTPUT] = False

    @property
    def models(self) -> list[ArmOptions]:
        """The options of each arm."""
        return [ArmOptions(arm=name, **vars(self.model)) for name in self.arm or (None,)]

    def varied(self) -> Varied:
        """What varies; raises OctarmError for options that cannot be meant."""
        from octarm.disturbances.varied import NOMINAL, is_varied, parse_varied
        from octarm.metrics.table import check_measures
        from octarm.simulation.engines import check_engine, usual_engine

        check_engine(self.engine or usual_engine())
        if not self.bound:
            raise OctarmError("no bound is given; --bound METRIC:VALUE, such as tip_rms_error:0.01")
        if not self.metric:  # which may have any name
            check_measures(bound.partition(":")[0] for bound in self.bound)
        varying = [text for text in self.disturbance if is_varied(text)]
        if len(varying) != 1:
            raise OctarmError(
                "one --disturbance goes without a value, the one whose largest value is sought; "
                f"here it is {' and '.join(varying) or 'none'}"
            )
        varied = parse_varied(varying[0], self.low, self.high)
        if varied.name == NOMINAL and self.model.mismatch:
            raise OctarmError(f"--mismatch is given, but {NOMINAL} is what varies")
        return varied


def margin(
    *controllers: Annotated[str, kinds.CALLED], options: MarginOptions = MarginOptions()
) -> kinds.Work:
    r"""Find how much of a disturbance controllers bear.

    One --disturbance goes without its VALUE: the one whose largest value is sought, by bisection,
    for every seed at once, the same seeds for all controllers. The others act as octarm run has
    them. The margin is what a share of the seeds bears within the error bounds, with an exact 95 %
    interval of order statistics; fewer than 36 seeds have no lower end of it at a share of 0.9.

    Args:
        controllers: controllers to compare
        options: see `MarginOptions`

    Examples:
      octarm margin smc-boundary afsmc --disturbance payload \
        --disturbance noise:0.4 --bound tip_rms_error:0.01
      octarm margin pd afsmc --disturbance nominal-mismatch \
        --bound rms_error_theta1:0.02
      octarm margin smc-boundary afsmc --arm octarm --arm eth \
        --disturbance payload --bound tip_rms_error:0.01
    """
    from controllers import CONTROLLERS

    kinds.check_free(options.force, options.csv, options.json)
    for word in controllers:
        CONTROLLERS.check(word)
    options.gain_options.values(*controllers)  # raises
    if controllers:
        options.varied()  # raises
    for model in options.models:
        model.both()  # raises
    from octarm.commands import margin as work

    job = partial(work.margin, controllers, options)
    return surviving_output(job) if options.csv or options.json else job


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class TuneOptions:
    """What gains are tuned for, and how.

    Attributes:
        reference: the desired motion, instead of those of the scenarios
        disturbance: NAME:VALUE[,KEY=VALUE..], what acts as well; octarm run --help lists them
        out: file to write; CONTROLLER.toml when not given; the search keeps its state beside it
        budget: what the search may simulate, all arms counted, 1224 s or more [s]; 16000 s take
            minutes. The last trials, of the best of its last generation, come on top
        seed: seed of the search
        resume: go on with the search that was interrupted
        force: replace gains that are there, and begin an interrupted search anew
        engine: what steps the arms of the search, mujoco or lagrange; lagrange where it is
            installed, when not given. The last trials, which choose the gains, run on mujoco
        workers: processes; one a core when not given; the gains do not depend on them
    """

    reference: Annotated[str | None, kinds.REFERENCE, kinds.EXPERIMENT] = None
    disturbance: Annotated[tuple[str, ...], kinds.DISTURBANCE, kinds.EXPERIMENT] = ()
    model: ArmOptions = ArmOptions()
    gain_options: GainOptions = GainOptions()
    out: Annotated[Path | None, kinds.file(".toml")] = None
    budget: Annotated[float, kinds.BUDGET] = 16000.0
    seed: Annotated[int, kinds.N] = 0
    resume: bool = False
    force: bool = False
    engine: Annotated[str | None, kinds.ENGINE] = None
    workers: Annotated[int | None, kinds.whole(1, 4096)] = None


def tune(
    controller: Annotated[str, kinds.CALLED], /, *, options: TuneOptions = TuneOptions()
) -> kinds.Work:
    """Find gains for one controller.

    The search and its budget are the same for every controller. Writes a small TOML file: the
    gains, as numbers in the scales of the nominal model that suit all similar arms, what they cost
    by the measure that all controllers are tuned for, and how they were found. octarm run --gains
    FILE.toml uses them.

    The measure holds two control periods, late and slow inputs, a payload, a fast motion, wrong
    models, noise, a plant of nine modules and an arm that hardly damps itself: the list SCENARIOS
    of octarm/sweeps/scenarios.py. What the gains are worth is then measured on the list EVALUATION
    there: desired motions, noises, faults and model errors that the search never saw.

    A reference takes the place of those of all scenarios; disturbances and errors of the model come
    in addition to what a scenario has. The search begins around the gains of --gains and --gain,
    the recommended ones when not given, and compares with them.

    Args:
        controller: controller to tune
        options: see `TuneOptions`

    Examples:
      octarm tune smc-boundary --out my-gains.toml
      octarm tune afsmc --arm eth --disturbance payload:0.05 --out eth.toml
      octarm tune smc-boundary --out my-gains.toml --resume
    """
    from controllers import CONTROLLERS
    from octarm.declared import short_name

    CONTROLLERS.check(controller)
    out = options.out or Path(f"{short_name(controller)}.toml")
    kinds.check_free(options.force or options.resume, out)
    options.gain_options.values(controller)  # raises
    options.model.both()  # raises
    if options.model.model is not None:
        raise OctarmError("--model is given; gains are tuned with the arm's own model")
    from octarm.commands import tune as work

    return surviving_output(work.tune, controller, dataclasses.replace(options, out=out))
