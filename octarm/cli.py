"""The command line: `octarm run`, `sweep`, `tune`, `replay` and `validate`.

Every refusal is one sentence on standard error. Heavy modules are imported by the command that
needs them.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import math
import os
import re
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import tyro

from octarm.errors import ExitCode

_MOMENT = 3.0  # [s]


@dataclasses.dataclass(frozen=True)
class Run:
    """Run one controller on the arm and record it.

    Writes a run folder: run.rrd (the recording), run.npz (all arrays), run.json (what was run).

    Example: octarm run --controller afsmc --disturbance noise:0.4 --disturbance payload:0.2,at=3

    Disturbances, by what they act on; NAME:VALUE[,KEY=VALUE..], keys with their defaults:

    forces
      noise:RATIO,time=0.01,on=all          band-limited white noise, RATIO of the input amplitude;
                                            noise:rms=SIZE gives its size instead
      sine:SIZE,frequency=1,on=theta1       [N] at tip-x, tip-y or on a slide, [N m] on a bend;
                                            also phase=0,at=0,length=inf
      pulse:SIZE,at=0,length=0.1,on=theta1  the same for a while, from `at` [s] on
      step:SIZE,at=0,on=theta1              the same to the end

    the arm
      payload:MASS,at=0                     [kg] at the tip, from `at` [s] on
      mismatch:X,mass=1,stiffness=1         true parameters: X as --mismatch, or single factors;
                                            also inertia=1,damping=1,rest_length=1,tilt=0
      random-mismatch:SHARE                 every parameter off by a random share up to SHARE;
                                            also rest_length=0,tilt=0
      drift:RATE,of=stiffness,limit=0.5     [1/s], steadily up to the limit
      cyclic-drift:SHARE,period=10          to and fro; also phase=0,of=stiffness
      tilt:ANGLE                            [rad], gravity out of the hanging line

    the inputs
      actuation-delay:TIME                  [s], to the nearest physics step
      dead-zone:WIDTH  saturation:LIMIT     [N]
      slew:RATE  lag:TIME                   [N/s], [s]
      loss:SHARE,at=0                       of effectiveness; loss:0/0/0.5/0/0/0 for each column

    the readings
      measurement-delay:TIME                [s], to the nearest physics step
      measurement-noise:RMS,rate=100        share of the rest length, [rad]; rate times that on v;
                                            also time=0.001
      quantisation:STEP,rate=100            likewise
    """

    controller: str = "smc-boundary"
    """Controller: pd, computed-torque, smc, smc-boundary, smc-integral, super-twisting, fuzzy,
    fsmc, afsmc-consequent, afsmc."""

    reference: str = "sine"
    """Desired motion: sine (of theta1, theta2), sine-slides, multi-sine, smooth-step, set-point."""

    duration: float = 10.0
    """Length of the run [s]."""

    disturbance: tuple[str, ...] = ()
    """NAME:VALUE[,KEY=VALUE..], what acts on the arm unknown to the controller; see above."""

    mismatch: float = 0.0
    """Error X of the nominal model: mass, inertia, damping times 1 + X, stiffness times 1 + X/2."""

    nominal: tuple[str, ...] = ()
    """NAME:FACTOR, a further factor on a parameter of the nominal model, e.g. mass:0.7."""

    parameter: tuple[str, ...] = ()
    """NAME:VALUES, a parameter of the true arm and the nominal model, e.g. mass:0.3,0.25,0.2."""

    gain: tuple[str, ...] = ()
    """NAME:VALUES, a gain of the controller, e.g. lambda:15 or K:1.6,1.0,0.8,0.4,0.25,0.03."""

    gains: str | None = None
    """Gains to start from: tuned (where there are any, when not given), recommended, or a file of
    octarm tune, NAME.toml."""

    seed: int = 0
    """Seed of all that is random in the run; an undisturbed run has nothing random in it."""

    timestep: float | None = None
    """Physics step [s]; that of models/octarm.xml, 0.0005 s, when not given."""

    control_period: float | None = None
    """Time between control actions [s], whole physics steps; one step when not given."""

    actuation: str = "f-coeff"
    """How input forces act: f-coeff (eq (2)), or internal (between neighbouring modules)."""

    out: Path | None = None
    """Run folder to write; runs/DATE-TIME-CONTROLLER when not given."""

    view: bool = False
    """Open the recording in the viewer when the run is done."""

    def main(self) -> int:
        """Runs, writes the folder, prints a summary."""
        from octarm.commands import run as commands

        return commands.run(self)


@dataclasses.dataclass(frozen=True)
class Replay:
    """Open recorded runs in the rerun viewer.

    One run folder, two of them side by side with the difference of their errors, or a sweep folder,
    of which the recorded episodes are opened.

    Example: octarm replay runs/my-run --screenshot picture.png
    """

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Run folder, two run folders, or a sweep folder."""

    screenshot: Path | None = None
    """Write a picture of the viewer instead of opening it; needs no display."""

    time: float | None = None
    """Time shown in the picture [s]; the middle of the run when not given."""

    web: bool = False
    """Serve the viewer to a browser on this machine instead; needs no network."""

    def main(self) -> int:
        """Opens the viewer and waits until it is closed, or writes the picture."""
        from octarm.commands import replay as replay_commands

        return replay_commands.replay(self)


@dataclasses.dataclass(frozen=True)
class Record:
    """Rebuild the recording of a run from run.npz and run.json.

    Example: octarm record runs/my-run
    """

    run: tyro.conf.Positional[Path]
    """Run folder."""

    out: Path | None = None
    """Recording to write; run.rrd in the folder when not given."""

    def main(self) -> int:
        """Writes the recording."""
        from octarm.commands import replay as replay_commands

        return replay_commands.record(self)


@dataclasses.dataclass(frozen=True)
class Plot:
    """Draw the standard figures of a run, as PNG and SVG.

    Example: octarm plot runs/my-run --out figures
    """

    run: tyro.conf.Positional[Path]
    """Run folder."""

    out: Path | None = None
    """Folder to write to; RUN-figures when not given."""

    def main(self) -> int:
        """Writes the figures."""
        from octarm.commands import replay as replay_commands

        return replay_commands.plot(self)


@dataclasses.dataclass(frozen=True)
class Video:
    """Film a run with MuJoCo's renderer; needs no display, but EGL or OSMesa.

    Example: octarm video runs/my-run --out run.mp4
    """

    run: tyro.conf.Positional[Path]
    """Run folder."""

    out: Path | None = None
    """Film to write; RUN.mp4 when not given."""

    width: int = 960
    """Width [pixel]."""

    height: int = 720
    """Height [pixel]."""

    rate: float = 30.0
    """Pictures a second [Hz]."""

    speed: float = 1.0
    """How much faster than real time the film runs."""

    def main(self) -> int:
        """Writes the film."""
        from octarm.recordings import video

        video.choose_renderer()  # before anything imports MuJoCo
        from octarm.commands import replay as replay_commands

        return replay_commands.video(self)


@dataclasses.dataclass(frozen=True)
class Validate:
    """Check MuJoCo against the analytic model, or controllers against their proofs; print a report.

    Examples: octarm validate --modules 5 --json report.json
              octarm validate --controllers
    """

    controllers: bool = False
    """Check instead that each controller's Lyapunov function falls as its proof says, and that the
    misprints of the paper are noticed."""

    modules: int = 3
    """Number of modules of the arm."""

    random_parameters: int = 0
    """Check this many arms with random parameters instead of the nominal one."""

    states: int | None = None
    """Random states that each comparison runs over; 10000, of controllers 3000, when not given."""

    seed: int = 0
    """Seed of the random states and parameters."""

    json: Path | None = None
    """Also write the report to this file."""

    def main(self) -> int:
        """Prints the report; exit code 1 when a check failed."""
        from octarm.commands import run as commands

        return commands.validate(self)


@dataclasses.dataclass(frozen=True)
class Sweep:
    """Run thousands of episodes as a spec has it, and keep a row of measures of each.

    Writes a folder: spec.toml, manifest.json (what was run where), episodes/*.parquet; in Python,
    octarm.read_sweep(DIR) gives the table. The table depends on the spec alone, not on the number
    of workers, and interruptions cost nothing but the shards under way.

    Episodes that [record] of the spec chooses, the worst, median or first diverged one of each
    controller by tip_rms_error, or by their numbers, are then run again into DIR/recorded/.

    Example: octarm sweep scripts/disturbance_sweep.toml --out runs/noise --workers 8
    """

    spec: tyro.conf.Positional[Path]
    """TOML file of the sweep; scripts/disturbance_sweep.toml is one."""

    out: Path | None = None
    """Folder to write."""

    workers: int | None = None
    """Number of processes, one thread each; one a core when not given."""

    resume: bool = False
    """Go on with the sweep that was begun in the folder."""

    dry_run: bool = False
    """Print the number of episodes, and the time and disk they will take; run nothing."""

    cluster: str | None = None
    """Run on a dask cluster: the ADDRESS of its scheduler, or `local` for one of this machine."""

    def main(self) -> int:
        """Runs the sweep and prints a row a controller."""
        from octarm.commands import sweep as sweep_commands

        return sweep_commands.sweep(self)


@dataclasses.dataclass(frozen=True)
class Report:
    """Turn a sweep into a page: medians with intervals, paired differences, failures, figures.

    Writes a folder: report.html (needs nothing beside itself), figures/ as PNG and SVG, and the
    tables as CSV. The same sweep gives the same files.

    Example: octarm report runs/noise --baseline smc-boundary --metric tip_rms_error
    """

    sweep: tyro.conf.Positional[Path]
    """Folder of the sweep."""

    baseline: str | None = None
    """Controller that the others are compared with, episode by episode; the spec's first one when
    not given."""

    metric: tuple[str, ...] = ()
    """Metric, or column of the table (rms_error, rms_error_theta3); rms_error, tip_rms_error,
    chattering, effort and overshoot when not given."""

    out: Path | None = None
    """Folder to write; report in the sweep's folder when not given."""

    def main(self) -> int:
        """Writes the report and prints a row a controller."""
        from octarm.commands import report as report_commands

        return report_commands.report(self)


@dataclasses.dataclass(frozen=True)
class Verify:
    """Run again what a folder says was run, and compare every bit.

    Of a run folder, all arrays at all control instants and the digest of the states; of a sweep,
    episodes run alone, their digests and measures. Reports where they first differ, and versions
    and machine of both sides. Exit code 1 if they do.

    Examples: octarm verify runs/my-run
              octarm verify sweeps/noise --episode 17 --episode 4
              octarm verify sweeps/noise --sample 10
    """

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Run folders, or sweep folders."""

    episode: tuple[int, ...] = ()
    """Episode of the sweep, by number; repeatable."""

    sample: int | None = None
    """Verify this many episodes of the sweep, drawn at random."""

    def main(self) -> int:
        """Runs and compares."""
        from octarm.commands import verify as verify_commands

        return verify_commands.verify(self)


@dataclasses.dataclass(frozen=True)
class Margin:
    """Find how much of a disturbance, or of model error, controllers bear within an error bound.

    One --disturbance goes without its VALUE: the one whose largest value is sought, by bisection,
    for every seed at once, the same seeds for all controllers. The others act as octarm run has
    them. The margin is what a share of the seeds bears, with a bootstrap interval over seeds.

    Examples: octarm margin smc-boundary afsmc --disturbance payload --disturbance noise:0.4
                  --bound tip_rms_error:0.01
              octarm margin pd afsmc --disturbance nominal-mismatch --bound rms_error_theta1:0.02
    """

    controllers: tyro.conf.Positional[tuple[str, ...]]
    """Controllers; octarm run --help names them."""

    disturbance: tuple[str, ...] = ()
    """NAME or NAME:KEY=VALUE,.. for what varies, also nominal-mismatch; NAME:VALUE[,KEY=VALUE..]
    for what acts beside it."""

    bound: tuple[str, ...] = ()
    """METRIC:VALUE, a column of octarm sweep and its largest absolute value; all are to be met."""

    low: float | None = None
    """Value to begin with, which is to be borne; 0 when not given."""

    high: float | None = None
    """Value up to which is tried, greater or smaller than low; a usual one when not given."""

    seeds: int = 16
    """Number of seeds."""

    share: float = 0.9
    """Share of the seeds that have to meet the bounds; 1 for all of them."""

    mismatch: float = 0.0
    """Error of the nominal model, as in octarm run."""

    reference: str = "sine"
    """Desired motion, as in octarm run."""

    duration: float = 6.0
    """Length of each run [s]."""

    timestep: float | None = None
    """Physics step [s], as in octarm run."""

    control_period: float | None = None
    """Time between control actions [s], as in octarm run."""

    gains: str | None = None
    """Gains, as in octarm run."""

    seed: int = 0
    """Seed of all that is random."""

    csv: Path | None = None
    """Also write the table to this file."""

    json: Path | None = None
    """Also write everything to this file: the margins of each seed, and the coarse grid."""

    def main(self) -> int:
        """Searches and prints a row a controller."""
        from octarm.commands import margin as margin_commands

        return margin_commands.margin(self)


@dataclasses.dataclass(frozen=True)
class Tune:
    """Find gains for one controller, with the same search and budget for each of them.

    Writes a small TOML file: the gains, what they cost by the measure that all controllers are
    tuned for, and how they were found. octarm run --gains FILE.toml uses them.

    Example: octarm tune smc-boundary --out my-gains.toml
    """

    controller: tyro.conf.Positional[str]
    """Controller; octarm run --help names them."""

    out: Path | None = None
    """File to write; CONTROLLER.toml when not given. The search keeps its state beside it."""

    budget: float = 8000.0
    """What the search may simulate, all arms counted [s]; 8000 s take about 5 minutes."""

    seed: int = 0
    """Seed of the search."""

    resume: bool = False
    """Go on with the search that was interrupted."""

    def main(self) -> int:
        """Searches, writes the file, prints what was gained."""
        from octarm.commands import tune as tune_commands

        return tune_commands.tune(self)


Command = Run | Sweep | Report | Verify | Margin | Tune | Replay | Record | Plot | Video | Validate


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line; returns the exit code."""
    try:
        code = _parse(sys.argv[1:] if arguments is None else arguments).main()
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # whoever read the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return ExitCode.FINE
    except MemoryError as error:
        print(f"octarm: there is not enough memory: {_one_line(error)}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    except (ValueError, OSError, RuntimeError) as error:
        print(f"octarm: {_one_line(error)}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    except KeyboardInterrupt as error:
        print("; ".join(["octarm: interrupted", *error.args]), file=sys.stderr)
        return ExitCode.INTERRUPTED


def command_line() -> int:
    """The console command: `main`, which a SIGTERM ends as Ctrl-C does.

    A second one within a moment changes nothing: a run that was interrupted is being closed.
    """
    before = -math.inf

    def interrupt(*_: object) -> None:
        nonlocal before
        now = time.monotonic()
        if now - before > _MOMENT:
            before = now
            raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
    return main()


def _parse(arguments: Sequence[str]) -> Command:
    errors = io.StringIO()
    try:
        with contextlib.redirect_stderr(errors):
            return tyro.cli(
                Command,  # pyright: ignore[reportArgumentType]
                prog="octarm",
                description="A testbed for robust controllers of a continuum robot arm.",
                args=list(arguments),
                config=(tyro.conf.UseAppendAction, tyro.conf.FlagCreatePairsOff),
            )
    except SystemExit as leaving:
        if not leaving.code:
            raise
        raise ValueError(_sentence(errors.getvalue())) from None


def _sentence(message: str) -> str:
    """The statement in one of tyro's error messages, with its suggestion.

    On a terminal the message is a box with its title in the frame; elsewhere the title is a line
    of its own. Rules separate the statement from what follows it.
    """
    message = re.sub(r"\x1b\[[0-9;]*m", "", message)  # colours
    framed = "│" in message
    lines = [line.strip("│ ") for line in message.splitlines() if line[:1] not in "╭╰"]
    parts = [" ".join(part.split()) for part in re.split(r"\n[─-]{3,}\n", "\n".join(lines))]
    statement, *rest = parts if framed else parts[1:] or parts
    statement = re.sub(r"( \(applied to [^)]*\))|( Arguments are applied .*)", "", statement)
    meant = re.search(r"Perhaps you meant: (--[\w-]+).*? in (octarm \w+) --help", " ".join(rest))
    if meant and meant[1] in statement.split():
        return f"{statement}; {meant[1]} belongs to {meant[2]}"
    if meant:
        return f"{statement}; did you mean {meant[1]}?"
    available = re.search(r"Available subcommands: (.*)", rest[0]) if rest else None
    return f"{statement}; the commands are {available[1]}" if available else statement


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or 'standard output'}: {error.strerror}"
    return " ".join(str(error).split())


if __name__ == "__main__":
    sys.exit(command_line())
