"""Claims (a) to (g) and our own questions: what is compared, where, and with which threshold.

Each function gives the cases of one claim. Both sides of a comparison have the same gain set, the
same joints, the same nominal model and the same noise. SMC is read in both ways that the paper
has: with sgn(s) and with a boundary layer.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from octarm.reports.statistics import Interval
from paper import studies, variants
from paper.claims import Case, Row, exact, percent
from paper.evidence import Evidence, interval
from paper.runs import ARMS, Series, name_of
from paper.studies import BEYOND, MEAN, MODELS, MOVING, NOISE, RATE, READINGS, Cell
from paper.variants import BY_HAND, FIXED_RULES, PROPOSED, SIGN, SMC, TUNED, by_hand, with_gains

OVERSHOOT = 3.0  # of SMC, by the paper [%]
# The threshold of each claim; verdicts are also given with half and with twice as much.
DIGIT = 0.5  # (a): what rounds to the paper's numbers [%]
SLIGHT = 5.0  # (b): oscillations that are no longer slight [% of the amplitude]
VISIBLE, ABSENT = 0.1, 0.5  # what can be seen [%]; share of SMC's that counts as none [1]
CHATTERING = 0.5  # (c): of the arm's weight; the motion alone has up to 0.1 [%]
HELPS = 0.02  # (d), premises: by how much an error must be smaller [1]
NEVER = 1e-3  # (e): share of periods that counts as none [1]
BETTER = 0.05  # (f), plants: by how much an error must be smaller [1]
MODERATE = 0.1  # (g): share of the control period [1]

LAWS = {SIGN: "sgn(s)", SMC: "a boundary layer"}  # what "SMC" may be
RIVALS = {law: f"SMC with {reading}" for law, reading in LAWS.items()}
OF_WEIGHT, OF_AMPLITUDE = "% of the weight", "% of the amplitude"
Place = tuple[dict[str, str], Cell]  # in words, and as a cell of the proposed law


def overshoot(evidence: Evidence) -> Iterator[Case]:
    """(a): 3 % overshoot with sliding mode, none with the proposed controller."""
    for where, cell in _places(evidence, noises=[0.0]):
        for reading, smc in _rivals(evidence, where, cell, LAWS):
            for joint in MOVING[cell.reference]:
                ours, theirs = (evidence.median(x, f"overshoot_{joint}").value for x in (cell, smc))
                rows = [exact("AFSMC overshoot", ours, "%"), exact("SMC overshoot", theirs, "%")]
                apart = max(abs(ours), abs(theirs - OVERSHOOT))
                yield Case({**where, "joint": joint, "SMC": reading}, rows, apart / DIGIT)


def oscillations(evidence: Evidence) -> Iterator[Case]:
    """(b): slight oscillations of SMC under noise, and none of the proposed controller."""
    for gains, reference in product((TUNED, BY_HAND), evidence.effort.readings):
        for law, joint, model in product(LAWS, MOVING[reference], MODELS):
            both = [name_of(with_gains(x, gains), reference) for x in (PROPOSED, law)]
            if not evidence.series.keys() >= set(both):
                continue
            where = {
                "gains": gains, "joints": READINGS[reference], "joint": joint,
                "model": percent(model), "noise": _noise(NOISE), "SMC": LAWS[law],
            }  # fmt: skip
            own, theirs = (_moved(evidence.series[x], joint, model) for x in both)
            with np.errstate(all="ignore"):
                size, ratio = interval(theirs), interval(own / theirs)
            rows = [Row("AFSMC, rms", interval(own), OF_AMPLITUDE), Row("AFSMC over SMC", ratio)]
            slight = size.value / SLIGHT if size.value >= VISIBLE else np.inf
            yield Case({**where, "of": "SMC"}, [Row("SMC, rms", size, OF_AMPLITUDE)], slight)
            yield Case({**where, "of": "AFSMC"}, rows, ratio.value / ABSENT)


def _moved(series: Series, joint: str, model: float) -> np.ndarray:
    """How far noise moves a joint with this model, an entry a seed [% of its amplitude]."""
    place = studies.COORDINATES.index(joint)
    arms = (series.mismatch == model) & (series.noise == NOISE)
    return 100.0 * series.moved[arms, place] / (0.5 * np.ptp(series.q_d[:, place]))


def chattering(evidence: Evidence) -> Iterator[Case]:
    """(c): chattering is eliminated."""
    for law, name in ((PROPOSED, "sat(s / phi)"), (variants.AS_PRINTED, "sgn(s)")):
        for where, cell in _places(evidence, law, noises=[0.0]):
            size = evidence.median(cell, "chattering")
            smc = [
                Row(rival, evidence.median(other, "chattering"), OF_WEIGHT)
                for rival, other in _rivals(evidence, where, cell, RIVALS)
            ]
            rows = [Row("AFSMC", size, OF_WEIGHT), *smc]
            yield Case({**where, "compensation": name}, rows, size.value / CHATTERING)


def rules(evidence: Evidence) -> Iterator[Case]:
    """(d): adapting the weights of the rules improves tracking."""
    return _against(evidence, _places(evidence), {FIXED_RULES: "fixed weights"}, HELPS)


def premises(evidence: Evidence) -> Iterator[Case]:
    """Whether adapting the premises as well improves it further."""
    rivals = {
        variants.FIXED_PREMISES: "fixed premises",
        variants.CONSEQUENT: "the law without premises",
    }
    return _against(evidence, _places(evidence), rivals, HELPS)


def stability(evidence: Evidence) -> Iterator[Case]:
    """(e): V falls over every control period, at the default rate."""
    for o in evidence.outcomes:
        law = o.label.removesuffix(by_hand(""))
        outside, inside = (o.grown_outside, o.outside), (o.grown_inside, o.inside)
        for side, (grown, periods) in (("outside", outside), ("inside", inside)):
            if o.rate == RATE and periods:
                where = {
                    "gains": TUNED if law == o.label else BY_HAND,
                    "joints": READINGS[o.reference], "model": percent(o.mismatch), "law": law,
                    "side": "everywhere, without a layer" if law == SIGN else side,
                }  # fmt: skip
                rows = [exact(f"V grew, of {periods} periods", 100.0 * grown / periods, "%")]
                if side == "outside" and o.inside:
                    rows.append(exact("of them after start-up", o.late))
                share = np.inf if o.diverged else grown / periods
                yield Case(where, rows, share / NEVER)


def uncertainty(evidence: Evidence) -> Iterator[Case]:
    """(f): performance under structured and unstructured uncertainty."""
    places = [
        ({**where, "kind": "noise" if cell.noise else "a wrong model"}, cell)
        for where, cell in _places(evidence) if cell.mismatch or cell.noise
    ]  # fmt: skip
    for where, cell in _places(evidence, study="beyond", noises=[0.0]):
        for name, words, value in ((n, *x) for n, sizes in BEYOND.items() for x in sizes.items()):
            place = {**where, "kind": name, "size": f"{name} {words}"}
            places.append((place, cell._replace(**{name: value})))
    rivals = {FIXED_RULES: "the same law without its estimator", **RIVALS}
    return _against(evidence, places, rivals, BETTER)


def load(evidence: Evidence) -> Iterator[Case]:
    """(g): a moderate computational load."""
    ours, smc = evidence.costs[PROPOSED], evidence.costs[SMC]
    sorts = (("one arm", ours.alone, smc.alone), (f"an arm of {ARMS}", ours.many, smc.many))
    for arms, taken, other in sorts:
        rows = [
            exact("a step", 1e6 * taken, "us"),
            exact("of the control period", 100.0 * taken * RATE, "%"),
            exact("over smc-boundary", taken / other),
        ]
        yield Case({"arms": arms}, rows, taken * RATE / MODERATE)


def plants(evidence: Evidence) -> Iterator[Case]:
    """Whether AFSMC is better than SMC when the arm is not its model."""
    places: list[Place] = []
    for cell, *_ in evidence.plants():
        where = {"gains": TUNED, "plant": f"{cell.plant} modules",
                 "period": f"{1e3 / cell.rate:g} ms", "noise": _noise(cell.noise)}  # fmt: skip
        if cell.plant > studies.MODULES:
            places.append((where, cell._replace(label=PROPOSED)))
    return _against(evidence, places, RIVALS, BETTER)


def _places(
    evidence: Evidence,
    law: str = PROPOSED,
    *,
    study: str = "tracking",
    noises: Sequence[float] = (0.0, NOISE),
) -> Iterator[Place]:
    """The cells of a law with both gain sets, both readings and all models, and where they are."""
    for gains, reference, noise in product((TUNED, BY_HAND), READINGS, noises):
        cell = Cell(with_gains(law, gains), study, reference, MEAN, noise)
        for own, model in zip(cell.models(), MODELS, strict=True):
            if evidence.has(own):
                yield {
                    "gains": gains, "joints": READINGS[reference], "model": percent(model),
                    "noise": _noise(noise),
                }, own  # fmt: skip


def _rivals(
    evidence: Evidence, where: Mapping[str, str], cell: Cell, rivals: Mapping[str, str]
) -> Iterator[tuple[str, Cell]]:
    """The same place for other laws with the same gain set, and their names, if all was run."""
    for law, name in rivals.items():
        rival = cell._replace(label=with_gains(law, where["gains"]))
        if evidence.has(cell, rival):
            yield name, rival


def _against(
    evidence: Evidence, places: Iterable[Place], rivals: Mapping[str, str], by: float
) -> Iterator[Case]:
    """A case for each rival that was run in a place: whether its error is larger, by a share."""
    for where, cell in places:
        for name, rival in _rivals(evidence, where, cell, rivals):
            row = Row("error over that", evidence.ratio(cell, rival.label))
            yield Case({**where, "against": name}, [row], most=how_often(row.number, by))


def how_often(ratio: Interval, share: float) -> float:
    """How many times a share a ratio is below 1; none if its interval is not."""
    return (1.0 - ratio.value) / share if ratio.high < 1.0 else -math.inf


def _noise(noise: float) -> str:
    return f"{100 * noise:g} % noise" if noise else "no noise"


CLAIMS = (overshoot, oscillations, chattering, rules, stability, uncertainty, load)
QUESTIONS = (premises, plants)
