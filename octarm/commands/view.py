"""What `octarm view` does."""

from __future__ import annotations

import functools

from dm_control import viewer

from controllers import make_controller
from octarm.errors import OctarmError
from octarm.runs.experiment import Experiment
from octarm.simulation.policy import Policy


def view(experiment: Experiment, gain_set: str | None) -> None:
    """`octarm view`: the arm in dm_control's viewer, moved by a controller."""
    factory = functools.partial(make_controller, gain_set=gain_set)
    environment, controller = experiment.begin(factory)
    title = f"{experiment.controller} on {experiment.reference}"
    try:
        viewer.launch(environment, Policy(environment, controller), title=title)
    except Exception as error:
        if type(error).__name__ not in ("GLFWError", "FatalError", "RuntimeError"):
            raise
        raise OctarmError(f"the window cannot be opened: {error}") from None
