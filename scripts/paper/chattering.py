"""Claim (c): chattering is eliminated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from paper.claims import Claim, Row, Verdict, listed, percent, span
from paper.evidence import Evidence
from paper.measured import Cell
from paper.studies import BENDS, MODELS, NOISE, RATE, SLIDES, WRONG, study_of_rate
from paper.variants import AS_PRINTED, PROPOSED, SIGN, SMC

NONE = 0.5  # of the arm's weight: less is no chattering; the motion alone has up to 0.1 [%]


def verdict(smooth: Sequence[float], printed: Sequence[float]) -> Verdict:
    """The rule.

    Args:
        smooth: chattering of the proposed controller with sat(s / phi) [% of the weight].
        printed: likewise with sgn(s), as eq (78) is printed.
    """
    if not smooth or max(smooth) >= NONE:
        return Verdict.FAILS
    return Verdict.HOLDS if max(printed) < NONE else Verdict.ONLY_IF


RULE = (
    "chattering is the part of the generalised forces above 50 Hz, without noise, its rms over all "
    f"joints in percent of the arm's weight; less than {NONE:g} % is none. Holds if neither the "
    "law with sgn(s), as printed, nor the one with sat(s / phi) chatters with any nominal model; "
    "holds only if ... if the one with sat does not; else it does not hold"
)


def claim(evidence: Evidence) -> Claim:
    """The claim with its numbers."""
    quiet = {label: _all(evidence, label, 0.0) for label in (PROPOSED, AS_PRINTED, SIGN, SMC)}
    noisy = {label: _all(evidence, label, NOISE) for label in (PROPOSED, SMC, SIGN)}
    rates = _rates(evidence)
    came = verdict([row.value for row in quiet[PROPOSED]], [row.value for row in quiet[AS_PRINTED]])
    fine = [rate for rate, value in rates.items() if value < NONE]
    bad = [f"{rate:g} Hz" for rate in rates if rate not in fine]
    rows = [
        *(row for label in quiet for row in quiet[label]),
        *(row for label in noisy for row in noisy[label]),
        *(
            Row.exact(f"afsmc at {rate:g} Hz, model {percent(WRONG)}, no noise", value, "%")
            for rate, value in rates.items()
        ),
    ]
    return Claim(
        letter="c",
        title="Chattering",
        quote="In this method chattering is eliminated.",
        place="section V, last sentence",
        verdict=came,
        condition="sgn(s) in the compensation term (78) is replaced by sat(s / phi)"
        if came == Verdict.ONLY_IF
        else "",
        rule=RULE,
        headline=f"above 50 Hz without noise, of the arm's weight: AFSMC "
        f"{_span(quiet[PROPOSED])} % with sat, {_span(quiet[AS_PRINTED])} % with sgn; "
        f"SMC {_span(quiet[SMC])} % and {_span(quiet[SIGN])} %",
        rows=tuple(rows),
        why=(
            f"Without noise the proposed controller with a saturation has "
            f"{_span(quiet[PROPOSED])} % of the arm's weight above 50 Hz; SMC within a boundary "
            f"layer has {_span(quiet[SMC])} %. With sgn(s) as printed in (78) it has "
            f"{_span(quiet[AS_PRINTED])} %, and SMC with sgn(s) {_span(quiet[SIGN])} %. "
            + (
                "It is the saturation that removes chattering, not the adaptation, and it removes "
                "that of plain SMC as well. "
                if came == Verdict.ONLY_IF
                else ""
            )
            + (f"At {listed(bad)} it chatters even so. " if bad else "")
            + f"Under the noise every controller's force is restless, as it answers the noise: "
            f"{_span(noisy[PROPOSED])} % for the proposed one, {_span(noisy[SMC])} % for SMC "
            "within a boundary layer."
        ),
    )


def _all(evidence: Evidence, label: str, noise: float) -> list[Row]:
    """Its chattering with all nominal models and readings."""
    cells = [
        Cell(label, reference=reference, mismatch=model, noise=noise)
        for reference in (BENDS, SLIDES)
        for model in MODELS
    ]
    told = "40 % noise" if noise else "no noise"
    return [
        Row.of(
            f"{label}: {'bends' if cell.reference == BENDS else 'slides'}, "
            f"model {percent(cell.mismatch)}, {told}",
            evidence.measured.median(cell, "chattering"),
            "%",
            100.0,
        )
        for cell in evidence.known(cells)
    ]


def _rates(evidence: Evidence) -> Mapping[float, float]:
    """Chattering of the proposed controller without noise, by control rate [%]."""
    found: dict[float, float] = {}
    for rate in sorted({*evidence.effort.rates, RATE}):
        cell = Cell(PROPOSED, study_of_rate(rate), mismatch=WRONG)
        if evidence.measured.has(cell):
            found[rate] = 100.0 * float(evidence.measured.median(cell, "chattering").value)
    return found


def _span(rows: Sequence[Row]) -> str:
    return span([row.value for row in rows])
