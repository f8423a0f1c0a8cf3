"""The figures of a run."""

import dataclasses

import numpy as np
import pytest
from PIL import Image
from recordings import described, swinging

from octarm.disturbances.ledger import asked
from octarm.disturbances.spelling import parse_disturbance
from octarm.reports.run_figures import _MOST, thinned, write_figures


def test_every_kind_of_run_gets_its_figures_as_png_and_svg(tmp_path):
    run = swinging(rows=300, theta=np.random.default_rng(0).normal(size=(300, 6, 5)))
    run = dataclasses.replace(run, disturbance=run.force)
    written = write_figures(tmp_path / "figures", run, described())
    names = {"tracking", "error", "inputs", "sliding", "adaptation", "disturbance"}
    assert {p.name for p in written} == {f"{n}.{kind}" for n in names for kind in ("png", "svg")}
    for path in written:
        if path.suffix == ".png":
            with Image.open(path) as image:
                assert image.size[0] == 1260
                assert len(image.convert("RGB").getcolors(1 << 24) or []) > 100
        else:
            assert "smc on sine" in path.read_text()
    plain = dataclasses.replace(run, signals={}, disturbance=0.0 * run.force)
    written = write_figures(tmp_path / "plain", plain, described())
    assert {p.stem for p in written} == {"tracking", "error", "inputs"}


def test_figures_have_units_events_and_the_desired_motion(tmp_path):
    run = dataclasses.replace(swinging(rows=3000), status="diverged")
    listed = asked([parse_disturbance("payload:0.1,at=1")])
    slow = {"lambda_": 0.01, "phi": [0.05] * 3 + [0.8] * 3}  # a bound of the error that is far off
    about = described(disturbances=listed, controller={"name": "smc", "gains": slow})
    written = write_figures(tmp_path, run, about)
    texts = {p.stem: p.read_text() for p in written if p.suffix == ".svg"}
    for text in texts.values():
        assert "smc on sine, payload" in text
        assert ">payload 100 g<" in text
        assert ">diverged<" in text
    assert ">desired<" in texts["tracking"]
    assert ">error q - q_d, bends [mrad]<" in texts["error"]
    assert ">error q - q_d, slides [mm]<" in texts["error"]
    assert ">φ / λ = 8e+04 mrad, off the axis<" in texts["error"]
    assert "V [J] (log)" in texts["sliding"] or "V [mJ] (log)" in texts["sliding"]


def test_equal_runs_give_equal_files(tmp_path):
    run = dataclasses.replace(swinging(rows=50), signals={})
    first = write_figures(tmp_path / "a", run, described())
    second = write_figures(tmp_path / "b", run, described())
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()


def test_a_long_curve_keeps_its_extremes():
    t = np.arange(100_003) * 1e-3
    y = np.sin(t)
    y[54_321] = 9.0
    few_t, few = thinned(t, y)
    assert len(few) <= 1.1 * _MOST
    assert few.max() == 9.0
    assert few_t[np.argmax(few)] == t[54_321]
    assert np.all(np.diff(few_t) >= 0.0)
    assert (few_t[0], few_t[-1]) == (t[0], t[-1])


def test_an_unwritable_place_is_one_sentence(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OSError):
        write_figures(tmp_path / "file", swinging(rows=10), described())
