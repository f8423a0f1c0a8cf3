"""The commands on many runs: sweep, report, margin, tune."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

from octarm.commands import kinds
from octarm.commands.kinds import Work
from octarm.commands.options import (
    ANY_MODEL,
    NOMINAL_ARM,
    USUAL_GAINS,
    ArmOptions,
    GainOptions,
    ModelOptions,
)
from octarm.commands.terminal import surviving_output
from octarm.errors import OctarmError


def sweep(
    spec: Annotated[Path, kinds.text("SPEC.toml")],
    /,
    *,
    out: Annotated[Path | None, kinds.DIR] = None,
    workers: Annotated[int | None, kinds.whole(1, 4096)] = None,
    resume: bool = False,
    force: bool = False,
    dry_run: bool = False,
    cluster: Annotated[str | None, kinds.text("ADDRESS")] = None,
    wait_for_workers: Annotated[float, kinds.S] = 60.0,
    engine: Annotated[str | None, kinds.ENGINE] = None,
) -> Work:
    """Run thousands of episodes as a spec has it.

    Writes a folder: spec.toml, manifest.json (what was run where), episodes/*.parquet with a row of
    measures of each episode; in Python, octarm.read_sweep(DIR) gives the table. The table depends
    on the spec alone, not on the number of workers, and interruptions cost nothing but the shards
    that are being run.

    Episodes that [record] of the spec selects, the worst, median or first diverged one of each
    controller by tip_rms_error, or by their numbers, are then run again into DIR/recorded/.

    Args:
        spec: TOML file; scripts/disturbance_sweep.toml is one
        out: folder to write
        workers: processes, one thread each; one a core when not given
        resume: go on with the sweep that was begun in the folder
        force: replace a sweep that is there
        dry_run: print the number of episodes, and the time and disk they take; run nothing
        cluster: run on the dask cluster with the scheduler of this address, or on `local`, one of
            this machine
        wait_for_workers: how long the cluster may have no worker, at the beginning or later [s]
        engine: what steps the arms, mujoco or lagrange, which is many times as fast; it takes the
            place of the spec's

    Examples:
      octarm sweep scripts/disturbance_sweep.toml --dry-run
      octarm sweep scripts/disturbance_sweep.toml --out runs/noise --workers 8
      octarm sweep scripts/disturbance_sweep.toml --out runs/noise --resume
    """
    from octarm.formats import read_toml

    read_toml(spec)  # raises, before anything that takes longer is imported
    from octarm.commands import sweep as work

    options = work.Options(
        spec, out, workers, resume, cluster, wait_for_workers, engine, force=force
    )
    if dry_run:
        return partial(work.dry_run, options)
    return surviving_output(partial(work.sweep, options))


def report(
    sweep: Annotated[Path | None, kinds.text("SWEEP")] = None,
    /,
    *,
    baseline: Annotated[str | None, kinds.CALLED] = None,
    metric: Annotated[tuple[str, ...], kinds.COLUMN] = (),
    columns: bool = False,
    out: Annotated[Path | None, kinds.DIR] = None,
    force: bool = False,
) -> Work:
    """Turn a sweep into a page with tables and figures.

    Medians with intervals, paired differences, failures. Writes a folder: report.html (needs
    nothing beside itself), figures/ as PNG and SVG, and the tables as CSV. The same sweep gives the
    same files.

    Args:
        sweep: folder of the sweep
        baseline: controller that the others are compared with, episode by episode; the spec's first
            one when not given
        metric: metric, or column of the table (rms_error, rms_error_theta3); rms_error,
            tip_rms_error, chattering, effort and overshoot when not given
        columns: print instead what each column of the sweep's table means, its unit, and which
            values are better; of any sweep without SWEEP
        out: folder to write; report in the sweep's when not given
        force: replace a report that is there

    Examples:
      octarm report runs/noise --baseline smc-boundary --metric tip_rms_error
      octarm report --columns
    """
    if sweep is None and not columns:
        raise OctarmError("octarm report needs SWEEP, folder of the sweep")
    if sweep and (refuse := kinds.refusal(sweep, "manifest.json", "a sweep")) is not None:
        return refuse
    if sweep is None or columns:
        from octarm.commands import report as work

        return partial(work.columns, sweep)
    kinds.check_free(force, (out or sweep / "report") / "report.html")
    from octarm.commands import report as work

    return surviving_output(partial(work.report, sweep, baseline, metric, out))


def margin(
    *controllers: Annotated[str, kinds.CALLED],
    disturbance: Annotated[tuple[str, ...], kinds.VARIED, kinds.SOUGHT] = (),
    bound: Annotated[tuple[str, ...], kinds.text("METRIC:VALUE"), kinds.SOUGHT] = (),
    low: Annotated[str | None, kinds.AMOUNT, kinds.SOUGHT] = None,
    high: Annotated[str | None, kinds.AMOUNT, kinds.SOUGHT] = None,
    seeds: Annotated[int, kinds.COUNT, kinds.SOUGHT] = 36,
    share: Annotated[float, kinds.X, kinds.SOUGHT] = 0.9,
    metric: Annotated[tuple[str, ...], kinds.METRIC, kinds.SOUGHT] = (),
    arm: Annotated[tuple[str, ...], kinds.ARM, kinds.MODEL] = (),
    model: ModelOptions = ANY_MODEL,
    gain_options: GainOptions = USUAL_GAINS,
    reference: Annotated[str, kinds.REFERENCE, kinds.RUNS] = "sine",
    duration: Annotated[float, kinds.DURATION, kinds.RUNS] = 6.0,
    settle: Annotated[float, kinds.SETTLE, kinds.RUNS] = 2.0,
    timestep: Annotated[float | str | None, kinds.STEP, kinds.RUNS] = None,
    control_period: Annotated[float | None, kinds.S, kinds.RUNS] = None,
    seed: Annotated[int, kinds.N, kinds.RUNS] = 0,
    engine: Annotated[str | None, kinds.ENGINE, kinds.RUNS] = None,
    csv: Annotated[Path | None, kinds.file(), kinds.OUTPUT] = None,
    json: Annotated[Path | None, kinds.file(), kinds.OUTPUT] = None,
    force: Annotated[bool, kinds.OUTPUT] = False,
) -> Work:
    r"""Find how much of a disturbance controllers bear.

    One --disturbance goes without its VALUE: the one whose largest value is sought, by bisection,
    for every seed at once, the same seeds for all controllers. The others act as octarm run has
    them. The margin is what a share of the seeds bears within the error bounds, with an exact 95 %
    interval of order statistics; fewer than 36 seeds have no lower end of it at a share of 0.9.

    Args:
        controllers: controllers to compare
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
        model: see `octarm.commands.options`
        gain_options: likewise
        reference: the desired motion, NAME[:KEY=VALUE..], as in octarm run
        duration: length of each run [s]
        settle: when errors and other metrics of the steady regime begin to count [s]
        timestep: physics step [s], or auto for one that suits the fastest mode of all arms
        control_period: time between control actions [s]
        seed: seed of all that is random
        engine: what steps the arms, mujoco or lagrange; lagrange where it is installed, when not
            given
        csv: also write the table to this file
        json: also write everything: the margins of each seed, and the coarse grid
        force: replace files that are there

    Examples:
      octarm margin smc-boundary afsmc --disturbance payload \
        --disturbance noise:0.4 --bound tip_rms_error:0.01
      octarm margin pd afsmc --disturbance nominal-mismatch \
        --bound rms_error_theta1:0.02
      octarm margin smc-boundary afsmc --arm octarm --arm eth \
        --disturbance payload --bound tip_rms_error:0.01
    """
    kinds.check_free(force, csv, json)
    for word in controllers:
        kinds.check("CONTROLLER", word)
    gain_options.values()  # raises
    models = [model.of(name) for name in arm or (None,)]
    for each in models:
        each.both()  # raises
    from octarm.commands import margin as work
    from octarm.simulation.engines import usual_engine

    settings = work.Settings(
        disturbance=disturbance,
        bound=bound,
        seeds=seeds,
        share=share,
        metric=metric,
        model=models[0],
        gain_options=gain_options,
        reference=reference,
        duration=duration,
        settle=settle,
        timestep=timestep,
        control_period=control_period,
        seed=seed,
        engine=usual_engine() if engine is None else engine,
    )
    job = partial(work.margin, controllers, settings, models, low, high, csv, json)
    return job if csv is None and json is None else surviving_output(job)


def tune(
    controller: Annotated[str, kinds.CALLED],
    /,
    *,
    reference: Annotated[str | None, kinds.REFERENCE, kinds.EXPERIMENT] = None,
    disturbance: Annotated[tuple[str, ...], kinds.DISTURBANCE, kinds.EXPERIMENT] = (),
    model: ArmOptions = NOMINAL_ARM,
    gain_options: GainOptions = USUAL_GAINS,
    out: Annotated[Path | None, kinds.file(".toml")] = None,
    budget: Annotated[float, kinds.S] = 16000.0,
    seed: Annotated[int, kinds.N] = 0,
    resume: bool = False,
    force: bool = False,
    engine: Annotated[str | None, kinds.ENGINE] = None,
    workers: Annotated[int | None, kinds.whole(1, 4096)] = None,
) -> Work:
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
        reference: the desired motion, instead of those of the scenarios
        disturbance: NAME:VALUE[,KEY=VALUE..], what acts as well; octarm run --help lists them
        model: see `octarm.commands.options`
        gain_options: likewise
        out: file to write; CONTROLLER.toml when not given; the search keeps its state beside it
        budget: what the search may simulate, all arms counted [s]; 16000 s take minutes
        seed: seed of the search
        resume: go on with the search that was interrupted
        force: replace gains that are there, and begin an interrupted search anew
        engine: what steps the arms, mujoco or lagrange; lagrange where it is installed, when not
            given
        workers: processes; one a core when not given; the gains do not depend on them

    Examples:
      octarm tune smc-boundary --out my-gains.toml
      octarm tune afsmc --arm eth --disturbance payload:0.05 --out eth.toml
      octarm tune smc-boundary --out my-gains.toml --resume
    """
    from octarm.declared import short_name

    kinds.check("CONTROLLER", controller)
    out = out or Path(f"{short_name(controller)}.toml")
    kinds.check_free(force or resume, out)
    gain_options.values()  # raises
    model.both()
    from octarm.commands import tune as work

    options = work.Options(
        out, budget, seed, resume, force, engine, model, gain_options, reference, disturbance,
        workers,
    )  # fmt: skip
    return surviving_output(partial(work.tune, controller, options))
