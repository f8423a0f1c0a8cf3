"""`scripts/reproduce_paper.py --quick` with short runs and fewer of them, to be killed."""

import dataclasses
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

import reproduce_paper  # noqa: E402
from paper import runs, studies  # noqa: E402

from octarm.interrupts import raise_interrupts  # noqa: E402

SETTLED, DURATION = 0.1, 0.6  # from when on errors count, and the length of a run [s]
_sweeps = studies.sweeps
runs.SETTLED = SETTLED  # in worker processes, too


def short_sweeps(variants, effort):
    """The sweeps of the quick variant, with one seed and shorter episodes."""
    for sweep in _sweeps(variants, effort):
        content = {**sweep.content, "duration": DURATION, "settle": SETTLED, "episodes": 1}
        yield sweep._replace(content=content)


if __name__ == "__main__":
    from paper import evidence
    from paper.runs import CONTROLLERS, Cost

    quick = dataclasses.replace(studies.QUICK, seeds=1, duration=DURATION, plant_labels=[])
    studies.QUICK = reproduce_paper.QUICK = quick
    evidence.sweeps = short_sweeps
    # What a step of a controller takes is no result of the study, and differs between runs.
    reproduce_paper.costs = lambda variants: dict.fromkeys(CONTROLLERS, Cost(1e-6, 1e-4))
    raise_interrupts()
    print("begun", flush=True)
    sys.exit(reproduce_paper.main())
