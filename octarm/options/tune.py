"""What `octarm tune` is asked for."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

from octarm.options.argument import Operand, Option


@dataclasses.dataclass(frozen=True)
class Tune:
    """Find gains for one controller.

    The search and its budget are the same for every controller. Writes a small TOML file: the
    gains, what they cost by the measure that all controllers are tuned for, and how they were
    found. octarm run --gains FILE.toml uses them.

    Examples:
      octarm tune smc-boundary --out my-gains.toml
      octarm tune smc-boundary --out my-gains.toml --resume
    """

    controller: Annotated[str, Operand("CONTROLLER", "controller to tune")]
    out: Annotated[
        Path | None,
        Option(
            "FILE.toml",
            "file to write; CONTROLLER.toml when not given; the search keeps its state beside it",
        ),
    ] = None
    budget: Annotated[
        float,
        Option("S", "what the search may simulate, all arms counted [s]; 8000 s take minutes"),
    ] = 8000.0
    seed: Annotated[int, Option("N", "seed of the search")] = 0
    resume: Annotated[bool, Option("", "go on with the search that was interrupted")] = False
