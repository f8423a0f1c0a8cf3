"""A metric from outside the package: one class and one line, and it is found everywhere."""

import json
import xml.etree.ElementTree as ET
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import octarm
from controllers import make_controller
from octarm.commands.cli import main
from octarm.interfaces import Rows
from octarm.metrics.metric import Accumulator, Metric, Settings
from octarm.metrics.table import METRICS
from octarm.sweeps.spec_file import parse_spec


class Reach(Accumulator):
    """The largest distance of a coordinate from zero, and what a signal says at the end."""

    metrics = {  # noqa: RUF012
        "largest_distance": Metric(
            "coordinate", ("m", "rad"), "largest |q| of the run", better="more"
        ),
        "last_s": Metric("arm", ("m/s",), "mean of s at the end", better="neither"),
    }
    signals = ("s",)

    def __init__(self, first: Rows, settings: Settings) -> None:
        self._largest = np.zeros_like(first["q"])
        self._last = np.zeros_like(first["q"][..., 0])

    def update(self, rows: Rows, steady: bool) -> None:
        self._largest = np.maximum(self._largest, np.max(np.abs(rows["q"]), axis=0))
        self._last = np.mean(rows["s"][-1], axis=-1)

    def result(self) -> dict[str, np.ndarray]:
        return {"largest_distance": self._largest, "last_s": self._last}


SPEC = """\
episodes = 2
duration = 0.1
[grid]
controller = ["smc-boundary", "pd"]
[grid.disturbance]
noise = [0.0, 0.4]
"""


@pytest.fixture
def declared(monkeypatch):
    monkeypatch.setattr(METRICS, "accumulators", (*METRICS.accumulators, Reach))


def test_a_run_has_it(declared, tmp_path):
    assert METRICS["largest_distance"].better == "more"
    run = ["run", "--controller", "smc-boundary", "--duration", "0.1", "--out", str(tmp_path / "r")]
    assert main(run) == 0
    trajectory, description = octarm.read_run(tmp_path / "r")
    largest = description["metrics"]["largest_distance"]
    np.testing.assert_array_equal(largest, np.max(np.abs(trajectory.q), axis=0))
    assert description["metrics"]["last_s"] == np.mean(trajectory.signals["s"][-1])
    assert (
        json.loads((tmp_path / "r" / "run.json").read_text())["metrics"]["largest_distance"]
        == largest
    )


def test_a_sweep_and_its_report_have_it(declared, tmp_path):
    folder = tmp_path / "sweep"
    with ThreadPoolExecutor(1) as thread:
        octarm.sweep(parse_spec(SPEC), make_controller, folder, executor=thread, in_flight=1)
    table = octarm.read_sweep(folder)
    assert table.schema.field("largest_distance_theta2").metadata[b"unit"] == b"rad"
    assert all(value > 0.0 for value in table["largest_distance_theta2"].to_pylist())
    metrics = ["--metric", "largest_distance_theta2", "--metric", "last_s"]
    assert main(["report", str(folder), *metrics]) == 0
    page = ET.fromstring((folder / "report" / "report.html").read_text(encoding="utf-8"))
    rows = [["".join(cell.itertext()) for cell in row.iter("td")] for row in page.iter("tr")]
    assert ["largest_distance_theta2", "largest |q| of the run", "mrad", "more"] in rows
    assert ["last_s", "mean of s at the end", "m/s", "neither"] in rows
