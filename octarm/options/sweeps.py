"""What the commands are asked for that run many episodes and report on them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

from octarm.options.argument import Operand, Option

_SOUGHT = "what is sought"
_RUNS = "the runs, as in octarm run"
_OUTPUT = "output"


@dataclasses.dataclass(frozen=True)
class Sweep:
    """Run thousands of episodes as a spec has it.

    Writes a folder: spec.toml, manifest.json (what was run where), episodes/*.parquet with a row of
    measures of each episode; in Python, octarm.read_sweep(DIR) gives the table. The table depends
    on the spec alone, not on the number of workers, and interruptions cost nothing but the shards
    under way.

    Episodes that [record] of the spec chooses, the worst, median or first diverged one of each
    controller by tip_rms_error, or by their numbers, are then run again into DIR/recorded/.

    Examples:
      octarm sweep scripts/disturbance_sweep.toml --dry-run
      octarm sweep scripts/disturbance_sweep.toml --out runs/noise --workers 8
      octarm sweep scripts/disturbance_sweep.toml --out runs/noise --resume
    """

    spec: Annotated[Path, Operand("SPEC.toml", "TOML file; scripts/disturbance_sweep.toml is one")]
    out: Annotated[Path | None, Option("DIR", "folder to write")] = None
    workers: Annotated[
        int | None, Option("N", "processes, one thread each; one a core when not given")
    ] = None
    resume: Annotated[bool, Option("", "go on with the sweep that was begun in the folder")] = False
    dry_run: Annotated[
        bool,
        Option("", "print the number of episodes, and the time and disk they take; run nothing"),
    ] = False
    cluster: Annotated[
        str | None,
        Option(
            "ADDRESS",
            "run on the dask cluster with the scheduler of this address, or on `local`, one of "
            "this machine",
        ),
    ] = None


@dataclasses.dataclass(frozen=True)
class Report:
    """Turn a sweep into a page with tables and figures.

    Medians with intervals, paired differences, failures. Writes a folder: report.html (needs
    nothing beside itself), figures/ as PNG and SVG, and the tables as CSV. The same sweep gives the
    same files.

    Examples:
      octarm report runs/noise --baseline smc-boundary --metric tip_rms_error
    """

    sweep: Annotated[Path, Operand("SWEEP", "folder of the sweep")]
    baseline: Annotated[
        str | None,
        Option(
            "CONTROLLER",
            "controller that the others are compared with, episode by episode; the spec's first "
            "one when not given",
        ),
    ] = None
    metric: Annotated[
        tuple[str, ...],
        Option(
            "METRIC",
            "metric, or column of the table (rms_error, rms_error_theta3); rms_error, "
            "tip_rms_error, chattering, effort and overshoot when not given",
        ),
    ] = ()
    out: Annotated[
        Path | None, Option("DIR", "folder to write; report in the sweep's when not given")
    ] = None


@dataclasses.dataclass(frozen=True)
class Margin:
    r"""Find how much of a disturbance controllers bear.

    One --disturbance goes without its VALUE: the one whose largest value is sought, by bisection,
    for every seed at once, the same seeds for all controllers. The others act as octarm run has
    them. The margin is what a share of the seeds bears within the error bounds, with a bootstrap
    interval over seeds.

    Examples:
      octarm margin smc-boundary afsmc --disturbance payload \
        --disturbance noise:0.4 --bound tip_rms_error:0.01
      octarm margin pd afsmc --disturbance nominal-mismatch \
        --bound rms_error_theta1:0.02
    """

    controllers: Annotated[tuple[str, ...], Operand("CONTROLLER", "controllers to compare")]
    disturbance: Annotated[
        tuple[str, ...],
        Option(
            "DISTURBANCE",
            "NAME or NAME:KEY=VALUE,.. for what varies, also nominal-mismatch; "
            "NAME:VALUE[,KEY=VALUE..] for what acts beside it; octarm run --help lists them",
            _SOUGHT,
        ),
    ] = ()
    bound: Annotated[
        tuple[str, ...],
        Option(
            "METRIC:VALUE",
            "a column of octarm sweep and its largest absolute value; all are to be met",
            _SOUGHT,
        ),
    ] = ()
    low: Annotated[
        float | None,
        Option("X", "value to begin with, which is to be borne; 0 when not given", _SOUGHT),
    ] = None
    high: Annotated[
        float | None,
        Option(
            "X",
            "value up to which is tried, greater or smaller than low; a usual one when not given",
            _SOUGHT,
        ),
    ] = None
    seeds: Annotated[int, Option("N", "number of seeds", _SOUGHT)] = 16
    share: Annotated[
        float,
        Option("X", "share of the seeds that have to meet the bounds; 1 for all of them", _SOUGHT),
    ] = 0.9

    mismatch: Annotated[float, Option("X", "error of the nominal model", _RUNS)] = 0.0
    reference: Annotated[str, Option("REFERENCE", "the desired motion", _RUNS)] = "sine"
    duration: Annotated[float, Option("S", "length of each run [s]", _RUNS)] = 6.0
    timestep: Annotated[float | None, Option("S", "physics step [s]", _RUNS)] = None
    control_period: Annotated[
        float | None, Option("S", "time between control actions [s]", _RUNS)
    ] = None
    gains: Annotated[str | None, Option("GAINS", "gains to start from", _RUNS)] = None
    seed: Annotated[int, Option("N", "seed of all that is random", _RUNS)] = 0

    csv: Annotated[Path | None, Option("FILE", "also write the table to this file", _OUTPUT)] = None
    json: Annotated[
        Path | None,
        Option(
            "FILE", "also write everything: the margins of each seed, and the coarse grid", _OUTPUT
        ),
    ] = None
