"""The paper's results section on this arm: figures, tables, and a verdict for each claim.

Run it: python scripts/reproduce_paper.py [--quick] [--out DIR]
Below 20 minutes of processor time, or 100 s with --quick, on the engine `lagrange`, which is the
default where it is installed; two hours on `mujoco`. Run it again with --resume, and it goes on
where it was interrupted. `--publish` also renews .readme/ and the claims in README.md, by MuJoCo.
"""

import argparse
import dataclasses
import shlex
import sys
from pathlib import Path

from paper import writeup
from paper.evidence import gather, run_all
from paper.runs import costs
from paper.studies import FULL, QUICK
from paper.variants import all_variants

from octarm.commands.terminal import repair_streams, surviving_output
from octarm.errors import ExitCode, OctarmError
from octarm.interrupts import raise_interrupts
from octarm.simulation.engines import ENGINES, MUJOCO, usual_engine

ROOT = Path(__file__).resolve().parent.parent
SHIPPED = ROOT / "controllers" / "gains"


def main() -> int:
    """Runs what is not there yet, and writes what came out."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/paper"), help="folder")
    parser.add_argument("--quick", action="store_true", help="fewer seeds, cells and controllers")
    parser.add_argument("--resume", action="store_true", help="go on with what is in the folder")
    parser.add_argument("--engine", choices=ENGINES, help="steps the arms")
    parser.add_argument("--workers", type=int, default=0, help="processes; one a core by default")
    parser.add_argument("--gains", type=Path, help="folder of gain sets instead of those shipped")
    parser.add_argument("--publish", action="store_true", help="renew what the repository shows")
    options = parser.parse_args()
    raise_interrupts()
    try:
        reproduce(options)
    except (OctarmError, OSError) as error:
        print(f"reproduce_paper: {error}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    except KeyboardInterrupt:
        words = ["python", "scripts/reproduce_paper.py", *sys.argv[1:]]
        again = shlex.join(words if options.resume else [*words, "--resume"])
        print(f"interrupted; what was finished is kept, go on by: {again}", file=sys.stderr)
        return ExitCode.INTERRUPTED
    return ExitCode.FINE


def reproduce(options: argparse.Namespace) -> None:
    """All of it."""
    engine = options.engine or (MUJOCO if options.publish else usual_engine())
    out, effort = options.out, dataclasses.replace(QUICK if options.quick else FULL, engine=engine)
    if options.publish and (options.quick or engine != MUJOCO):
        raise OctarmError(
            f"--publish needs all numbers by {MUJOCO}; leave out --quick and --engine"
        )
    if out.exists() and any(out.iterdir()) and not options.resume:
        raise OctarmError(f"{out} is not empty; go on with it by --resume, or choose another --out")
    variants = all_variants(options.gains)
    run_all(variants, effort, out, options.workers)
    evidence = gather(variants, effort, out, costs(variants))
    gains = options.gains or SHIPPED
    root = ROOT if options.publish else None
    for claim in writeup.write_all(evidence, out, gains, root):
        print(f"({claim.letter}) {claim.title}: {claim.outcome}")
    print(f"wrote {out / writeup.PAGE}")
    if options.publish:
        print(f"renewed {ROOT / 'README.md'} and .readme/paper.*")


if __name__ == "__main__":  # the worker processes import this file, too
    repair_streams()
    sys.exit(surviving_output(main)())
