"""What `octarm verify` does."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from controllers import make_controller
from octarm.bars import bar as new_bar
from octarm.checks.differences import listed, sweep_differences
from octarm.checks.verify import check_episode, check_run
from octarm.commands.terminal import note
from octarm.declared import Code, CodeChanged, file_of, samples_of, word_of
from octarm.errors import ExitCode, OctarmError, printable
from octarm.formats import Document
from octarm.runs import folder as runs
from octarm.runs.description import Description
from octarm.sweeps.episodes import FinishedSweep
from octarm.sweeps.store import MANIFEST


def verify(folders: Sequence[Path], episodes: Sequence[int], sample: int | None) -> int:
    """`octarm verify`: runs again what was run, and says whether every bit is the same."""
    if not folders:
        raise OctarmError("there is nothing to verify; give a run folder or a sweep folder")
    identical: list[bool] = []
    for folder in folders:
        try:
            if (folder / MANIFEST).is_file():
                identical.append(_sweep(folder, episodes, sample))
            elif episodes or sample is not None:
                raise OctarmError(f"{folder} is no sweep; --episode and --sample are for sweeps")
            else:
                identical.append(_run(folder))
        except CodeChanged as changed:
            _print_lines(folder, [f"not run again: {changed}"])
            identical.append(False)
    return ExitCode.FINE if all(identical) else ExitCode.CHECK_FAILED


def _run(folder: Path) -> bool:
    """Whether a run comes out again; says so."""
    factory = functools.partial(make_controller, gain_set="recommended")  # none is left open
    description = runs.read_description(folder)
    announce(folder, Document(runs.DESCRIPTION, description).read(Description).code)
    periods = description.get("duration", 0.0) / description.get("control_period", 1.0)
    with new_bar(total=round(periods) or None, unit=" periods") as bar:
        check = check_run(folder, factory, bar.update)
    _print_lines(folder, check.lines())
    return check.identical


def _sweep(folder: Path, named: Sequence[int], sample: int | None) -> bool:
    """Whether a sweep's files are as written, and episodes come out again alone; says so."""
    sweep = FinishedSweep(folder)
    episodes = _selected(sweep, named, sample)
    announce(folder, sweep.plan.spec.code)
    for episode in episodes:
        sweep.row(episode)  # raises before the work rather than after
    changed = sweep_differences(sweep, make_controller)
    if changed:
        _print_lines(folder, ["the files are not those of this sweep", *listed(changed, "entry")])
    identical = not changed
    with new_bar(episodes, unit=" episodes") as bar:
        for episode in bar:
            check = check_episode(sweep, episode, make_controller)
            bar.clear()
            _print_lines(folder, check.lines())
            identical = identical and check.identical
    return identical


def announce(folder: Path, code: Mapping[str, Code]) -> None:
    """Says which code that is not built in is run: that of this machine's user, if it is as then.

    Raises CodeChanged if a file is not what it was, before any of them is imported, OctarmError for
    a file within the folder, which whoever made the folder may have written.
    """
    for path in [word_of(name, code) for name in code]:
        if samples_of(path) is not None:
            continue
        if file_of(path).resolve().is_relative_to(folder.resolve()):
            raise OctarmError(f"{path} is within the folder that is to be verified; it is not run")
        note(f"runs {path}, the same file as then")


def _print_lines(folder: Path, lines: Sequence[str]) -> None:
    print("\n".join(map(printable, [f"{folder}: {lines[0]}", *lines[1:]])), flush=True)


def _selected(sweep: FinishedSweep, named: Sequence[int], sample: int | None) -> list[int]:
    """The episodes that were named, and those of a sample."""
    episodes = list(dict.fromkeys(named))
    if sample is None:
        if not episodes:
            raise OctarmError(
                f"{sweep.path} is a sweep; --episode N says which of its "
                f"{sweep.plan.episodes} episodes to verify, or --sample N takes some"
            )
        return episodes
    finished = np.setdiff1d(sweep.finished(), episodes)
    count = min(sample, len(finished))
    return [*episodes, *np.sort(np.random.default_rng().choice(finished, count, False)).tolist()]
