"""The report on a sweep: its numbers, its doubts, its page."""

import csv
import dataclasses
import html.parser
import json
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

import octarm
from controllers import make_controller
from octarm.arrays import coordinate_names, coordinate_units
from octarm.commands.cli import main
from octarm.errors import ExitCode
from octarm.metrics.table import METRICS
from octarm.metrics.table import columns as metric_columns
from octarm.palette import look_of
from octarm.reports.charts import pictures
from octarm.reports.comparisons import compare, partners
from octarm.reports.consistency import remarks
from octarm.reports.figures import inline_svg, panels_of
from octarm.reports.frame import read_episodes
from octarm.reports.report import Tables, number
from octarm.reports.statistics import adjusted, binomial
from octarm.sweeps.plan import Plan
from octarm.sweeps.spec import Axis, SweepSpec
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.store import SweepFolder, open_sweep

HOSTILE = '<script>alert("&")</script>'
NOISES, MISMATCHES, SEEDS = (0.0, 0.2, 0.4), (-0.3, 0.3), 6
FACTOR = {"plain": 2.0, "better": 1.0, HOSTILE: 3.0}
PIECE = 18  # rows of a shard


def columns(controllers=tuple(FACTOR), seeds=SEEDS) -> dict[str, np.ndarray]:
    """A sweep whose numbers are known.

    The error of theta1 is the controller's factor times (0.01 rad + noise x luck), the luck of a
    seed being the same for all.
    """
    shape = (len(controllers), len(MISMATCHES), len(NOISES), seeds)
    c, m, k, seed = (place.ravel() for place in np.indices(shape))
    luck = 0.001 * (1.0 + seed)
    factor = np.array([FACTOR.get(name, 1.0) for name in controllers])[c]
    noise = np.array(NOISES)[k]
    error = factor * (0.01 + noise * luck)
    n = len(seed)
    missing = {
        f"{metric}_{name}": np.full(n, np.nan)
        for metric in ("rms_error", "overshoot", "settling_time", "settled", "layer_share")
        for name in ("s1", "s2", "s3", "theta1", "theta2", "theta3")
    }
    return missing | {
        "episode": np.arange(n),
        "controller": np.array(controllers, dtype=object)[c],
        "seed": seed,
        "status": np.full(n, "ok", dtype=object),
        "reference": np.full(n, "sine", dtype=object),
        "mismatch": np.array(MISMATCHES)[m],
        "noise": noise,
        "rms_error_s1": 1e-5 * np.ones(n),
        "rms_error_theta1": error,
        "rms_error_theta2": 0.5 * error,
        "tip_rms_error": 0.1 * error,
        "settling_time_theta1": np.where(noise > 0.3, np.nan, 0.1),
        "settled_theta1": np.where(noise > 0.3, 0.0, 1.0),
        "layer_share_theta1": 1.0 - noise,
        "overshoot_theta1": -100.0 * error,
        "effort_tau1": 3.0 * np.ones(n),
        "effort_tau2": 4.0 * np.ones(n),
        "digest": np.arange(n, dtype=np.uint64) + np.uint64(2**63),
    }


def spec_of(
    table: dict[str, np.ndarray], duration: float = 4.0, random: tuple[Axis, ...] = ()
) -> SweepSpec:
    """The spec of a table like that of `columns`."""
    values = {
        name: tuple(dict.fromkeys(table[name].tolist()))
        for name in ("controller", "reference", "mismatch", "noise")
    }
    axes = [Axis(name=name, values=values[name]) for name in ("controller", "reference")]
    axes += [Axis(name="mismatch", values=values["mismatch"])]
    axes += [Axis(name="noise", values=values["noise"], disturbance="noise", field="ratio")]
    spec = SweepSpec(
        axes=tuple(axes),
        random=random,
        episodes=int(table["seed"].max()) + 1,
        duration=duration,
        batch=PIECE,
    )
    return dataclasses.replace(spec, text=f"# {HOSTILE}\n{spec.to_toml()}")


def write_sweep(folder: Path, table: dict[str, np.ndarray], **settings) -> Path:
    """A folder as `octarm sweep` leaves it; settings are those of `spec_of`."""
    plan = Plan(spec_of(table, **settings))
    table = {**table, "episode": np.arange(plan.episodes)}
    known = metric_columns(coordinate_names(3), coordinate_units(3))
    metadata = {column.name: column.metadata for column in known}
    fields = []
    arrays = []
    for name, column in table.items():
        missing = np.isnan(column) if column.dtype.kind == "f" else None
        arrays.append(pa.array(column, mask=missing))
        fields.append(pa.field(name, arrays[-1].type, metadata=metadata.get(name)))
    whole = pa.table(arrays, pa.schema(fields, {"gains": json.dumps({"K": 1.0})}))
    sweep = SweepFolder(folder, plan)
    with sweep.locked():
        sweep.begin({name: {"K": 1.0} for name in plan.spec.controllers})
        for i, episodes in enumerate(map(plan.shard, plan.shards)):
            sweep.write(i, whole.slice(episodes.start, len(episodes)))
    manifest = open_sweep(folder)[1]
    host = {"cpu": "x", "cores": 2}
    manifest["starts"] = [{"time": "2026-01-01", "versions": {"numpy": "2"}, "host": host}]
    (folder / "manifest.json").write_text(json.dumps(manifest))
    return folder


@pytest.fixture(scope="module")
def known(tmp_path_factory) -> Path:
    return write_sweep(tmp_path_factory.mktemp("known") / "sweep", columns())


@pytest.fixture(scope="module")
def written(known) -> Path:
    assert main(["report", str(known), "--metric", "tip_rms_error", "--metric", "effort"]) == 0
    return known / "report"


def diverge(table: dict[str, np.ndarray], where: np.ndarray) -> None:
    table["status"][where] = "diverged"
    for name, column in table.items():
        if any(name.startswith(metric) for metric in METRICS):
            column[where] = np.nan


# --- numbers ---------------------------------------------------------------------------------


def test_the_default_metrics_are_those_of_what_moves(known):
    episodes = read_episodes(known)
    assert [measure.name for measure in episodes.measures] == [
        "rms_error_theta1", "rms_error_theta2", "tip_rms_error", "effort", "overshoot_theta1",
    ]  # fmt: skip
    assert episodes.absent == ("chattering", "overshoot_theta2")
    assert [axis.name for axis in episodes.factors] == ["mismatch", "noise"]
    assert episodes.factors[1].title == "noise [%]"
    assert episodes.factors[1].labels == ("0", "20", "40")
    assert episodes.factors[1].levels == ("0", "0.2", "0.4")  # as the table has them
    assert np.allclose(episodes.factors[1].places, (0.0, 20.0, 40.0))


def test_medians_and_differences_are_those_of_the_formula(known):
    report = compare(read_episodes(known, ["rms_error_theta1"]), "plain")
    noisy = [entry for entry in report.of(report.episodes.factors[1]) if entry.label == "40"]
    for entry in noisy:
        factor = FACTOR[entry.controller]
        assert entry.episodes == SEEDS * len(MISMATCHES)
        assert entry.medians.value[0] == pytest.approx(factor * (0.01 + 0.4 * 0.0035))
        assert entry.medians.low[0] < entry.medians.value[0] < entry.medians.high[0]
    assert noisy[0].difference is None
    for entry in noisy[1:]:
        assert entry.difference is not None
        measured, sign = entry.difference.measured, FACTOR[entry.controller] - 2.0
        assert measured.difference.value[0] == pytest.approx(sign * (0.01 + 0.4 * 0.0035))
        assert measured.won[0] == (12 if sign < 0.0 else 0)
        assert measured.lost[0] == (0 if sign < 0.0 else 12)


def test_inputs_are_brought_together_and_single_columns_are_not(known):
    episodes = read_episodes(known, ["effort", "effort_tau2"])
    assert np.all(episodes.values == [np.sqrt(12.5), 4.0])


def test_partners_share_seed_and_cell(known):
    episodes = read_episodes(known)
    partner = partners(episodes, "better")
    assert np.all(episodes.controller[partner] == 1)
    for axis in episodes.factors:
        assert np.array_equal(axis.code[partner], axis.code)
    assert np.array_equal(episodes.seed[partner], episodes.seed)


def test_diverged_episodes_lose_and_are_counted(tmp_path):
    table = columns()
    per = len(table["seed"]) // 3
    diverge(table, np.isin(table["episode"], [0, 1, 2, per + 2, per + 3, 2 * per]))
    write_sweep(tmp_path / "s", table)
    report = compare(read_episodes(tmp_path / "s", ["tip_rms_error"]), "plain")
    plain, better, other = report.of(None)
    assert (plain.failed, better.failed, other.failed) == (3, 2, 1)
    c = better.difference
    assert c is not None
    assert (c.pairs, c.alone, c.other, c.both, c.unpaired) == (36, 1, 2, 1, 0)
    assert (c.measured.won[0], c.measured.lost[0]) == (34, 1)  # and one even


def test_a_median_does_not_gain_by_losing_the_hard_episodes(tmp_path):
    table = columns(("plain", "better"))
    hard = (table["controller"] == "better") & (table["noise"] > 0.1)
    diverge(table, hard)
    write_sweep(tmp_path / "s", table)
    report = compare(read_episodes(tmp_path / "s", ["tip_rms_error", "layer_share_theta1"]))
    better = report.of(None)[1]
    assert better.failed == 24
    np.testing.assert_array_equal(better.medians.value, [np.inf, -np.inf])


def test_what_never_settled_is_worse_than_what_did(known):
    values = read_episodes(known, ["settling_time_theta1"]).values[:, 0]
    noise = columns()["noise"]
    assert np.all(values[noise > 0.3] == np.inf)
    assert np.all(values[noise < 0.3] == 0.1)


def test_a_measure_that_a_controller_does_not_have_is_not_held_against_it(tmp_path):
    table = columns(("plain", "better"))
    table["layer_share_theta1"][table["controller"] == "plain"] = np.nan
    diverge(table, table["episode"] == 0)
    report = compare(
        read_episodes(write_sweep(tmp_path / "s", table), ["layer_share_theta1"]), "better"
    )
    assert np.isnan(report.of(None)[0].medians.value[0])


def test_signed_measures_are_compared_by_size(known):
    report = compare(read_episodes(known, ["overshoot_theta1"]), "plain")
    better = report.of(None)[1]
    assert better.medians.value[0] < 0.0
    assert better.difference is not None
    assert better.difference.measured.won[0] == 36
    assert better.difference.measured.difference.high[0] < 0.0


def test_a_drawn_axis_is_cut_into_ranges(tmp_path):
    table = columns(seeds=12)
    axis = Axis(
        name="payload", values=(0.0, 0.5), method="uniform", disturbance="payload", field="mass"
    )
    drawn = Plan(spec_of(table, random=(axis,))).values(np.arange(12))["payload"]
    table["payload"] = drawn[table["seed"]]
    folder = write_sweep(tmp_path / "s", table, random=(axis,))
    (payload,) = (axis for axis in read_episodes(folder).factors if axis.name == "payload")
    assert payload.unit == "kg" and len(payload.labels) == 3
    order = np.argsort(drawn)
    expected = np.empty(12, dtype=int)
    expected[order] = np.repeat([0, 1, 2], 4)
    assert np.array_equal(payload.code, expected[table["seed"]])
    assert not [f for f in remarks(read_episodes(folder)) if f.warning]


def test_tables_hold_the_same_numbers(written):
    with open(written / "medians.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    (row,) = (
        row
        for row in rows
        if (row["axis"], row["value"], row["controller"], row["metric"])
        == ("noise", "0.4", HOSTILE, "tip_rms_error")
    )
    assert float(row["median"]) == pytest.approx(0.3 * (0.01 + 0.4 * 0.0035))
    assert (row["unit"], row["episodes"], row["diverged"]) == ("m", "12", "0")
    with open(written / "differences.csv", newline="") as file:
        assert {row["baseline"] for row in csv.DictReader(file)} == {"plain"}


# --- doubts ----------------------------------------------------------------------------------


def told(folder: Path) -> str:
    return "\n".join(f"{f.warning:d} {f.text}" for f in remarks(read_episodes(folder)))


def test_a_sound_sweep_raises_no_warning(known):
    assert all(not finding.warning for finding in remarks(read_episodes(known)))


def test_controllers_that_move_the_arm_alike_are_told(tmp_path):
    table = columns()
    per = len(table["seed"]) // 3
    table["digest"][per : per + 5] = table["digest"][:5]
    text = told(write_sweep(tmp_path / "s", table))
    assert "1 plain and better moved the arm in the same way to the last digit in 5 of 36" in text


def test_a_status_that_is_no_success_is_told(tmp_path):
    table = columns()
    table["rms_error_theta1"][3] = 0.25  # the sine's is 0.35 / sqrt(2) = 0.2475 rad
    table["rms_error_theta1"][4] = 0.24
    table["rms_error_theta2"][5] = 0.0
    text = told(write_sweep(tmp_path / "s", table))
    assert "no better than if it hung still (plain 1 of 36)" in text
    assert "1 Episodes have an error of exactly zero (plain 1 of 36)" in text


def test_axes_and_seeds_without_effect_are_told(tmp_path):
    table = columns()
    shape = (3, len(MISMATCHES), len(NOISES), SEEDS)
    digest = table["digest"].reshape(shape)
    digest[:, 1] = digest[:, 0]
    digest[:2, :, :, :] = digest[:2, :, :1, :]
    digest[0] = digest[0][..., :1]
    text = told(write_sweep(tmp_path / "s", table))
    assert "1 mismatch has no effect on any controller" in text
    assert "0 noise has no effect at all on plain, better" in text
    assert "0 Nothing random acts in 6 of 18 cells" in text
    assert "0 The sweep has 6 seeds a cell: intervals are rough" in text


def test_an_unfinished_sweep_of_mixed_versions_is_told(tmp_path):
    folder = write_sweep(tmp_path / "s", columns())
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["starts"].append({**manifest["starts"][0], "versions": {"numpy": "3"}})
    (folder / "manifest.json").write_text(json.dumps(manifest))
    for shard in manifest["shards"][3:]:
        (folder / shard["file"]).unlink()
    text = told(folder)
    assert "1 The sweep is not finished: 54 of 108 episodes are there" in text
    assert f"1 No episode of {HOSTILE} is finished" in text
    assert "1 Parts of the sweep ran with different numpy: 2 and 3" in text
    entry = compare(read_episodes(folder), "plain").of(None)[1]
    assert entry.difference is not None and entry.difference.pairs == 18
    other = compare(read_episodes(folder), HOSTILE).of(None)[0].difference
    assert other is not None and (other.pairs, other.unpaired) == (0, 36)


def test_a_controller_that_always_diverges_is_told(tmp_path):
    table = columns()
    diverge(table, table["controller"] == "better")
    assert "1 All episodes diverged of better." in told(write_sweep(tmp_path / "s", table))


@pytest.mark.parametrize("lost", [False, True])
def test_none_finished_is_not_all_diverged(tmp_path, capsys, lost):
    """Of better half of the episodes are finished, of the last controller none."""
    table = columns()
    diverge(table, (table["controller"] == "better") & lost)
    folder = write_sweep(tmp_path / "s", table)
    for i in (3, 4, 5):
        (folder / f"episodes/0000{i}.parquet").unlink()
    text = told(folder)
    assert f"No episode of {HOSTILE} is finished." in text
    assert "54 of 108 episodes are there" in text
    assert ("All finished episodes diverged of better: 18 of 36 planned." in text) == lost
    assert "All episodes diverged" not in text
    status = " that did not diverge" if lost else ""
    assert f"No finished episode{status} has a value of chattering, overshoot_theta2" in text
    assert main(["report", str(folder)]) == 0
    out = capsys.readouterr().out
    assert re.search(r"^<script>.* 0 +0 +none finished$", out, re.MULTILINE)
    body = "".join(ET.fromstring((folder / "report/report.html").read_text()).itertext())
    assert "54 of 108 episodes of 4 s" in body
    assert body.count("none finished") >= 2
    assert "Median over all finished episodes" in body
    assert "Empty where no finished episode" in body
    assert "nan" not in out


# --- the page --------------------------------------------------------------------------------


class Links(html.parser.HTMLParser):
    """Collects what a page refers to."""

    def __init__(self) -> None:
        super().__init__()
        self.targets: list[str] = []
        self.ids: list[str] = []
        self.tags: set[str] = set()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        for name, value in attrs:
            if name in ("href", "src", "srcset", "data", "action", "poster", "xlink:href"):
                self.targets.append(value or "")
            if name == "id":
                self.ids.append(value or "")


def test_the_page_is_well_formed_and_needs_nothing_else(written):
    text = (written / "report.html").read_text(encoding="utf-8")
    ET.fromstring(text)
    links = Links()
    links.feed(text)
    assert not links.tags & {"script", "link", "iframe", "object", "img"}
    assert "://" not in text and "@import" not in text
    assert len(set(links.ids)) == len(links.ids)
    inside = set(re.findall(r"url\(#([^)]*)\)", text))
    for target in links.targets:
        if target.startswith("#"):
            inside.add(target[1:])
        elif not target.startswith("data:image/png;base64,"):
            assert (written / target).is_file()
    assert inside <= set(links.ids)


def test_fewer_than_six_seeds_have_ranges_and_nothing_is_coloured(tmp_path):
    folder = write_sweep(tmp_path / "few", columns(seeds=4))
    numbers = compare(read_episodes(folder))
    cells = [c for row in Tables(numbers).medians(None).rows for c in row]
    assert any(line.endswith(" range") for cell in cells for line in cell.small)
    cells = [c for row in Tables(numbers).differences(None).rows for c in row]
    assert "even" in {c.kind for c in cells} and not {"good", "bad"} & {c.kind for c in cells}
    assert "medians have the range of their seeds; an interval needs 6" in told(folder)


def test_differences_are_coloured_after_benjamini_and_hochberg(known, written):
    numbers = compare(read_episodes(known))
    differences = [g.difference for g in numbers.groups if g.difference is not None]
    raw = np.array([difference.measured.chance for difference in differences])
    own = np.array([difference.chance for difference in differences])
    signs = np.array([measure.declared.sign for measure in numbers.episodes.measures])
    assert np.isnan(own[:, signs == 0]).all()
    raw = np.where(signs == 0, np.nan, raw)
    np.testing.assert_allclose(own, adjusted(raw))
    assert np.nanmin(own - raw) >= 0.0
    kinds = {c.kind for row in Tables(numbers).differences(None).rows for c in row}
    assert {"good", "bad"} <= kinds
    page = (written / "report.html").read_text(encoding="utf-8")
    assert "Benjamini and Hochberg" in page and "Korn and Graubard" in page
    assert " range</small>" not in page


def test_shares_over_cells_of_the_same_seeds_are_no_surer_than_the_seeds(tmp_path):
    table = columns()
    diverge(table, table["seed"] == 0)  # in every cell
    (whole, *_) = compare(read_episodes(write_sweep(tmp_path / "lost", table))).of(None)
    assert (whole.episodes, whole.failed) == (36, 6)
    np.testing.assert_allclose(whole.failures, binomial(1, 6), rtol=1e-12)


def test_names_are_escaped(written):
    text = (written / "report.html").read_text(encoding="utf-8")
    assert HOSTILE not in text
    body = "".join(ET.fromstring(text).itertext())
    assert body.count(HOSTILE) >= 5
    for svg in (written / "figures").glob("*.svg"):
        ET.parse(svg)


def test_the_page_says_what_was_run_and_how(written, known):
    body = "".join(ET.fromstring((written / "report.html").read_text()).itertext())
    assert "108 episodes of 4 s: 3 controllers × 2 values of mismatch × 3 values of noise" in body
    assert f"octarm sweep {known}/spec.toml --out {known}-again" in body
    assert f"octarm report {known} --metric=tip_rms_error --metric=effort" in body
    assert METRICS["tip_rms_error"].text in body
    assert "numpy 2" in body


def test_figures_come_in_both_formats(written):
    names = {file.name for file in (written / "figures").iterdir()}
    stems = ("degradation-mismatch", "degradation-noise", "distributions", "map-mismatch-noise")
    assert names == {f"{stem}.{kind}" for stem in stems for kind in ("png", "svg")}
    for file in (written / "figures").glob("*.png"):
        assert file.read_bytes().startswith(b"\x89PNG")


def test_figures_have_room_for_many_controllers_and_show_failures(tmp_path):
    names = tuple(f"a-controller-with-a-name-{i}" for i in range(10))
    table = columns(names, seeds=2)
    table = {name: column[table["mismatch"] > 0.0] for name, column in table.items()}
    diverge(table, table["seed"] == 1)
    folder = write_sweep(tmp_path / "s", table)
    found = {p.name: p for p in pictures(compare(read_episodes(folder, ["tip_rms_error"])))}
    assert list(found) == ["degradation-noise", "distributions", "failures"]
    assert f"{names[3]}, 3 diverged" in found["distributions"].svg
    for name in names:
        assert all(look_of(name).color in picture.svg for picture in found.values())


@pytest.mark.slow
def test_the_same_sweep_gives_the_same_files(written, known):
    before = {file: file.read_bytes() for file in written.rglob("*") if file.is_file()}
    code = "import sys; from octarm.commands.cli import main; sys.exit(main(sys.argv[1:]))"
    subprocess.run(
        [sys.executable, "-c", code, "report", str(known),
         "--metric", "tip_rms_error", "--metric", "effort", "--force"],
        check=True, capture_output=True, env={"PYTHONHASHSEED": "7"},
        cwd=Path(__file__).parent.parent,
    )  # fmt: skip
    after = {file: file.read_bytes() for file in written.rglob("*") if file.is_file()}
    assert before == after


def test_figures_in_a_page_take_its_colours():
    svg = '<?xml?><svg viewBox="0 0 10 5" xmlns="http://a"><g id="b" style="fill: #24292f"/></svg>'
    assert inline_svg(svg, "p", "<x>") == (
        '<svg viewBox="0 0 10 5" style="min-width: 9px; max-width: 15px" role="img" '
        'aria-label="&lt;x&gt;">'
        '<g id="p-b" style="fill: var(--ink)"/></svg>'
    )


@given(st.floats(-1e300, 1e300))
def test_numbers_are_told_to_three_digits(value):
    shown = float(number(value).replace("−", "-"))
    assert shown == pytest.approx(value, rel=0.0051)
    assert number(float("nan")) == "-" and number(np.inf, signed=True) == "+∞"


# --- the command -----------------------------------------------------------------------------


def refused(arguments: list[str], capsys) -> str:
    assert main(["report", *arguments, "--force"]) == ExitCode.BAD_INPUT
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


def test_a_report_is_replaced_by_force_alone(written, known, capsys):
    assert main(["report", str(known)]) == ExitCode.BAD_INPUT
    assert "report.html is there already; --force replaces it" in capsys.readouterr().err


def test_bad_input_is_one_sentence(known, tmp_path, capsys):
    assert "is not a sweep" in refused([str(tmp_path)], capsys)
    error = refused([str(known), "--baseline", "plane"], capsys)
    assert "no controller 'plane', did you mean 'plain'?" in error
    error = refused([str(known), "--metric", "tip_rms"], capsys)
    assert "unknown metric 'tip_rms', did you mean 'tip_rms_error'?" in error
    assert "is the sweep itself" in refused([str(known), "--out", str(known)], capsys)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("")
    error = refused([str(known), "--out", str(tmp_path / "mine")], capsys)
    assert "exists and is not a report" in error
    assert [file.name for file in (tmp_path / "mine").iterdir()] == ["thesis.tex"]


def test_a_sweep_without_numbers_is_one_sentence(tmp_path, capsys):
    table = columns()
    diverge(table, table["episode"] >= 0)
    write_sweep(tmp_path / "diverged", table)
    assert "all finished episodes of" in refused([str(tmp_path / "diverged")], capsys)
    empty = write_sweep(tmp_path / "empty", columns())
    for file in (empty / "episodes").iterdir():
        file.unlink()
    assert "has no finished episode yet" in refused([str(empty)], capsys)
    short = write_sweep(tmp_path / "short", columns(), duration=0.5)
    assert "no value of work in any" in refused([str(short), "--metric", "work"], capsys)


SPEC = """\
gain_set = "recommended"
episodes = 2
duration = 0.2
settle = 0.1
timestep = 0.001
control_period = 0.002
[grid]
controller = ["smc-boundary", "pd"]
[grid.disturbance]
noise = [0.0, 0.4]
"""


def test_a_real_sweep_is_reported(tmp_path, capsys):
    folder = tmp_path / "real"
    with ThreadPoolExecutor(1) as thread:
        octarm.sweep(parse_spec(SPEC), make_controller, folder, executor=thread, in_flight=1)
    arguments = ["--baseline", "pd", "--metric", "rms_error_theta2", "--out", str(tmp_path / "r")]
    assert main(["report", str(folder), *arguments]) == 0
    out = capsys.readouterr().out
    assert "note: The sweep has 2 seeds a cell" in out
    with open(tmp_path / "r" / "medians.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    table = octarm.read_sweep(folder)
    for row in rows:
        if (row["axis"], row["metric"]) == ("noise", "rms_error_theta2"):
            own = [
                error
                for name, noise, error in zip(
                    table["controller"].to_pylist(), table["noise"].to_pylist(),
                    table["rms_error_theta2"].to_pylist(), strict=True,
                )
                if (name, noise) == (row["controller"], float(row["value"]))
            ]  # fmt: skip
            assert float(row["median"]) == pytest.approx(np.median(own))
            assert row["unit"] == "rad"
    page = ET.fromstring((tmp_path / "r" / "report.html").read_text(encoding="utf-8"))
    assert SPEC.strip() in "".join(page.itertext())


def test_one_seed_a_cell_has_a_median_and_no_ends(tmp_path, capsys):
    assert main(["report", str(write_sweep(tmp_path / "s", columns(seeds=1)))]) == 0
    out = capsys.readouterr().out
    assert "nan" not in out and re.search(r"^better .* [\d.]+$", out, re.MULTILINE)


def test_a_panel_has_three_ticks_at_least():
    _, (panel,) = panels_of(1, 1.75)
    panel.plot([0.0, 1.0], [-0.38, 0.88])
    low, high = panel.get_ylim()
    assert sum(low <= tick <= high for tick in panel.get_yticks()) >= 3
