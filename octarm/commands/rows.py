"""The arrays of a recorded run, whole or partial, for the commands that draw it again."""

from __future__ import annotations

from pathlib import Path

from octarm.commands.terminal import note
from octarm.runs import folder as runs


def rows_of(folder: Path) -> runs.Run:
    """The arrays of a run, as far as there are any, and its description; raises OctarmError."""
    trajectory, description = runs.map_run(folder)
    if description["status"] == runs.RUNNING:
        say_partial(float(trajectory.t[-1]))
        ended = {"status": trajectory.status, "message": trajectory.message}
        return runs.Run(trajectory, {**description, **ended})
    return runs.Run(trajectory, description)


def say_partial(end: float) -> None:
    """Says on stderr that a run ends early, at a time [s]."""
    note(f"the run is partial: it is still going on or was killed, and reaches to t = {end:.6g} s")
