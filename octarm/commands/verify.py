"""What `octarm verify` does."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from controllers import make_controller
from octarm.checks.verify import check_run
from octarm.checks.verify_episode import check_episode
from octarm.errors import ExitCode, OctarmError
from octarm.runs import folder as runs
from octarm.sweeps.episodes import FinishedSweep
from octarm.sweeps.store import MANIFEST

if TYPE_CHECKING:
    from octarm.options.checks import Verify


def verify(options: Verify) -> int:
    """`octarm verify`: runs again what was run, and says whether every bit is the same."""
    if not options.runs:
        raise OctarmError("there is nothing to verify; give a run folder or a sweep folder")
    for episode in options.episode:
        if episode < 0:
            raise OctarmError(f"episode is {episode}; it must be at least 0")
    if options.sample is not None and options.sample < 1:
        raise OctarmError(f"sample is {options.sample}; it must be at least 1")
    checks = [_sweep(f, options) if _is_sweep(f) else _run(f, options) for f in options.runs]
    return ExitCode.FINE if all(checks) else ExitCode.CHECK_FAILED


def _is_sweep(folder: Path) -> bool:
    return (folder / MANIFEST).is_file()


def _run(folder: Path, options: Verify) -> bool:
    """Whether a run comes out again; says so."""
    if options.episode or options.sample is not None:
        raise OctarmError(f"{folder} is no sweep; --episode and --sample are for sweeps")
    factory = functools.partial(make_controller, gain_set="recommended")  # none is left open
    known = runs.read_description(folder)
    periods = known.get("duration", 0.0) / known.get("control_period", 1.0)
    with tqdm(total=round(periods) or None, unit=" periods", disable=None, leave=False) as bar:
        check = check_run(folder, factory, bar.update)
    first, *more = check.lines()
    print("\n".join([f"{folder}: {first}", *more]), flush=True)
    return check.identical


def _sweep(folder: Path, options: Verify) -> bool:
    """Whether episodes of a sweep come out again alone; says so, one by one."""
    sweep = FinishedSweep(folder)
    episodes = _chosen(sweep, options)
    for episode in episodes:
        sweep.row(episode)  # raises before the work rather than after
    good = True
    with tqdm(episodes, unit=" episodes", disable=None, leave=False) as bar:
        for episode in bar:
            check = check_episode(sweep, episode, make_controller)
            bar.clear()
            print("\n".join([f"{folder}: {check.lines()[0]}", *check.lines()[1:]]), flush=True)
            good = good and check.identical
    return good


def _chosen(sweep: FinishedSweep, options: Verify) -> list[int]:
    """The episodes that were named, and those of a sample."""
    named = list(dict.fromkeys(options.episode))
    if options.sample is None:
        if not named:
            raise OctarmError(
                f"{sweep.path} is a sweep; --episode ID says which of its "
                f"{sweep.plan.episodes} episodes to verify, or --sample N takes some"
            )
        return named
    finished = np.setdiff1d(sweep.finished(), named)
    count = min(options.sample, len(finished))
    return [*named, *np.sort(np.random.default_rng().choice(finished, count, False)).tolist()]
