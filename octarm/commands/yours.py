"""The commands on what is your own: arm, new."""

from __future__ import annotations

import dataclasses
import os
import re
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from octarm.commands import kinds
from octarm.commands.terminal import surviving_output
from octarm.errors import OctarmError, closest, printable, quoted

_STARTS = Path(__file__).resolve().parent / "starts"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*([_-][A-Za-z0-9]+)*")
_NEXT = {
    "controller": "octarm run --controller ./{file}:{Name}",
    "reference": "octarm run --reference ./{file}:{Name}",
    "disturbance": "octarm run --disturbance ./{file}:{Name}:5",
    "metric": "octarm run --metric ./{file}:{Name}",
    "arm": "octarm run --arm {file}",
    "experiment": "octarm sweep {file} --out runs/{name}",
}


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class SourceOptions:
    """From what an arm is made.

    Attributes:
        from_rod: a chain of modules that stands for a rod, with the keys modules, layout (paper or
            centred), length [m], EA [N], EI [N m^2], density [kg/m], rotary_inertia [kg m],
            damping_time [s] and gravity [m/s^2], in SI or with a unit as in length=36cm;
            BASE:TIP for a property that tapers
        fit_modules: go on with the arm of so many modules that stands best for this one, and say
            what error remains in statics, modes and transients
        layout: of the fitted modules, and of the plant of --plant-modules: paper or centred
    """

    from_rod: Annotated[str | None, kinds.kind("KEY=VALUE,.."), kinds.SOURCE] = None
    fit_modules: Annotated[int | None, kinds.whole(1, 60), kinds.SOURCE] = None
    layout: Annotated[str, kinds.LAYOUT, kinds.SOURCE] = "paper"


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class LoopOptions:
    """Which sampled loops are looked at.

    Attributes:
        controller: look at the loop with this controller
        gains: its gains, as in octarm run
        roll_off: corner beyond which its force is rolled off, as in octarm run [Hz]
        control_period: time between control actions [s]; 0.0005 when not given
        plant_modules: modules of the true arm, as in octarm run
        model: what the controller believes, as in octarm run
    """

    controller: Annotated[tuple[str, ...], kinds.CONTROLLER, kinds.LOOP] = ()
    gains: Annotated[str | None, kinds.GAINS, kinds.LOOP] = None
    roll_off: Annotated[float | None, kinds.HZ, kinds.LOOP] = None
    control_period: Annotated[float | None, kinds.PERIOD, kinds.LOOP] = None
    plant_modules: Annotated[int | None, kinds.COUNT, kinds.LOOP] = None
    model: Annotated[str | None, kinds.ARM, kinds.LOOP] = None

    def check(self) -> None:
        """Raises OctarmError for what is given of a loop without its controller."""
        given = [name for name, value in vars(self).items() if value not in (None, ())]
        if given and not self.controller:
            option = given[0].replace("_", "-")
            raise OctarmError(f"--{option} is given without --controller, whose loop it is for")


def arm(
    *arms: Annotated[str, kinds.FILE_OR_ARM],
    source: SourceOptions = SourceOptions(),
    write: Annotated[Path | None, kinds.file(".toml"), kinds.OUTPUT] = None,
    out: Annotated[Path | None, kinds.file(".png"), kinds.OUTPUT] = None,
    force: Annotated[bool, kinds.OUTPUT] = False,
    loop: LoopOptions = LoopOptions(),
) -> kinds.Work:
    r"""Say what the numbers of an arm mean.

    Prints how it hangs, its modes with frequencies and damping ratios, the longest stable physics
    step, the largest bends that the input range allows, and how well its matrices are conditioned.

    With --controller also whether the sampled loop about rest is stable: the longest control
    period, and what grows first beyond it. Nothing is simulated for that. Exit code 1 if a loop is
    unstable at --control-period.

    Args:
        arms: files NAME.toml with numbers and their units, or arms that come with octarm; the
            nominal arm when none is given
        source: see `SourceOptions`
        write: write the arm to this file, in SI units
        out: draw the arm into this file
        force: replace files that are there
        loop: see `LoopOptions`

    Examples:
      octarm arm my-arm.toml --out my-arm.png
      octarm arm --from-rod length=.36,EA=240,EI=.384:.2,modules=15 --write rod.toml
      octarm arm --from-rod modules=30 --fit-modules 3 --write fitted.toml
      octarm arm eth --controller smc-boundary --controller afsmc \
        --control-period 0.001
      octarm arm --controller afsmc --plant-modules 15 --roll-off 60
    """
    from octarm.arm.file import read_arm

    kinds.check_free(force, write, out)
    loop.check()
    if source.layout != "paper" and source.fit_modules is None and loop.plant_modules is None:
        raise OctarmError("--layout is given without --fit-modules or --plant-modules")
    for word in arms:
        read_arm(word)  # raises, before anything that takes longer is imported
    from octarm.commands import arm as work

    job = partial(work.arm, arms, source, loop, write, out)
    return surviving_output(job) if write or out else job


def new(
    kind: Annotated[str, kinds.KIND], name: Annotated[str, kinds.kind("NAME")], /
) -> kinds.Work:
    """Write a commented file to start from, which runs as it is.

    Into the working folder, as NAME.py with a class of this name, or NAME.toml. A file that is
    there already stays as it is. What you make of it needs no place in octarm: every command takes
    FILE.py:NAME, or MODULE:NAME of an installed package.

    Args:
        kind: what it is to be
        name: of your own, such as my-law

    Examples:
      octarm new controller my-law
      octarm new disturbance soft-wall
      octarm new experiment first
    """
    return partial(_new, kind, name)


def _new(kind: str, name: str) -> None:
    from jinja2 import Template

    from octarm.disturbances.spelling import DISTURBANCES
    from octarm.files import write_text

    if kind not in kinds.NEW_FILES:
        raise OctarmError(f"unknown kind {quoted(kind)}{closest(kind, kinds.NEW_FILES)}")
    if not _NAME.fullmatch(name):
        raise OctarmError(
            f"name is {quoted(name)}; it must be letters and digits, joined by - or _, such as "
            "my-law"
        )
    words = re.split("[_-]", name)
    hyphened = "-".join(words).lower()
    if kind == "disturbance" and (hyphened in DISTURBANCES or words[-1].isdigit()):
        raise OctarmError(
            f"{hyphened} cannot be the name of a disturbance: it is built in, or ends in a number"
        )
    (start,) = _STARTS.glob(f"{kind}.*")
    suffix, column = Path(start.stem).suffix, "_".join(words).lower()
    named = {
        "file": f"{column if suffix == '.py' else hyphened}{suffix}",
        "Name": "".join(word[0].upper() + word[1:] for word in words),
        "name": hyphened,
        "column": column,
    }
    if os.path.lexists(named["file"]):
        raise OctarmError(f"{named['file']} exists; choose another name, or remove it")
    template = Template(start.read_text(encoding="utf-8"), keep_trailing_newline=True)
    write_text(named["file"], template.render(named))
    print(f"wrote {printable(named['file'])}")
    print(f"try it: {_NEXT[kind].format(**named)}")
