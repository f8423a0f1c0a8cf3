"""Claims (a) to (c): overshoot, oscillations under noise, chattering."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from paper import studies
from paper.claims import Examined, Row, Verdict, exact, percent
from paper.evidence import Cell, Evidence, coordinates, interval
from paper.runs import Series, name_of
from paper.studies import BENDS, MODELS, MOVING, NOISE, RATES, SETTLED, SLIDES, TIME, WRONG
from paper.variants import AS_PRINTED, PROPOSED, SIGN, SMC, by_hand

OVERSHOOT = 3.0  # of SMC, by the paper [%]
DIGIT = 0.5  # what rounds to the paper's numbers [%]
VISIBLE, SLIGHT = 0.1, 5.0  # what can be seen in a figure, and what is no longer slight [%]
ABSENT = 0.5  # of the oscillations of SMC; with more, they are there as well [1]
CHATTERING = 0.5  # of the arm's weight: less is none; the motion alone has up to 0.1 [%]


def overshoot_verdict(smc: Sequence[float], proposed: Sequence[float]) -> Verdict:
    """The rule of claim (a).

    Args:
        smc: overshoots of SMC, over joints, model errors and gain sets [%].
        proposed: those of the proposed controller [%].
    """
    if not proposed or max(map(abs, proposed)) >= DIGIT:
        return Verdict.FAILS
    if all(abs(value - OVERSHOOT) < DIGIT for value in smc):
        return Verdict.HOLDS
    return Verdict.ONLY_IF if min(smc) <= OVERSHOOT <= max(smc) else Verdict.FAILS


def overshoot(evidence: Evidence) -> Examined:
    """Claim (a): 3 % overshoot with sliding mode, none with the proposed controller."""
    smc = {label: _overshoots(evidence, label) for label in (SMC, by_hand(SMC))}
    tuned, hand_set = ([value for _, value in pairs] for pairs in smc.values())
    proposed = _overshoots(evidence, PROPOSED)
    values = [value for _, value in proposed]
    crossing = crossing_at(*_curve(evidence, by_hand(SMC)))
    rows = [
        _largest("afsmc: overshoot furthest from 0", proposed),
        *(
            exact(f"{label}: {end} overshoot", pick([v for _, v in pairs]), "%")
            for label, pairs in smc.items()
            for end, pick in (("smallest", min), ("largest", max))
        ),
        exact(f"{by_hand(SMC)}: model error with {OVERSHOOT:g} % on theta1", 100 * crossing, "%"),
        _largest(f"{by_hand(PROPOSED)}: furthest from 0", _overshoots(evidence, by_hand(PROPOSED))),
    ]
    numbers = {
        "said": OVERSHOOT,
        "digit": DIGIT,
        "models": MODELS,
        "tuned": tuned,
        "hand_set": hand_set,
        "crossing": crossing,
        "exact": max(abs(v) for x in smc.values() for where, v in x if where.endswith("exact")),
        "proposed": max(map(abs, values)),
    }
    return Examined(overshoot_verdict([*tuned, *hand_set], values), rows, numbers)


def _overshoots(evidence: Evidence, label: str) -> list[tuple[str, float]]:
    """The overshoots without noise: where, and how much [%]."""
    return [
        (
            f"{joint}, model {percent(cell.mismatch)}",
            evidence.median(cell, f"overshoot_{joint}").value,
        )
        for reference, joints in MOVING.items()
        for cell in evidence.known(Cell(label, reference=reference).models())
        for joint in joints
    ]


def _largest(name: str, overshoots: Sequence[tuple[str, float]]) -> Row:
    where, value = max(overshoots, key=lambda pair: abs(pair[1]))
    return exact(f"{name} ({where})", value, "%")


def _curve(evidence: Evidence, label: str) -> tuple[np.ndarray, np.ndarray]:
    """Overshoot of theta1 [%] over all model errors that were tried [1]."""
    models = evidence.models(label)
    cells = [Cell(label, mismatch=model) for model in models]
    return np.array(models), np.array([evidence.median(c, "overshoot_theta1").value for c in cells])


def crossing_at(models: np.ndarray, overshoots: np.ndarray) -> float:
    """The first model error at which the overshoot passes 3 % [1]; NaN if it never does.

    Args:
        models: model errors, rising, shape (k,) [1].
        overshoots: at each of them, shape (k,) [%].
    """
    for i in range(len(models) - 1):
        low, high = overshoots[i] - OVERSHOOT, overshoots[i + 1] - OVERSHOOT
        if low * high <= 0.0 and low != high:
            return float(models[i] + (models[i + 1] - models[i]) * low / (low - high))
    return float("nan")


def oscillation_verdict(smc: Sequence[float], ratios: Sequence[float]) -> Verdict:
    """The rule of claim (b).

    Args:
        smc: oscillations of SMC in shares of the motion's amplitude [%].
        ratios: those of the proposed controller over those of SMC [1].
    """
    if not all(VISIBLE <= value <= SLIGHT for value in smc):
        return Verdict.FAILS
    return Verdict.HOLDS if max(ratios) <= ABSENT else Verdict.ONLY_IF


def oscillations(evidence: Evidence) -> Examined:
    """Claim (b): slight oscillations of SMC under noise."""
    places = [
        (reference, joint, model)
        for reference in evidence.effort.readings
        for joint in MOVING[reference]
        for model in MODELS
    ]
    moved = {
        label: [_oscillations(evidence.series[name_of(label, r)], j, m) for r, j, m in places]
        for label in evidence.effort.labels
    }
    ratios = [interval(a / b).value for a, b in zip(moved[PROPOSED], moved[SMC], strict=True)]
    mean = {label: np.mean(values, axis=0) for label, values in moved.items()}
    rows = [
        *(
            Row(f"{label}: mean of all joints and models", interval(values), "%")
            for label, values in mean.items()
        ),
        Row("afsmc over smc-boundary, mean of all", interval(mean[PROPOSED] / mean[SMC])),
        *(
            Row(f"{label}: {joint}, model {percent(model)}", interval(values), "% of amplitude")
            for label, own in moved.items()
            for (_, joint, model), values in zip(places, own, strict=True)
        ),
    ]
    numbers = {
        "visible": VISIBLE,
        "slight": SLIGHT,
        "absent": ABSENT,
        "noise": 100.0 * NOISE,
        "held": 1.0 / TIME,
        "smc": interval(mean[SMC]),
        "proposed": interval(mean[PROPOSED]),
        "ratios": ratios,
    }
    verdict = oscillation_verdict([interval(values).value for values in moved[SMC]], ratios)
    return Examined(verdict, rows, numbers)


def _oscillations(series: Series, joint: str, model: float) -> np.ndarray:
    """The oscillations of a joint, an entry a seed, shape (seeds,) [%]."""
    place = coordinates().index(joint)
    steady = series.t >= SETTLED - 1e-9
    moved = series.of(model, NOISE)[steady, :, place] - series.of(model, 0.0)[steady, :, place]
    amplitude = 0.5 * np.ptp(series.q_d[:, place])
    return np.asarray(100.0 * np.sqrt(np.mean(np.square(moved), axis=0)) / amplitude)


def chattering_verdict(smooth: Sequence[float], printed: Sequence[float]) -> Verdict:
    """The rule of claim (c).

    Args:
        smooth: chattering of the proposed controller with sat(s / phi) [% of the weight].
        printed: likewise with sgn(s), as eq (78) is printed.
    """
    if not smooth or max(smooth) >= CHATTERING:
        return Verdict.FAILS
    return Verdict.HOLDS if max(printed) < CHATTERING else Verdict.ONLY_IF


def chattering(evidence: Evidence) -> Examined:
    """Claim (c): chattering is eliminated."""
    quiet = {n: _chattering(evidence, n, 0.0) for n in (PROPOSED, AS_PRINTED, SIGN, SMC)}
    noisy = {n: _chattering(evidence, n, NOISE) for n in (PROPOSED, SMC, SIGN)}
    rates = {
        rate: evidence.median(cell, "chattering", 100.0).value
        for rate in RATES
        if evidence.has(cell := Cell(PROPOSED, studies.study_of_rate(rate), mismatch=WRONG))
    }
    rows = [
        *(row for own in (quiet, noisy) for label in own for row in own[label]),
        *(
            exact(f"afsmc at {rate:g} Hz, model {percent(WRONG)}, no noise", value, "%")
            for rate, value in rates.items()
        ),
    ]
    numbers = {
        "limit": CHATTERING,
        "smooth": quiet[PROPOSED],
        "printed": quiet[AS_PRINTED],
        "smc": quiet[SMC],
        "sign": quiet[SIGN],
        "noisy": noisy[PROPOSED],
        "noisy_smc": noisy[SMC],
        "bad_rates": [f"{rate:g} Hz" for rate, value in rates.items() if not value < CHATTERING],
    }
    smooth, printed = ([row.number.value for row in quiet[n]] for n in (PROPOSED, AS_PRINTED))
    return Examined(chattering_verdict(smooth, printed), rows, numbers)


def _chattering(evidence: Evidence, label: str, noise: float) -> list[Row]:
    """Its chattering with all nominal models and readings."""
    return [
        Row(place_of(cell, label), evidence.median(cell, "chattering", 100.0), "%")
        for reference in (BENDS, SLIDES)
        for cell in evidence.known(Cell(label, reference=reference, noise=noise).models())
    ]


def place_of(cell: Cell, label: str) -> str:
    """A cell of the main study in words, after a label."""
    reading = "bends" if cell.reference == BENDS else "slides"
    noise = "40 % noise" if cell.noise else "no noise"
    return f"{label}: {reading}, model {percent(cell.mismatch)}, {noise}"
