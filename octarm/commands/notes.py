"""What the commands say, before they run, of what may come as a surprise."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from controllers.gain_sets import unsuited
from octarm.arm.mjcf import physics_step
from octarm.arm.nominal import LagrangeModel
from octarm.arm.parameters import ArmParameters
from octarm.commands.terminal import note
from octarm.declared import Code, samples_of
from octarm.disturbances.episode import Disturbance
from octarm.references import recorded_word
from octarm.references.samples import samples_end


def print_unsuited(
    controller: str,
    gain_set: str | None,
    nominal: ArmParameters,
    timestep: float | str | None,
    control_period: float | None,
) -> str:
    """Notes, and returns, that gains were found for another arm or period; empty if they suit.

    The physics step [s] may also be `auto`, or None for the usual one; the control period is one
    physics step when None.
    """
    step = timestep if isinstance(timestep, float) else physics_step()
    period = step if control_period is None else control_period
    sentence = unsuited(controller, gain_set, LagrangeModel(nominal), period)
    if sentence:
        note(sentence)
    return sentence


def print_late(
    starts: Iterable[tuple[str, float]],
    references: Iterable[str],
    code: Mapping[str, Code],
    duration: float,
) -> None:
    """Notes what a run of this duration [s] does not come to.

    That is what `starts`, and when [s], and the end of samples that desired motions name.
    """
    for text, at in starts:
        if at >= duration:
            note(f"{text} begins at {at:g} s, and the run ends at {duration:g} s before it")
    words = [recorded_word(name, code) for name in references]
    for file in filter(None, map(samples_of, words)):
        if (end := samples_end(file)) < duration * (1.0 - 1e-9):
            note(
                f"the samples of {file} end at {end:.4g} s, and the run at {duration:g} s: from "
                "then on the arm is to rest there"
            )


def starts_of(disturbances: Iterable[Disturbance]) -> list[tuple[str, float]]:
    """What begins of disturbances, and when [s]."""
    events = [event for each in disturbances for event in each.events()]
    return [(event.text, event.at) for event in events if event.text]
