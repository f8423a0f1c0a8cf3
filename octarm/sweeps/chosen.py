"""The episodes of a sweep that are recorded: which ones, and as run folders."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from octarm.arm.mjcf import nominal_parameters
from octarm.checks.verify_episode import FinishedSweep, first_difference
from octarm.errors import OctarmError
from octarm.runs import folder as runs
from octarm.runs.digest import StateDigest
from octarm.runs.experiment import Experiment, Factory, run_into
from octarm.simulation.environment import whole_periods
from octarm.simulation.trajectory import Trajectory
from octarm.sweeps.folder import RECORDED
from octarm.sweeps.gain_sets import of_sets
from octarm.sweeps.plan import Plan

METRIC = "tip_rms_error"  # one number an arm: by it episodes are the worst or the median ones
COLUMNS = ("episode", "controller", "status", "diverged_at", METRIC)


class Choice(NamedTuple):
    """Episodes to record.

    Attributes:
        reasons: why, by episode, in the order in which they were asked for.
        notes: what was asked for and is not there, a sentence each.
    """

    reasons: Mapping[int, tuple[str, ...]]
    notes: tuple[str, ...]


def choose(table: pa.Table, record: Sequence[int | str]) -> Choice:
    """The episodes that a spec asks for: by number, or by a word that means one a controller.

    - `worst`: the largest `METRIC` of all episodes that did not diverge;
    - `median`: the middle one of them by `METRIC`, the lower one of two;
    - `diverged`: the one that diverged first.

    Of equals it is the one with the lowest number. Asked for by its number: `chosen`.

    Args:
        table: of a sweep, with at least `COLUMNS`.
        record: numbers and words.

    Raises:
        ValueError: if the table has no episode of a number.
    """
    episodes, controllers, status, lost, size = (
        table[name].to_numpy(zero_copy_only=False) for name in COLUMNS
    )
    found: list[tuple[int, str]] = []
    notes: list[str] = []
    for word in record:
        if isinstance(word, int):
            if word not in episodes:
                raise OctarmError(f"there is no episode {word} in the table")
            found.append((word, "chosen"))
            continue
        by = lost if word == "diverged" else size
        usable = ((status == "diverged") == (word == "diverged")) & ~np.isnan(by)
        for name in dict.fromkeys(controllers.tolist()):
            places = np.flatnonzero(usable & (controllers == name))
            if len(places):
                order = places[np.lexsort((episodes[places], by[places]))]
                found.append((int(episodes[_pick(word, order, by)]), word))
            elif word != "diverged":
                notes.append(
                    f"no episode of {name} is the {word} one: none that stayed within the limits "
                    f"has a {METRIC}"
                )
    reasons: dict[int, tuple[str, ...]] = {}
    for episode, reason in found:
        reasons[episode] = tuple(dict.fromkeys((*reasons.get(episode, ()), reason)))
    return Choice(reasons, tuple(notes))


def _pick(word: str, order: np.ndarray, by: np.ndarray) -> int:
    """The place of the one that is meant; `order` sorts places by size, then by number."""
    if word == "diverged":
        return int(order[0])
    if word == "median":
        return int(order[(len(order) - 1) // 2])
    return int(order[by[order] == by[order[-1]]][0])


def record_chosen(
    sweep: FinishedSweep,
    reasons: Mapping[int, tuple[str, ...]],
    factory: Factory,
    *,
    begin: Callable[[int, str], object] = lambda periods, label: None,
    progress: Callable[[], object] | None = None,
) -> dict[int, str]:
    """Runs episodes again, one by one, each into a run folder `recorded/ID-REASON` of the sweep.

    Those that are there already are left alone. After an interruption the next call goes on.

    Args:
        sweep: the sweep, whose rows of these episodes are there.
        reasons: see `choose`.
        factory: of the controllers, the one that the sweep had.
        begin: called before every run with its number of control periods and what it is.
        progress: called after every control period.

    Returns:
        Where a run differs from what the sweep's table says of it: a sentence by episode.

    Raises:
        ValueError: if an episode cannot be run.
        OSError: if a folder cannot be written.
        KeyboardInterrupt: if interrupted; finished folders stay.
    """
    from octarm.recordings.recording import run_recording  # the import takes half a second

    different: dict[int, str] = {}
    for episode, words in reasons.items():
        folder = sweep.path / RECORDED / f"{episode}-{'-'.join(words)}"
        if _is_there(folder, episode):
            continue
        experiment = experiment_of(sweep.plan, episode)
        environment, controller = experiment.begin(of_sets(factory, sweep.plan.spec))
        announced = experiment.announcement(environment, controller)
        periods = whole_periods(experiment.duration, environment.control_timestep())
        begin(periods, f"recording episode {episode} ({', '.join(words)})")
        trajectory, _ = run_into(
            folder, environment, controller, announced, recording=run_recording, progress=progress,
            partial=False,
        )  # fmt: skip
        difference = _difference(sweep, episode, trajectory, periods)
        if difference:
            different[episode] = difference
    return different


def experiment_of(plan: Plan, episode: int) -> Experiment:
    """An episode as a run of one arm.

    Raises:
        ValueError: if there is no such episode.
    """
    spec, arms = plan.spec, plan.episode(episode)
    (seed,) = arms.seeds
    nominal = nominal_parameters()
    return Experiment(
        controller=arms.controller,
        gains=spec.gains.get(arms.controller, {}),
        nominal=nominal.mismatched(arms.mismatch),
        parameters=nominal,
        reference=arms.reference,
        disturbances=arms.disturbances,
        seed=spec.seed,
        spawn_key=tuple(seed.spawn_key),
        duration=spec.duration,
        timestep=spec.timestep,
        control_period=spec.control_period,
        actuation=spec.actuation,
    )


def _is_there(folder: Path, episode: int) -> bool:
    """Whether an episode is recorded; its folder gets the name of the present reason.

    What a killed process has left is removed.
    """
    for other in sorted(folder.parent.glob(f"{episode}-*")):
        try:
            status = runs.read_description(other)["status"]
        except (KeyError, ValueError):
            status = ""
        if status in ("ok", "diverged") and (other / runs.RECORDING).is_file():
            if other != folder:
                os.replace(other, folder)
            return True
        shutil.rmtree(other, ignore_errors=True)
    return False


def _difference(sweep: FinishedSweep, episode: int, trajectory: Trajectory, periods: int) -> str:
    """How a recorded run differs from its row; empty if it does not."""
    digest = StateDigest(periods)
    for q, v in zip(trajectory.q, trajectory.v, strict=True):
        digest.update(q, v)
    _, marks = digest.result()
    row = sweep.row(episode).to_pylist()[0]
    between = first_difference(row["checkpoints"], marks[0].tolist(), sweep.plan.spec.duration)
    if between is None:
        return ""
    return (
        f"episode {episode}: what was recorded differs from the table from an instant between "
        f"t = {between[0]:g} s and {between[1]:g} s on; octarm verify {sweep.path} "
        f"--episode {episode} says more"
    )
