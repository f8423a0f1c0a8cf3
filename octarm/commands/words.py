"""The experiment that words of a command line name."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from controllers import CONTROLLERS
from octarm.declared import named
from octarm.disturbances.spelling import DISTURBANCES, parse_disturbance
from octarm.metrics.declared import ACCUMULATORS
from octarm.references import REFERENCES
from octarm.runs.experiment import Experiment


def experiment(
    controller: str,
    reference: str,
    disturbances: Sequence[str],
    metrics: Sequence[str] = (),
    **others: Any,
) -> Experiment:
    """The experiment, with short names and the code of what is not built in.

    Raises:
        OctarmError: for a word that means nothing.
    """
    words = [(CONTROLLERS, controller), (REFERENCES, reference)]
    words += [(DISTURBANCES, text) for text in disturbances]
    words += [(ACCUMULATORS, word) for word in metrics]
    names, code = named(words)
    return Experiment(
        controller=names[0],
        reference=names[1],
        disturbances=tuple(map(parse_disturbance, disturbances)),
        code=code,
        **others,
    )
