"""Whether the numbers of a sweep can be what they seem to be."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from octarm.metrics.metric import unsettled
from octarm.reports.comparisons import partners
from octarm.reports.factors import Factor
from octarm.reports.frame import Episodes
from octarm.reports.statistics import FEWEST
from octarm.sweeps.engine_check import LIMIT, sentence

_FEW = 8  # seeds, below which intervals are rough


class Remark(NamedTuple):
    """A sentence that a reader should know; a warning that a number may be wrong."""

    warning: bool
    text: str


def remarks(episodes: Episodes) -> list[Remark]:
    """All remarks on a sweep, warnings first."""
    checks = (_unfinished, _versions, _engines, _same_states, _implausible, _idle_factors, _seeds)
    made = [remark for check in checks for remark in check(episodes)]
    return sorted(made, key=lambda remark: not remark.warning)


def _unfinished(episodes: Episodes) -> Iterator[Remark]:
    n, planned = len(episodes.seed), episodes.planned
    if n < planned:
        yield Remark(
            True,
            f"The sweep is not finished: {n} of {planned} episodes are there; octarm sweep "
            "--resume goes on with it.",
        )
    for name in episodes.controllers:
        if not episodes.of_controller(name).size:
            yield Remark(True, f"No episode of {name} is finished.")
    if episodes.absent:
        names = ", ".join(episodes.absent)
        why = unsettled(episodes.spec.duration, episodes.spec.settle, "settle =")
        left_out = f"No {episodes.with_values} has a value of {names}: left out"
        yield Remark(False, f"{left_out}{why and f', since {why}'}.")


def _versions(episodes: Episodes) -> Iterator[Remark]:
    starts = [start["versions"] for start in episodes.manifest["starts"]]
    for name in dict.fromkeys(key for versions in starts for key in versions):
        different = dict.fromkeys(str(versions.get(name)) for versions in starts)
        if len(different) > 1:
            both = " and ".join(different)
            yield Remark(True, f"Parts of the sweep ran with different {name}: {both}.")


def _engines(episodes: Episodes) -> Iterator[Remark]:
    difference = episodes.engine_difference
    if difference.size:
        yield Remark(bool(np.any(difference > LIMIT)), sentence(difference, len(episodes.seed)))


def _same_states(episodes: Episodes) -> Iterator[Remark]:
    for j, second in enumerate(episodes.controllers):
        partner = partners(episodes, second)
        for first in episodes.controllers[:j]:
            rows = episodes.of_controller(first)
            rows = rows[partner[rows] >= 0]
            if same := int(np.sum(episodes.digest[rows] == episodes.digest[partner[rows]])):
                yield Remark(
                    True,
                    f"{first} and {second} moved the arm in the same way to the last digit in "
                    f"{same} of {len(rows)} pairs of episodes: are they two controllers?",
                )


def _implausible(episodes: Episodes) -> Iterator[Remark]:
    """Episodes that ended well by their status alone, or better than anything can."""
    if hanging := _counts(episodes, episodes.lost):
        yield Remark(
            True,
            "Their status ok is no success: episodes did not diverge, but a coordinate followed "
            f"its reference no better than if it hung still ({hanging}).",
        )
    if exact := _counts(episodes, episodes.exact):
        yield Remark(True, f"Episodes have an error of exactly zero ({exact}).")
    planned, lost = episodes.planned // len(episodes.controllers), dict[str, int]()
    for name in episodes.controllers:
        mine = episodes.of_controller(name)
        if mine.size and episodes.diverged[mine].all():
            lost[name] = len(mine)
    if whole := [name for name, count in lost.items() if count == planned]:
        yield Remark(True, f"All episodes diverged of {', '.join(whole)}.")
    for name, count in lost.items():
        if count < planned:
            text = f"All finished episodes diverged of {name}: {count} of {planned} planned."
            yield Remark(True, text)


def _counts(episodes: Episodes, which: np.ndarray) -> str:
    """The number of such episodes of each controller, in words; those with none are left out."""
    rows = {name: episodes.of_controller(name) for name in episodes.controllers}
    counts = {name: int(np.sum(which[mine])) for name, mine in rows.items()}
    return ", ".join(f"{name} {k} of {len(rows[name])}" for name, k in counts.items() if k)


def _idle_factors(episodes: Episodes) -> Iterator[Remark]:
    """Factors that leave the states as they are, bit for bit."""
    names = episodes.controllers
    for factor in (factor for factor in episodes.factors if not factor.drawn):
        idle = [n for n in names if _is_idle(episodes, factor, episodes.of_controller(n))]
        if len(idle) == len(names):
            yield Remark(True, f"{factor.name} has no effect on any controller: does it act?")
        elif idle:
            yield Remark(
                False,
                f"{factor.name} has no effect at all on {', '.join(idle)}, as it should be for "
                "what a controller does not use.",
            )


def _is_idle(episodes: Episodes, factor: Factor, rows: np.ndarray) -> bool:
    """Whether episodes that differ in the factor alone have the same states."""
    key = (episodes.cell(but=factor) * (episodes.seed.max() + 1) + episodes.seed)[rows]
    order = np.lexsort((factor.code[rows], key))
    key, digest = key[order], episodes.digest[rows][order]
    neighbours = key[1:] == key[:-1]
    return bool(np.any(neighbours) and np.all(digest[1:][neighbours] == digest[:-1][neighbours]))


def _seeds(episodes: Episodes) -> Iterator[Remark]:
    count, planned = len(np.unique(episodes.seed)), episodes.spec.episodes
    if count < _FEW:
        seeds = "one seed" if count == 1 else f"{count} seeds"
        if count < planned:
            seeds = f"finished episodes of {count} of its {planned} seeds"
        what = "intervals are rough"
        if count < FEWEST:
            what = f"medians have the range of their seeds; an interval needs {FEWEST}"
        if count == 1:
            what = "there are no intervals"
        yield Remark(False, f"The sweep has {seeds} a cell: {what}.")
    cell = episodes.cell() * len(episodes.controllers) + episodes.controller
    order = np.argsort(cell, kind="stable")
    cell, digest = cell[order], episodes.digest[order]
    starts = np.flatnonzero(np.diff(cell, prepend=-1))
    sizes = np.diff(np.append(starts, len(cell)))
    same = np.maximum.reduceat(digest, starts) == np.minimum.reduceat(digest, starts)
    if repeated := int(np.sum(same & (sizes > 1))):
        yield Remark(
            False,
            f"Nothing random acts in {repeated} of {len(starts)} cells (a controller at one place "
            "of the grid): their seeds repeat one episode, and intervals there have no width.",
        )
