"""The claims of the paper, (a) to (g): a rule for the verdict of each, and the numbers behind it.

A rule is a function of numbers alone. The words of a claim, its rule in words among them, stand in
`texts.toml`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import numpy as np

from octarm.metrics.table import SETTLED_AFTER
from octarm.reports.statistics import Interval
from paper.claims import Claim, Row, Verdict, ends, percent
from paper.evidence import NAMES, Cell, Evidence, interval
from paper.lyapunov import Outcome
from paper.runs import ARMS, Series, name_of
from paper.studies import (
    AS_PRINTED,
    BENDS,
    BEYOND,
    CONSEQUENT,
    FIXED_PREMISES,
    INTEGRAL,
    MATCHED,
    MODELS,
    MOVING,
    NOISE,
    PROPOSED,
    RATE,
    SIGN,
    SLIDES,
    SMC,
    WRONG,
    by_hand,
    study_of_rate,
)

SAID = 3.0  # (a) overshoot of SMC in the paper [%]
DIGIT = 0.5  # (a) what rounds to the paper's numbers [%]
VISIBLE, SLIGHT = 0.1, 5.0  # (b) what can be seen in a figure, and what is no longer slight [%]
ABSENT = 0.5  # (b) of the oscillations of SMC; with more, they are there as well [1]
NONE = 0.5  # (c) of the arm's weight: less is no chattering; the motion alone has up to 0.1 [%]
HELPS = 0.98  # (d) errors at least 2 % smaller [1]
NEVER = 1e-3  # (e) share of periods that counts as none [1]
BETTER = 0.95  # (f) errors at least 5 % smaller [1]
MODERATE = 0.1  # (g) share of the control period [1]


def claims(evidence: Evidence) -> list[Claim]:
    """(a) to (g)."""
    made = (overshoot, oscillation, chattering, premises, stability, uncertainty, computation)
    return [claim(evidence) for claim in made]


def less(ratio: Interval, limit: float) -> bool:
    """Whether an error ratio is small enough, and its interval below 1."""
    return bool(ratio.value <= limit and ratio.high < 1.0)


helps = functools.partial(less, limit=HELPS)
better = functools.partial(less, limit=BETTER)


def overshoot_verdict(smc: Sequence[float], proposed: Sequence[float]) -> Verdict:
    """Overshoots of SMC, over joints, model errors and gain sets, and of the proposed law [%]."""
    if not proposed or max(map(abs, proposed)) >= DIGIT:
        return Verdict.FAILS
    if all(abs(value - SAID) < DIGIT for value in smc):
        return Verdict.HOLDS
    return Verdict.ONLY_IF if min(smc) <= SAID <= max(smc) else Verdict.FAILS


def overshoot(evidence: Evidence) -> Claim:
    """(a) 3 % overshoot with sliding mode, none with the proposed controller."""
    tuned, hand, proposed, proposed_by_hand = (
        _overshoots(evidence, label) for label in (SMC, by_hand(SMC), PROPOSED, by_hand(PROPOSED))
    )
    curve = [Cell(by_hand(SMC), mismatch=model) for model in evidence.effort.mismatches]
    values = [evidence.measured.median(cell, "overshoot_theta1").value for cell in curve]
    crossing = crossing_at(np.array(evidence.effort.mismatches), np.array(values))
    rows = [
        _largest("afsmc: overshoot furthest from 0", proposed),
        *(
            Row(f"{label}: {end} overshoot", pick(overshoots.values()), "%")
            for label, overshoots in ((SMC, tuned), (by_hand(SMC), hand))
            for end, pick in (("smallest", min), ("largest", max))
        ),
        Row(f"{by_hand(SMC)}: model error with {SAID:g} % on theta1", 100.0 * crossing, "%"),
        _largest(f"{by_hand(PROPOSED)}: furthest from 0", proposed_by_hand),
    ]
    smc = [*tuned.items(), *hand.items()]
    return Claim.written(
        "a",
        overshoot_verdict([value for _, value in smc], list(proposed.values())),
        rows,
        hand=list(hand.values()),
        tuned=list(tuned.values()),
        largest=max(map(abs, proposed.values())),
        exact=max(abs(value) for where, value in smc if where.endswith("exact")),
        crossing=crossing,
        crosses=not math.isnan(crossing),
        SAID=SAID,
        DIGIT=DIGIT,
    )


def _overshoots(evidence: Evidence, label: str) -> dict[str, float]:
    """The overshoots without noise, by where [%]."""
    return {
        f"{joint}, model {percent(cell.mismatch)}": float(
            evidence.measured.median(cell, f"overshoot_{joint}").value
        )
        for cell in _known(evidence, label, 0.0)
        for joint in MOVING[cell.reference]
    }


def _largest(name: str, overshoots: dict[str, float]) -> Row:
    where, value = max(overshoots.items(), key=lambda pair: abs(pair[1]))
    return Row(f"{name} ({where})", value, "%")


def crossing_at(models: np.ndarray, overshoots: np.ndarray) -> float:
    """The first model error at which the overshoot passes 3 % [1]; NaN if it never does.

    Args:
        models: model errors, rising, shape (k,) [1].
        overshoots: at each of them, shape (k,) [%].
    """
    for i in range(len(models) - 1):
        low, high = overshoots[i] - SAID, overshoots[i + 1] - SAID
        if low * high <= 0.0 and low != high:
            return float(models[i] + (models[i + 1] - models[i]) * low / (low - high))
    return math.nan


def oscillation_verdict(smc: Sequence[float], ratios: Sequence[float]) -> Verdict:
    """Oscillations of SMC [% of the amplitude], and those of the proposed law over them [1]."""
    if not all(VISIBLE <= value <= SLIGHT for value in smc):
        return Verdict.FAILS
    return Verdict.HOLDS if max(ratios) <= ABSENT else Verdict.ONLY_IF


def oscillation(evidence: Evidence) -> Claim:
    """(b) Slight oscillations of SMC under noise."""
    effort = evidence.effort
    places = [(r, joint, m) for r in effort.references for joint in MOVING[r] for m in MODELS]
    by_label = {
        label: [_oscillations(evidence.series[name_of(label, r)], j, m) for r, j, m in places]
        for label in effort.series
    }
    means = {label: np.mean(values, axis=0) for label, values in by_label.items()}
    smc = [interval(values).value for values in by_label[SMC]]
    ratios = [interval(a / b).value for a, b in zip(by_label[PROPOSED], by_label[SMC], strict=True)]
    rows = [
        *(
            Row(f"{label}: mean of all joints and models", interval(mean), "%")
            for label, mean in means.items()
        ),
        Row("afsmc over smc-boundary, mean of all", interval(means[PROPOSED] / means[SMC])),
        *(
            Row(f"{label}: {joint}, model {percent(m)}", interval(value), "% of amplitude")
            for label, values in by_label.items()
            for (_, joint, m), value in zip(places, values, strict=True)
        ),
    ]
    together = {label: interval(mean) for label, mean in means.items()}
    return Claim.written(
        "b",
        oscillation_verdict(smc, ratios),
        rows,
        smc=together[SMC].value,
        smc_row=Row("", together[SMC], "% of the amplitude").text,
        proposed=together[PROPOSED].value,
        proposed_row=Row("", together[PROPOSED], "%").text,
        low=min(ratios),
        high=max(ratios),
        VISIBLE=VISIBLE,
        SLIGHT=SLIGHT,
        ABSENT=ABSENT,
    )


def _oscillations(series: Series, joint: str, model: float) -> np.ndarray:
    """The oscillations of a joint, an entry a seed, shape (seeds,) [%]."""
    place = NAMES.index(joint)
    steady = series.t >= SETTLED_AFTER - 1e-9
    moved = series.of(model, NOISE)[steady, :, place] - series.of(model, 0.0)[steady, :, place]
    amplitude = 0.5 * np.ptp(series.q_d[:, place])
    return np.asarray(100.0 * np.sqrt(np.mean(np.square(moved), axis=0)) / amplitude)


def chattering_verdict(smooth: Sequence[float], printed: Sequence[float]) -> Verdict:
    """Chattering of the proposed law with sat(s / phi), and with sgn(s) [% of the weight]."""
    if not smooth or max(smooth) >= NONE:
        return Verdict.FAILS
    return Verdict.HOLDS if max(printed) < NONE else Verdict.ONLY_IF


def chattering(evidence: Evidence) -> Claim:
    """(c) Chattering is eliminated."""
    quiet, noisy = (
        {
            label: [
                Row(f"{label}: {_where(cell)}", evidence.measured.percent(cell, "chattering"), "%")
                for cell in _known(evidence, label, noise)
            ]
            for label in labels
        }
        for noise, labels in (
            (0.0, (PROPOSED, AS_PRINTED, SIGN, SMC)),
            (NOISE, (PROPOSED, SMC, SIGN)),
        )
    )
    rates = {rate: Cell(PROPOSED, study_of_rate(rate), mismatch=WRONG)
             for rate in sorted({*evidence.effort.rates, RATE})}  # fmt: skip
    by_rate = {
        rate: float(evidence.measured.percent(cell, "chattering").value)
        for rate, cell in rates.items()
        if evidence.measured.has(cell)
    }
    rows = [row for rows in (*quiet.values(), *noisy.values()) for row in rows]
    rows += [
        Row(f"afsmc at {rate:g} Hz, model {percent(WRONG)}, no noise", value, "%")
        for rate, value in by_rate.items()
    ]
    calm, restless = (
        {label: [ends(row.value)[0] for row in rows] for label, rows in table.items()}
        for table in (quiet, noisy)
    )
    return Claim.written(
        "c",
        chattering_verdict(calm[PROPOSED], calm[AS_PRINTED]),
        rows,
        smooth=calm[PROPOSED],
        printed=calm[AS_PRINTED],
        smc=calm[SMC],
        sign=calm[SIGN],
        smooth_noisy=restless[PROPOSED],
        smc_noisy=restless[SMC],
        bad_rates=[f"{rate:g} Hz" for rate, value in by_rate.items() if not value < NONE],
        NONE=NONE,
    )


def premises_verdict(
    noisy: Sequence[Interval], quiet: Sequence[Interval], tuned: Sequence[Interval]
) -> Verdict:
    """The rule.

    Args:
        noisy: error of `afsmc` over that with eta3 = eta4 = 0 and the same other gains, with noise.
        quiet: likewise without noise.
        tuned: error of `afsmc` over that of `afsmc-consequent`, tuned on its own.
    """
    if not noisy or not all(map(helps, noisy)):
        return Verdict.FAILS
    return Verdict.HOLDS if all(map(helps, (*quiet, *tuned))) else Verdict.ONLY_IF


def premises(evidence: Evidence) -> Claim:
    """(d) Adapting the premises as well as the consequents helps."""
    measured = evidence.measured
    pairs = [
        cell.over(other)
        for other in (FIXED_PREMISES, CONSEQUENT)
        for cell in _known(evidence, PROPOSED, NOISE, 0.0)
    ]
    pairs += [
        cell.over(by_hand(CONSEQUENT)) for cell in Cell(by_hand(PROPOSED), noise=NOISE).models()
    ]
    ratios = {pair: measured.ratio(*pair) for pair in pairs if measured.has(*pair)}
    rows = [
        Row(f"{cell.label} over {other.label}: {_where(cell)}", ratio)
        for (cell, other), ratio in ratios.items()
    ]

    def against(label: str, *noises: float) -> list[Interval]:
        return [
            ratio
            for (cell, other), ratio in ratios.items()
            if other.label == label and cell.noise in noises
        ]

    noisy, quiet = against(FIXED_PREMISES, NOISE), against(FIXED_PREMISES, 0.0)
    tuned = against(CONSEQUENT, NOISE, 0.0)
    restless = [
        measured.ratio(*pair, "chattering").value
        for pair in ratios
        if pair[1].label == FIXED_PREMISES and pair[0].noise
    ]
    return Claim.written(
        "d",
        premises_verdict(noisy, quiet, tuned),
        rows,
        helped=[f"{sum(map(helps, group))} of {len(group)}" for group in (noisy, quiet, tuned)],
        noisy=_values(noisy),
        quiet=_values(quiet),
        louder=_values(against(CONSEQUENT, NOISE)),
        restless=restless,
        HELPS=HELPS,
    )


def falls(outcome: Outcome) -> bool:
    """Whether V falls outside the boundary layer and the arm stays within its limits."""
    return not outcome.diverged and outcome.share_outside <= NEVER


def stability_verdict(layered: Sequence[Outcome]) -> Verdict:
    """Outcomes of laws with a boundary layer at the default control rate."""
    if not layered or not all(map(falls, layered)):
        return Verdict.FAILS
    inside = all(outcome.share_inside <= NEVER for outcome in layered)
    return Verdict.HOLDS if inside else Verdict.ONLY_IF


def stability(evidence: Evidence) -> Claim:
    """(e) Lyapunov stability, in discrete time."""
    layered = [o for o in evidence.outcomes if o.label != by_hand(SIGN)]
    sign = [o for o in evidence.outcomes if o.label == by_hand(SIGN)]
    here = [o for o in layered if o.rate == RATE]
    rates = sorted({o.rate for o in layered})
    rows = [row for outcome in (*here, *sign, *layered) for row in _growth(outcome)]
    return Claim.written(
        "e",
        stability_verdict(here),
        list(dict.fromkeys(rows)),
        grown=sum(o.grown_outside for o in here),
        outside=sum(o.outside for o in here),
        inside=[100.0 * o.share_inside for o in here],
        jumps=[100.0 * o.share_outside for o in sign if o.rate == RATE],
        bound=max(o.bound for o in here),
        bounds=sorted((o.rate, 1e3 * o.bound) for o in sign if o.mismatch == MODELS[0]),
        covered=sum(o.covered for o in here),
        runs=len(here),
        bad_rates=[
            f"{rate:g} Hz" for rate in rates if not all(falls(o) for o in layered if o.rate == rate)
        ],
        NEVER=NEVER,
    )


def _growth(o: Outcome) -> list[Row]:
    where = f"{o.label}, {o.rate:g} Hz, model {percent(o.mismatch)}"
    shares = (("inside", o.share_inside, o.inside), ("outside", o.share_outside, o.outside))
    grown = [
        Row(f"{where}: V grew {side} the layer, of {periods} periods", 100.0 * share, "%")
        for side, share, periods in shares
        if periods
    ]
    return [*grown, Row(f"{where}: largest 1/2 s^T D s after 2 s", 1e3 * o.bound, "mJ")]


def uncertainty_verdict(ratios: Sequence[Interval]) -> Verdict:
    """Errors of the proposed controller over those of SMC."""
    if ratios and all(map(better, ratios)):
        return Verdict.HOLDS
    return Verdict.ONLY_IF if any(map(better, ratios)) else Verdict.FAILS


def uncertainty(evidence: Evidence) -> Claim:
    """(f) Performance under structured and unstructured uncertainty."""
    ratios = {
        rival: [
            (name, cell, evidence.measured.ratio(*cell.over(rival)))
            for name, cell in _uncertain().items()
            if evidence.measured.has(*cell.over(rival))
        ]
        for rival in (SMC, INTEGRAL, MATCHED)
    }
    rows = [
        Row(f"afsmc over {rival}: {name}", ratio)
        for rival, cases in ratios.items()
        for name, _, ratio in cases
    ]
    calm = {rival: [r.value for _, c, r in cases if not c.noise] for rival, cases in ratios.items()}
    loud = {rival: [r.value for _, c, r in cases if c.noise] for rival, cases in ratios.items()}
    return Claim.written(
        "f",
        uncertainty_verdict([ratio for _, _, ratio in ratios[SMC]]),
        rows,
        quiet=[r.value for _, c, r in ratios[SMC] if not c.noise and c.study == "tracking"],
        noisy=loud[SMC],
        rivals=[
            (rival, calm[rival], loud[rival]) for rival in (INTEGRAL, MATCHED) if ratios[rival]
        ],
        lost=[name for name, _, ratio in ratios[SMC] if not better(ratio)],
        BETTER=BETTER,
    )


def _uncertain() -> dict[str, Cell]:
    """Cells of the proposed controller in which something is uncertain, by name."""
    cells: dict[str, Cell] = {}
    for reference, reading in ((BENDS, "bends"), (SLIDES, "slides")):
        for noise in (0.0, NOISE):
            for cell in Cell(PROPOSED, reference=reference, noise=noise).models():
                if cell.mismatch or noise:
                    words = f"{reading}, model {percent(cell.mismatch)}"
                    cells[words + (", 40 % noise" if noise else "")] = cell
    for name, stress in BEYOND.items():
        cell = Cell(PROPOSED, "beyond", mismatch=WRONG)._replace(**{name: stress.tested})
        value = f"{name} {stress.factor * stress.tested:g} {stress.unit}"
        cells[f"bends, model {percent(WRONG)}, {value}"] = cell
    return cells


def computation_verdict(share: float) -> Verdict:
    """Share of the control period that a step's arithmetic takes [1]."""
    return Verdict.HOLDS if share <= MODERATE else Verdict.FAILS


def computation(evidence: Evidence) -> Claim:
    """(g) A moderate computational load; its numbers are timings, which differ from run to run."""
    costs, rules = evidence.costs, len(evidence.variants[PROPOSED].gains["alpha0"])
    many, ratio = costs[PROPOSED].many, costs[PROPOSED].many / costs[SMC].many
    rows = [
        Row("rules of afsmc, one input each, a joint", rules),
        Row("rules of fuzzy, two inputs each, a joint", 49.0),
        *(
            Row(f"{label}: a step, an arm of {ARMS}", 1e6 * cost.many, "us", varies=True)
            for label, cost in costs.items()
        ),
        *(
            Row(f"{label}: a step, one arm alone", 1e6 * cost.alone, "us", varies=True)
            for label, cost in costs.items()
        ),
        Row("afsmc over smc-boundary", ratio, varies=True),
    ]
    verdict = computation_verdict(many * RATE)
    return Claim.written("g", verdict, rows, many=many, ratio=ratio, rules=rules, MODERATE=MODERATE)


def _known(evidence: Evidence, label: str, *noises: float) -> list[Cell]:
    """The cells of a variant in both readings and with all nominal models that were run."""
    cells = [
        cell
        for noise in noises
        for reference in (BENDS, SLIDES)
        for cell in Cell(label, reference=reference, noise=noise).models()
    ]
    return [cell for cell in cells if evidence.measured.has(cell)]


def _where(cell: Cell) -> str:
    reading, noise = "bends" if cell.reference == BENDS else "slides", "40 % noise"
    model = percent(cell.mismatch)
    return f"{reading}, model {model}, {noise if cell.noise else 'no noise'}"


def _values(ratios: Sequence[Interval]) -> list[float]:
    return [float(ratio.value) for ratio in ratios]
