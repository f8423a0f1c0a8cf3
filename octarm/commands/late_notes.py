"""What the commands say of what begins after a run, and of samples that end before it does."""

from __future__ import annotations

import sys
from collections.abc import Iterable

from octarm.declared import samples_of
from octarm.disturbances.episode import Disturbance
from octarm.errors import printable
from octarm.references.samples import samples_end


def print_late(starts: Iterable[tuple[str, float]], words: Iterable[str], duration: float) -> None:
    """Prints on stderr what a run of this duration [s] does not come to.

    Args:
        starts: what begins, and when [s].
        words: of desired motions, as `recorded_word` has them.
        duration: of the run [s].
    """
    said = [
        f"{text} begins at {at:g} s, and the run ends at {duration:g} s before it"
        for text, at in starts
        if at >= duration
    ]
    for file in filter(None, map(samples_of, words)):
        if (end := samples_end(file)) < duration * (1.0 - 1e-9):
            said.append(
                f"the samples of {file} end at {end:.4g} s, and the run at {duration:g} s: from "
                "then on the arm is to rest there"
            )
    for sentence in said:
        print(f"octarm: {printable(sentence)}", file=sys.stderr)


def starts_of(disturbances: Iterable[Disturbance]) -> list[tuple[str, float]]:
    """What begins of disturbances, and when [s]."""
    events = [event for each in disturbances for event in each.events()]
    return [(event.text, event.at) for event in events if event.text]
