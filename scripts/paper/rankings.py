"""The tables on who is better than whom: ranking, joints, ablations, gain sets, tuning."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np

from octarm.reports.statistics import Interval
from paper.claims import percent
from paper.evidence import Evidence
from paper.measured import MOVING, Cell, interval
from paper.quantities import chattering_of, error_mean, error_of, scaled
from paper.studies import BENDS, MODELS, NOISE, SLIDES, WRONG
from paper.tables import Entry, Table
from paper.variants import CONSEQUENT, CONTROLLERS, INTEGRAL, PROPOSED, SMC, by_hand

_READING = {BENDS: "theta1, theta2", SLIDES: "s1, s2"}


def ranking(evidence: Evidence) -> Table:
    """The tuned controllers, the best under noise first."""
    known = [n for n in CONTROLLERS if evidence.measured.has(Cell(n, noise=NOISE))]
    order = sorted(known, key=lambda name: error_mean(evidence, name, NOISE).value)
    rows: list[tuple[Entry, ...]] = []
    for name in order:
        row: list[Entry] = [name]
        for noise in (NOISE, 0.0):
            row.append(error_mean(evidence, name, noise))
            row += [error_of(evidence, Cell(name, mismatch=m, noise=noise)) for m in MODELS]
        row += [chattering_of(evidence, Cell(name, mismatch=WRONG, noise=n)) for n in (NOISE, 0.0)]
        row.append(_over(evidence, name, SMC))
        rows.append(tuple(row))
    head = ["controller"]
    for noise in ("noise", "no noise"):
        head += [f"error, {noise} [%]", *(f"{noise}, model {percent(m)} [%]" for m in MODELS)]
    head += ["chattering, noise [%]", "chattering, no noise [%]", f"error over {SMC}, noise"]
    caption = (
        "All controllers with the gains they are shipped with, on theta1 and theta2, by their "
        "error under 40 % noise. The error is the rms over all six coordinates in percent of the "
        "motion (17.5 mm, 0.3 rad), chattering the part of the forces above 50 Hz in percent of "
        f"the arm's weight with the model at {percent(WRONG)}. Medians over seeds with 95 % "
        "intervals; without noise nothing is random."
    )
    return Table("ranking", caption, tuple(head), tuple(rows))


def joints(evidence: Evidence) -> Table:
    """The numbers of figures 1 and 2."""
    rows: list[tuple[Entry, ...]] = []
    for reference in (BENDS, SLIDES):
        for noise in (0.0, NOISE):
            for model in MODELS:
                for label in evidence.cast.labels():
                    cell = Cell(label, reference=reference, mismatch=model, noise=noise)
                    if evidence.measured.has(cell):
                        rows.append(_joint_row(evidence, cell))
    columns = (
        "joints",
        "noise",
        "model",
        "controller",
        "rms error 1 [mm, mrad]",
        "rms error 2 [mm, mrad]",
        "overshoot 1 [%]",
        "overshoot 2 [%]",
        "diverged",
    )
    caption = (
        "Figures 1 and 2 in numbers, for all variants: both readings of the paper's first two "
        "links, three nominal models, without and with the noise. mrad for theta, mm for s."
    )
    return Table("joints", caption, columns, tuple(rows))


def _joint_row(evidence: Evidence, cell: Cell) -> tuple[Entry, ...]:
    measured = evidence.measured
    moving = MOVING[cell.reference]
    errors = [scaled(measured.median(cell, f"rms_error_{j}"), 1e3) for j in moving]
    overshoots = [measured.median(cell, f"overshoot_{j}") for j in moving]
    lost, count = measured.diverged(cell)
    where = (_READING[cell.reference], percent(cell.noise).lstrip("+"), percent(cell.mismatch))
    where = (where[0], "none" if not cell.noise else where[1], where[2])
    return (*where, cell.label, *errors, *overshoots, f"{lost} of {count}")


def ablations(evidence: Evidence) -> Table:
    """What is left of `afsmc` without one of its parts, and what others reach."""
    rows: list[tuple[Entry, ...]] = []
    labels = [CONSEQUENT, SMC, INTEGRAL, *evidence.cast.ablations]
    for label in labels:
        for reference in (BENDS, SLIDES):
            for noise in (NOISE, 0.0):
                own = [Cell(label, reference=reference, mismatch=m, noise=noise) for m in MODELS]
                if all(map(evidence.measured.has, own)):
                    ratios = [_over_proposed(evidence, cell, "error") for cell in own]
                    restless = _over_proposed(evidence, own[0], "chattering")
                    told = "40 %" if noise else "none"
                    rows.append((label, _READING[reference], told, *ratios, restless))
    head = (
        "instead of afsmc",
        "joints",
        "noise",
        *(f"model {percent(m)}" for m in MODELS),
        f"chattering, model {percent(WRONG)}",
    )
    caption = (
        "Error, and chattering, over those of afsmc, seed by seed: more than 1 is worse than "
        "afsmc. The matched slope gives SMC the slope and the largest force that the bounds of "
        "afsmc allow."
    )
    return Table("ablations", caption, head, tuple(rows))


def gain_sets(evidence: Evidence) -> Table:
    """Tuned gains against hand-set ones."""
    rows: list[tuple[Entry, ...]] = []
    for name in CONTROLLERS:
        for noise in (NOISE, 0.0):
            own = [Cell(name, mismatch=m, noise=noise) for m in MODELS]
            hand = [cell._replace(label=by_hand(name)) for cell in own]
            if all(map(evidence.measured.has, (*own, *hand))):
                ratios = [
                    evidence.measured.ratio(a, b, "error") for a, b in zip(own, hand, strict=True)
                ]
                rows.append((name, "40 %" if noise else "none", *ratios))
    head = ("controller", "noise", *(f"model {percent(m)}" for m in MODELS))
    caption = (
        "Error with tuned gains over that with hand-set ones, seed by seed, theta1 and theta2."
    )
    return Table("gain-sets", caption, head, tuple(rows))


def tuning(evidence: Evidence, gains: Path) -> Table:
    """What tuning found, from the files of the gain sets."""
    rows: list[tuple[Entry, ...]] = []
    for name in CONTROLLERS:
        file = gains / f"{name}.toml"
        if name not in evidence.cast.shipped or not file.is_file():
            continue
        origin = tomllib.loads(file.read_text(encoding="utf-8"))
        if not {"tuning", "search", "long_trial"} <= set(origin):
            continue
        short, long = origin["search"], origin["long_trial"]
        costs = [float(t[key]) for t in (short, long) for key in ("cost", "recommended")]
        better = "yes" if costs[2] < costs[3] else "no"
        at = ", ".join(origin["tuning"]["at_bounds"]) or "none"
        rows.append((name, *costs, costs[3] / costs[2], better, at))
    head = (
        "controller",
        "search, tuned",
        "search, hand-set",
        "long trial, tuned",
        "long trial, hand-set",
        "hand-set over tuned",
        "tuned is better",
        "at its bounds",
    )
    caption = (
        "The objective of tuning for each controller with the same budget, seeds, input limits "
        "and search; less is better. The long trial has noise that the search did not see. From "
        "the files in controllers/gains."
    )
    return Table("tuning", caption, head, tuple(rows))


def _over(evidence: Evidence, name: str, other: str) -> Interval:
    """Error under noise over that of another controller, mean of the models, seed by seed."""
    means = [
        np.mean(
            [evidence.measured.values(Cell(n, mismatch=m, noise=NOISE), "error") for m in MODELS],
            axis=0,
        )
        for n in (name, other)
    ]
    return interval(means[0] / means[1])


def _over_proposed(evidence: Evidence, cell: Cell, quantity: str) -> Interval:
    return evidence.measured.ratio(cell, cell._replace(label=PROPOSED), quantity)
