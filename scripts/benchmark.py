"""All speed figures of this testbed, measured in one run on this machine.

Run it: python scripts/benchmark.py [--only SECTION ..] [--json FILE]

Three limits are what the figures compare with: the bare physics (a batch of the slim model in
MuJoCo, `closed-loop`), the operations that have to be computed (`controller-step`, `engines`,
`plants`), and others' programs (`peers`: PyElastica on the same rod; `one-by-one`: a plain loop of
dm_control).

It takes 10 to 15 minutes. Other programs disturb it, the ratios least, those of workers most: it
says how busy the processors are before each section if that is more than a tenth. To add figures,
write a function that returns rows in `scripts/benchmarks/`, and its line in `SECTIONS`.
"""

import argparse
import json
import math
import pkgutil
import platform
from importlib.metadata import version
from pathlib import Path

import psutil
from benchmarks.figures import LeftOut, Row, Settings

SECTIONS = {  # module below `benchmarks`, imported when it is run, and function
    "controller-step": "controller_step:controller_step",
    "plants": "engines:plants",
    "closed-loop": "closed_loop:closed_loop",
    "engines": "engines:engines",
    "tuning": "engines:tuning",
    "peers": "engines:peers",
    "one-by-one": "closed_loop:one_by_one",
    "one-arm": "closed_loop:one_arm",
    "workers": "whole_sweeps:workers",
    "memory": "whole_sweeps:memory",
    "overhead": "whole_sweeps:overhead",
    "recording": "recordings:recording",
}
_QUIET = 10.0  # [%] of all processors, that other programs may use
_MET = {None: "", True: "met", False: "NOT met"}


def main() -> None:
    """Prints the table, and writes it as JSON where that is asked for."""
    plain = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=plain)
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
    loads: dict[str, float] = {}
    print(f"{'':<52}{'value':>11}{'':<5}{'target':<16}")
    for title in options.only:
        print(title, flush=True)
        loads[title] = psutil.cpu_percent(0.5)
        print(load_note(loads[title]), end="", flush=True)
        measured[title] = rows_of(title, settings)
        for row in measured[title]:
            print(line(row), flush=True)
    if options.json is not None:
        options.json.write_text(as_json(measured, loads), encoding="utf-8")


def load_note(share: float) -> str:
    """A line if other programs use so much of all processors [%] that figures suffer."""
    if share <= _QUIET:
        return ""
    return f"  not a quiet machine: others use {share:.0f} % of its processors\n"


def rows_of(title: str, settings: Settings) -> list[Row]:
    """The rows of a section; none, and a line that says why, if an extra is missing."""
    try:
        return pkgutil.resolve_name(f"benchmarks.{SECTIONS[title]}")(settings)
    except LeftOut as reason:
        print(f"  {reason}", flush=True)
        return []


def line(row: Row) -> str:
    """A row of the table."""
    unit = "" if row.unit == "1" else row.unit
    return f"  {row.name:<50}{row.value:11.3f} {unit:<4}{row.target:<16}{_MET[row.met]}".rstrip()


def as_json(measured: dict[str, list[Row]], loads: dict[str, float]) -> str:
    """The machine, its load before each section [%], and the rows by section."""
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
    return json.dumps({"machine": machine, "load": loads, **figures}, indent=2) + "\n"


if __name__ == "__main__":
    main()
