"""A run in a rerun viewer while it goes on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import rerun as rr

from octarm.errors import OctarmError
from octarm.interfaces import Rows
from octarm.recordings.recording import RunRecording


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
        self._send(lambda recording: recording.add(rows, layer))

    def finish(self, description: Mapping[str, Any]) -> None:
        """Sends what is known when the run is over."""
        self._send(lambda recording: recording.finish(description))

    def _send(self, send: Callable[[RunRecording], object]) -> None:
        if self._recording is None:
            return
        try:
            send(self._recording)
        except OctarmError:
            self._recording = None
            self._say("the viewer has gone away; the run goes on without it")
