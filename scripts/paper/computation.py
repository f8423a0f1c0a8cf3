"""Claim (g): a moderate computational load."""

from __future__ import annotations

from paper.claims import Claim, Row, Verdict, number
from paper.evidence import Evidence
from paper.load import ARMS
from paper.studies import RATE
from paper.variants import PROPOSED, SMC

MODERATE = 0.1  # share of the control period [1]


def verdict(shares: float) -> Verdict:
    """The rule, given the share of the control period that a step's arithmetic takes [1]."""
    return Verdict.HOLDS if shares <= MODERATE else Verdict.FAILS


RULE = (
    f"holds if the arithmetic of a step takes at most {100 * MODERATE:g} % of the control period "
    f"of {1e3 / RATE:g} ms on one core; else it does not hold"
)


def claim(evidence: Evidence) -> Claim:
    """The claim; its numbers are timings, which differ from run to run."""
    costs, gains = evidence.costs, evidence.cast.tuned[PROPOSED].gains
    rules = len(gains["alpha0"])
    rows = [
        Row.exact("rules of afsmc, one input each, a joint", rules),
        Row.exact("rules of fuzzy, two inputs each, a joint", 49.0),
        *(
            Row.exact(f"{label}: a step, an arm of {ARMS}", 1e6 * cost.many, "us", varies=True)
            for label, cost in costs.items()
        ),
        *(
            Row.exact(f"{label}: a step, one arm alone", 1e6 * cost.alone, "us", varies=True)
            for label, cost in costs.items()
        ),
        Row.exact("afsmc over smc-boundary", costs[PROPOSED].many / costs[SMC].many, varies=True),
    ]
    return Claim(
        letter="g",
        title="Computational load",
        quote="The addition of an adaptive law to a fuzzy sliding mode controller to online tune "
        "the parameters of the fuzzy rules in use will ensure a moderate computational load.",
        place="abstract",
        verdict=verdict(costs[PROPOSED].many * RATE),
        condition="",
        rule=RULE,
        headline=f"{number(1e6 * costs[PROPOSED].many)} us a step, "
        f"{number(100 * costs[PROPOSED].many * RATE)} % of the control period, "
        f"{number(costs[PROPOSED].many / costs[SMC].many)} times SMC",
        rows=tuple(rows),
        why=(
            f"{number(rules)} rules with one input for each joint, adapted at every step, are "
            "little arithmetic beside the nominal model, which every model-based controller works "
            "out as well. Stepped side by side with others, where Python's own cost for each call "
            f"vanishes, a step must stay below {1e6 * MODERATE / RATE:g} us; the timings stand in "
            "a table of their own, as they differ from machine to machine. A static rule base with "
            "two inputs for each joint needs 49 rules a joint for the same coverage."
        ),
    )
