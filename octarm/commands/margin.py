"""What `octarm margin` does."""

from __future__ import annotations

import csv
import dataclasses
import functools
import io
import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from controllers import CONTROLLERS, make_controller
from octarm.arm.groups import SUMS
from octarm.arm.parameters import ArmParameters
from octarm.bars import bar as new_bar
from octarm.commands.gain_notes import print_unsuited
from octarm.commands.options import ArmOptions, GainOptions
from octarm.declared import Code, named, short_name
from octarm.disturbances.spelling import DISTURBANCES, parse_disturbance, spelling
from octarm.errors import ExitCode, OctarmError
from octarm.files import write_text
from octarm.formats import to_json
from octarm.interfaces import Controller
from octarm.metrics.declared import ACCUMULATORS
from octarm.metrics.table import METRICS
from octarm.references import REFERENCES
from octarm.runs.versions import host, versions
from octarm.simulation.engines import check_engine
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
    seeds_needed,
)
from octarm.sweeps.workers import cores

_NUMBERS = ("margin", "interval_low", "interval_high", "least", "median", "most")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """What a margin is sought of and by which runs, as the command line spells it."""

    disturbance: tuple[str, ...]
    bound: tuple[str, ...]
    seeds: int
    share: float
    metric: tuple[str, ...]
    model: ArmOptions
    gain_options: GainOptions
    reference: str
    duration: float
    settle: float
    timestep: float | str | None
    control_period: float | None
    seed: int
    engine: str

    @property
    def fixed(self) -> list[str]:
        """The disturbances that do not vary."""
        return [text for text in self.disturbance if not is_varied(text)]

    def check(self) -> None:
        """Raises OctarmError for settings that cannot be meant."""
        check_engine(self.engine)
        if not self.bound:
            raise OctarmError("no bound is given; --bound METRIC:VALUE, such as tip_rms_error:0.01")
        if not 0.0 < self.share <= 1.0:
            raise OctarmError(f"share is {self.share:g}; it must be above 0 and at most 1")

    def varied(self, low: str | None, high: str | None) -> Varied:
        """What varies: the one disturbance without a value."""
        varying = [text for text in self.disturbance if is_varied(text)]
        if len(varying) != 1:
            raise OctarmError(
                "one --disturbance goes without a value, the one whose largest value is sought; "
                f"here it is {' and '.join(varying) or 'none'}"
            )
        varied = parse_varied(varying[0], low, high)
        if varied.name == NOMINAL and self.model.mismatch:
            raise OctarmError(f"--mismatch is given, but {NOMINAL} is what varies")
        return varied

    def runs(self, controller: str, varied: Varied) -> MarginRuns:
        """The runs of a controller."""
        return MarginRuns(
            factory=functools.partial(_controller, controller, self.gain_options),
            varied=varied,
            bounds=[parse_bound(text) for text in self.bound],
            disturbances=[parse_disturbance(text) for text in self.fixed],
            mismatch=self.model.mismatch,
            nominal=self.model.factors(),
            reference=self.reference,
            duration=self.duration,
            settle=self.settle,
            timestep=self.timestep,
            control_period=self.control_period,
            engine=self.engine,
            parameters=self.model.true_arm(),
            plant_modules=self.model.plant_modules,
            layout=self.model.layout,
            sensing=self.model.sensing,
            seed=self.seed,
            threads=cores(),
            catalogue=METRICS.extended(ACCUMULATORS[word] for word in self.metric),
        )

    def named(self, controllers: Sequence[str]) -> tuple[dict[str, str], dict[str, Code]]:
        """Short names by word, and the code of what is not built in."""
        varied = (DISTURBANCES.split(text).word for text in self.disturbance)
        words = [
            *((CONTROLLERS, word) for word in controllers),
            (REFERENCES, self.reference),
            *((DISTURBANCES, word) for word in varied if word != NOMINAL),
            *((ACCUMULATORS, word) for word in self.metric),
        ]
        names, code = named(words)
        return dict(zip((word for _, word in words), names, strict=True)), code


def margin(
    controllers: Sequence[str],
    settings: Settings,
    models: Sequence[ArmOptions],
    low: str | None,
    high: str | None,
    csv_file: Path | None,
    json_file: Path | None,
) -> int:
    """`octarm margin`: how much each controller bears on each arm, as a table."""
    if not controllers:
        raise OctarmError("no controller is given; octarm run --help names them")
    settings.check()
    varied = settings.varied(low, high)
    short, code = settings.named(controllers)
    of_arms = [dataclasses.replace(settings, model=model) for model in models]
    pairs = list(itertools.product(of_arms, dict.fromkeys(controllers)))
    for each, word in pairs:
        gains, step = each.gain_options.gains, each.timestep
        print_unsuited(short_name(word), gains, each.model.both()[1], step, each.control_period)
    runs = [
        (short[word], each, each.runs(word, varied).rehearse(each.seeds)) for each, word in pairs
    ]
    rows: list[Mapping[str, Any]] = []
    for name, each, run in runs:
        found = _row(name, _search(name, run, each.seeds), each.share, varied)
        rows.append({**found, "arm": each.model.arm or ""})
        if len(rows) == 1:  # not before it is known that there is something to say
            print("\n".join(_heading(settings, models, varied, short[settings.reference])))
        if len(models) > 1 and [row["arm"] for row in rows].count(each.model.arm) == 1:
            print(f"{each.model.arm}:")
        print(_line(rows[-1], varied), flush=True)
    _print_notes(rows, varied, settings)
    if csv_file is not None:
        write_text(csv_file, _csv(rows))
    if json_file is not None:
        write_text(json_file, to_json(_report(settings, models, varied, rows, code)))
    return ExitCode.FINE


def _controller(name: str, options: GainOptions, nominal: ArmParameters) -> Controller:
    return make_controller(name, nominal, options.values(), gain_set=options.gains)


def _search(name: str, run: MarginRuns, seeds: int) -> Brackets:
    """The brackets of one controller, with a bar on the progress."""
    with new_bar(desc=name, total=0, unit=" simulated s", unit_scale=True) as bar:
        counted = dataclasses.replace(run, progress=bar.update)

        def attempt(arms: np.ndarray, shares: np.ndarray) -> Attempt:
            bar.total = (bar.total or 0.0) + len(arms) * run.duration
            values = run.varied.at(np.array([shares.min(), shares.max()]))
            bar.set_postfix_str(f"{len(arms)} arms, {values[0]:.4g} .. {values[1]:.4g}")
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


def _heading(
    settings: Settings, models: Sequence[ArmOptions], varied: Varied, reference: str
) -> list[str]:
    """What the table is of."""
    unit = "" if varied.unit == "1" else f" [{varied.unit}]"
    bounds = " and ".join(settings.bound).replace(":", " <= ")
    around = [f"{reference}, {settings.duration:g} s"]
    model = settings.model
    around += [f"nominal model wrong by {model.mismatch:g}"] if model.mismatch else []
    around += [f"of the nominal model {factor}" for factor in model.nominal]
    arms = [each.arm for each in models if each.arm is not None]
    around += [f"the arm{'s' * (len(arms) > 1)} {', '.join(arms)}"] if arms else []
    around += [*model.parameter]
    if model.plant_modules is not None:
        read = "" if model.sensing == SUMS else f", read by {model.sensing}"
        around += [f"a plant of {model.plant_modules} modules, {model.layout}{read}"]
    around += [f"gain {gain}" for gain in settings.gain_options.gain]
    if corner := settings.gain_options.roll_off:
        around += [f"roll-off {corner:g} Hz"]
    around += [spelling(parse_disturbance(text)) for text in settings.fixed]
    seeds = f"{settings.share:.0%} of {settings.seeds} seeds"
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
    interval = "" if low == high == "?" else f"{low} .. {high}"
    mark = "  *" if row["met_again"] else ""
    return (
        f"{row['controller']:<18}{value:>10}  {interval:<24}{least:>10}{median:>10}{most:>10}{mark}"
    )


def _spelt(value: float, varied: Varied) -> str:
    if math.isnan(value):
        return "?"
    if math.isinf(value):
        return f"> {varied.high:g}" if value > 0.0 else "fails"
    return f"{value:.4g}"


def _print_notes(rows: Sequence[Mapping[str, Any]], varied: Varied, settings: Settings) -> None:
    """What a reader of the table has to know."""
    seeds = settings.seeds
    ends = [row[key] for row in rows for key in _NUMBERS]
    if math.inf in ends:
        print(f"> {varied.high:g}: the bound is met there, too; a further --high finds the margin")
    if -math.inf in ends:
        print(f"fails: the bound is broken at {varied.low:g} already")
    if any(row["alike"] for row in rows):
        print("no interval: nothing random acts, all seeds are the same; --disturbance noise:0.4?")
    if not all(row["alike"] for row in rows):
        _print_missing_ends(settings.share, seeds)
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


def _print_missing_ends(share: float, seeds: int) -> None:
    """Which ends of intervals the seeds cannot carry, and how many could."""
    for end, needed in zip(("lower", "upper"), seeds_needed(share), strict=True):
        if needed > seeds:
            enough = (
                f"it needs {needed} seeds" if needed < math.inf else "no number of seeds has one"
            )
            print(f"?: {seeds} seeds have no {end} end of a 95 % interval at {share:.0%}; {enough}")


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
    settings: Settings,
    models: Sequence[ArmOptions],
    varied: Varied,
    rows: Sequence[Mapping[str, Any]],
    code: Mapping[str, Code],
) -> dict[str, Any]:
    """Everything, for a JSON file."""
    limits = {key: getattr(varied, key) for key in ("name", "low", "high", "unit")}
    given = dataclasses.asdict(settings)
    given |= given.pop("model") | given.pop("gain_options") | {"arm": [m.arm for m in models]}
    return {
        "varied": limits,
        "settings": given,
        "controllers": list(rows),
        "code": {name: each.model_dump() for name, each in code.items()},
        "versions": versions(settings.engine, code),
        "host": host(),
    }
