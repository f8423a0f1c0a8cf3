"""What notebooks show of runs, sweeps and reports, and bars where somebody sees them."""

import dataclasses
import functools
import io
import os
import re
import subprocess
import sys
import types
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from recordings import described, swinging, write_run
from test_sweep import Inline

import octarm
from controllers import make_controller
from octarm import bars
from octarm.errors import OctarmError
from octarm.recordings.recording import write_recording
from octarm.recordings.rrd import contents
from octarm.runs.folder import Run
from octarm.simulation import rollout as rollouts
from octarm.sweeps.spec_file import parse_spec

SPEC = """
episodes = 2
duration = 0.3
settle = 0.1
timestep = 0.001
control_period = 0.001
[grid]
controller = ["smc-boundary", "pd"]
[grid.disturbance]
noise = [0.0, 0.4]
"""


def parsed(html: str) -> ET.Element:
    """A cell as XML, of which nothing may be left open."""
    return ET.fromstring(html.replace("&nbsp;", " "))


def texts(html: str) -> str:
    return " ".join(" ".join(parsed(html).itertext()).split())


@pytest.fixture(scope="module")
def swept(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("swept") / "sweep"
    octarm.sweep(parse_spec(SPEC), make_controller, folder, executor=Inline(), in_flight=1)
    return folder


def test_a_trajectory_shows_the_error_of_each_coordinate():
    run = swinging(rows=400)
    text = texts(run._repr_html_())
    assert "400 control instants, 0 to 0.399 s, ok" in text
    rms = np.sqrt(np.mean(run.error**2, axis=0))
    for name, value, unit in zip(("s1", "theta3"), (rms[0], rms[5]), ("mm", "mrad"), strict=True):
        assert f"{name} {1e3 * value:.3g} {unit}" in text
    assert len(run._repr_html_()) < 40_000
    svg = parsed(run._repr_html_()).findall(".//svg")
    assert len(svg) == 6 and all(len(each) == 2 for each in svg)


def test_cells_take_the_colours_of_the_notebook_and_fetch_nothing(swept):
    for thing in (swinging(rows=9), octarm.FinishedSweep(swept), octarm.report(swept)):
        html = thing._repr_html_()
        assert "currentColor" in html or "<svg" not in html
        assert not re.search(r"https?://|src=|@import|<script|#[0-9a-f]{6};? *color", html)
        assert "background: #" not in html.replace('class="dot" style="background: #', "")


def test_columns_of_words_are_on_the_left_whatever_the_notebook_says_of_tables(swept):
    """JupyterLab has a rule of two classes and an element, `..Common td`, that puts all right."""
    style = re.search(r"<style>(.*)</style>", octarm.FinishedSweep(swept)._repr_html_(), re.DOTALL)
    assert style is not None
    ways = re.findall(r"([^{}]*)\{[^{}]*text-align: left", style[1])
    selectors = [selector for way in ways for selector in way.split(",")]
    assert len(selectors) == 2
    for selector in selectors:
        classes, elements = selector.count("."), len(re.findall(r"(?:^|\s)[a-z]", selector.strip()))
        assert (classes, elements) >= (2, 1)


def test_what_a_run_says_is_escaped():
    evil = "<script>alert(1)</script>"
    run = swinging(rows=9)
    html = Run(run, described(controller={"name": evil}, disturbances=[{"name": evil}]))
    assert "<script" not in html._repr_html_()
    assert evil in texts(html._repr_html_())


def test_a_run_that_diverged_is_shown():
    run = swinging(rows=50)
    q = run.q.copy()
    q[30:] = 1e300
    q[40:] = np.nan
    lost = dataclasses.replace(run, q=q, status="diverged", message="diverged at t = 0.03 s")
    assert "diverged at t = 0.03 s" in texts(lost._repr_html_())
    said = texts(Run(lost, described())._repr_html_())
    assert "50 control instants, diverged at t = 0.03 s" in said
    assert "nan," not in lost._repr_html_() and ",nan" not in lost._repr_html_()


def test_a_run_is_read_by_names_and_can_be_unpacked(tmp_path):
    write_run(tmp_path, swinging(rows=20), described(metrics={"tip_rms_error": 0.25}))
    run = octarm.read_run(tmp_path)
    trajectory, description = run
    assert run.trajectory is trajectory and run.description is description
    assert run.metrics == {"tip_rms_error": 0.25}
    assert len(trajectory) == 20 and description["controller"]["name"] == "smc"
    assert "smc on sine" in texts(run._repr_html_())


def test_a_sweep_shows_its_axes_and_how_far_it_is(swept):
    sweep = octarm.FinishedSweep(str(swept))
    text = texts(sweep._repr_html_())
    count = sweep.plan.episodes
    assert f"{count} of {count} episodes" in text
    for axis in sweep.plan.spec.axes:
        assert axis.name in text and str(axis.values[-1]) in text


def test_a_report_shows_the_medians(swept):
    report = octarm.report(swept)
    text = texts(report._repr_html_())
    for group in report.comparisons.of(None):
        assert group.controller in text
    assert all(remark.text in text for remark in report.remarks)
    with pytest.raises(OctarmError, match="unknown"):
        octarm.report(swept, metrics=["no_such_metric"])


@pytest.mark.parametrize("kind", ["trajectory", "run", "folder", "recording"])
def test_the_viewer_of_a_cell_gets_the_whole_recording(tmp_path, monkeypatch, kind):
    sent = []
    made = lambda **size: types.SimpleNamespace(send_rrd=sent.append, **size)  # noqa: E731
    fake = types.SimpleNamespace(Viewer=made)
    monkeypatch.setitem(sys.modules, "rerun_notebook", fake)
    monkeypatch.delenv("RERUN_NOTEBOOK_ASSET", raising=False)
    run = swinging(rows=50)
    folder = tmp_path / "run"
    folder.mkdir()
    write_run(folder, run, described())
    write_recording(folder / "run.rrd", run, described())
    things = {"trajectory": run, "run": octarm.read_run(folder), "folder": folder,
              "recording": str(folder / "run.rrd")}  # fmt: skip
    octarm.show(things[kind])
    (tmp_path / "sent.rrd").write_bytes(sent[0])
    assert "/signals octarm:signals" in contents(tmp_path / "sent.rrd")
    assert os.environ["RERUN_NOTEBOOK_ASSET"] == "inline"


def test_without_the_extra_or_a_recording_one_sentence_says_so(tmp_path, monkeypatch):
    with pytest.raises(OctarmError, match=r"there is no recording .*run\.rrd"):
        octarm.show(tmp_path)
    monkeypatch.setitem(sys.modules, "rerun_notebook", None)
    with pytest.raises(OctarmError, match=r"octarm\[notebook\]"):
        octarm.show(swinging(rows=9))


@pytest.mark.slow
def test_the_widget_of_rerun_is_complete_without_the_network():
    code = (
        "import octarm, sys; sys.path.insert(0, 'tests')\n"
        "from recordings import swinging\n"
        "widget = octarm.show(swinging(rows=50))\n"
        "print(len(widget._esm) > 10_000_000, 'app.rerun.io/version' in widget._esm[:10**6])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True,
        cwd=Path(__file__).parent.parent,
    )  # fmt: skip
    assert done.stdout == "True False\n"


class Terminal(io.StringIO):
    """A standard error that somebody sees."""

    def isatty(self) -> bool:
        return True


def test_a_bar_is_seen_on_terminals_and_in_notebooks_alone(monkeypatch):
    monkeypatch.delitem(sys.modules, "IPython", raising=False)
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    assert not bars.visible()
    monkeypatch.setattr(sys, "stderr", None)
    assert not bars.visible()
    monkeypatch.setattr(sys, "stderr", Terminal())
    assert bars.visible()
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    for config, seen in (({"IPKernelApp": {}}, True), ({}, False)):
        shell = types.SimpleNamespace(config=config)
        fake = types.SimpleNamespace(get_ipython=lambda shell=shell: shell)
        monkeypatch.setitem(sys.modules, "IPython", fake)
        assert bars.visible() is seen


@pytest.mark.parametrize("stream", [Terminal, io.StringIO])
def test_rollout_says_how_far_it_is_where_somebody_sees_it(monkeypatch, stream):
    errors = stream()
    monkeypatch.setattr(sys, "stderr", errors)
    at_once = functools.partial(rollouts.new_bar, mininterval=0.0)
    monkeypatch.setattr(rollouts, "new_bar", lambda delay, **o: at_once(**o))
    environment = octarm.load("sine")
    controller = make_controller("pd", nominal=octarm.nominal_parameters())
    octarm.rollout(environment, controller, 0.02)
    shown = errors.getvalue()
    assert ("40/40" in shown) == (stream is Terminal)
    assert bool(shown) == (stream is Terminal)


def test_a_bar_changes_nothing_of_a_run(monkeypatch):
    controller = make_controller("afsmc", nominal=octarm.nominal_parameters())
    runs = []
    for stream in (io.StringIO, Terminal):
        monkeypatch.setattr(sys, "stderr", stream())
        runs.append(octarm.rollout(octarm.load("sine"), controller, 0.02))
    assert runs[0].digest == runs[1].digest


def test_the_table_of_a_sweep_is_one_line_away_from_pandas_polars_and_duckdb(swept):
    import duckdb
    import pandas
    import polars

    table = octarm.read_sweep(swept)
    frame = table.to_pandas()
    np.testing.assert_array_equal(frame["tip_rms_error"], table["tip_rms_error"].to_numpy())
    files = f"{swept}/episodes/*.parquet"
    first = pandas.concat(map(pandas.read_parquet, sorted(swept.glob("episodes/*.parquet"))))
    assert first["episode"].tolist() == table["episode"].to_pylist()
    assert polars.read_parquet(files)["episode"].to_list() == table["episode"].to_pylist()
    query = f"SELECT controller, median(tip_rms_error) FROM '{files}' GROUP BY controller"
    medians = dict(duckdb.connect().execute(query).fetchall())
    for name, group in frame.groupby("controller"):
        assert medians[name] == pytest.approx(group["tip_rms_error"].median())
