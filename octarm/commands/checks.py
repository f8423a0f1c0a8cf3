"""The commands that check results and the machine: validate, verify, doctor."""

from __future__ import annotations

import dataclasses
import textwrap
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from octarm.commands import kinds
from octarm.commands.terminal import surviving_output
from octarm.errors import ExitCode, OctarmError


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class ValidateOptions:
    """What is checked.

    Attributes:
        controllers: check instead that each controller's Lyapunov function falls as its proof
            says, and that the misprints of the paper are noticed
        engines: check instead that mujoco and lagrange move the arm alike for 10 s, with every
            controller and under every disturbance; it takes minutes
        plant_modules: of --engines: on a plant of so many modules, as octarm run has it, for 1 s
        layout: of that plant
        arm: check this arm, a file NAME.toml or one that comes with octarm, instead of the nominal
            one
        rod: check instead how chains of 1 to 40 modules converge to the extensible rod that they
            stand for: statics, frequencies, motion, and PyElastica where it is installed
        modules: number of modules of the arm, at most 60; the time grows with its cube
        random_parameters: check so many arms with random parameters instead of the nominal one
        states: random states that each comparison runs over; 10000, of controllers 3000, when not
            given
        seed: seed of the random states and parameters
        json: also write the report to this file
        out: of --rod: also draw its figures in this folder
        force: replace files that are there
    """

    controllers: bool = False
    engines: bool = False
    plant_modules: Annotated[int | None, kinds.COUNT] = None
    layout: Annotated[str, kinds.LAYOUT] = "paper"
    arm: Annotated[str | None, kinds.ARM] = None
    rod: bool = False
    modules: Annotated[int, kinds.whole(1, 60)] = 3
    random_parameters: Annotated[int, kinds.whole(0, 10_000)] = 0
    states: Annotated[int | None, kinds.whole(1, 1_000_000)] = None
    seed: Annotated[int, kinds.N] = 0
    json: Annotated[Path | None, kinds.file()] = None
    out: Annotated[Path | None, kinds.DIR] = None
    force: bool = False

    def check(self) -> None:
        """Raises OctarmError for options that do not go together."""
        flags = {"--controllers": self.controllers, "--engines": self.engines, "--rod": self.rod}
        given = [name for name, flag in flags.items() if flag]
        if len(given) > 1:
            raise OctarmError(f"{' and '.join(given)} are given; one check at a time")
        if self.arm is not None and (self.rod or self.modules != 3 or self.random_parameters):
            raise OctarmError("--arm is given with --modules, --random-parameters or --rod")
        if not self.engines and (self.plant_modules is not None or self.layout != "paper"):
            raise OctarmError("--plant-modules or --layout is given without --engines")
        if self.out is not None and not self.rod:
            raise OctarmError("--out is given without --rod, which alone draws figures")


def validate(*, options: ValidateOptions = ValidateOptions()) -> kinds.Work:
    """Check MuJoCo against the analytic model.

    Or, with --controllers, the controllers against their proofs; with --engines, the engines
    against each other; with --rod, chains of modules against rod theory. Prints a report; exit
    code 1 when a check failed.

    Examples:
      octarm validate --modules 5 --json report.json
      octarm validate --controllers
      octarm validate --engines --plant-modules 9 --layout centred
      octarm validate --rod --out convergence
    """
    out = options.out
    kinds.check_free(options.force, options.json, out and out / "convergence.png")
    options.check()
    from octarm.commands import validate as work

    job = partial(work.validate, options)
    return surviving_output(job) if options.json or out else job


def verify(
    *runs: Annotated[Path, kinds.RUN],
    episode: Annotated[tuple[int, ...], kinds.N] = (),
    sample: Annotated[int | None, kinds.COUNT] = None,
) -> kinds.Work:
    """Run again what a folder says was run, and compare every bit.

    Of a run folder, run.json, all arrays at all control instants, and the recording; of a sweep,
    its files, and episodes run alone, their digests and measures. Reports what is missing, what is
    there in addition, where numbers first differ, and versions and machine of both sides, which
    alone may differ. Exit code 1 if anything else does.

    Args:
        runs: run folders, or sweep folders
        episode: an episode of the sweep, by number
        sample: verify so many episodes of the sweep, drawn at random

    Examples:
      octarm verify runs/my-run
      octarm verify sweeps/noise --episode 17 --episode 4
      octarm verify sweeps/noise --sample 10
    """
    kinds.check_runs(*runs, sweeps=True)
    from octarm.commands import verify as work

    return partial(work.verify, runs, episode, sample)


def doctor() -> kinds.Work:
    """Say what this machine has for octarm, and what to install.

    Versions, processor, graphics, folders. Everything is tried out rather than looked up. Exit code
    0 when octarm run works here, even if pictures or films do not, 1 when it does not.

    Examples:
      octarm doctor
    """
    from octarm.checks import doctor as machine

    def job() -> int:
        found: list[machine.Finding] = []
        for title, findings in {
            "versions": machine.versions(),
            "processor": machine.processor(),
            "commands, tried out": machine.work(),
            "folders": machine.folders(),
        }.items():
            print(f"{title}:", flush=True)
            for each in findings:  # as they come in
                head = f"  {each.state.value:<8} {each.name:<16} "
                text = textwrap.fill(each.text, 80, initial_indent=head, subsequent_indent=" " * 28)
                print(text, flush=True)
                found.append(each)
        remedies = [f"  {each.name}: {each.remedy}" for each in found if each.remedy]
        if remedies:
            print("\n".join(["", "to do:", *remedies]))
        works = all(each.state is not machine.State.BROKEN for each in found)
        slow = [each.name for each in found if each.state is machine.State.SLOW and each.remedy]
        verdict = "works here" if works else "does not work here"
        if works and "octarm run" in slow:
            works, verdict = False, "was too slow here to tell whether it works"
        print(f"\noctarm run {verdict}")
        return ExitCode.FINE if works else ExitCode.CHECK_FAILED

    return job
