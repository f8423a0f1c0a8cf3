"""The quick variant of the paper's results, and what the repository shows of the full one."""

import dataclasses
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import filelock
import numpy as np
import pytest
import tomlkit
from paper import plants, runs, writeup
from paper.claims import Claim, Verdict
from paper.evidence import Evidence, gather, measured, run_all
from paper.studies import BENDS, COORDINATES, FULL, NOISE, QUICK, SCALE, TIME, Cell, Effort, sweeps
from paper.tables import all_tables, as_csv, tuning
from paper.variants import CONTROLLERS, FIXED_PREMISES, PROPOSED, SIGN, SMC, all_variants, by_hand

import octarm
from controllers import make_controller
from octarm.disturbances.forces import BandLimitedNoise
from octarm.simulation.engines import LAGRANGE
from octarm.sweeps.shards import measure

ROOT = Path(__file__).resolve().parent.parent
SCRIPT = ROOT / "scripts" / "reproduce_paper.py"
SHIPPED = ROOT / "controllers" / "gains"
VARIANTS, ARM = all_variants(), octarm.nominal_parameters()


@pytest.fixture(scope="module")
def published() -> dict[str, Any]:
    return json.loads((ROOT / ".readme" / "paper.json").read_text(encoding="utf-8"))


@dataclasses.dataclass(frozen=True)
class Quick:
    """What came of the quick variant."""

    evidence: Evidence
    claims: list[Claim]
    out: Path


@pytest.fixture(scope="module")
def quick(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Quick]:
    out = tmp_path_factory.mktemp("paper")
    base = tmp_path_factory.getbasetemp()  # of a worker it lies in that of the session
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "quick-paper"
    with filelock.FileLock(f"{shared}.lock"):
        run_all(VARIANTS, QUICK, shared)
    shutil.copytree(shared, out, dirs_exist_ok=True)
    evidence = gather(VARIANTS, QUICK, out, runs.costs(VARIANTS))
    yield Quick(evidence, writeup.write_all(evidence, out, SHIPPED), out)


@pytest.mark.slow
def test_the_quick_variant_contradicts_no_published_verdict(
    quick: Quick, published: dict[str, Any]
):
    """Its cases are some of all, with fewer seeds: none holds here in all and there in none."""
    here = {claim.letter: str(claim.verdict) for claim in quick.claims if claim.place}
    assert list(here) == list("abcdefg")
    opposite = {str(verdict) for verdict in Verdict} - {str(Verdict.ONLY_IF)}
    assert len(opposite) == 2
    for claim in published["claims"]:
        assert {here[claim["letter"]], claim["verdict"]} != opposite
    assert next(claim.letter for claim in quick.claims if not claim.place) == "i"


@pytest.mark.slow
def test_the_report_needs_nothing_beside_itself(quick: Quick):
    page = (quick.out / writeup.PAGE).read_text(encoding="utf-8")
    assert not re.search(r"""(src|href)=["'](?!#)""", page)
    assert "nan" not in re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL).lower().split()
    for claim in quick.claims:
        assert f"({claim.letter}) {claim.title}" in page
    for folder, ending in (
        (writeup.FIGURES, "png"),
        (writeup.FIGURES, "svg"),
        (writeup.TABLES, "csv"),
    ):
        assert len(list((quick.out / folder).glob(f"*.{ending}"))) >= 5


@pytest.mark.slow
def test_timings_stand_apart_and_all_else_is_the_same_again(quick: Quick):
    slower = {n: c._replace(many=1.1 * c.many) for n, c in quick.evidence.costs.items()}
    again = gather(VARIANTS, QUICK, quick.out, slower)
    tables = all_tables(again, SHIPPED)
    assert "timings" in tables
    for table in (x for name, x in tables.items() if name != "timings"):
        written = quick.out / writeup.TABLES / f"{table.name}.csv"
        assert as_csv(table) == written.read_text(encoding="utf-8")
    content = json.loads((quick.out / "claims.json").read_text(encoding="utf-8"))
    for claim in writeup.all_claims(again):
        written = next(
            x for x in content["claims"] + content["questions"] if x["letter"] == claim.letter
        )
        assert (json.loads(json.dumps(claim.to_dict())) == written) == (claim.letter != "g")
    assert "[us]" in (quick.out / "timings.csv").read_text(encoding="utf-8")


def test_the_readme_shows_the_published_claims(published: dict[str, Any]):
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert writeup.with_claims(readme, published) == readme
    assert published["effort"] == FULL.name and published["seeds"] == FULL.seeds == 64
    for name in ("paper.png", "paper.md"):
        assert f"](.readme/{name})" in readme and (ROOT / ".readme" / name).is_file()


@pytest.mark.slow
def test_every_tuned_controller_beats_its_hand_set_gains_on_the_objective(quick: Quick):
    rows = list(tuning(quick.evidence, SHIPPED))
    assert [row[0] for row in rows] == list(CONTROLLERS)
    for name, short, short_by_hand, long, long_by_hand, *_ in rows:
        costs = np.array([short, short_by_hand, long, long_by_hand], dtype=float)
        assert costs[0] < costs[1] and costs[2] < costs[3], name


@pytest.mark.parametrize("effort", [FULL, QUICK], ids=lambda effort: effort.name)
def test_a_study_is_a_spec_with_the_gains_of_its_variants(effort: Effort, tmp_path: Path):
    parts = list(sweeps(VARIANTS, effort))
    assert len({part.name for part in parts}) == len(parts)
    for part in parts:
        (tmp_path / "spec.toml").write_text(tomlkit.dumps(part.content), encoding="utf-8")
        spec = octarm.read_spec(tmp_path / "spec.toml")
        assert list(spec.controllers) == list(part.labels)
        for name, label in part.labels.items():
            assert spec.gains[name] == VARIANTS[label].gains
    labels = {label for part in parts for label in part.labels.values()}
    assert {x for entry in effort.sweeps for part in entry["labels"] for x in part} == labels


def test_what_is_run_is_the_specs_with_cells_without_noise_apart():
    parts = {part.name: part for part in sweeps(VARIANTS, FULL)}
    assert (
        parts["tuned"].content["episodes"] == 64 and parts["tuned-quiet"].content["episodes"] == 1
    )
    assert parts["tuned"].content["grid"]["disturbance"]["noise"] == [NOISE]
    assert parts["tuned-quiet"].content["grid"]["disturbance"]["noise"] == [0.0]
    assert len(parts["tuned-quiet"].content["grid"]["mismatch"]) == 7


def test_a_sweep_of_the_study_twice_gives_the_same_cells(tmp_path: Path):
    part = next(p for p in sweeps(VARIANTS, QUICK) if FIXED_PREMISES in p.labels.values())
    part = part._replace(content={**part.content, "duration": 2.05, "episodes": 1})
    (tmp_path / "spec.toml").write_text(tomlkit.dumps(part.content), encoding="utf-8")
    spec = octarm.read_spec(tmp_path / "spec.toml")
    results = []
    for name in ("first", "second"):
        octarm.sweep(spec, make_controller, tmp_path / name / part.name)
        results.append(measured([part], tmp_path / name))
    first, second = results
    assert len(first) == 12 and list(first) == list(second)
    for cell, quantities in first.items():
        for quantity in ("error", "chattering", "overshoot_theta1"):
            own, again = quantities[quantity], second[cell][quantity]
            assert np.array_equal(own, again, equal_nan=True)


def test_what_figure_1_shows_is_what_is_recorded(tmp_path: Path):
    request = next(r for r in runs.requests(VARIANTS, QUICK) if r.name == "sine-smc-boundary")
    request = request._replace(duration=0.2, seeds=1)
    series = runs.Series(**request.perform())
    runs.record(request, -0.3, tmp_path)
    folder = tmp_path / "sine-smc-boundary--30"
    trajectory, description = octarm.read_run(folder)
    assert description["controller"]["name"] == SMC
    assert (folder / "run.rrd").is_file()
    assert np.array_equal(series.of(-0.3, 0.0)[:, 0], trajectory.q[::20])
    assert not np.array_equal(series.of(-0.3, NOISE)[:, 0], trajectory.q[::20])


def test_oscillations_are_those_of_all_control_instants():
    """Noise is held for 20 of them: every 20th would always see it at the same age."""
    request = runs.Request(
        "run", VARIANTS[SMC], BENDS, 2.2, ("q", "q_d", "lost"),
        lambda one, rows: {"all": rows["q"], **runs.kept(one, rows)},
        mismatches=(0.0, 0.3), seeds=2,
    )  # fmt: skip
    arrays = request.perform()
    assert np.array_equal(arrays["q"], arrays["all"][::20]) and len(arrays["all"]) == 4400
    steady = arrays["all"][4000:]  # from 2 s on, at 2 kHz
    moved = steady - steady[:, [0, 0, 0, 3, 3, 3]]  # the arms without noise
    expected = np.sqrt(np.mean(np.square(moved), axis=0))
    np.testing.assert_allclose(arrays["moved"], expected, rtol=1e-9)
    coarse = np.sqrt(np.mean(np.square(moved[::20]), axis=0))
    assert np.max(np.abs(coarse / np.where(expected, expected, np.inf) - 1.0)) > 0.01


def test_the_error_on_a_plant_is_that_of_all_physics_steps_and_arms_are_those_of_the_seeds():
    """Three modules are the arm itself; the metrics of the package count from 2 s on."""
    environment = octarm.load(
        BENDS, batch=3, control_period=0.002, timestep="auto", engine=LAGRANGE,
        disturbances=[
            BandLimitedNoise(ratio=np.array([[0.0], [NOISE], [NOISE]]), correlation_time=TIME)
        ],
        seed=[np.random.SeedSequence(0, spawn_key=(i,)) for i in (0, 0, 1)],
    )  # fmt: skip
    variant = VARIANTS[by_hand(SMC)]
    outcome = measure(environment, variant.controls(ARM), 2.2)
    rms = np.array([outcome.metrics[f"rms_error_{name}"] for name in COORDINATES])
    expected = np.sqrt(np.mean((rms / SCALE[:, None]) ** 2, axis=0))
    arms = runs.noisy_arms([0.0, NOISE, NOISE], [0, 0, 1])
    kept = plants.tracking(variant, 3, 0.002, LAGRANGE, 2.2, 2.0, **arms)
    np.testing.assert_allclose(kept["error"], expected, rtol=1e-9)
    planted = plants.planted(variant, 3, 500.0, 2, LAGRANGE)
    assert planted["error"].shape == (3,) and not planted["lost"].any()
    assert len(set(planted["error"].tolist())) == 3


@pytest.mark.parametrize("modules", [3, 9])
def test_the_longest_period_about_rest_is_the_one_that_is_predicted(modules: int):
    """With hand-set gains, which stay what they are."""
    predicted, simulated = plants.longest_two(VARIANTS[by_hand(SMC)], modules, 1e-3, LAGRANGE)
    assert simulated == pytest.approx(predicted, rel=0.08)


def test_a_law_without_a_slope_is_asked_to_track():
    rattling = VARIANTS[by_hand(SIGN)].changed("rattling", K=100.0)
    assert plants.tracking(rattling, 3, 0.005, LAGRANGE)["error"] > plants.TRACKED
    usual = VARIANTS[by_hand(SIGN)]
    assert plants.tracking(usual, 3, 0.001, LAGRANGE)["error"] <= plants.TRACKED


def outcomes(variant, rate: float, duration: float) -> list[runs.Descent]:
    request = runs.Request("run", variant, BENDS, duration, runs.LYAPUNOV, runs.counts, rate=rate)
    return runs.outcomes(request, request.perform())


def test_the_lyapunov_function_of_the_printed_law_falls_when_control_is_fast():
    """With sgn(s) and without safeguards V' <= 0 holds everywhere; sampling alone can break it."""
    printed = VARIANTS[by_hand(PROPOSED)].changed("printed", phi=0.0, safeguards=0.0)
    grown = {}
    for rate in (10_000.0, 40_000.0):
        arms = outcomes(printed, rate, 0.05)
        assert all(o.inside == 0 and o.outside == round(0.05 * rate) - 1 for o in arms)
        grown[rate] = max(o.grown_outside / o.outside for o in arms)
    assert grown[40_000.0] <= grown[10_000.0] < 0.1


def test_the_layer_tells_where_v_falls():
    arms = outcomes(VARIANTS[by_hand(SMC)], 2000.0, 0.1)
    assert all(o.outside > 5 and o.grown_outside == 0 and o.covered for o in arms)
    sign = outcomes(VARIANTS[by_hand(SIGN)], 2000.0, 0.1)
    assert all(o.inside == 0 and o.grown_outside > 0 for o in sign)


@pytest.mark.slow
def test_cells_are_found_by_what_acts(quick: Quick):
    evidence = quick.evidence
    assert evidence.has(Cell(PROPOSED, mismatch=-0.3, noise=NOISE))
    assert evidence.has(Cell(PROPOSED, "beyond", mismatch=-0.3, payload=0.1))
    assert not evidence.has(Cell(PROPOSED, mismatch=-0.25))
    assert len(evidence.cells[Cell(SMC, mismatch=0.3, noise=NOISE)]["error"]) == QUICK.seeds


@pytest.mark.slow
def test_a_resumed_run_does_nothing_again(quick: Quick):
    files = sorted(quick.out.glob("s*/**/*.npz")) + sorted(quick.out.glob("sweeps/*/episodes/*"))
    before = [file.stat().st_mtime_ns for file in files]
    run_all(VARIANTS, QUICK, quick.out)
    assert before == [file.stat().st_mtime_ns for file in files]
    assert len(files) > 10


def test_bad_input_is_one_sentence(tmp_path: Path):
    (tmp_path / "file").write_text("x", encoding="utf-8")
    done = subprocess.run(
        [sys.executable, SCRIPT, "--quick", "--out", tmp_path],
        capture_output=True, text=True, timeout=1800, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "is not empty" in done.stderr and len(done.stderr.splitlines()) == 1
