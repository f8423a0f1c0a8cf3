"""What the commands are asked for that look at runs."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

from octarm.options.argument import Operand, Option


@dataclasses.dataclass(frozen=True)
class Replay:
    """Open recorded runs in the rerun viewer.

    One run folder, two of them side by side with the difference of their errors, or a sweep folder,
    of which the recorded episodes are opened.

    Examples:
      octarm replay runs/my-run
      octarm replay runs/smc runs/afsmc
      octarm replay runs/my-run --screenshot picture.png --time 4.5
    """

    runs: Annotated[
        tuple[Path, ...], Operand("RUN", "run folder, two run folders, or a sweep folder")
    ]
    screenshot: Annotated[
        Path | None,
        Option("FILE.png", "write a picture of the viewer instead of opening it; no display"),
    ] = None
    time: Annotated[
        float | None,
        Option("S", "time shown in the picture [s]; the middle of the run when not given"),
    ] = None
    web: Annotated[
        bool, Option("", "serve the viewer to a browser on this machine; no network")
    ] = False


@dataclasses.dataclass(frozen=True)
class Record:
    """Rebuild the recording of a run from its arrays.

    The recording is made of run.npz and run.json alone.

    Examples:
      octarm record runs/my-run
    """

    run: Annotated[Path, Operand("RUN", "run folder")]
    out: Annotated[
        Path | None,
        Option("FILE.rrd", "recording to write; run.rrd in the folder when not given"),
    ] = None


@dataclasses.dataclass(frozen=True)
class Plot:
    """Draw the standard figures of a run, as PNG and SVG.

    Examples:
      octarm plot runs/my-run --out figures
    """

    run: Annotated[Path, Operand("RUN", "run folder")]
    out: Annotated[Path | None, Option("DIR", "folder to write to; RUN-figures when not given")] = (
        None
    )


@dataclasses.dataclass(frozen=True)
class Video:
    """Film a run with MuJoCo's renderer.

    It needs no display, but one of the libraries EGL and OSMesa; octarm doctor tells.

    Examples:
      octarm video runs/my-run --out run.mp4 --speed 0.5
    """

    run: Annotated[Path, Operand("RUN", "run folder")]
    out: Annotated[Path | None, Option("FILE.mp4", "film to write; RUN.mp4 when not given")] = None
    width: Annotated[int, Option("N", "width [pixel]")] = 960
    height: Annotated[int, Option("N", "height [pixel]")] = 720
    rate: Annotated[float, Option("HZ", "pictures a second [Hz]")] = 30.0
    speed: Annotated[float, Option("X", "how much faster than real time the film runs")] = 1.0
