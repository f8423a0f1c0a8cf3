"""Single episodes of a finished sweep: which ones are recorded, and running them again alone."""

from __future__ import annotations

import dataclasses
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
from dm_control.rl import control

from octarm.errors import OctarmError
from octarm.html import Cell, Table, notebook_cell
from octarm.interfaces import Controller, ControllerFactory
from octarm.runs import folder as runs
from octarm.runs.digest import CHECKPOINTS, StateDigest
from octarm.runs.experiment import Experiment, run_into
from octarm.simulation.environment import whole_periods
from octarm.simulation.setup import Setup
from octarm.sweeps import shards
from octarm.sweeps.store import RECORDED, open_sweep, read_shard

METRIC = "tip_rms_error"  # one number an arm: by it episodes are the worst or the median ones
COLUMNS = ("episode", "controller", "status", "diverged_at", METRIC)


class FinishedSweep:
    """A sweep folder as it was when it was read, whose episodes can be run again one by one.

    Attributes:
        gains: of each controller for the first arm when the sweep was begun.
    """

    def __init__(self, path: Path | str) -> None:
        """Reads what was run; raises what `open_sweep` does."""
        self.path = Path(path)
        self.plan, self.manifest = open_sweep(self.path)
        self.gains: Mapping[str, Any] = self.manifest["gains"]

    def finished(self) -> np.ndarray:
        """The numbers of the episodes that are there, shape (n,)."""
        ranges: list[np.ndarray] = [
            np.arange(shard["first"], shard["first"] + shard["episodes"])
            for shard in self.manifest["shards"]
            if shard["sha256"] and (self.path / shard["file"]).is_file()
        ]
        return np.concatenate([np.empty(0, dtype=np.int64), *ranges])

    def _repr_html_(self) -> str:
        """What a notebook shows of it."""
        spec, done = self.plan.spec, len(self.finished())
        words = f"{done} of {self.plan.episodes} episodes of {spec.duration:g} s are finished"
        axes = [(axis.name, ", ".join(map(str, axis.values))) for axis in spec.axes]
        axes += [(axis.name, "{:g} .. {:g}, drawn".format(*axis.values)) for axis in spec.random]
        axes.append(("seeds", f"{spec.episodes} a cell"))
        rows = [[Cell(name, kind="left"), Cell(text, kind="wide")] for name, text in axes]
        head = [Cell("axis", kind="left"), Cell("values", kind="left")]
        lines = [f"{words}; octarm.read_sweep reads them"]
        return notebook_cell(f"Sweep {self.path.resolve().name}", lines, Table(head, rows))

    def row(self, episode: int) -> pa.Table:
        """The row of an episode; the metadata of its schema are what `origin_of` reads.

        Raises OctarmError if there is no such episode, or it is not finished or damaged.
        """
        self.plan.episode(episode)  # raises when there is no such episode
        shard = next(i for i in self.plan.shards if episode in self.plan.shard(i))
        table = read_shard(self.path, self.plan, self.manifest, shard)
        if table is None:
            raise OctarmError(f"episode {episode} of {self.path} is not finished; --resume runs it")
        return table.slice(episode - self.plan.shard(shard).start, 1)

    def experiment(self, episode: int) -> Experiment:
        """An episode as a run of one arm, whose factory is that of the sweep's controllers."""
        spec, arms = self.plan.spec, self.plan.episode(episode)
        (seed,) = arms.seeds
        return Experiment(
            controller=arms.controller,
            gains=spec.gains.get(arms.controller, {}),
            nominal=spec.believed(arms.arm).mismatched(arms.mismatch),
            seed=spec.seed,
            spawn_key=tuple(seed.spawn_key),
            duration=spec.duration,
            settle=spec.settle,
            code=spec.code,
            **{field.name: getattr(arms, field.name) for field in dataclasses.fields(Setup)},
        )

    def begin(
        self, episode: int, factory: ControllerFactory
    ) -> tuple[control.Environment, Controller, dict[str, Any]]:
        """Environment and controller of an episode that is run alone, and its announcement.

        The factory is the one that the sweep had. Raises OctarmError if the episode is not there or
        cannot be made.
        """
        arms = self.plan.episode(episode)
        environment, controller = shards.begin(self.plan.spec, arms, factory)
        announced = self.experiment(episode).announcement(environment, controller)
        return environment, controller, announced


def first_difference(
    was: Sequence[int], now: Sequence[int], duration: float
) -> tuple[float, float] | None:
    """Between which instants [s] two motions of a duration [s] part; None if they do not.

    They are given by their checkpoints, see `octarm.runs.digest.StateDigest`.
    """
    for k, pair in enumerate(zip(was, now, strict=True)):
        if pair[0] != pair[1]:
            return duration * k / CHECKPOINTS, duration * (k + 1) / CHECKPOINTS
    return None


class Selection(NamedTuple):
    """Episodes to record.

    Attributes:
        reasons: why, by episode, in the order in which they were asked for.
        notes: what was asked for and is not there, a sentence each.
    """

    reasons: Mapping[int, tuple[str, ...]]
    notes: tuple[str, ...]


def select(table: pa.Table, record: Sequence[int | str]) -> Selection:
    """The episodes that a spec asks for: by number, or by a word that means one a controller.

    - `worst`: the largest `METRIC` of all episodes that did not diverge;
    - `median`: the middle one of them by `METRIC`, the lower one of two;
    - `diverged`: the one that diverged first.

    Of equals it is the one with the lowest number. The reason for a number is `chosen`. The table
    has at least `COLUMNS`. Raises OctarmError if it has no episode of a number.
    """
    episodes, controllers, status, lost, size = (
        table[name].to_numpy(zero_copy_only=False) for name in COLUMNS
    )
    reasons: dict[int, dict[str, None]] = {}  # a dict serves as an ordered set
    notes: list[str] = []
    for word in record:
        if isinstance(word, int):
            if word not in episodes:
                raise OctarmError(f"there is no episode {word} in the table")
            reasons.setdefault(word, {})["chosen"] = None
            continue
        by = lost if word == "diverged" else size
        usable = ((status == "diverged") == (word == "diverged")) & ~np.isnan(by)
        for name in dict.fromkeys(controllers.tolist()):
            places = np.flatnonzero(usable & (controllers == name))
            if len(places):
                order = places[np.lexsort((episodes[places], by[places]))]
                worst, median = int(np.argmax(by[order])), (len(order) - 1) // 2
                place = {"worst": worst, "median": median, "diverged": 0}[word]
                reasons.setdefault(int(episodes[order[place]]), {})[word] = None
            elif word != "diverged":
                notes.append(
                    f"no episode of {name} is the {word} one: none that stayed within the limits "
                    f"has a {METRIC}"
                )
    return Selection({episode: tuple(words) for episode, words in reasons.items()}, tuple(notes))


def record_episodes(
    sweep: FinishedSweep,
    reasons: Mapping[int, tuple[str, ...]],
    factory: ControllerFactory,
    *,
    begin: Callable[[int, str], object] = lambda periods, label: None,
    progress: Callable[[], object] | None = None,
) -> dict[int, str]:
    """Runs episodes again, one by one, each into a run folder `recorded/ID-REASON` of the sweep.

    Those that are there already are left alone. After an interruption the next call goes on.

    Args:
        sweep: whose rows of these episodes are there.
        reasons: see `select`.
        factory: of the controllers, the one that the sweep had.
        begin: called before every run with its number of control periods and what it is.
        progress: called after every control period.

    Returns:
        Where a run differs from what the sweep's table says of it: a sentence by episode.

    Raises:
        OctarmError: if an episode cannot be run, or a folder cannot be written.
    """
    from octarm.recordings.recording import run_recording  # the import takes half a second

    different: dict[int, str] = {}
    for episode, words in reasons.items():
        folder = sweep.path / RECORDED / f"{episode}-{'-'.join(words)}"
        if _is_there(folder, episode):
            continue
        environment, controller, announced = sweep.begin(episode, factory)
        periods = whole_periods(announced["duration"], environment.control_timestep())
        begin(periods, f"recording episode {episode} ({', '.join(words)})")
        trajectory, _ = run_into(
            folder, environment, controller, announced, recording=run_recording, progress=progress,
            partial=False,
        )  # fmt: skip
        digest = StateDigest(periods)
        for q, v in zip(trajectory.q, trajectory.v, strict=True):
            digest.update(q, v)
        (was,) = sweep.row(episode)["checkpoints"].to_pylist()
        now = digest.result()[1][0].tolist()
        if between := first_difference(was, now, sweep.plan.spec.duration):
            different[episode] = (
                f"episode {episode}: what was recorded differs from the table from an instant "
                f"between t = {between[0]:g} s and {between[1]:g} s on; octarm verify {sweep.path} "
                f"--episode {episode} says more"
            )
    return different


def _is_there(folder: Path, episode: int) -> bool:
    """Whether an episode is recorded; its folder gets the name of the present reason.

    What a killed process has left is removed, and so is what was changed.
    """
    for other in sorted(folder.parent.glob(f"{episode}-*")):
        try:
            description = runs.read_description(other)
            whole = description.get(runs.SUMS) == runs.checksums(other, description)
        except OctarmError:
            description, whole = {}, False
        if whole and description["status"] in ("ok", "diverged"):
            if other != folder:
                os.replace(other, folder)
            return True
        shutil.rmtree(other, ignore_errors=True)
    return False
