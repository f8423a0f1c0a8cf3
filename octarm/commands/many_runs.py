"""The commands on many runs: sweep, report, margin, tune."""

from __future__ import annotations

import dataclasses
from functools import partial
from pathlib import Path
from typing import Annotated

from octarm.commands import kinds
from octarm.commands.options import ARMS, SEARCH, SHARDS, MarginOptions, SweepOptions, TuneOptions
from octarm.commands.terminal import surviving_output
from octarm.errors import OctarmError


def sweep(
    spec: Annotated[Path, kinds.kind("SPEC.toml")], /, *, options: SweepOptions = SHARDS
) -> kinds.Work:
    """Run thousands of episodes as a spec has it.

    Writes a folder: spec.toml, manifest.json (what was run where), episodes/*.parquet with a row of
    measures of each episode; in Python, octarm.read_sweep(DIR) gives the table. The table depends
    on the spec alone, not on the number of workers, and interruptions cost nothing but the shards
    that are being run.

    Episodes that [record] of the spec selects, the worst, median or first diverged one of each
    controller by tip_rms_error, or by their numbers, are then run again into DIR/recorded/.

    Args:
        spec: TOML file; scripts/disturbance_sweep.toml is one
        options: see `octarm.commands.options`

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


def report(
    sweep: Annotated[Path | None, kinds.kind("SWEEP")] = None,
    /,
    *,
    baseline: Annotated[str | None, kinds.CALLED] = None,
    metric: Annotated[tuple[str, ...], kinds.COLUMN] = (),
    columns: bool = False,
    run_code: bool = False,
    out: Annotated[Path | None, kinds.DIR] = None,
    force: bool = False,
) -> kinds.Work:
    """Turn a sweep into a page with tables and figures.

    Medians with intervals, paired differences, failures, and whether the sampled loops about rest
    predict them. Writes a folder: report.html (needs
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
        run_code: also look at the loops of controllers of your own, whose code is run if it is what
            it was
        out: folder to write; report in the sweep's when not given
        force: replace a report that is there

    Examples:
      octarm report runs/noise --baseline smc-boundary --metric tip_rms_error
      octarm report --columns
    """
    if sweep is None and not columns:
        raise OctarmError("octarm report needs SWEEP, folder of the sweep")
    if sweep is not None:
        kinds.check_sweep(sweep)
    if sweep is None or columns:
        from octarm.commands import report as work

        return partial(work.columns, sweep)
    kinds.check_free(force, (out or sweep / "report") / "report.html")
    from octarm.commands import report as work

    return surviving_output(work.report, sweep, baseline, metric, run_code, out)


def margin(*controllers: Annotated[str, kinds.CALLED], options: MarginOptions = ARMS) -> kinds.Work:
    r"""Find how much of a disturbance controllers bear.

    One --disturbance goes without its VALUE: the one whose largest value is sought, by bisection,
    for every seed at once, the same seeds for all controllers. The others act as octarm run has
    them. The margin is what a share of the seeds bears within the error bounds, with an exact 95 %
    interval of order statistics; fewer than 36 seeds have no lower end of it at a share of 0.9.

    Args:
        controllers: controllers to compare
        options: see `octarm.commands.options`

    Examples:
      octarm margin smc-boundary afsmc --disturbance payload \
        --disturbance noise:0.4 --bound tip_rms_error:0.01
      octarm margin pd afsmc --disturbance nominal-mismatch \
        --bound rms_error_theta1:0.02
      octarm margin smc-boundary afsmc --arm octarm --arm eth \
        --disturbance payload --bound tip_rms_error:0.01
    """
    kinds.check_free(options.force, options.csv, options.json)
    for word in controllers:
        kinds.check("CONTROLLER", word)
    options.gain_options.values(*controllers)  # raises
    for model in options.models:
        model.both()  # raises
    from octarm.commands import margin as work

    job = partial(work.margin, controllers, options)
    return surviving_output(job) if options.csv or options.json else job


def tune(
    controller: Annotated[str, kinds.CALLED], /, *, options: TuneOptions = SEARCH
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
        options: see `octarm.commands.options`

    Examples:
      octarm tune smc-boundary --out my-gains.toml
      octarm tune afsmc --arm eth --disturbance payload:0.05 --out eth.toml
      octarm tune smc-boundary --out my-gains.toml --resume
    """
    from octarm.declared import short_name

    kinds.check("CONTROLLER", controller)
    out = options.out or Path(f"{short_name(controller)}.toml")
    kinds.check_free(options.force or options.resume, out)
    options.gain_options.values(controller)  # raises
    options.model.both()  # raises
    if options.model.model is not None:
        raise OctarmError("--model is given; gains are tuned with the arm's own model")
    from octarm.commands import tune as work

    return surviving_output(work.tune, controller, dataclasses.replace(options, out=out))
