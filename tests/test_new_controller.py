"""A controller of one file and one line is all that it takes, from the command line to tuning."""

import contextlib
import importlib
import json
import sys
from concurrent.futures import Executor, Future
from pathlib import Path

import numpy as np
import pytest

import octarm
from controllers import CONTROLLERS, make_controller
from controllers.law import gain_fields
from octarm.commands import cli
from octarm.sweeps.tune import Space

P = octarm.nominal_parameters()

FILE = '''
"""Damps what it is told to damp, and weighs the arm by its model."""

from __future__ import annotations

import dataclasses
from typing import Annotated

from controllers.law import Gain, GainField, Law
from controllers.recommended import by_unit, linear_gain
from octarm.interfaces import Command, Knob


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Follower(Law):
    """Q = G^(q_d) - K_v e' - pull e."""

    K_v: Annotated[Gain, GainField("damping", "N s/m, N m s/rad", linear_gain, Knob("K_v"))]
    pull: Annotated[
        Gain,
        GainField(
            "what an error is answered with",
            "N/m, N m/rad",
            lambda nominal: by_unit(nominal, 2000.0, 20.0),
            Knob("pull", high=2.0, apart=True),
            zero=True,
        ),
    ]

    def __call__(self, state, measurement, reference):
        self.check(measurement, reference)
        e, e_dot = measurement.q - reference.q, measurement.v - reference.v
        weight = self.nominal.potential_force(reference.q)
        return Command(weight - self.K_v * e_dot - self.pull * e, {"weight": weight}), state
'''


class Inline(Executor):
    """Runs each call at once, in this process, where the new controller is known."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        future.set_result(fn(*args, **kwargs))
        return future


@pytest.fixture
def _follower(tmp_path, monkeypatch):
    """The file, and the line in the table."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "follower_law.py").write_text(FILE, encoding="utf-8")
    module = importlib.import_module("follower_law")
    monkeypatch.setitem(CONTROLLERS, "follower", module.Follower)
    yield
    sys.modules.pop("follower_law")


@pytest.mark.usefixtures("_follower")
def test_help_and_errors_name_it(capsys):
    with contextlib.suppress(SystemExit):
        cli.main(["run", "--help"])
    assert "follower" in capsys.readouterr().out
    assert cli.main(["run", "--controller", "folower"]) == 2
    assert "did you mean 'follower'" in capsys.readouterr().err


@pytest.mark.usefixtures("_follower")
def test_its_gains_say_what_they_are_and_are_checked():
    fields = gain_fields(CONTROLLERS["follower"])
    assert {name: field.units for name, field in fields.items()} == {
        "K_v": "N s/m, N m s/rad",
        "pull": "N/m, N m/rad",
    }
    law = make_controller("follower", P)
    np.testing.assert_array_equal(getattr(law, "pull"), np.repeat([2000.0, 20.0], 3))  # noqa: B009
    for gains, sentence in (
        ({"pull": -1.0}, "pull holds -1; it must be at least 0"),
        ({"K_v": 0.0}, "K_v holds 0; it must be above 0"),
        ({"K_v": [1.0, 2.0]}, "K_v has 2 values; it needs 1 or 6"),
        ({"pul": 1.0}, "follower has no gain 'pul', did you mean 'pull'"),
    ):
        with pytest.raises(octarm.errors.OctarmError, match=sentence):
            make_controller("follower", P, gains)


@pytest.mark.usefixtures("_follower")
def test_it_runs():
    command = ["run", "--controller", "follower", "--duration", "0.05", "--out", "run"]
    assert cli.main([*command, "--gain", "pull:1500,1500,1500,20,20,20"]) == 0
    description = json.loads(Path("run/run.json").read_text(encoding="utf-8"))
    assert description["controller"]["name"] == "follower"
    assert description["controller"]["gains"]["pull"] == [1500.0] * 3 + [20.0] * 3
    assert octarm.read_run("run")[0].signals["weight"].shape == (100, 6)


@pytest.mark.usefixtures("_follower")
def test_it_is_swept():
    text = 'seed = 1\nepisodes = 2\nduration = 0.1\n[grid]\ncontroller = ["follower", "pd"]\n'
    Path("spec.toml").write_text(text, encoding="utf-8")
    spec = octarm.read_spec("spec.toml")
    folder = octarm.sweep(spec, make_controller, Path("sweep"), executor=Inline(), in_flight=1)
    table = octarm.read_sweep(folder)
    assert sorted(table["controller"].to_pylist()) == ["follower"] * 2 + ["pd"] * 2


@pytest.mark.usefixtures("_follower")
def test_its_margin_is_found(capsys):
    what = ["--disturbance", "payload:at=0.05", "--bound", "tip_rms_error:0.5"]
    size = ["--seeds", "1", "--duration", "2.1", "--timestep", "0.001", "--high", "0.1"]
    assert cli.main(["margin", "follower", *what, *size]) == 0
    assert "follower" in capsys.readouterr().out


@pytest.mark.usefixtures("_follower")
def test_it_is_tuned_by_its_own_knobs(capsys):
    law = make_controller("follower", P)
    assert [(k.name, k.high, k.apart, k.gains) for k in law.knobs()] == [
        ("K_v", 1000.0, False, ("K_v",)),
        ("pull", 2.0, True, ("pull",)),
    ]
    space = Space(law, P.modules)
    assert [u.name for u in space.unknowns] == ["K_v", "pull of slides", "pull of bends"]
    turned = space.turned(space.bounds.T)
    most = turned["pull"][1] * law.scales()["pull"]
    np.testing.assert_allclose(most, np.repeat([4000.0, 40.0], 3), rtol=1e-3)
    assert cli.main(["tune", "follower", "--budget", "1"]) == 2  # it is known, and cannot be paid
    assert "budget is 1 s" in capsys.readouterr().err
