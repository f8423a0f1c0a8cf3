"""Whether the numbers of a sweep can be what they seem to be."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from octarm.metrics.metric import unsettled
from octarm.reports.frame import Episodes
from octarm.reports.statistics import FEWEST
from octarm.sweeps.engine_check import LIMIT, sentence

_FEW = 8  # seeds, below which intervals are rough


class Remark(NamedTuple):
    """Something that a reader should know: a sentence.

    Attributes:
        warning: whether a number is not to be believed without looking into it.
    """

    warning: bool
    text: str


def remarks(episodes: Episodes) -> list[Remark]:
    """All remarks on a sweep, warnings first."""
    checks = (_unfinished, _versions, _engines, _lost, _diverged, _seeds)
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
        left_out = f"No finished episode has a value of {names}: left out"
        yield Remark(False, f"{left_out}{why and f', since {why}'}.")


def _versions(episodes: Episodes) -> Iterator[Remark]:
    starts = [start["versions"] for start in episodes.manifest["starts"]]
    for name in dict.fromkeys(key for versions in starts for key in versions):
        different = list(dict.fromkeys(str(versions.get(name)) for versions in starts))
        if len(different) > 1:
            both = " and ".join(different)
            yield Remark(True, f"Parts of the sweep ran with different {name}: {both}.")


def _engines(episodes: Episodes) -> Iterator[Remark]:
    """How far the engines are apart, if some episodes were run on both."""
    difference = episodes.engine_difference
    if difference.size:
        yield Remark(bool(np.any(difference > LIMIT)), sentence(difference, len(episodes.seed)))


def _lost(episodes: Episodes) -> Iterator[Remark]:
    """Episodes that ended well by their status alone."""
    rows = {name: episodes.of_controller(name) for name in episodes.controllers}
    counts = {name: int(np.sum(episodes.lost[mine])) for name, mine in rows.items()}
    if any(counts.values()):
        which = ", ".join(f"{name} {k} of {len(rows[name])}" for name, k in counts.items() if k)
        yield Remark(
            True,
            "Their status ok is no success: episodes did not diverge, but a coordinate followed "
            f"its reference no better than if it hung still ({which}).",
        )


def _diverged(episodes: Episodes) -> Iterator[Remark]:
    """Controllers of which no episode is left."""
    planned = episodes.planned // len(episodes.controllers)
    for name in episodes.controllers:
        mine = episodes.of_controller(name)
        if mine.size and episodes.diverged[mine].all():
            text = f"All episodes diverged of {name}."
            if len(mine) < planned:
                text = (
                    f"All finished episodes diverged of {name}: {len(mine)} of {planned} planned."
                )
            yield Remark(True, text)


def _seeds(episodes: Episodes) -> Iterator[Remark]:
    """Seeds that are few."""
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
