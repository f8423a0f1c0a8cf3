"""The command line: `octarm run`, `octarm sweep`, `octarm replay`, `octarm validate`.

Every refusal is one sentence on standard error. Heavy modules are imported by the command that
needs them.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import os
import re
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import tyro

from octarm.errors import ExitCode


@dataclasses.dataclass(frozen=True)
class Run:
    """Run one controller on the arm and record it.

    Writes a run folder: run.rrd (the recording), run.npz (all arrays), run.json (what was run).

    Example: octarm run --controller afsmc --disturbance noise:0.4 --disturbance payload:0.2,at=3

    Disturbances, by what they act on; NAME:VALUE[,KEY=VALUE..], keys with their defaults:

    forces
      noise:RATIO,time=0.01,on=all        band-limited white noise, RATIO of the input's amplitude
      sine:SIZE,frequency=1,on=theta1     [N] at tip-x, tip-y or on a slide, [N m] on a bend
      pulse:SIZE,at=0,length=0.1,on=..    the same for a while, from `at` [s] on
      step:SIZE,at=0,on=theta1            the same to the end

    the arm
      payload:MASS,at=0                   [kg] at the tip, from `at` [s] on
      mismatch:X,mass=1,stiffness=1,..    true parameters: X as --mismatch, or single factors
      random-mismatch:SHARE               every parameter off by a random share up to SHARE
      drift:RATE,of=stiffness,limit=0.5   [1/s], steadily up to the limit
      cyclic-drift:SHARE,period=10        to and fro
      tilt:ANGLE                          [rad], gravity out of the hanging line

    the inputs
      actuation-delay:TIME                [s], to the next physics step
      dead-zone:WIDTH  saturation:LIMIT   [N]
      slew:RATE  lag:TIME                 [N/s], [s]
      loss:SHARE,at=0                     of effectiveness; loss:0/0/0.5/0/0/0 for each column

    the readings
      measurement-delay:TIME              [s], to the next physics step
      measurement-noise:RMS,rate=100      share of the rest length, [rad]; rate times that on v
      quantisation:STEP,rate=100          likewise
    """

    controller: str = "smc-boundary"
    """Controller: pd, computed-torque, smc, smc-boundary, smc-integral, super-twisting, fuzzy, fsmc,
    afsmc-consequent, afsmc."""

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
        from octarm import commands

        return commands.run(self)


@dataclasses.dataclass(frozen=True)
class Replay:
    """Open a recorded run in the rerun viewer.

    Example: octarm replay runs/my-run --screenshot picture.png
    """

    run: tyro.conf.Positional[Path]
    """Run folder."""

    screenshot: Path | None = None
    """Write a picture of the viewer instead of opening it; needs no display."""

    time: float | None = None
    """Time shown in the picture [s]; the middle of the run when not given."""

    def main(self) -> int:
        """Opens the viewer and waits until it is closed, or writes the picture."""
        from octarm import commands

        return commands.replay(self)


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
        from octarm import commands

        return commands.validate(self)


@dataclasses.dataclass(frozen=True)
class Sweep:
    """Run thousands of episodes as a spec has it, and keep a row of measures of each.

    Writes a folder: spec.toml, manifest.json (what was run where), episodes/*.parquet; in Python,
    octarm.read_sweep(DIR) gives the table. The table depends on the spec alone, not on the number
    of workers, and interruptions cost nothing but the shards under way.

    Example: octarm sweep scripts/disturbance_sweep.toml --out sweeps/noise --workers 8
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
        from octarm import sweep_commands

        return sweep_commands.sweep(self)


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
    """The console command: `main`, which a SIGTERM ends as Ctrl-C does."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)
    return main()


def _parse(arguments: Sequence[str]) -> Run | Sweep | Replay | Validate:
    errors = io.StringIO()
    try:
        with contextlib.redirect_stderr(errors):
            return tyro.cli(
                Run | Sweep | Replay | Validate,  # pyright: ignore[reportArgumentType]
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
