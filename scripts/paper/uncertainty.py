"""Claim (f): performance under structured and unstructured uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from octarm.reports.statistics import Interval
from paper.claims import Claim, Row, Verdict, listed, percent, span
from paper.evidence import Evidence
from paper.measured import Cell
from paper.studies import BENDS, BEYOND, MODELS, NOISE, SLIDES, WRONG
from paper.variants import INTEGRAL, MATCHED, PROPOSED, SMC

BETTER = 0.95  # errors at least 5 % smaller [1]


class Case(NamedTuple):
    """A cell with uncertainty.

    Attributes:
        name: in words.
        cell: of the proposed controller.
    """

    name: str
    cell: Cell


def better(ratio: Interval) -> bool:
    """Whether an error ratio says that the proposed controller is better."""
    return bool(ratio.value <= BETTER and ratio.high < 1.0)


def verdict(ratios: Sequence[Interval]) -> Verdict:
    """The rule, given the errors of the proposed controller over those of SMC."""
    if ratios and all(map(better, ratios)):
        return Verdict.HOLDS
    return Verdict.ONLY_IF if any(map(better, ratios)) else Verdict.FAILS


RULE = (
    "error of afsmc over that of SMC within a boundary layer, both tuned with the same budget, "
    f"seed by seed; better where the median is at most {BETTER:g} and the interval ends below 1. "
    "Holds if it is better in all cases of structured (model -30 %, +30 %) and unstructured "
    "uncertainty (noise, payload, delay, actuator loss); holds only if ... if it is in some; "
    "else it does not hold"
)


_EXPLAINED = (
    " A wrong model, a load or a weak actuator makes a slow error, which any integral action "
    "removes; an adaptive law is one, and so is an integral surface. Against noise no memory "
    "helps: what counts there is how much gain sampling allows."
)


def cases() -> list[Case]:
    """What is uncertain."""
    found: list[Case] = []
    for reference, reading in ((BENDS, "bends"), (SLIDES, "slides")):
        for noise in (0.0, NOISE):
            for model in MODELS:
                if model or noise:
                    told = f"model {percent(model)}" + (", 40 % noise" if noise else "")
                    cell = Cell(PROPOSED, reference=reference, mismatch=model, noise=noise)
                    found.append(Case(f"{reading}, {told}", cell))
    units = {
        "payload": ("payload", "kg", 1.0),
        "delay": ("delay", "ms", 1e3),
        "loss": ("loss", "%", 100.0),
    }
    for name, (field, unit, factor) in units.items():
        value = BEYOND[name][2]
        cell = Cell(PROPOSED, "beyond", mismatch=WRONG)._replace(**{field: value})
        found.append(Case(f"bends, model {percent(WRONG)}, {name} {factor * value:g} {unit}", cell))
    return found


def claim(evidence: Evidence) -> Claim:
    """The claim with its numbers."""
    known = [case for case in cases() if evidence.measured.has(case.cell)]
    found = {
        rival: [
            (case, _ratio(evidence, case, rival)) for case in known if _runs(evidence, case, rival)
        ]
        for rival in (SMC, INTEGRAL, MATCHED)
    }
    ratios = [ratio for _, ratio in found[SMC]]
    came = verdict(ratios)
    lost = [case.name for case, ratio in found[SMC] if not better(ratio)]
    quiet = [r for c, r in found[SMC] if not c.cell.noise and c.cell.study == "tracking"]
    noisy = [r for c, r in found[SMC] if c.cell.noise]
    rows = [
        Row.of(f"afsmc over {rival}: {case.name}", ratio)
        for rival, own in found.items()
        for case, ratio in own
    ]
    rivals = "".join(
        f" Over {rival} it is {_span([r for c, r in own if not c.cell.noise])} without noise and "
        f"{_span([r for c, r in own if c.cell.noise])} with it."
        for rival, own in found.items()
        if own and rival != SMC
    )
    return Claim(
        letter="f",
        title="Structured and unstructured uncertainty",
        quote="The proposed controller attenuates the effort of model uncertainties from both "
        "structured uncertainties and unstructured uncertainties.",
        place="section V",
        verdict=came,
        condition=f"these are left out: {'; '.join(lost)}" if came == Verdict.ONLY_IF else "",
        rule=RULE,
        headline=f"error over that of SMC within a boundary layer: wrong model {_span(quiet)}, "
        f"noise {_span(noisy)}",
        rows=tuple(rows),
        why=(
            f"Against a wrong nominal model the error of afsmc is {_span(quiet)} times that of SMC "
            f"within a boundary layer, against noise {_span(noisy)} times."
            + rivals
            + (_EXPLAINED if came != Verdict.FAILS else "")
            + (f" It is not better at {listed(lost)}." if lost else "")
        ),
    )


def _runs(evidence: Evidence, case: Case, rival: str) -> bool:
    return evidence.measured.has(case.cell._replace(label=rival))


def _ratio(evidence: Evidence, case: Case, rival: str) -> Interval:
    return evidence.measured.ratio(case.cell, case.cell._replace(label=rival), "error")


def _span(ratios: Sequence[Interval]) -> str:
    return span([ratio.value for ratio in ratios])
