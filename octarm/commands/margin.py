"""What `octarm margin` does."""

from __future__ import annotations

import csv
import dataclasses
import functools
import io
import math
import shlex
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from controllers import CONTROLLERS, make_controller
from octarm.arm.file import read_arm
from octarm.bars import bar as new_bar
from octarm.commands.many_runs import MarginOptions
from octarm.commands.notes import print_late, print_unsuited, starts_of
from octarm.commands.options import spelt
from octarm.declared import Code, named, short_name
from octarm.disturbances.spelling import DISTURBANCES, parse_disturbance
from octarm.disturbances.varied import NOMINAL, Varied, is_varied
from octarm.errors import OctarmError, printable
from octarm.files import write_text
from octarm.formats import to_json
from octarm.metrics.table import ACCUMULATORS, METRICS, parse_bound
from octarm.references import REFERENCES
from octarm.runs.versions import host, versions
from octarm.simulation.engines import usual_engine
from octarm.sweeps.margin import Attempt, Brackets, MarginRuns, margin_of, search, seeds_needed
from octarm.sweeps.workers import cores

_NEVER_ENOUGH = "no number of seeds has one"
_AS_GIVEN = (
    "reference", "duration", "settle", "timestep", "control_period", "seed", "start", "start_share",
    "mismatch", "plant_modules", "layout", "sensing",
)  # fmt: skip
_NUMBERS = ("margin", "interval_low", "interval_high", "least", "median", "most")


def margin(controllers: Sequence[str], options: MarginOptions) -> None:
    """`octarm margin`: how much each controller bears on each arm, as a table."""
    if not controllers:
        raise OctarmError("no controller is given; octarm run --help names them")
    varied = options.varied()
    metrics = METRICS.extended(ACCUMULATORS[word] for word in options.metric)
    words = [(CONTROLLERS, word) for word in dict.fromkeys(controllers)]
    more = [(DISTURBANCES, word) for word in options.disturbance if word != NOMINAL]
    more += [(ACCUMULATORS, word) for word in options.metric]
    names, code = named([*words, (REFERENCES, options.reference), *more])
    pairs = [(model, *each) for model in options.models for each in zip(words, names, strict=False)]
    gains, step, period = options.gain_options, options.timestep, options.control_period
    for model, (_, word), _ in pairs:
        print_unsuited(short_name(word), gains.gains, model.both()[1], step, period)
    fixed = [parse_disturbance(text) for text in options.disturbance if not is_varied(text)]
    starts = starts_of([*fixed, *varied.of(np.array([varied.high]))])
    print_late(starts, [names[len(words)]], code, options.duration)
    runs = [
        MarginRuns(
            factory=functools.partial(
                make_controller, word, gains=gains.values(), gain_set=gains.gains
            ),
            varied=varied,
            bounds=[parse_bound(text) for text in options.bound],
            disturbances=fixed,
            nominal=model.factors(),
            engine=options.engine or usual_engine(),
            parameters=model.true_arm(),
            model=None if model.model is None else read_arm(model.model),
            threads=cores(),
            catalogue=metrics,
            **{name: (vars(options) | vars(model))[name] for name in _AS_GIVEN},
        ).rehearse(options.seeds)
        for model, (_, word), _ in pairs
    ]
    rows: list[Mapping[str, Any]] = []
    for (model, _, name), run in zip(pairs, runs, strict=True):
        row = _row(name, _search(name, run, options.seeds), options.share, varied)
        rows.append({**row, "arm": model.arm or ""})
        if len(rows) == 1:  # not before it is known that there is something to say
            print("\n".join(_heading(options, varied)))
        if len(options.models) > 1 and [row["arm"] for row in rows].count(model.arm) == 1:
            print(f"{model.arm}:")
        value, low, high, *others = (_spelt(row[key], varied) for key in _NUMBERS)
        interval = "" if low == high == "?" else f"{low} .. {high}"
        ends = "".join(f"{each:>10}" for each in others) + "  *" * (row["met_again"] > 0)
        print(f"{name:<18}{value:>10}  {interval:<24}{ends}", flush=True)
    _print_notes(rows, varied, options)
    if options.csv is not None:
        write_text(options.csv, _csv(rows))
    if options.json is not None:
        write_text(options.json, to_json(_report(options, varied, rows, code)))


def _search(name: str, run: MarginRuns, seeds: int) -> Brackets:
    """The brackets of one controller, with a bar on the progress."""
    with new_bar(desc=name, total=0, unit=" simulated s", unit_scale=True) as bar:
        counted = dataclasses.replace(run, progress=bar.update)

        def attempt(arms: np.ndarray, shares: np.ndarray) -> Attempt:
            bar.total = (bar.total or 0.0) + len(arms) * run.duration
            values = run.varied.at(np.array([shares.min(), shares.max()]))
            ends = " .. ".join(_spelt(x, run.varied) for x in values)
            bar.set_postfix_str(f"{len(arms)} arms, {ends}")
            return counted(arms, shares)

        return search(attempt, seeds)


def _row(name: str, brackets: Brackets, share: float, varied: Varied) -> dict[str, Any]:
    """What is known of one controller; inf: beyond the high value, -inf: not even the low one."""
    estimated = margin_of(brackets, share)
    margins = np.sort(brackets.margins)
    middle = margins[(len(margins) - 1) // 2]
    shares = dict(zip(_NUMBERS, (*estimated, margins[0], middle, margins[-1]), strict=True))
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


def _heading(options: MarginOptions, varied: Varied) -> list[str]:
    """What the table is of: what is sought, and the options that are not as usual."""
    unit = " [%]" if varied.unit == "1" else f" [{varied.unit}]"
    ends = " .. ".join(_spelt(x, varied) for x in (varied.low, varied.high))
    bounds = " and ".join(options.bound).replace(":", " <= ")
    others = spelt(options, "bound", "low", "high", "seeds", "share", "csv", "json", "force")
    return [
        f"largest {varied.name}{unit} of {ends} at which {options.share:.0%} of {options.seeds} "
        f"seeds have {bounds}",
        f"({printable(shlex.join(others), 2000)})",
        f"{'controller':<18}{'margin':>10}  {'95 % interval':<24}{'least':>10}{'median':>10}"
        f"{'most':>10}",
    ]


def _spelt(value: float, varied: Varied) -> str:
    """A value in the unit of the table, in which shares are percentages."""
    if math.isnan(value):
        return "?"
    if math.isinf(value):
        return f"> {_spelt(varied.high, varied)}" if value > 0.0 else "fails"
    return f"{100.0 * value if varied.unit == '1' else value:.4g}"


def _print_notes(rows: Sequence[Mapping[str, Any]], varied: Varied, options: MarginOptions) -> None:
    seeds = options.seeds
    ends = [row[key] for row in rows for key in _NUMBERS]
    if math.inf in ends:
        high = _spelt(varied.high, varied)
        print(f"> {high}: the bound is met there, too; a further --high finds the margin")
    if -math.inf in ends:
        print(f"fails: the bound is broken at {_spelt(varied.low, varied)} already")
    if any(row["alike"] for row in rows):
        print("no interval: nothing random acts, all seeds are the same; --disturbance noise:0.4?")
    if not all(row["alike"] for row in rows):
        for end, needed in zip(("lower", "upper"), seeds_needed(options.share), strict=True):
            if needed > seeds:
                enough = (
                    f"it needs {needed} seeds"
                    if needed < math.inf
                    else "no number of seeds has one"
                )
                missing = f"no {end} end of a 95 % interval at {options.share:.0%}"
                print(f"?: {seeds} seeds have {missing}; {enough}")
    print(
        "taken for granted between the values that were tried: what breaks the bound breaks it "
        "further on, too"
    )
    for row in rows:
        if row["met_again"]:
            print(
                f"* {row['controller']}: not so, {row['met_again']} of {seeds} seeds meet "
                "the bound again further on; the margin is that of the first failure"
            )


def _csv(rows: Sequence[Mapping[str, Any]]) -> str:
    """The table; inf and -inf as above, nothing where there is no interval."""
    file = io.StringIO()
    table = csv.writer(file, lineterminator="\n")
    table.writerow(["controller", *_NUMBERS, "met_again", "arm"])
    for row in rows:
        numbers = ["" if math.isnan(row[key]) else repr(row[key]) for key in _NUMBERS]
        table.writerow([row["controller"], *numbers, row["met_again"], row["arm"]])
    return file.getvalue()


def _report(
    options: MarginOptions,
    varied: Varied,
    rows: Sequence[Mapping[str, Any]],
    code: Mapping[str, Code],
) -> dict[str, Any]:
    """Everything, for a JSON file."""
    given = dataclasses.asdict(options)
    given |= given.pop("model") | given.pop("gain_options")
    given["engine"] = options.engine or usual_engine()
    for name in ("low", "high", "csv", "json", "force"):  # of the table, and where it is written
        del given[name]
    return {
        "varied": {key: getattr(varied, key) for key in ("name", "low", "high", "unit")},
        "settings": {**given, "arm": list(options.arm or (None,))},
        "controllers": list(rows),
        "code": {name: each.model_dump() for name, each in code.items()},
        "versions": versions(given["engine"], code),
        "host": host(),
    }
