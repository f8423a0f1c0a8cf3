"""Set-up shared by all tests."""

import os
import sys

import pytest

# Or each of hundreds of processes would compile all files anew, and rewrite all assertions.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
# Nothing here draws with MuJoCo's renderer; without this, dm_control looks for a display.
os.environ.setdefault("MUJOCO_GL", "disabled")

from octarm.simulation.engines import ENGINES
from octarm.simulation.environment import load

sys.dont_write_bytecode = False


@pytest.fixture(params=ENGINES)
def each_engine(request, monkeypatch) -> str:
    """Lets `load` take each of the engines where a test does not say which."""
    monkeypatch.setitem(load.__kwdefaults__, "engine", request.param)
    return request.param


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Tests of a file share what they are tried on: a worker gets its files in order.

    What is left at the end is shared out.
    """
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log)
