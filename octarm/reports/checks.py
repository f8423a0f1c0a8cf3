"""Whether the numbers of a sweep can be what they seem to be."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from octarm.reports.episodes import Axis, Episodes
from octarm.reports.findings import partners

_FEW = 8  # seeds, below which intervals are rough


class Finding(NamedTuple):
    """Something that a reader should know.

    Attributes:
        warning: whether a number is not to be believed without looking into it.
        text: one sentence.
    """

    warning: bool
    text: str


def findings(episodes: Episodes) -> list[Finding]:
    """All that was found, warnings first."""
    found = [
        *_unfinished(episodes),
        *_versions(episodes),
        *_same_states(episodes),
        *_implausible(episodes),
        *_idle_axes(episodes),
        *_seeds(episodes),
    ]
    return sorted(found, key=lambda finding: not finding.warning)


def _unfinished(episodes: Episodes) -> Iterator[Finding]:
    n, planned = len(episodes.seed), episodes.planned
    if n < planned:
        yield Finding(
            True,
            f"The sweep is not finished: {n} of {planned} episodes are there; octarm sweep "
            "--resume goes on with it.",
        )
    for i, name in enumerate(episodes.controllers):
        if not np.any(episodes.controller == i):
            yield Finding(True, f"No episode of {name} is finished.")
    if episodes.absent:
        names = ", ".join(episodes.absent)
        yield Finding(False, f"No episode has a value of {names}: left out.")


def _versions(episodes: Episodes) -> Iterator[Finding]:
    starts = [start["versions"] for start in episodes.manifest["starts"]]
    for name in dict.fromkeys(key for versions in starts for key in versions):
        different = list(dict.fromkeys(str(versions.get(name)) for versions in starts))
        if len(different) > 1:
            told = " and ".join(different)
            yield Finding(True, f"Parts of the sweep ran with different {name}: {told}.")


def _same_states(episodes: Episodes) -> Iterator[Finding]:
    """Controllers that cannot be told apart."""
    for j, second in enumerate(episodes.controllers):
        partner = partners(episodes, second)
        for i, first in enumerate(episodes.controllers[:j]):
            rows = np.flatnonzero((episodes.controller == i) & (partner >= 0))
            same = int(np.sum(episodes.digest[rows] == episodes.digest[partner[rows]]))
            if same:
                yield Finding(
                    True,
                    f"{first} and {second} moved the arm in the same way to the last digit in "
                    f"{same} of {len(rows)} pairs of episodes: are they two controllers?",
                )


def _implausible(episodes: Episodes) -> Iterator[Finding]:
    """Episodes that ended well by their status alone, or better than anything can."""
    if lost := _counts(episodes, episodes.lost):
        yield Finding(
            True,
            "Their status ok is no success: episodes did not diverge, but a coordinate followed "
            f"its reference no better than if it hung still ({lost}).",
        )
    if exact := _counts(episodes, episodes.exact):
        yield Finding(True, f"Episodes have an error of exactly zero ({exact}).")
    if all_diverged := [
        name
        for i, name in enumerate(episodes.controllers)
        if np.all(episodes.diverged[episodes.controller == i])
    ]:
        yield Finding(True, f"All episodes diverged of {', '.join(all_diverged)}.")


def _counts(episodes: Episodes, which: np.ndarray) -> str:
    """How many episodes of each controller there are in words, those with none left out."""
    told: list[str] = []
    for i, name in enumerate(episodes.controllers):
        own = episodes.controller == i
        if count := int(np.sum(own & which)):
            told.append(f"{name} {count} of {np.sum(own)}")
    return ", ".join(told)


def _idle_axes(episodes: Episodes) -> Iterator[Finding]:
    """Axes that leave the states as they are, bit for bit."""
    for axis in episodes.axes:
        if axis.drawn:
            continue
        idle = [
            name
            for i, name in enumerate(episodes.controllers)
            if _is_idle(episodes, axis, np.flatnonzero(episodes.controller == i))
        ]
        if len(idle) == len(episodes.controllers):
            yield Finding(True, f"{axis.name} has no effect on any controller: does it act?")
        elif idle:
            yield Finding(
                False,
                f"{axis.name} has no effect at all on {', '.join(idle)}, as it should be for what "
                "a controller does not use.",
            )


def _is_idle(episodes: Episodes, axis: Axis, rows: np.ndarray) -> bool:
    """Whether episodes that differ in the axis alone have the same states."""
    key = episodes.seed[rows]
    for other in episodes.axes:
        if other is not axis:
            key = key * len(other.labels) + other.code[rows]
    order = np.lexsort((axis.code[rows], key))
    key, digest = key[order], episodes.digest[rows][order]
    neighbours = key[1:] == key[:-1]
    return bool(np.any(neighbours) and np.all(digest[1:][neighbours] == digest[:-1][neighbours]))


def _seeds(episodes: Episodes) -> Iterator[Finding]:
    """Seeds that are few, or all the same."""
    count = len(np.unique(episodes.seed))
    if count < _FEW:
        seeds = "one seed" if count == 1 else f"{count} seeds"
        what = "there are no intervals" if count == 1 else "intervals are rough"
        yield Finding(False, f"The sweep has {seeds} a cell: {what}.")
    cell = episodes.cell() * len(episodes.controllers) + episodes.controller
    order = np.argsort(cell, kind="stable")
    cell, digest = cell[order], episodes.digest[order]
    starts = np.flatnonzero(np.diff(cell, prepend=-1))
    sizes = np.diff(np.append(starts, len(cell)))
    same = np.maximum.reduceat(digest, starts) == np.minimum.reduceat(digest, starts)
    repeated = int(np.sum(same & (sizes > 1)))
    if repeated:
        yield Finding(
            False,
            f"Nothing random acts in {repeated} of {len(starts)} cells (a controller at one place "
            "of the grid): their seeds repeat one episode, and intervals there have no width.",
        )
