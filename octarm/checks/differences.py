"""What was written down beside what comes out now, and the files of run and sweep folders."""

from __future__ import annotations

import dataclasses
import itertools
import json
import re
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import pyarrow as pa

from octarm.errors import OctarmError, printable, quoted
from octarm.interfaces import ControllerFactory
from octarm.recordings.recording import write_recording
from octarm.recordings.rrd import contents
from octarm.runs import folder as runs
from octarm.simulation.trajectory import Ending, Trajectory, unreadable
from octarm.sweeps.episodes import FinishedSweep
from octarm.sweeps.store import EPISODES, LOCK, MANIFEST, PROGRESS, RECORDED, SPEC, read_shard

_LISTED = 12  # differences that are printed
ABSENT = "absent"  # instead of a value that is missing
_FILES = (runs.DESCRIPTION, runs.ARRAYS, runs.RECORDING)
_OF_SWEEPS = (SPEC, MANIFEST, LOCK, PROGRESS)  # what else there is are folders
# Of run.json: what came of a run, and where it was made.
_OF_THE_RUN = (
    "disturbances", "metrics", "status", "message", "digest", "command", *runs.NAMED,
)  # fmt: skip
_ENDING = Ending._fields  # arrays that have no row for each instant


class Difference(NamedTuple):
    """An entry that is not what it was: its dotted name, and both values."""

    key: str
    was: Any
    now: Any


def compare(
    was: Mapping[str, Any], now: Mapping[str, Any], may_differ: Collection[str] = ()
) -> Iterator[Difference]:
    """Entries that only one of them has, or that have another value, down to single numbers.

    Numbers are the same when all their bits are. What is missing on one side is `absent` there.
    Both are contents of JSON files, or what would become one; below the keys of `may_differ`
    numbers and words may differ, what there is may not.
    """
    yield from _compare_tables("", was, json.loads(json.dumps(now)), may_differ)


def _compare_tables(
    key: str, was: Mapping[str, Any], now: Mapping[str, Any], may_differ: Collection[str]
) -> Iterator[Difference]:
    for name in dict.fromkeys((*was, *now)):
        place = f"{key}.{name}".lstrip(".")
        if name in was and name in now:
            yield from _compare(place, was[name], now[name], name in may_differ)
        else:
            yield Difference(place, was.get(name, ABSENT), now.get(name, ABSENT))


def _compare(key: str, was: Any, now: Any, free: bool) -> Iterator[Difference]:
    kinds: set[object] = {type(was), type(now)}
    if kinds == {dict}:
        yield from _compare_tables(key, was, now, was if free else ())
    elif kinds == {list} and len(was) == len(now):
        for i, pair in enumerate(zip(was, now, strict=True)):
            yield from _compare(f"{key}[{i}]", *pair, free)
    elif kinds & {dict, list} or not (free or repr(was) == repr(now)):  # tells 0.0 from -0.0
        yield Difference(key, was, now)


def origin(description: Mapping[str, Any]) -> dict[str, str]:
    """Versions and properties of the machine by name, from the tables `versions` and `host`."""
    given = (description.get(key) for key in ("versions", "host"))
    tables = [cast(dict[str, Any], table) for table in given if isinstance(table, dict)]
    return {key: str(value) for table in tables for key, value in table.items()}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Comparison:
    """A result that was written down beside that of a re-run, and the origins of both."""

    differences: tuple[Difference, ...]
    then: Mapping[str, str]
    now: Mapping[str, str]

    def origins(self) -> list[str]:
        """Versions and machines side by side, a line each; a star marks what has changed."""
        width = max([7, *map(len, self.then.values())]) + 2
        lines = [f"  {'':<12}  {'then':<{width}}now"]
        for key in dict.fromkeys((*self.then, *self.now)):
            was, now = self.then.get(key, "unknown"), self.now.get(key, "unknown")
            lines.append(f"{' ' if was == now else '*'} {key:<12}  {was:<{width}}{now}")
        return lines


def listed(differences: Sequence[Difference], heading: str) -> list[str]:
    """A heading, and a line for each of the first differences; no line when there are none."""
    if not differences:
        return []
    lines = [f"  {heading:<34}  was -> is"]
    lines += [
        f"  {printable(key, 80):<34}  {quoted(was)} -> {quoted(now)}"
        for key, was, now in differences[:_LISTED]
    ]
    left = len(differences) - _LISTED
    return [*lines, f"  and {left} more"] if left > 0 else lines


class Deviation(NamedTuple):
    """Where an array of `run.npz` and that of the re-run first have other bits, at time t [s].

    The row is a control instant, the place a number of it; `largest` is the largest difference.
    """

    array: str
    row: int
    t: float
    place: str
    was: float
    now: float
    largest: float


def stored_arrays(path: Path) -> dict[str, np.ndarray]:
    """What a `.npz` file holds by name, as it is stored: rows of shape (T, ...), and the ending.

    Raises OctarmError if it cannot be read, or has no rows.
    """
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as file:
            arrays = {name: np.asarray(array) for name, array in file.items()}
    except Exception as error:  # damaged bytes raise errors of any kind
        raise unreadable(path, error) from None
    t = arrays.get("t")
    if t is None or t.ndim != 1 or not len(t):
        raise OctarmError(f"{path} holds no rows")
    return arrays


def array_differences(
    was: Mapping[str, np.ndarray], now: Mapping[str, np.ndarray], coordinates: Sequence[str]
) -> tuple[list[Difference], list[Deviation]]:
    """What differs in form or without rows, and where rows differ, the earliest first.

    Both are rows of shape (T, ...) with the ending, by `stored_arrays` and `Trajectory.saved`. Rows
    are compared of arrays that both sides have in the same form.
    """
    form, deviations = list[Difference](), list[Deviation]()
    if len(was["t"]) != len(now["t"]):
        form.append(Difference("rows", len(was["t"]), len(now["t"])))
    for name in dict.fromkeys((*was, *now)):
        forms = [_form(name, arrays) for arrays in (was, now)]
        if forms[0] != forms[1] or name in _ENDING:
            form += compare(*forms)
        else:
            deviations += _deviation(name, was[name], now[name], now["t"], coordinates)
    return form, sorted(deviations, key=lambda d: d.row)


def _form(name: str, arrays: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """The form of an array, and the value of one without rows."""
    if name not in arrays:
        return {f"form of {name}": ABSENT}
    array, rows = arrays[name], len(arrays["t"])
    if name in _ENDING:
        value = {f"{name} in {runs.ARRAYS}": array.tolist()}
        return value | {f"form of {name}": f"{array.dtype.str} {array.shape}"}
    shape = f"{array.shape[1:]} by rows" if array.shape[:1] == (rows,) else f"{array.shape}"
    return {f"form of {name}": f"{array.dtype.str} {shape}"}


def _deviation(
    name: str, was: np.ndarray, now: np.ndarray, t: np.ndarray, coordinates: Sequence[str]
) -> Iterator[Deviation]:
    rows = min(len(was), len(now))
    one, other = (np.ascontiguousarray(x[:rows]) for x in (was, now))
    differs = one.view(np.uint64) != other.view(np.uint64)
    if not differs.any():
        return
    row, *place = here = tuple(int(i) for i in np.argwhere(differs)[0])
    words = ", ".join(map(str, place)) or "-"
    if now.shape[1:] == (len(coordinates),):
        words = f"tau{place[0] + 1}" if name == "tau" else coordinates[place[0]]
    with np.errstate(all="ignore"):
        largest = float(np.max(np.abs(one - other)[differs]))
    yield Deviation(name, row, float(t[row]), words, float(one[here]), float(other[here]), largest)


def checksum_differences(folder: Path, description: Mapping[str, Any]) -> list[Difference]:
    """Files whose SHA-256 is not what `run.json` states, and files that belong to no run."""
    stated = {key: description[key] for key in (runs.SUMS,) if key in description}
    differences = [*compare(stated, {runs.SUMS: runs.checksums(folder, description)})]
    extra = sorted(path.name for path in folder.iterdir() if path.name not in _FILES)
    return [*differences, *(Difference(f"file {name}", "there", ABSENT) for name in extra)]


def recording_differences(
    file: Path, run: Trajectory, description: Mapping[str, Any]
) -> Iterator[Difference]:
    """What a recording holds, beside what one that is made of the run and its `run.json` holds."""
    with tempfile.TemporaryDirectory() as scratch:
        again = Path(scratch) / runs.RECORDING
        write_recording(again, run, description)
        now = contents(again)
    try:
        was = contents(file)
    except OctarmError as error:
        yield Difference(runs.RECORDING, str(error), "a recording")
        return
    for key in dict.fromkeys((*was, *now)):
        one, other = was.get(key), now.get(key)
        place = f"{runs.RECORDING} {key}"
        if one is None or other is None:
            yield Difference(place, *(ABSENT if x is None else "there" for x in (one, other)))
        elif not _same(one, other):
            if one.type != other.type or len(one) != len(other):
                yield Difference(place, *(f"{len(x)} rows of {x.type}" for x in (one, other)))
                continue
            row = next(i for i in range(len(one)) if not _same(one[i : i + 1], other[i : i + 1]))
            values = ({f"{place}, row {row}": x[row].as_py()} for x in (one, other))
            yield from compare(*values)


def _same(was: pa.Array, now: pa.Array) -> bool:
    """Whether all bits of their values are the same."""
    return was.type == now.type and _bytes(was) == _bytes(now)


def _bytes(array: pa.Array) -> bytes:
    return pa.record_batch([array], ["values"]).serialize().to_pybytes()


def sweep_differences(sweep: FinishedSweep, factory: ControllerFactory) -> list[Difference]:
    """What of a finished or unfinished sweep is not as it was written, without running it again.

    The factory is the one that the sweep had. Raises OctarmError if a controller cannot be made.
    """
    spec = sweep.plan.spec
    gains = {name: spec.stated_gains(name, factory) for name in spec.controllers}
    recorded = sorted((sweep.path / RECORDED).glob("*"))
    return [
        *compare({"gains": sweep.gains}, {"gains": gains}),
        *_shards(sweep),
        *_extra(sweep),
        *itertools.chain.from_iterable(_recorded(sweep, each, factory) for each in recorded),
    ]


def _shards(sweep: FinishedSweep) -> Iterator[Difference]:
    """Shards that are damaged, missing although they were finished, or there without a SHA-256."""
    for i, shard in enumerate(sweep.manifest["shards"]):
        file = sweep.path / shard["file"]
        if file.exists() != bool(shard["sha256"]):
            yield Difference(
                shard["file"], *("there" if x else ABSENT for x in (file.exists(), shard["sha256"]))
            )
            continue
        try:
            read_shard(sweep.path, sweep.plan, sweep.manifest, i, ())
        except OctarmError as error:
            yield Difference(shard["file"], str(error), "undamaged")


def _extra(sweep: FinishedSweep) -> Iterator[Difference]:
    """Files that belong to no sweep; folders beside its own may be the user's, such as reports."""
    known = {sweep.path / shard["file"] for shard in sweep.manifest["shards"]}
    known |= {sweep.path / name for name in _OF_SWEEPS}
    places = [*(sweep.path / EPISODES).iterdir(), *sweep.path.iterdir()]
    for path in sorted({*places} - known):
        if path.is_file() or path.parent != sweep.path:
            yield Difference(f"file {path.relative_to(sweep.path)}", "there", ABSENT)


def _recorded(
    sweep: FinishedSweep, folder: Path, factory: ControllerFactory
) -> Iterator[Difference]:
    """A recorded episode whose files were changed, or that is another run than its name says."""
    place = f"{RECORDED}/{folder.name}"
    number = re.match(r"\d+(?=-)", folder.name)
    if number is None or int(number[0]) >= sweep.plan.episodes:
        yield Difference(f"file {place}", "there", ABSENT)
        return
    try:
        description = runs.read_description(folder)
    except OctarmError as error:
        yield Difference(place, str(error), "a run")
        return
    for key, was, now in checksum_differences(folder, description):
        yield Difference(f"{place}: {key}", was, now)
    *_, announced = sweep.begin(int(number[0]), factory)
    inputs = {key: x for key, x in runs.written(announced).items() if key not in _OF_THE_RUN}
    was = {key: value for key, value in description.items() if key in inputs}
    for key, before, now in compare(was, inputs):
        yield Difference(f"{place}: {key}", before, now)
