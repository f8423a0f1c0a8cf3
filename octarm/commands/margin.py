"""What `octarm margin` does."""

from __future__ import annotations

import csv
import dataclasses
import functools
import io
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from tqdm import tqdm

from controllers import make_controller
from octarm.disturbances.spelling import parse_disturbance, spelling
from octarm.errors import ExitCode, OctarmError
from octarm.files import write_text
from octarm.formats import to_json
from octarm.runs.versions import host, versions
from octarm.sweeps.margin import (
    NOMINAL,
    Attempt,
    Brackets,
    MarginRuns,
    Varied,
    is_varied,
    margin_of,
    parse_bound,
    parse_varied,
    search,
)
from octarm.sweeps.workers import cores

if TYPE_CHECKING:
    from octarm.arm.parameters import ArmParameters
    from octarm.interfaces import Controller
    from octarm.options.sweeps import Margin

_NUMBERS = ("margin", "interval_low", "interval_high", "least", "median", "most")


def margin(options: Margin) -> int:
    """`octarm margin`: how much each controller bears, as a table."""
    _check(options)
    varied = _varied(options)
    trials = _trials(options, varied)
    for trial in trials.values():
        trial.rehearse()
    print("\n".join(_heading(options, varied)), flush=True)
    rows: list[Mapping[str, Any]] = []
    for name, trial in trials.items():
        brackets = _search(name, trial, options)
        rows.append(_row(name, brackets, options.share, varied))
        print(_line(rows[-1], varied), flush=True)
    _print_notes(rows, varied, options)
    if options.csv is not None:
        write_text(options.csv, _csv(rows))
    if options.json is not None:
        write_text(options.json, to_json(_report(options, varied, rows)))
    return ExitCode.FINE


def _trials(options: Margin, varied: Varied) -> dict[str, MarginRuns]:
    """The runs of each controller."""
    fixed = [parse_disturbance(text) for text in options.disturbance if not is_varied(text)]
    bounds = [parse_bound(text) for text in options.bound]
    return {
        name: MarginRuns(
            factory=functools.partial(_controller, name, options.gains),
            varied=varied,
            bounds=bounds,
            disturbances=fixed,
            mismatch=options.mismatch,
            reference=options.reference,
            duration=options.duration,
            timestep=options.timestep,
            control_period=options.control_period,
            seed=options.seed,
            threads=cores(),
        )
        for name in options.controllers
    }


def _controller(name: str, gain_set: str | None, nominal: ArmParameters) -> Controller:
    return make_controller(name, nominal, gain_set=gain_set)


def _check(options: Margin) -> None:
    """Raises ValueError for options that cannot be meant."""
    if not options.controllers:
        raise OctarmError("no controller is given; octarm run --help names them")
    if not options.bound:
        raise OctarmError("no bound is given; --bound METRIC:VALUE, such as tip_rms_error:0.01")
    if options.seeds < 1:
        raise OctarmError(f"seeds is {options.seeds}; it must be at least 1")
    if options.seed < 0:
        raise OctarmError(f"seed is {options.seed}; it must be at least 0")
    if not 0.0 < options.share <= 1.0:
        raise OctarmError(f"share is {options.share:g}; it must be above 0 and at most 1")
    for file in (options.csv, options.json):
        if file is not None and not file.resolve().parent.is_dir():
            raise OctarmError(f"{file} cannot be written: there is no folder for it")


def _varied(options: Margin) -> Varied:
    """What varies: the one disturbance without a value."""
    open_ = [text for text in options.disturbance if is_varied(text)]
    if len(open_) != 1:
        given = " and ".join(open_) or "none"
        raise OctarmError(
            "one --disturbance goes without a value, the one whose largest value is sought; "
            f"here it is {given}"
        )
    varied = parse_varied(open_[0], options.low, options.high)
    if varied.name == NOMINAL and options.mismatch:
        raise OctarmError(f"--mismatch is given, but {NOMINAL} is what varies")
    return varied


def _search(name: str, trial: MarginRuns, options: Margin) -> Brackets:
    """The brackets of one controller, with a bar on the progress."""
    with tqdm(
        desc=name, total=0, unit=" simulated s", unit_scale=True, disable=None, leave=False
    ) as bar:
        counted = dataclasses.replace(trial, progress=bar.update)

        def attempt(seeds: np.ndarray, shares: np.ndarray) -> Attempt:
            bar.total = (bar.total or 0.0) + len(seeds) * trial.duration
            values = trial.varied.at(np.array([shares.min(), shares.max()]))
            bar.set_postfix_str(f"{len(seeds)} arms, {values[0]:.4g} .. {values[1]:.4g}")
            return counted(seeds, shares)

        return search(attempt, options.seeds)


def _row(name: str, brackets: Brackets, share: float, varied: Varied) -> dict[str, Any]:
    """What is known of one controller; inf: beyond the high value, -inf: not even the low one."""
    found = margin_of(brackets, share)
    margins = np.sort(brackets.margins)
    middle = margins[(len(margins) - 1) // 2]
    shares = dict(zip(_NUMBERS, (*found, margins[0], middle, margins[-1]), strict=True))
    return {
        "controller": name,
        **{key: float(varied.at(value)) for key, value in shares.items()},
        "met_again": int(brackets.again.sum()),
        "alike": brackets.alike,
        "met": varied.at(brackets.met).tolist(),
        "failed": varied.at(brackets.failed).tolist(),
        "grid": varied.at(brackets.grid).tolist(),
        "share_that_met": np.mean(brackets.excess <= 1.0, axis=0).tolist(),
    }


def _heading(options: Margin, varied: Varied) -> list[str]:
    """What the table is of."""
    unit = "" if varied.unit == "1" else f" [{varied.unit}]"
    bounds = " and ".join(options.bound).replace(":", " <= ")
    fixed = [text for text in options.disturbance if not is_varied(text)]
    around = [f"{options.reference}, {options.duration:g} s"]
    around += [f"nominal model wrong by {options.mismatch:g}"] if options.mismatch else []
    around += [spelling(parse_disturbance(text)) for text in fixed]
    seeds = f"{options.share:.0%} of {options.seeds} seeds"
    return [
        f"largest {varied.name}{unit} of {varied.low:g} .. {varied.high:g} at which {seeds} have "
        f"{bounds}",
        f"({'; '.join(around)})",
        f"{'controller':<18}{'margin':>10}  {'95 % interval':<24}{'least':>10}{'median':>10}"
        f"{'most':>10}",
    ]


def _line(row: Mapping[str, Any], varied: Varied) -> str:
    """A row of the table."""
    value, low, high, least, median, most = (_spelt(row[key], varied) for key in _NUMBERS)
    interval = "" if math.isnan(row["interval_low"]) else f"{low} .. {high}"
    mark = "  *" if row["met_again"] else ""
    return (
        f"{row['controller']:<18}{value:>10}  {interval:<24}{least:>10}{median:>10}{most:>10}{mark}"
    )


def _spelt(value: float, varied: Varied) -> str:
    if math.isinf(value):
        return f"> {varied.high:g}" if value > 0.0 else "fails"
    return f"{value:.4g}"


def _print_notes(rows: Sequence[Mapping[str, Any]], varied: Varied, options: Margin) -> None:
    """What a reader of the table has to know."""
    ends = [row[key] for row in rows for key in _NUMBERS]
    if math.inf in ends:
        print(f"> {varied.high:g}: the bound is met there, too; a further --high finds the margin")
    if -math.inf in ends:
        print(f"fails: the bound is broken at {varied.low:g} already")
    if any(row["alike"] for row in rows):
        print("no interval: nothing random acts, all seeds are the same; --disturbance noise:0.4?")
    print(
        "taken for granted between the values that were tried: what breaks the bound breaks it "
        "further on, too"
    )
    for row in rows:
        if row["met_again"]:
            print(
                f"* {row['controller']}: not so, {row['met_again']} of {options.seeds} seeds meet "
                "the bound again further on; the margin is that of the first failure"
            )


def _csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """The table; inf and -inf as above, nothing where there is no interval."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(("controller", *_NUMBERS, "met_again"))
    for row in rows:
        numbers = ["" if math.isnan(row[key]) else repr(row[key]) for key in _NUMBERS]
        writer.writerow((row["controller"], *numbers, row["met_again"]))
    return text.getvalue()


def _report(options: Margin, varied: Varied, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Everything, for a JSON file."""
    settings = {
        key: value
        for key, value in dataclasses.asdict(options).items()
        if key not in ("csv", "json", "controllers", "low", "high")
    }
    return {
        "varied": {
            "name": varied.name,
            "low": varied.low,
            "high": varied.high,
            "unit": varied.unit,
        },
        "settings": settings,
        "controllers": list(rows),
        "versions": versions(),
        "host": host(),
    }
