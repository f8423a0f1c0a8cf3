"""Whether a run comes out again bit by bit, and where it does not."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from octarm.checks.differences import Comparison, Difference, compare, listed, origin
from octarm.errors import OctarmError
from octarm.interfaces import ControllerFactory
from octarm.runs import folder as runs
from octarm.runs.experiment import Experiment, perform
from octarm.simulation.trajectory import Trajectory

_INPUTS = ("controller", "parameters", "nominal", "reference", "timestep", "control_period")
_RESULTS = ("disturbances", "metrics", "status", "message")


class Deviation(NamedTuple):
    """Where an array of `run.npz` and that of the re-run first have other bits.

    Attributes:
        array: name.
        row: number of the control instant.
        t: its time [s].
        place: which number of the row.
        was: the number in `run.npz`.
        now: that of the re-run.
        largest: largest difference of all their numbers.
    """

    array: str
    row: int
    t: float
    place: str
    was: float
    now: float
    largest: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunCheck(Comparison):
    """A run folder beside a re-run of what its `run.json` says.

    Differences are those of `run.json`, and of names and lengths of arrays; those of results only
    when no array deviates.

    Attributes:
        rows: number of control instants in `run.npz`.
        arrays: number of arrays there.
        deviations: of its arrays, the earliest first.
        digests: those that `run.json` and `run.npz` state, and that of the re-run.
    """

    rows: int
    arrays: int
    deviations: tuple[Deviation, ...]
    digests: tuple[str, str, str]

    @property
    def identical(self) -> bool:  # noqa: D102
        return not self.deviations and not self.differences and len(set(self.digests)) == 1

    def lines(self) -> list[str]:  # noqa: D102
        if self.identical:
            same = f"{self.rows} control instants, {self.arrays} arrays and the digest"
            return [f"identical: {same}, bit for bit", *self.harmless_changes()]
        lines = [f"different, although q and v are the same at all {self.rows} control instants"]
        for d in [d for d in self.deviations if d.array in ("q", "v")][:1]:
            begin = f"different from t = {d.t:.9g} s on, control instant {d.row} of {self.rows}"
            lines = [f"{begin}: {d.array} of {d.place} was {d.was!r} and is {d.now!r}"]
        if self.deviations:
            lines.append(
                "  array               first at t [s]  of        was -> is (largest difference)"
            )
        for d in self.deviations:
            numbers = f"{d.was!r} -> {d.now!r} ({d.largest:.2g})"
            lines.append(f"  {d.array:<18}  {d.t:<14.9g}  {d.place:<8}  {numbers}")
        lines += [*listed(self.differences, "entry"), self._diagnosis()]
        return lines if self.digests[0] == self.digests[2] else [*lines, *self.origins()]

    def _diagnosis(self) -> str:
        stated, kept, now = self.digests
        if now == stated and (self.deviations or kept != now):
            return "the re-run has the digest that run.json states: run.npz was changed"
        if now == stated:
            return (
                "the motion came out again: run.json was changed, or this version measures "
                "something else"
            )
        if now == kept and not self.deviations:
            return "the re-run has the digest that run.npz states: run.json was changed"
        if changes := self.changes():
            return f"changed since the run: {', '.join(changes)}"
        unknown = [key for key in self.now if key not in self.then]
        missing = f", and {', '.join(unknown)} are not known" if unknown else ""
        return f"run.json or the code was changed: versions and machine are as then{missing}"


def check_run(
    folder: Path, factory: ControllerFactory, progress: Callable[[], object] | None = None
) -> RunCheck:
    """Runs again what `run.json` of a run folder says, and compares.

    A run that diverged or was interrupted is repeated up to where it ended.

    Args:
        folder: of the run.
        factory: makes the controller from all its gains.
        progress: called after every control period.

    Raises:
        OctarmError: if the folder holds no complete run, or one that cannot be made again.
    """
    description = runs.read_description(folder)
    stored = _stored(folder, description)
    interrupted = stored.status == "interrupted"
    try:
        experiment = Experiment.from_description(description)
        if interrupted:
            length = len(stored) * float(description["control_period"])
            experiment = dataclasses.replace(experiment, duration=length)
        environment, controller = experiment.begin(factory)
    except ValueError as error:
        raise OctarmError(f"{folder} cannot be run again: {error}") from None
    announced = experiment.announcement(environment, controller)
    again, described = perform(environment, controller, announced, progress=progress)
    names = environment.physics.coordinates.names
    deviations = tuple(sorted(_deviations(stored, again, names), key=lambda d: d.row))
    keys = [*_INPUTS]
    if not deviations:  # what was measured of another motion is another one anyway
        keys += ["metrics"] if interrupted else _RESULTS
    known = {key: description[key] for key in keys if key in description}
    return RunCheck(
        rows=len(stored),
        arrays=len(list(stored.arrays())),
        deviations=deviations,
        differences=(*_form(stored, again), *compare(known, described)),
        digests=(str(description.get("digest")), stored.digest, again.digest),
        then=origin(description),
        now=origin(described),
    )


def _stored(folder: Path, description: Mapping[str, Any]) -> Trajectory:
    """The arrays of a run; an OctarmError if there are none."""
    file = folder / runs.ARRAYS
    if not file.is_file():
        killed = description.get("status") == runs.RUNNING
        why = "it is still going on or was killed" if killed else "it is incomplete"
        raise OctarmError(f"{folder} has no {runs.ARRAYS} to compare with: {why}")
    stored = Trajectory.load(file)
    if not len(stored):
        raise OctarmError(f"{file} holds no rows")
    return stored


def _deviations(stored: Trajectory, again: Trajectory, names: Sequence[str]) -> Iterator[Deviation]:
    """Of all arrays that both have in the same form, as far as both reach."""
    others, rows = dict(again.arrays()), min(len(stored), len(again))
    for name, array in stored.arrays():
        other = others.get(name)
        if other is None or other.shape[1:] != array.shape[1:]:
            continue
        was, now = (np.ascontiguousarray(x[:rows]) for x in (array, other))
        differs = was.view(np.uint64) != now.view(np.uint64)
        if not differs.any():
            continue
        row, *place = here = tuple(int(i) for i in np.argwhere(differs)[0])
        words = ", ".join(map(str, place)) or "-"
        if array.shape[1:] == (len(names),):
            words = f"tau{place[0] + 1}" if name == "tau" else names[place[0]]
        with np.errstate(all="ignore"):
            largest = float(np.max(np.abs(was - now)[differs]))
        numbers = float(was[here]), float(now[here])
        yield Deviation(name, row, float(again.t[row]), words, *numbers, largest)


def _form(stored: Trajectory, again: Trajectory) -> Iterator[Difference]:
    """Names, shapes and lengths of the arrays that are not the same, and the boundary layer."""
    if len(stored) != len(again):
        yield Difference("rows", len(stored), len(again))
    was, now = ({name: a.shape[1:] for name, a in run.arrays()} for run in (stored, again))
    for name in dict.fromkeys((*was, *now)):
        if was.get(name) != now.get(name):
            shapes = (shape.get(name, "absent") for shape in (was, now))
            yield Difference(f"shape of {name}", *shapes)
    layers = [None if run.layer is None else run.layer.tolist() for run in (stored, again)]
    if layers[0] != layers[1]:
        yield Difference("layer", *layers)
