"""What the commands are asked for that check results."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

from octarm.options.argument import Operand, Option


@dataclasses.dataclass(frozen=True)
class Validate:
    """Check MuJoCo against the analytic model.

    Or, with --controllers, the controllers against their proofs. Prints a report; exit code 1 when
    a check failed.

    Examples:
      octarm validate --modules 5 --json report.json
      octarm validate --controllers
    """

    controllers: Annotated[
        bool,
        Option(
            "",
            "check instead that each controller's Lyapunov function falls as its proof says, and "
            "that the misprints of the paper are noticed",
        ),
    ] = False
    modules: Annotated[int, Option("N", "number of modules of the arm")] = 3
    random_parameters: Annotated[
        int,
        Option("N", "check so many arms with random parameters instead of the nominal one"),
    ] = 0
    states: Annotated[
        int | None,
        Option(
            "N",
            "random states that each comparison runs over; 10000, of controllers 3000, when not "
            "given",
        ),
    ] = None
    seed: Annotated[int, Option("N", "seed of the random states and parameters")] = 0
    json: Annotated[Path | None, Option("FILE", "also write the report to this file")] = None


@dataclasses.dataclass(frozen=True)
class Verify:
    """Run again what a folder says was run, and compare every bit.

    Of a run folder, all arrays at all control instants and the digest of the states; of a sweep,
    episodes run alone, their digests and measures. Reports where they first differ, and versions
    and machine of both sides. Exit code 1 if they do.

    Examples:
      octarm verify runs/my-run
      octarm verify sweeps/noise --episode 17 --episode 4
      octarm verify sweeps/noise --sample 10
    """

    runs: Annotated[tuple[Path, ...], Operand("RUN", "run folders, or sweep folders")]
    episode: Annotated[tuple[int, ...], Option("N", "an episode of the sweep, by number")] = ()
    sample: Annotated[
        int | None, Option("N", "verify so many episodes of the sweep, drawn at random")
    ] = None
