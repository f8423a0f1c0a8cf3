"""The files of a sweep folder beside those that its manifest says, and gains beside today's."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator
from pathlib import Path

from octarm.checks.differences import ABSENT, Difference, compare
from octarm.checks.run_files import checksum_differences
from octarm.errors import OctarmError
from octarm.interfaces import ControllerFactory
from octarm.runs import folder as runs
from octarm.sweeps.episodes import FinishedSweep
from octarm.sweeps.manifest import EPISODES, MANIFEST, SPEC
from octarm.sweeps.store import LOCK, PROGRESS, RECORDED, read_shard

_FILES = (SPEC, MANIFEST, LOCK, PROGRESS)  # what else there is are folders
# Of run.json: what came of a run, and where it was made.
_OF_THE_RUN = (
    "disturbances", "metrics", "status", "message", "digest", "command", *runs.NAMED,
)  # fmt: skip


def sweep_differences(sweep: FinishedSweep, factory: ControllerFactory) -> list[Difference]:
    """What of a finished or unfinished sweep is not as it was written, without running it again.

    The factory is the one that the sweep had. Raises OctarmError if a controller cannot be made.
    """
    spec = sweep.plan.spec
    first = spec.all_arms()[0]
    made = {name: spec.controller(name, first, factory) for name in spec.controllers}
    gains = {name: runs.gains_of(controller) for name, controller in made.items()}
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
    known |= {sweep.path / name for name in _FILES}
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
