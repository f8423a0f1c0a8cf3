"""The commands that check results and the machine: validate, verify, doctor."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

from octarm.commands import kinds
from octarm.commands.terminal import surviving_output


def validate(
    *,
    controllers: bool = False,
    engines: bool = False,
    plant_modules: Annotated[int | None, kinds.COUNT] = None,
    layout: Annotated[str, kinds.LAYOUT] = "paper",
    arm: Annotated[str | None, kinds.ARM] = None,
    rod: bool = False,
    modules: Annotated[int, kinds.whole(1, 60)] = 3,
    random_parameters: Annotated[int, kinds.whole(0, 10_000)] = 0,
    states: Annotated[int | None, kinds.whole(1, 1_000_000)] = None,
    seed: Annotated[int, kinds.N] = 0,
    json: Annotated[Path | None, kinds.file()] = None,
    out: Annotated[Path | None, kinds.DIR] = None,
    force: bool = False,
) -> kinds.Work:
    """Check MuJoCo against the analytic model.

    Or, with --controllers, the controllers against their proofs; with --engines, the engines
    against each other; with --rod, chains of modules against rod theory. Prints a report; exit
    code 1 when a check failed.

    Args:
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
        out: of --rod: also draw its figure in this folder
        force: replace files that are there

    Examples:
      octarm validate --modules 5 --json report.json
      octarm validate --controllers
      octarm validate --engines --plant-modules 9 --layout centred
      octarm validate --rod --out convergence
    """
    kinds.check_free(force, json, out and out / "convergence.png")
    from octarm.commands import rod as rods
    from octarm.commands import validate as work
    from octarm.errors import OctarmError

    flags = {"--controllers": controllers, "--engines": engines, "--rod": rod}
    given = [name for name, flag in flags.items() if flag]
    if len(given) > 1:
        raise OctarmError(f"{' and '.join(given)} are given; one check at a time")
    if arm is not None and (modules != 3 or random_parameters):
        raise OctarmError("--arm is given, and so are --modules or --random-parameters")
    if not engines and (plant_modules is not None or layout != "paper"):
        raise OctarmError("--plant-modules or --layout is given without --engines, which takes it")
    if rod:
        if arm is not None:
            raise OctarmError("--arm is given, and so is --rod, which has its own chains")
        job = partial(rods.validate_rod, out, json)
        return surviving_output(job) if json or out else job
    if out is not None:
        raise OctarmError("--out is given without --rod, which alone draws figures")
    states = (3000 if controllers else 10_000) if states is None else states
    of_engines = partial(work.engines, plant_modules=plant_modules, layout=layout)
    compare = work.ledger if controllers else of_engines if engines else work.plant
    arms = work.arms(arm, modules, random_parameters, seed)
    job = partial(work.validate, compare, arms, states, seed, json)
    return surviving_output(job) if json else job


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
    from octarm.commands import doctor as work

    return work.doctor
