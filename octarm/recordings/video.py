"""A run as a film: the scene of the recording, drawn by MuJoCo without a display."""
# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)

from __future__ import annotations

import contextlib
import ctypes.util
import os
import sys
from collections.abc import Iterator, Mapping
from fractions import Fraction
from typing import Any

import numpy as np

from octarm.errors import OctarmError, quoted
from octarm.files import whole_file
from octarm.simulation.trajectory import Trajectory

Path = str | os.PathLike[str]
_NEEDED = (
    "drawing needs an OpenGL library: on Debian it is one of the packages libegl1 and libosmesa6"
)
_MOST_PICTURES = 1_000_000
_SOLIDS = 4000  # at most in a picture


def choose_renderer() -> None:
    """Sets MUJOCO_GL to the library that is installed, EGL before OSMesa, unless it is set.

    MuJoCo reads it when it is imported; a display is not used. Raises OctarmError if there is
    neither library.
    """
    if os.environ.get("MUJOCO_GL") or sys.platform != "linux":
        return
    for name, library in (("egl", "EGL"), ("osmesa", "OSMesa")):
        if ctypes.util.find_library(library):
            os.environ["MUJOCO_GL"] = name
            return
    raise OctarmError(_NEEDED)


def write_video(
    path: Path,
    run: Trajectory,
    description: Mapping[str, Any],
    *,
    size: tuple[int, int] = (960, 720),
    rate: float = 30.0,
    speed: float = 1.0,
) -> None:
    """Writes the film of a run, whole or not at all; the desired arm appears as a ghost.

    A plant of more modules than what is measured of it stands beside the arm that the controller
    believes in. `choose_renderer` must have been called before MuJoCo was imported, unless
    MUJOCO_GL is set.

    Of what `run.json` holds, the description, only `parameters` are needed; the rest is written in
    the film. It has a width and height [pixel], even, and so many pictures a second [Hz], and runs
    at some speed in terms of real time. Raises OctarmError if a number is out of range, the file is
    not named .mp4, or nothing can be drawn on this machine, OSError if it cannot be written.
    """
    import av

    from octarm.recordings.shapes import drawable  # imports MuJoCo

    if not str(path).endswith(".mp4"):
        raise OctarmError(f"the film is {quoted(os.fspath(path))}; its name must end in .mp4")
    if not (1.0 <= rate <= 240.0 and 0.0 < speed <= 1000.0):
        raise OctarmError(
            f"rate is {rate:g} and speed {speed:g}; they must be within 1 to 240 and above 0"
        )
    if min(size) < 16 or max(size) > 4096 or size[0] % 2 or size[1] % 2:
        raise OctarmError(f"the size is {size[0]} x {size[1]}; both must be even, 16 to 4096")
    pictures = (run.t[-1] - run.t[0]) / speed * rate
    if not pictures <= _MOST_PICTURES:
        raise OctarmError(
            f"the film would have {pictures:.3g} pictures; it must have at most {_MOST_PICTURES}, "
            "so choose a higher speed or a lower rate"
        )
    count = max(1, round(pictures) + 1)
    rows = np.searchsorted(run.t, float(run.t[0]) + np.arange(count) * speed / rate - 1e-9)
    rows = np.minimum(rows, len(run) - 1)
    rows = rows[drawable(run.q[rows]) & drawable(run.q_d[rows])]
    container: Any  # its types are partly unknown
    with whole_file(path) as part, av.open(os.fspath(part), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(rate).limit_denominator(1000))
        stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
        stream.options = {"crf": "20", "preset": "veryfast"}
        for picture in _pictures(run, rows, description, size):
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def _pictures(
    run: Trajectory, rows: np.ndarray, description: Mapping[str, Any], size: tuple[int, int]
) -> Iterator[np.ndarray]:
    """Red, green and blue of the arm at these rows, each of shape (height, width, 3)."""
    import mujoco

    from octarm.recordings.stage import Captions, Stage

    model = Stage.model(size)
    try:
        renderer = mujoco.Renderer(model, size[1], size[0], max_geom=_SOLIDS)
    except Exception as error:  # errors of OpenGL are of many kinds
        raise OctarmError(f"{_NEEDED} ({type(error).__name__})") from None
    stage, captions = Stage(run, rows, description), Captions(run, description, size)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with contextlib.closing(renderer):
        for row in rows:
            renderer.update_scene(data, camera=stage.camera)
            stage.fill(renderer.scene, int(row))
            yield captions.on(renderer.render(), int(row))
