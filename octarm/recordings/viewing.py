"""A run in a rerun viewer: while it goes on, or in a cell of a notebook, without the network."""

from __future__ import annotations

import contextlib
import io
import os
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.errors import FileError, OctarmError
from octarm.interfaces import Rows
from octarm.recordings.recording import RunRecording, write_recording
from octarm.runs.folder import RECORDING
from octarm.simulation.trajectory import Trajectory

_ASSET = "RERUN_NOTEBOOK_ASSET"  # says where rerun's widget gets its viewer from


class LiveRecording:
    """Sends a run to a viewer; one that goes away, or does not answer, is sent nothing more.

    It is what `octarm.runs.experiment.run_into` takes as `live`.
    """

    def __init__(
        self, url: str, description: Mapping[str, Any], say: Callable[[str], object]
    ) -> None:
        """Connects to a viewer, `rerun+http://HOST:PORT/proxy`; `say` is called if it goes away."""
        self._say = say
        stream = rr.RecordingStream("octarm", send_properties=False)
        stream.connect_grpc(url)
        recording = RunRecording(stream, url, description, following=True)
        self._recording: RunRecording | None = recording

    def add(self, rows: Rows, layer: np.ndarray | None) -> None:
        """Sends further rows, and the half width of the boundary layer, shape (2N,)."""
        self._send(RunRecording.add, rows, layer)

    def finish(self, description: Mapping[str, Any]) -> None:
        """Sends what is known when the run is over."""
        self._send(RunRecording.finish, description)

    def _send(self, send: Callable[..., object], *what: Any) -> None:
        try:
            if self._recording is not None:
                send(self._recording, *what)
        except OctarmError:
            self._recording = None
            self._say("the viewer has gone away; the run goes on without it")


def show(run: Any, arm: ArmParameters | None = None, *, height: int = 620) -> Any:
    """The rerun viewer on a run, which a cell shows that ends with it; needs the extra `notebook`.

    All that the viewer is made of comes from the installed package, unless the environment variable
    RERUN_NOTEBOOK_ASSET says otherwise before the first call. The run is what `octarm.rollout`, of
    this arm or the nominal one, or `octarm.read_run` returns, or a run folder or its recording. The
    viewer is as wide as the cell, and has a height [pixel]. Raises OctarmError if the extra is not
    installed, or there is no such recording.
    """
    content = _content(run, arm)
    os.environ.setdefault(_ASSET, "inline")
    try:
        with contextlib.redirect_stdout(io.StringIO()):  # it says that it loads what it is told
            import rerun_notebook
    except ModuleNotFoundError:
        raise OctarmError(
            "the viewer in a cell needs the extra notebook: pip install 'octarm[notebook]'"
        ) from None
    widget = rerun_notebook.Viewer(width="auto", height=height)
    widget.send_rrd(content)
    return widget


def _content(run: Any, arm: ArmParameters | None) -> bytes:
    """The recording of a run: that of its folder, or one made of its rows."""
    if isinstance(run, str | Path):
        path = Path(run)
        path = path / RECORDING if path.is_dir() else path
        if not path.is_file():
            raise FileError(f"there is no recording {path}")
        return path.read_bytes()
    if isinstance(run, Trajectory):
        parameters = nominal_parameters() if arm is None else arm
        run = run, {"parameters": parameters.to_dict(), "status": run.status}
    with tempfile.TemporaryDirectory(prefix="octarm-") as folder:
        path = Path(folder) / RECORDING
        write_recording(path, *run)
        return path.read_bytes()
