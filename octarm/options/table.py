"""All commands, by what they are for."""

from __future__ import annotations

from octarm.options.checks import Validate, Verify
from octarm.options.machine import Completion, Doctor
from octarm.options.recordings import Plot, Record, Replay, Video
from octarm.options.run import Run
from octarm.options.sweeps import Margin, Report, Sweep
from octarm.options.tune import Tune

Command = (
    Run | Replay | Record | Plot | Video | Sweep | Report | Margin | Tune | Validate | Verify
    | Doctor | Completion
)  # fmt: skip

GROUPS: dict[str, tuple[type[Command], ...]] = {
    "one run": (Run, Replay, Record, Plot, Video),
    "many runs": (Sweep, Report, Margin, Tune),
    "checks": (Validate, Verify),
    "this machine": (Doctor, Completion),
}
COMMANDS: dict[str, type[Command]] = {
    kind.__name__.lower(): kind for kinds in GROUPS.values() for kind in kinds
}
