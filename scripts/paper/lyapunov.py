"""Claim (e): Lyapunov stability, in discrete time."""

from __future__ import annotations

from collections.abc import Sequence

from paper.claims import Claim, Row, Verdict, listed, number, percent, span
from paper.evidence import Evidence
from paper.stability import Outcome
from paper.studies import MODELS, RATE
from paper.variants import SIGN, by_hand

NEVER = 1e-3  # share of periods that counts as none [1]


def share(grown: int, periods: int) -> float:
    """Share of periods over which V grew; 0 where there are none [1]."""
    return grown / periods if periods else 0.0


def falls(outcome: Outcome) -> bool:
    """Whether V falls outside the boundary layer and the arm stays within its limits."""
    grown = share(outcome.grown_outside, outcome.outside)
    return not outcome.diverged and grown <= NEVER


def verdict(layered: Sequence[Outcome]) -> Verdict:
    """The rule.

    Args:
        layered: outcomes of laws with a boundary layer at the default control rate.
    """
    if not layered or not all(map(falls, layered)):
        return Verdict.FAILS
    inside = all(share(o.grown_inside, o.inside) <= NEVER for o in layered)
    return Verdict.HOLDS if inside else Verdict.ONLY_IF


RULE = (
    "V of eqs (32) and (80) at the control instants of runs without noise. Holds if V never grows "
    f"over a control period (in at most {100 * NEVER:g} % of them); holds only if ... if it does "
    "so inside the boundary layer alone; does not hold if it grows outside of it, or an arm is lost"
)


def claim(evidence: Evidence) -> Claim:
    """The claim with its numbers."""
    layered = [o for o in evidence.outcomes if o.label != by_hand(SIGN)]
    sign = [o for o in evidence.outcomes if o.label == by_hand(SIGN)]
    here = [o for o in layered if o.rate == RATE]
    came = verdict(here)
    rates = sorted({o.rate for o in layered})
    fine = [rate for rate in rates if all(map(falls, (o for o in layered if o.rate == rate)))]
    bad = [f"{rate:g} Hz" for rate in rates if rate not in fine]
    rows = [row for outcome in (*here, *sign, *layered) for row in _rows(outcome)]
    outside = sum(o.outside for o in here)
    inside = [100.0 * share(o.grown_inside, o.inside) for o in here]
    covered = sum(o.covered for o in here)
    jumps = [100.0 * share(o.grown_outside, o.outside) for o in sign if o.rate == RATE]
    return Claim(
        letter="e",
        title="Lyapunov stability in discrete time",
        quote="On Line Tuning Premise and Consequence FIS Based on Lyapunov Theory; V' is negative "
        "semidefinite [...] lim s(t) = 0",
        place="title; section III, eqs (80)-(87)",
        verdict=came,
        condition=(
            "V is asked to fall outside the boundary layer alone, within which it stays bounded"
            if came == Verdict.ONLY_IF
            else ""
        ),
        rule=RULE,
        headline=f"V grew over {sum(o.grown_outside for o in here)} of {outside} periods outside "
        f"the layer, {span(inside, '%')} of those inside; with sgn {span(jumps, '%')} of all",
        rows=tuple(dict.fromkeys(rows)),
        why=(
            "In continuous time the corrected law has the V' that the proof says; octarm validate "
            "--controllers checks that at random states. Sampled, with the control held for "
            f"{1e3 / RATE:g} ms and sat in place of sgn, V fell over all but "
            f"{sum(o.grown_outside for o in here)} of the {outside} periods that began outside the "
            "boundary layer"
            + f", with all of V of eq (80) for the adaptive law; within it V grew in "
            f"{number(min(inside))} to {number(max(inside))} % of the periods, and 1/2 s^T D s "
            f"stayed below {number(max(o.bound for o in here))} J. That is ultimate boundedness, "
            "which is all that a saturation can promise, and not the limit s = 0. With sgn(s) V "
            f"grew in {number(min(jumps))} to {number(max(jumps))} % of all periods: a sampled sgn "
            "overshoots the surface at every step, and the bound falls with the period "
            f"({_bounds(sign)}). "
            + (
                f"At {listed(bad)} V grows outside the layer as well, or an arm is lost. "
                if bad
                else ""
            )
            + f"The gains cover the model error, as the proof asks, in {covered} of {len(here)} of "
            "these runs; the outcome "
            "is the same in the others."
        ),
    )


def _rows(o: Outcome) -> list[Row]:
    where = f"{o.label}, {o.rate:g} Hz, model {percent(o.mismatch)}"
    found = [Row.exact(f"{where}: largest 1/2 s^T D s after 2 s", 1e3 * o.bound, "mJ")]
    for name, grown, periods in (
        ("outside", o.grown_outside, o.outside),
        ("inside", o.grown_inside, o.inside),
    ):
        if periods:
            told = f"{where}: V grew {name} the layer, of {periods} periods"
            found.insert(0, Row.exact(told, 100.0 * share(grown, periods), "%"))
    return found


def _bounds(sign: Sequence[Outcome]) -> str:
    """The ultimate bounds with sgn(s) at each rate, with the exact model."""
    own = [o for o in sorted(sign, key=lambda o: o.rate) if o.mismatch == MODELS[0]]
    return ", ".join(f"{number(1e3 * o.bound)} mJ at {o.rate:g} Hz" for o in own)
