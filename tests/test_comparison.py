"""Two runs in one recording."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from recordings import described, entities, fields, swinging, write_run

from octarm.commands.cli import main
from octarm.palette import look_of
from octarm.recordings.comparison import difference, differences, labels, verdict, write_comparison
from octarm.reports.run_comparison import RunComparison
from octarm.runs.folder import Run


def test_it_holds_both_runs_and_the_difference_of_their_errors(tmp_path):
    first, second = swinging(rows=2500), swinging(rows=2000)
    second = dataclasses.replace(second, q=second.q + 0.01)
    path = tmp_path / "both.rrd"
    write_comparison(path, (first, described()), (second, described()))
    for root, run in (("A", first), ("B", second)):
        assert f"/{root}/world/tube" in entities(path)
        found = fields(path, f"/{root}/signals", "signals")
        np.testing.assert_array_equal(found["tau"], run.tau)
    found = fields(path, "/difference")
    expected = 1e3 * (np.abs(first.error[:2000]) - np.abs(second.error))  # [mm], [mrad]
    np.testing.assert_allclose(found["slides"], expected[:, :3], atol=1e-12)
    np.testing.assert_allclose(found["bends"], expected[:, 3:], atol=1e-12)
    assert len(rr.chunk.RrdReader(path).blueprints()) == 1


def test_any_number_of_runs_is_held_with_the_differences_from_the_first(tmp_path):
    runs = [dataclasses.replace(swinging(rows=300 + 10 * i)) for i in range(4)]
    path = tmp_path / "all.rrd"
    write_comparison(path, *((run, described()) for run in runs))
    assert {f"/{root}/world/tube" for root in "ABCD"} <= entities(path)
    for i, root in enumerate("BCD", 1):
        expected = 1e3 * (np.abs(runs[0].error) - np.abs(runs[i].error[:300]))
        parts = fields(path, f"/difference/{root}", "difference")
        np.testing.assert_allclose(parts["bends"], expected[:, 3:], atol=1e-12)
    assert labels(28)[24:] == ["Y", "Z", "AA", "AB"]


def of(name="noise", **asked):
    """An entry of the disturbances of `run.json`."""
    return {"disturbances": [{"name": name, "asked": {"ratio": 0.4, **asked}}]}


DIFFERENT = [
    ({"seed": 4}, "seed", False),  # nothing draws from it
    ({"controller": {"name": "pd", "gains": {"K_p": 3.0}}}, "controller", False),
    ({"nominal": {"mass": [0.1, 0.2]}}, "model's mass [kg]", False),
    ({"control_period": 0.001}, "control period [s]", False),
    ({"reference": {"name": "step"}}, "reference", True),
    ({"duration": 3.0}, "duration [s]", True),
    (
        {"parameters": described(tip=1)["parameters"] | {"gravity": 1.6}},
        "arm's gravity [m/s^2]",
        True,
    ),
    ({"status": "interrupted"}, "end", True),
    (of(), "disturbance noise", True),
    ({"plant": {"modules": 15, "layout": "paper"}}, "plant's modules", True),
]


@pytest.mark.parametrize(("change", "name", "task"), DIFFERENT, ids=lambda x: str(x)[:24])
def test_what_differs_is_named_and_tasks_that_differ_are_not_ranked(change, name, task):
    found = differences([described(), described(3, **change)])
    assert {each.name: each.of_the_task for each in found}[name] is task
    assert ("Not ranked" in verdict(found)) is task
    assert name in verdict(found)
    assert differences([described(3, **change)] * 3) == []


def test_the_seed_counts_where_something_is_random_and_digits_that_are_not_printed():
    found = differences([described(3, **of()), described(3, **of(), seed=4)])
    assert [(each.name, each.of_the_task) for each in found] == [("seed", True)]
    found = differences([described(3, **of(ratio=x)) for x in (0.1, 0.1 + 1e-12)])
    assert len(set(found[0].values)) == 2
    found = differences([described(), described(controller={"name": "pd", "gains": {"K": 1}})])
    assert [each.name for each in found] == ["controller"]  # gains of other laws mean other things


@pytest.mark.parametrize("alike", [True, False])
def test_a_plot_of_the_difference_says_who_is_nearer_only_of_the_same_task(tmp_path, alike):
    runs = [(swinging(rows=200), described()), (swinging(rows=200), described())]
    if not alike:
        runs[1] = (runs[1][0], described(3, **of()))
    write_comparison(tmp_path / "x.rrd", *runs)
    reader = rr.chunk.RrdReader(tmp_path / "x.rrd")
    stores = [chunk for store in reader.blueprints() for chunk in reader.stream(store=store)]
    names = " ".join(str(chunk.to_record_batch().to_pylist()) for chunk in stores)
    assert ("B is nearer" in names) is alike
    assert ("not ranked" in names) is not alike


def run_folder(i, **changes):
    """The name of a run folder with arrays."""
    run = swinging(rows=220, rate=100.0)
    metrics = {"rms_error": [1e-3 * (i + 1)] * 6, "tip_rms_error": 0.5 / (i + 1)}
    Path(f"r{i}").mkdir()
    write_run(Path(f"r{i}"), run, described(metrics=metrics, **changes))
    return f"r{i}"


def test_the_command_writes_one_page_and_one_recording(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    gust = of("<b>gust</b>")
    gust["disturbances"][0]["drawn"] = {"tilt": 0.0}
    folders = [run_folder(i) for i in range(3)]
    another = run_folder(3, status="diverged", **gust)
    assert main(["compare", *folders, "--out", "c"]) == 0
    assert_compared(capsys.readouterr().out, ranked=True)
    assert main(["compare", *folders, "--out", "c"]) == 2
    assert "--force replaces it" in capsys.readouterr().err
    assert main(["compare", *folders[:2], another, "--out", "c", "--force"]) == 0
    assert_compared(capsys.readouterr().out, ranked=False)


def assert_compared(told, *, ranked):
    """Three runs, of which the last one may have been disturbed and lost."""
    assert {path.name for path in Path("c").iterdir()} == {
        "comparison.html", "comparison.rrd", "figures",
    }  # fmt: skip
    assert {path.name for path in Path("c/figures").iterdir()} == {
        f"{name}.{end}" for name in ("errors", "differences", "inputs") for end in ("png", "svg")
    }
    text = Path("c/comparison.html").read_text()
    assert text.index("What differs") < text.index("Numbers") < text.index("Figures")
    assert ('<td class="best">' in text) is ranked
    assert ("Not ranked" in text) is not ranked
    assert ("the other one is nearer" in text) is ranked
    assert ("Runs that diverged leave the panels" in text) is not ranked
    assert ("  rms error: A is best in 6 of 6\n  tip rms error: C is best\n" in told) is ranked
    assert (" is best" in told) is ranked
    assert "<b>gust" not in text and "<script" not in text
    assert len(re.findall("<figure>", text)) == 3
    assert "/C/world/tube" in entities("c/comparison.rrd")
    assert "A: r0, smc on sine" in told


def test_a_metric_has_one_unit_for_all_coordinates_of_a_kind():
    moments = {"chattering": [2.0, 1e-3, 2e-3, 0.09, 0.3, 1e-4]}
    comparison = RunComparison([Run(swinging(rows=20), described(metrics=moments))] * 2)
    units = re.findall(r"chattering \[([^\]]*)\]", comparison.page(["a", "b"], []))
    assert units == ["N"] * 3 + ["mN m"] * 3


def test_each_run_has_the_colour_of_its_controller_or_one_of_its_own():
    def runs(*names):
        """Runs of these controllers."""
        return [
            Run(swinging(rows=50), described(controller={"name": name, "gains": {}}, metrics={}))
            for name in names
        ]

    names = ("afsmc", "smc-boundary", "pd")
    assert RunComparison(runs(*names)).colors == [look_of(name).color for name in names]
    assert len({*RunComparison(runs("pd", "pd", "afsmc")).colors}) == 3
    same = next(f"law{i}" for i in range(99) if look_of(f"law{i}").color == look_of("mine").color)
    assert len({*RunComparison(runs("mine", same)).colors}) == 2


def test_when_a_disturbance_begins_is_marked_in_its_panels():
    payload = {"name": "payload", "asked": {"mass": 0.1, "at": 0.02}}
    numbers = {"metrics": {}, "disturbances": [payload]}
    comparison = RunComparison([Run(swinging(rows=50), described(**numbers))] * 2)
    plain = RunComparison([Run(swinging(rows=50), described(metrics={}))] * 2)
    marked, bare = next(comparison.pictures()), next(plain.pictures())
    assert "when a disturbance begins" in marked.caption
    assert marked.svg.count("stroke-dasharray") == bare.svg.count("stroke-dasharray") + 6


def test_code_that_differs_is_named_by_its_path_and_the_start_of_its_digest():
    code = {"kind": "controller", "path": "/x/law.py:Law", "sha256": 32 * "ab", "declares": {}}
    (found,) = differences([described(), described(code={"Law": code})])
    assert found == ("code of Law", ["–", "/x/law.py:Law, SHA-256 abababababab"], False)
    code["kind"] = "reference"
    assert differences([described(), described(code={"Law": code})])[0].of_the_task


def test_what_cannot_be_compared_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run_folder(0)
    Path("two").mkdir()
    write_run(Path("two"), swinging(2, rows=50), described(2, metrics={}))
    for words, sentence in (
        ([], "octarm compare needs two runs or more; 0 given"),
        (["r0"], "octarm compare needs two runs or more; 1 given"),
        (["r0", "two"], "the arms have 3 and 2 modules; they cannot be compared"),
        (["r0", "nothing"], "nothing is not a run folder"),
    ):
        assert main(["compare", *words, "--out", "c"]) == 2
        assert sentence in capsys.readouterr().err
    assert not Path("c").exists()


def test_another_rate_is_interpolated():
    slow, fast = swinging(rows=100, rate=50.0), swinging(rows=1000, rate=500.0)
    ramp = np.tile(slow.t[:, None], (1, 6)), np.tile(fast.t[:, None], (1, 6))
    slow = dataclasses.replace(slow, q=slow.q_d + ramp[0])
    fast = dataclasses.replace(fast, q=fast.q_d + 2.0 * ramp[1])
    t, larger = difference(fast, slow)
    assert t[-1] <= slow.t[-1]
    np.testing.assert_allclose(larger, np.tile(t[:, None], (1, 6)), atol=1e-12)


def test_arms_of_other_sizes_are_refused(tmp_path):
    with pytest.raises(ValueError, match="3 and 2 modules"):
        write_comparison(tmp_path / "x.rrd", (swinging(), described()), (swinging(2), described(2)))
    assert list(tmp_path.iterdir()) == []
