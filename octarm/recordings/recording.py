"""A run as a `.rrd` file: the arm in 3D beside plots, laid out by a blueprint in the file.

The file can be written while the run goes on, and can be read up to the last block if the process
is killed. The modules `recorded_run`, `recorded_scene`, `heat_map` and `blueprints` hold what is
drawn and how it is laid out; together they are all that imports rerun.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections.abc import Generator, Mapping
from types import TracebackType
from typing import Any

import pyarrow as pa
import rerun as rr
from rerun.experimental import ViewerClient as ViewerClient  # for octarm.recordings.viewer

from octarm.errors import OctarmError
from octarm.files import piped, whole_file
from octarm.interfaces import Rows
from octarm.recordings.recorded_run import RecordedRun
from octarm.runs.archive import BLOCK
from octarm.simulation.trajectory import Ending, Trajectory


def write_recording(
    path: str | os.PathLike[str], trajectory: Trajectory, description: Mapping[str, Any]
) -> None:
    """Writes a run as a rerun recording, whole or not at all.

    The timeline is `t` [s]. What the controller logged is recorded and plotted, whatever the names
    and widths.

    Args:
        path: the `.rrd` file; its folder must exist.
        trajectory: the run of one arm of N modules.
        description: what `run.json` holds; `parameters` are needed, the rest may be missing.

    Raises:
        ValueError: if the trajectory has no rows, or the parameters are not those of one such arm.
        OSError: if the file cannot be written.
        RuntimeError: if rerun does not take the data, or is switched off by RERUN=off.
    """
    if len(trajectory) == 0:
        raise OctarmError("there is nothing to record: the trajectory has no rows")
    disturbed = bool(trajectory.disturbance.any() or description.get("disturbances"))
    end = float(trajectory.t[-1])
    short = end < 0.9 * float(description.get("duration", end))
    announced = {**description, "duration": end} if short else description
    with Recorder(path, announced, disturbed=disturbed) as recorder:
        for k in range(0, len(trajectory), BLOCK):
            recorder.add(part_of(trajectory, k, k + BLOCK))
        recorder.finish(description)


@contextlib.contextmanager
def rrd_file(path: str | os.PathLike[str]) -> Generator[rr.RecordingStream]:
    """A stream to a `.rrd` file, which appears whole or not at all.

    It is `PATH.part` until the block ends well; if the process is killed it stays, readable up to
    the last flush.

    Raises:
        OSError: if the file cannot be written.
        RuntimeError: if rerun does not take the data, or is switched off by RERUN=off.
    """
    if os.environ.get("RERUN", "on").lower() in ("0", "off", "false"):
        raise RuntimeError(f"{path} cannot be recorded: RERUN={os.environ['RERUN']} is set")
    with whole_file(path) as part, _strict_mode():
        stream = rr.RecordingStream("octarm", send_properties=False)
        with contextlib.ExitStack() as file, recording_errors(path):
            # rerun itself would hang for ever on a full disk
            stream.save(file.enter_context(piped(part)))
            file.enter_context(stream)
            opened = file.pop_all()
        try:
            yield stream
        except BaseException:
            with contextlib.suppress(Exception):  # the error is known already
                opened.close()
            raise
        with recording_errors(path):
            opened.close()


@contextlib.contextmanager
def recording_errors(path: str | os.PathLike[str]) -> Generator[None]:
    """Turns rerun's errors, of many kinds, into RuntimeErrors of one sentence."""
    try:
        yield
    except (OSError, ValueError, MemoryError):
        raise
    except Exception as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise RuntimeError(f"{path} cannot be recorded: {reason}") from error


def time_axes(path: str | os.PathLike[str]) -> list[str]:
    """The entities of a recording's blueprint that fix what time its plots show."""
    reader = rr.chunk.RrdReader(os.fspath(path))
    return sorted(
        {
            chunk.entity_path
            for store in reader.blueprints()
            for chunk in reader.stream(store=store)
            if chunk.entity_path.endswith("/TimeAxis")
        }
    )


def last_instant(path: str | os.PathLike[str]) -> float:
    """The last instant of a recording [s]; see `octarm.recordings.viewer.end_of`."""
    ends: list[int] = []
    try:
        for chunk in rr.chunk.RrdReader(os.fspath(path)).stream():
            batch = chunk.to_record_batch()
            if not chunk.is_static and "t" in batch.schema.names and batch.num_rows:
                ends.append(batch.column("t").cast(pa.int64()).to_numpy().max())
    except Exception as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise RuntimeError(f"{path} cannot be read: {reason}") from None
    if not ends:
        raise RuntimeError(f"{path} is a recording without instants")
    return float(max(ends)) * 1e-9


class Recorder:
    """Writes a recording while the run goes on: `add` rows in their order, then `finish`.

    Used with `with`. The file is `PATH.part` until it is finished and whole; a failure removes it.
    If the process is killed it stays, readable up to the last block.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        description: Mapping[str, Any],
        *,
        disturbed: bool | None = None,
    ) -> None:
        """A recording of the run that `description` announces; see `write_recording`.

        Args:
            path: the `.rrd` file; its folder must exist.
            description: what `run.json` will hold, as far as it is known.
            disturbed: whether the disturbances' force is recorded; by the description if None.
        """
        self._path, self._description, self._disturbed = path, description, disturbed
        self._file = contextlib.ExitStack()

    def __enter__(self) -> Recorder:
        """Opens the file; raises what `rrd_file` does."""
        with contextlib.ExitStack() as file:
            self._stream = file.enter_context(rrd_file(self._path))
            self._run = RecordedRun(self._stream, self._description, disturbed=self._disturbed)
            self._file = file.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Closes the file; it takes its name unless there was an error."""
        self._file.__exit__(kind, error, trace)

    def add(self, rows: Trajectory | Rows) -> None:
        """Records further rows; what was added is on disk afterwards.

        Raises:
            ValueError: if the rows are not those of an arm with these parameters.
        """
        with recording_errors(self._path):
            run = rows if isinstance(rows, Trajectory) else Trajectory.from_rows(rows, Ending())
            self._run.add(run)
            self._stream.flush(timeout_sec=60.0)  # bounds what waits in memory; raises errors

    def finish(self, description: Mapping[str, Any]) -> None:
        """Records what is known when the run is over; `description` is now complete."""
        with recording_errors(self._path):
            self._run.finish(description)


def part_of(run: Trajectory, start: int, stop: int) -> Trajectory:
    """Rows of a run as a run."""
    arrays = {name: array[start:stop] for name, array in run.arrays() if name not in run.signals}
    signals = {name: array[start:stop] for name, array in run.signals.items()}
    return dataclasses.replace(run, **arrays, signals=signals)  # pyright: ignore


@contextlib.contextmanager
def _strict_mode() -> Generator[None]:
    """Lets rerun raise errors; it would otherwise warn of bad data, and drop it."""
    before = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        yield
    finally:
        rr.set_strict_mode(before)
