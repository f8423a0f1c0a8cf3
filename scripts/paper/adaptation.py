"""Claims (d) to (g): premises, Lyapunov stability, uncertainty, computational load."""

from __future__ import annotations

from collections.abc import Sequence

from octarm.reports.statistics import Interval
from paper.claims import Examined, Row, Verdict, exact, number, percent
from paper.evidence import Cell, Evidence
from paper.lyapunov import Outcome
from paper.runs import ARMS
from paper.studies import BENDS, BEYOND, MODELS, NOISE, RATE, SLIDES, WRONG
from paper.tracking import place_of
from paper.variants import (
    CONSEQUENT,
    FIXED_PREMISES,
    INTEGRAL,
    MATCHED,
    PROPOSED,
    SIGN,
    SMC,
    by_hand,
)

HELPS = 0.98  # errors at least 2 % smaller [1]
NEVER = 1e-3  # share of periods that counts as none [1]
BETTER = 0.95  # errors at least 5 % smaller [1]
MODERATE = 0.1  # share of the control period [1]


def below(limit: float, ratio: Interval) -> bool:
    """Whether a ratio is at most so large, and its interval ends below 1."""
    return bool(ratio.value <= limit and ratio.high < 1.0)


def helps(ratio: Interval) -> bool:
    """Whether an error ratio says that adapting the premises helps."""
    return below(HELPS, ratio)


def premises_verdict(
    noisy: Sequence[Interval], quiet: Sequence[Interval], tuned: Sequence[Interval]
) -> Verdict:
    """The rule of claim (d).

    Args:
        noisy: error of `afsmc` over that with eta3 = eta4 = 0 and the same other gains, with noise.
        quiet: likewise without noise.
        tuned: error of `afsmc` over that of `afsmc-consequent`, tuned by itself.
    """
    if not noisy or not all(map(helps, noisy)):
        return Verdict.FAILS
    return Verdict.HOLDS if all(map(helps, (*quiet, *tuned))) else Verdict.ONLY_IF


def premises(evidence: Evidence) -> Examined:
    """Claim (d): adapting the premises as well as the consequents helps."""
    cells = [
        cell
        for noise in (NOISE, 0.0)
        for reference in (BENDS, SLIDES)
        for cell in evidence.known(Cell(PROPOSED, reference=reference, noise=noise).models())
    ]
    fixed, tuned = (_ratios(evidence, cells, label) for label in (FIXED_PREMISES, CONSEQUENT))
    by_hands = [
        cell
        for cell in evidence.known(Cell(by_hand(PROPOSED), noise=NOISE).models())
        if evidence.has(cell._replace(label=by_hand(CONSEQUENT)))
    ]
    pairs = {
        FIXED_PREMISES: fixed,
        CONSEQUENT: tuned,
        by_hand(CONSEQUENT): _ratios(evidence, by_hands, by_hand(CONSEQUENT)),
    }
    rows = [
        Row(place_of(cell, f"{cell.label} over {label}"), ratio)
        for label, own in pairs.items()
        for cell, ratio in own
    ]
    noisy = [ratio for cell, ratio in fixed if cell.noise]
    quiet = [ratio for cell, ratio in fixed if not cell.noise]
    against_tuned = [ratio for _, ratio in tuned]
    numbers = {
        "helps": HELPS,
        "noisy": noisy,
        "quiet": quiet,
        "tuned": [ratio for cell, ratio in tuned if cell.noise],
        "counts": [
            f"{sum(map(helps, ratios))} of {len(ratios)}"
            for ratios in (noisy, quiet, against_tuned)
        ],
        "chattering": [
            evidence.ratio(cell, FIXED_PREMISES, "chattering").value
            for cell, _ in fixed
            if cell.noise
        ],
    }
    return Examined(premises_verdict(noisy, quiet, against_tuned), rows, numbers)


def _ratios(evidence: Evidence, cells: Sequence[Cell], label: str) -> list[tuple[Cell, Interval]]:
    """The errors of cells over those of another variant, where that was run."""
    both = [cell for cell in cells if evidence.has(cell._replace(label=label))]
    return [(cell, evidence.ratio(cell, label)) for cell in both]


def share(grown: int, periods: int) -> float:
    """Share of periods over which V grew; 0 where there are none [1]."""
    return grown / periods if periods else 0.0


def falls(outcome: Outcome) -> bool:
    """Whether V falls outside the boundary layer and the arm stays within its limits."""
    return not outcome.diverged and share(outcome.grown_outside, outcome.outside) <= NEVER


def lyapunov_verdict(layered: Sequence[Outcome]) -> Verdict:
    """The rule of claim (e), given laws with a boundary layer at the default control rate."""
    if not layered or not all(map(falls, layered)):
        return Verdict.FAILS
    inside = all(share(o.grown_inside, o.inside) <= NEVER for o in layered)
    return Verdict.HOLDS if inside else Verdict.ONLY_IF


def stability(evidence: Evidence) -> Examined:
    """Claim (e): Lyapunov stability, in discrete time."""
    layered = [o for o in evidence.outcomes if o.label != by_hand(SIGN)]
    sign = [o for o in evidence.outcomes if o.label == by_hand(SIGN)]
    here = [o for o in layered if o.rate == RATE]
    jumps = [100.0 * share(o.grown_outside, o.outside) for o in sign if o.rate == RATE]
    bad = {o.rate for o in layered if not falls(o)}
    numbers = {
        "never": 100.0 * NEVER,
        "period": 1e3 / RATE,
        "grown": sum(o.grown_outside for o in here),
        "outside": sum(o.outside for o in here),
        "inside": [100.0 * share(o.grown_inside, o.inside) for o in here],
        "bound": max(o.bound for o in here),
        "jumps": jumps,
        "bounds": [
            f"{number(1e3 * o.bound)} mJ at {o.rate:g} Hz"
            for o in sorted(sign, key=lambda o: o.rate)
            if o.mismatch == MODELS[0]
        ],
        "bad_rates": [f"{rate:g} Hz" for rate in sorted(bad)],
        "covered": sum(o.covered for o in here),
        "runs": len(here),
    }
    rows = [row for outcome in (*here, *sign, *layered) for row in _outcome_rows(outcome)]
    return Examined(lyapunov_verdict(here), tuple(dict.fromkeys(rows)), numbers)


def _outcome_rows(o: Outcome) -> list[Row]:
    where = f"{o.label}, {o.rate:g} Hz, model {percent(o.mismatch)}"
    parts = (("inside", o.grown_inside, o.inside), ("outside", o.grown_outside, o.outside))
    grown = [
        exact(
            f"{where}: V grew {side} the layer, of {periods} periods",
            100.0 * share(count, periods),
            "%",
        )
        for side, count, periods in parts
        if periods
    ]
    return [*grown, exact(f"{where}: largest 1/2 s^T D s after 2 s", 1e3 * o.bound, "mJ")]


def better(ratio: Interval) -> bool:
    """Whether an error ratio says that the proposed controller is better."""
    return below(BETTER, ratio)


def uncertainty_verdict(ratios: Sequence[Interval]) -> Verdict:
    """The rule of claim (f), given the errors of the proposed controller over those of SMC."""
    if ratios and all(map(better, ratios)):
        return Verdict.HOLDS
    return Verdict.ONLY_IF if any(map(better, ratios)) else Verdict.FAILS


def uncertain_cells() -> dict[Cell, str]:
    """The cells of the proposed controller with uncertainty, and their names."""
    cells = {
        cell: f"{reading}, model {percent(cell.mismatch)}" + (", 40 % noise" if noise else "")
        for reference, reading in ((BENDS, "bends"), (SLIDES, "slides"))
        for noise in (0.0, NOISE)
        for cell in Cell(PROPOSED, reference=reference, noise=noise).models()
        if cell.mismatch or noise
    }
    for name, beyond in BEYOND.items():
        cell = Cell(PROPOSED, "beyond", mismatch=WRONG)._replace(**{name: beyond.value})
        value = f"{beyond.factor * beyond.value:g} {beyond.unit}"
        cells[cell] = f"bends, model {percent(WRONG)}, {name} {value}"
    return cells


def uncertainty(evidence: Evidence) -> Examined:
    """Claim (f): performance under structured and unstructured uncertainty."""
    names = uncertain_cells()
    cells = evidence.known(list(names))
    ratios = {rival: _ratios(evidence, cells, rival) for rival in (SMC, INTEGRAL, MATCHED)}
    rows = [
        Row(f"afsmc over {rival}: {names[cell]}", ratio)
        for rival, own in ratios.items()
        for cell, ratio in own
    ]
    rivals = [
        (rival, [r for c, r in own if not c.noise], [r for c, r in own if c.noise])
        for rival, own in ratios.items()
        if own and rival != SMC
    ]
    numbers = {
        "better": BETTER,
        "quiet": [r for c, r in ratios[SMC] if not c.noise and c.study == "tracking"],
        "noisy": [r for c, r in ratios[SMC] if c.noise],
        "rivals": rivals,
        "lost": [names[cell] for cell, ratio in ratios[SMC] if not better(ratio)],
    }
    return Examined(uncertainty_verdict([ratio for _, ratio in ratios[SMC]]), rows, numbers)


def load_verdict(taken: float) -> Verdict:
    """The rule of claim (g), given the share of the control period that a step takes [1]."""
    return Verdict.HOLDS if taken <= MODERATE else Verdict.FAILS


def load(evidence: Evidence) -> Examined:
    """Claim (g): a moderate computational load; its numbers are timings, which differ."""
    costs, rules = evidence.costs, len(evidence.variants[PROPOSED].gains["alpha0"])
    proposed, smc = costs[PROPOSED], costs[SMC]
    rows = [
        exact("rules of afsmc, one input each, a joint", rules),
        exact("rules of fuzzy, two inputs each, a joint", 49.0),
        *(
            exact(f"{label}: a step, an arm of {ARMS}", 1e6 * cost.many, "us", varies=True)
            for label, cost in costs.items()
        ),
        *(
            exact(f"{label}: a step, one arm alone", 1e6 * cost.alone, "us", varies=True)
            for label, cost in costs.items()
        ),
        exact("afsmc over smc-boundary", proposed.many / smc.many, varies=True),
    ]
    numbers = {
        "moderate": 100.0 * MODERATE,
        "period": 1e3 / RATE,
        "step": 1e6 * proposed.many,
        "taken": 100.0 * proposed.many * RATE,
        "over_smc": proposed.many / smc.many,
        "rules": rules,
        "most": 1e6 * MODERATE / RATE,
    }
    return Examined(load_verdict(proposed.many * RATE), rows, numbers)
