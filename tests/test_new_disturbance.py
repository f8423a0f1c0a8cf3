"""One class and one line in the catalogue make a disturbance known everywhere."""

import dataclasses
import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from test_recording import entities

import octarm
from controllers import make_controller
from octarm.commands import cli
from octarm.disturbances.episode import Event
from octarm.disturbances.ledger import Ledger, in_words
from octarm.disturbances.spelling import (
    DISTURBANCES,
    from_entry,
    help_text,
    parse_disturbance,
    spelling,
)
from octarm.disturbances.varied import parse_varied
from octarm.sweeps.plan import Plan
from octarm.sweeps.spec_file import parse_spec

FILE = '''
"""A gust against the arm."""

import dataclasses
from typing import Annotated, ClassVar

import numpy as np

from octarm.disturbances.episode import Episode, Force
from octarm.fields import Amount, Quantity
from octarm.disturbances.streams import first_step


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Gust(Force):
    """A wind that bends the last module, from the time `at` on."""

    name: ClassVar[str] = "gust"
    units: ClassVar[dict[str, str]] = {"strength": "N m"}
    speed: Annotated[Amount, Quantity("m/s", at_least=0.0, at_most=40.0, usual=(0.0, 8.0))]
    drag: Annotated[Amount, Quantity("N m s^2/m^2", at_least=0.0, key="c")] = 0.01
    at: Annotated[Amount, Quantity("s", at_least=0.0)] = 0.0

    def start(self, episode: Episode):
        torque = episode.value(self, "drag") * episode.value(self, "speed") ** 2
        first = first_step(episode.value(self, "at"), episode.timestep)

        def force(step, q):
            out = np.zeros_like(q)
            out[..., -1] = np.where(step >= first, torque, 0.0)
            return out

        return force

    def delivered(self, measured):
        return {"strength": measured.signal.sizes()["peak"][-1]} | measured.signal.presence()

    def events(self):
        return self.span(self.at)
'''


@pytest.fixture
def gust(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The one file, and the one line."""
    path = tmp_path / "gust.py"
    path.write_text(FILE)
    spec = importlib.util.spec_from_file_location("gust", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "gust", module)
    spec.loader.exec_module(module)
    monkeypatch.setitem(DISTURBANCES, "gust", module.Gust)
    return module


@pytest.mark.usefixtures("gust")
def test_the_help_has_its_spelling_its_meaning_and_its_units():
    forces = help_text().partition("\n\n")[0]
    assert "  gust:SPEED,c=0.01,at=0\n" in forces
    text = " ".join(forces.partition("gust:")[2].split())
    assert "A wind that bends the last module, from the time `at` on" in text
    assert text.endswith("speed [m/s], c [N m s^2/m^2], at [s]")


@pytest.mark.usefixtures("gust")
def test_the_command_line_spells_and_checks_it():
    spelt = parse_disturbance("gust:5,c=0.02")
    assert spelling(spelt) == "gust:5,c=0.02"
    for text, sentence in (
        ("gust:50", "speed of gust is 50 m/s; it must be at most 40 m/s"),
        ("gust:5,a=1", "gust has no key 'a', did you mean 'at'?"),
        ("gus:5", "unknown disturbance 'gus', did you mean 'gust'?"),
    ):
        with pytest.raises(ValueError, match=sentence):
            parse_disturbance(text)


@pytest.mark.usefixtures("gust")
def test_a_run_receives_it_and_the_ledger_states_it():
    listed = [parse_disturbance("gust:4,at=0.05"), parse_disturbance("gust:2")]
    environment = octarm.load("sine", disturbances=listed)
    ledger = Ledger(listed, environment.physics)
    environment.physics.watch = ledger.step
    run = octarm.rollout(environment, make_controller("pd", octarm.nominal_parameters()), 0.1)
    expected = np.where(np.arange(len(run.t)) < 100, 0.04, 0.04 + 0.16)
    np.testing.assert_allclose(run.disturbance[:, -1], expected, rtol=1e-12)
    first, second = ledger.rows()
    assert first["name"] == "gust" and second["name"] == "gust-2"
    assert first["asked"] == {"speed": 4.0, "drag": 0.01, "at": 0.05}
    assert first["delivered"]["strength"] == pytest.approx(0.16)
    assert first["delivered"]["from"] == pytest.approx(0.05)
    assert in_words([second])[0].startswith("  gust:2 -> strength 0.04 N m; from 0")


SPEC = "duration = 1.0\nepisodes = 1\n[grid]\ncontroller = ['pd']\n[grid.disturbance]\n"


@pytest.mark.usefixtures("gust")
def test_a_sweep_varies_it():
    plan = Plan(parse_spec(SPEC + "gust = [0.0, 3.0]\n[disturbance]\ngust.c = 0.05\n"))
    disturbances = plan.arms([0, 1]).disturbances
    fields = dataclasses.asdict(disturbances[0])  # pyright: ignore[reportArgumentType]
    np.testing.assert_array_equal(fields["speed"], [0.0, 3.0])
    assert (fields["drag"], fields["at"]) == (0.05, 0.0)
    environment = octarm.load("sine", disturbances=disturbances, batch=2)
    environment.reset()
    environment.step(np.zeros((2, 6)))
    np.testing.assert_allclose(environment.physics.disturbance()[:, -1], [0.0, 0.45])
    with pytest.raises(ValueError, match="speed of gust is 90 m/s; it must be at most 40 m/s"):
        parse_spec(SPEC + "gust = [90.0]\n")


@pytest.mark.usefixtures("gust")
def test_a_margin_goes_over_its_usual_range():
    varied = parse_varied("gust:at=1", None, None)
    assert (varied.low, varied.high, varied.unit) == (0.0, 8.0, "m/s")


@pytest.mark.usefixtures("gust")
def test_a_recording_marks_when_it_begins(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    out = tmp_path / "run"
    command = ["run", "--controller", "pd", "--duration", "0.1", "--out", str(out)]
    assert cli.main([*command, "--disturbance", "gust:4,at=0.05"]) == 0
    assert "  gust:4,at=0.05 -> strength 0.16 N m; from 0.05; until 0.1" in capsys.readouterr().out
    [entry] = json.loads((out / "run.json").read_text())["disturbances"]
    assert from_entry({**entry, "name": "gust-3"}).events() == [Event(0.05, "gust 4")]
    assert {"/states/gust", "/world/disturbance"} <= entities(out / "run.rrd")
