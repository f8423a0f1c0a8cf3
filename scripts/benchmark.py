"""All speed figures of this testbed, measured in one run on this machine.

Run it: python scripts/benchmark.py [--only SECTION ..] [--json FILE]

It takes six to ten minutes. Other programs disturb it, the ratios least. To add figures, write a
function that returns rows in `scripts/benchmarks/`, and its line in `SECTIONS`.
"""

import argparse
import importlib
import json
import math
import platform
from importlib.metadata import version
from pathlib import Path

from benchmarks.figures import Row, Section, Settings

SECTIONS = {  # module below `benchmarks` and function
    "controller-step": "controller_step.controller_step",
    "closed-loop": "closed_loop.closed_loop",
    "one-by-one": "closed_loop.one_by_one",
    "one-arm": "one_arm.one_arm",
    "workers": "whole_sweeps.workers",
    "memory": "whole_sweeps.memory",
    "overhead": "whole_sweeps.overhead",
    "recording": "recordings.recording",
}
_MET = {None: "", True: "met", False: "NOT met"}


def main() -> None:
    """Prints the table, and writes it as JSON where that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=_Plain)
    parser.add_argument("--only", nargs="+", choices=SECTIONS, metavar="SECTION",
                        default=list(SECTIONS), help=f"some of {', '.join(SECTIONS)}")  # fmt: skip
    parser.add_argument("--arms", type=int, default=1024, help="arms in a batch")
    parser.add_argument("--seconds", type=float, default=1.0, help="stretches all measurements [s]")
    parser.add_argument("--episodes", type=int, default=100_000, help="of the largest sweep")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures there")
    options = parser.parse_args()
    for name in ("arms", "episodes"):
        if getattr(options, name) < 1:
            parser.error(f"{name} is {getattr(options, name)}; it must be at least 1")
    if not 0.0 < options.seconds <= 600.0:
        parser.error(f"seconds is {options.seconds:g}; it must be above 0 and at most 600")
    settings = Settings(options.arms, options.seconds, options.episodes)
    measured: dict[str, list[Row]] = {}
    print(f"{'':<52}{'value':>11}{'':<5}{'target':<16}")
    for title in options.only:
        print(title, flush=True)
        measured[title] = section(title)(settings)
        for row in measured[title]:
            print(line(row), flush=True)
    if options.json is not None:
        options.json.write_text(as_json(measured), encoding="utf-8")


def section(title: str) -> Section:
    """A section, imported when it is run: worker processes import this file, too."""
    module, _, function = SECTIONS[title].partition(".")
    return getattr(importlib.import_module(f"benchmarks.{module}"), function)


def line(row: Row) -> str:
    """A row of the table."""
    unit = "" if row.unit == "1" else row.unit
    return f"  {row.name:<50}{row.value:11.3f} {unit:<4}{row.target:<16}{_MET[row.met]}".rstrip()


def as_json(measured: dict[str, list[Row]]) -> str:
    """The machine, and the rows by section."""
    figures = {
        title: [
            {**row._asdict(), "value": row.value if math.isfinite(row.value) else None}
            | {"met": row.met}
            for row in rows
        ]
        for title, rows in measured.items()
    }
    packages = {name: version(name) for name in ("numpy", "mujoco", "rerun-sdk")}
    machine = {"platform": platform.platform(), "python": platform.python_version(), **packages}
    return json.dumps({"machine": machine, **figures}, indent=2) + "\n"


class _Plain(argparse.RawDescriptionHelpFormatter):
    """Leaves the lines of the description as they are."""


if __name__ == "__main__":
    main()
