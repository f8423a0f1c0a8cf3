"""The quick variant of the paper's results, and what the repository shows of the full one."""

import dataclasses
import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from paper import report as output
from paper.evidence import Cell, Evidence, Measured
from paper.lyapunov import LyapunovRequest
from paper.report import Report
from paper.runs import SingleRequest, series_requests
from paper.studies import BENDS, CONTROLLERS, FULL, NOISE, PROPOSED, QUICK, SIGN, SMC, by_hand, cast
from paper.tables import tuning
from reproduce_paper import measure

from controllers import make_controller
from controllers.gain_sets import SHIPPED
from octarm import sweep
from octarm.runs.folder import read_run

ROOT = Path(__file__).resolve().parent.parent
SCRIPT = ROOT / "scripts" / "reproduce_paper.py"
EVERYBODY = cast()


@pytest.fixture(scope="module")
def published() -> dict[str, Any]:
    return json.loads((ROOT / ".readme" / "paper.json").read_text(encoding="utf-8"))


@dataclasses.dataclass(frozen=True)
class Quick:
    """What came of the quick variant."""

    evidence: Evidence
    report: Report
    out: Path


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Quick:
    out = tmp_path_factory.mktemp("paper")
    evidence = measure(QUICK, out)
    report = Report(evidence, SHIPPED)
    report.write(out)
    return Quick(evidence, report, out)


@pytest.mark.slow
def test_the_quick_variant_comes_to_the_published_verdicts(quick: Quick, published: dict[str, Any]):
    here = {claim.letter: str(claim.verdict) for claim in quick.report.claims}
    assert here == {claim["letter"]: claim["verdict"] for claim in published["claims"]}
    assert list(here) == list("abcdefg")


@pytest.mark.slow
def test_the_report_needs_nothing_beside_itself(quick: Quick):
    page = (quick.out / output.PAGE).read_text(encoding="utf-8")
    assert not re.search(r"""(src|href)=["'](?!#)""", page)
    assert "nan" not in re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL).lower().split()
    for claim in quick.report.claims:
        assert f"({claim.letter}) {claim.title}" in page
    for folder, ending in (
        (output.FIGURES, "png"),
        (output.FIGURES, "svg"),
        (output.TABLES, "csv"),
    ):
        assert len(list((quick.out / folder).glob(f"*.{ending}"))) >= 5


@pytest.mark.slow
def test_timings_stand_apart_and_all_else_is_the_same_again(quick: Quick):
    slower = {name: c._replace(many=1.1 * c.many) for name, c in quick.evidence.costs.items()}
    again = Report(dataclasses.replace(quick.evidence, costs=slower), SHIPPED)
    for table in again.tables:
        written = quick.out / output.TABLES / f"{table.name}.csv"
        assert table.csv() == written.read_text(encoding="utf-8")
    claims = (quick.out / output.CLAIMS).read_text(encoding="utf-8")
    assert output.as_json(again.content()) == claims
    assert "[us]" in (quick.out / "timings.csv").read_text(encoding="utf-8")


def test_the_readme_shows_the_published_claims(published: dict[str, Any]):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert output.with_claims(readme, published["claims"]) == readme
    assert published["effort"] == FULL.name and published["seeds"] == FULL.seeds == 64
    for name in ("paper.png", "paper.md"):
        assert f"](.readme/{name})" in readme and (ROOT / ".readme" / name).is_file()


def test_every_tuned_controller_beats_its_hand_set_gains_on_the_objective():
    evidence = Evidence(
        variants=EVERYBODY,
        effort=QUICK,
        measured=Measured({}, {}),
        series={},
        outcomes=[],
        costs={},
    )
    rows = tuning(evidence, SHIPPED).rows
    assert len(rows) == len(CONTROLLERS)
    for name, short, short_by_hand, long, long_by_hand, *_ in rows:
        costs = np.array([short, short_by_hand, long, long_by_hand], dtype=float)
        assert costs[0] < costs[1] and costs[2] < costs[3], name


def test_a_sweep_of_the_study_twice_gives_the_same_cells(tmp_path: Path):
    part = next(p for p in QUICK.parts(EVERYBODY) if p.name == "tracking-premises")
    part = part._replace(spec=dataclasses.replace(part.spec, duration=2.05, episodes=1))
    cells = []
    for name in ("first", "second"):
        sweep(part.spec, make_controller, tmp_path / name / part.name)
        cells.append(Measured.read([part], tmp_path / name))
    first, second = cells
    for cell in first.cells():
        for quantity in ("error", "chattering", "overshoot_theta1"):
            assert np.array_equal(first.values(cell, quantity), second.values(cell, quantity))


def test_what_figure_1_shows_is_what_is_recorded(tmp_path: Path):
    request = next(r for r in series_requests(EVERYBODY, QUICK) if r.name == "sine-smc-boundary")
    run = request._replace(duration=0.2, seeds=1).run()
    single = SingleRequest("run", EVERYBODY[SMC], BENDS, -0.3, 0.2)
    single.write(tmp_path)
    folder = single.file(tmp_path).parent
    trajectory, description = read_run(folder)
    assert description["controller"]["name"] == SMC
    assert (folder / "run.rrd").is_file()
    assert np.array_equal(run.of(-0.3, 0.0)[:, 0], trajectory.q[::20])
    assert not np.array_equal(run.of(-0.3, NOISE)[:, 0], trajectory.q[::20])


def test_the_lyapunov_function_of_the_printed_law_falls_when_control_is_fast():
    """With sgn(s) and without safeguards V' <= 0 holds everywhere; sampling alone can break it."""
    printed = EVERYBODY[by_hand(PROPOSED)].changed("printed", phi=0.0, safeguards=0.0)
    grown = {}
    for rate in (10_000.0, 40_000.0):
        outcomes = LyapunovRequest(printed, rate, 0.05).run()
        assert all(o.inside == 0 and o.outside == round(0.05 * rate) - 1 for o in outcomes)
        grown[rate] = max(o.grown_outside / o.outside for o in outcomes)
    assert grown[40_000.0] <= grown[10_000.0] < 0.1


def test_the_layer_tells_where_v_falls():
    outcomes = LyapunovRequest(EVERYBODY[by_hand(SMC)], 2000.0, 0.1).run()
    assert all(o.outside > 5 and o.grown_outside == 0 and o.covered for o in outcomes)
    sign = LyapunovRequest(EVERYBODY[by_hand(SIGN)], 2000.0, 0.1).run()
    assert all(o.inside == 0 and o.grown_outside > 0 for o in sign)


@pytest.mark.slow
def test_cells_are_found_by_what_acts(quick: Quick):
    measured = quick.evidence.measured
    assert measured.has(Cell(PROPOSED, mismatch=-0.3, noise=NOISE))
    assert measured.has(Cell(PROPOSED, "beyond", mismatch=-0.3, payload=0.1))
    assert not measured.has(Cell(PROPOSED, mismatch=-0.25))
    assert len(measured.values(Cell(SMC, mismatch=0.3, noise=NOISE), "error")) == QUICK.seeds


@pytest.mark.slow
def test_an_interrupted_run_says_how_to_go_on(tmp_path: Path):
    out = tmp_path / "out"
    process = subprocess.Popen(
        [sys.executable, SCRIPT, "--quick", "--out", out],
        cwd=tmp_path, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    while not (out / "sweeps").is_dir() and process.poll() is None:
        time.sleep(0.05)
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    _, error = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "--resume" in error.splitlines()[-1]
    assert "Traceback" not in error


def test_bad_input_is_one_sentence(tmp_path: Path):
    (tmp_path / "file").write_text("x", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, SCRIPT, "--quick", "--out", tmp_path],
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "is not empty" in done.stderr and len(done.stderr.splitlines()) == 1
