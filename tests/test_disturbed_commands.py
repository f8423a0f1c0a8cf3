"""`octarm run --disturbance`: what the help prints is what works."""

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from test_disturbances import SPELLINGS

from octarm.commands import cli
from octarm.disturbances.episode import Disturbance
from octarm.disturbances.spelling import DISTURBANCES, help_text, parse_disturbance, spelling
from octarm.fields import field_defaults, field_keys, field_kinds
from octarm.runs import folder as runs

_NAMES = "|".join(sorted(DISTURBANCES, key=len, reverse=True))
_SPELLING = re.compile(rf"(?<![\w-])({_NAMES}):(\S*[\w.])")


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def short_run(*options: str, duration: str = "0.05") -> int:
    return cli.main(["run", "--controller", "pd", "--duration", duration, "--out", "a", *options])


def from_help(text: str) -> Disturbance:
    """A disturbance of the help, with a number for each word in capitals."""
    return parse_disturbance(re.sub(r"\b[A-Z]+\b", "0.25", text))


def test_every_spelling_in_the_help_works_and_all_are_there():
    listed = [match[0] for match in _SPELLING.finditer(help_text())]
    assert [from_help(text).name for text in listed] == list(DISTURBANCES)
    assert max(map(len, help_text().splitlines())) <= 80


def test_the_help_names_all_keys_with_their_units_and_defaults():
    matches = [*_SPELLING.finditer(help_text())]
    ends = [*(match.start() for match in matches[1:]), len(help_text())]
    for match, end, cls in zip(matches, ends, DISTURBANCES.values(), strict=True):
        meaning = " ".join(help_text()[match.end() : end].split())
        items = dict(item.split("=") for item in match[2].split(",")[1:])
        for key, field in [*field_keys(cls).items()][1:]:
            default, kind = field_defaults(cls)[field], field_kinds(cls)[field]
            if default is not None:
                assert items.pop(key) == (default if kind.unit == "" else f"{default:g}")
            assert kind.unit in ("", "1") or f"{key} [{kind.unit}]" in meaning
        assert not items


@pytest.mark.parametrize("name", SPELLINGS)
def test_spellings_and_disturbances_are_two_forms_of_one_thing(name: str):
    disturbance = parse_disturbance(SPELLINGS[name])
    again = parse_disturbance(spelling(disturbance))
    for field in dataclasses.fields(disturbance):  # pyright: ignore[reportArgumentType]
        np.testing.assert_array_equal(getattr(again, field.name), getattr(disturbance, field.name))
    assert spelling(again) == spelling(disturbance)


@pytest.mark.parametrize("name", SPELLINGS)
def test_a_run_says_what_was_asked_and_what_was_delivered(name: str, capsys):
    assert short_run("--disturbance", SPELLINGS[name]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    asked = spelling(parse_disturbance(SPELLINGS[name]))
    [line] = [line for line in out.splitlines() if line.strip().startswith(asked + " -> ")]
    assert not line.endswith("nothing")
    [row] = json.loads(Path("a/run.json").read_text())["disturbances"]
    assert (row["name"], row["asked"].keys()) == (name, field_kinds(DISTURBANCES[name]).keys())
    assert row["delivered"]
    if "unexplained" in row["delivered"]:
        assert row["delivered"]["unexplained"] == 0.0


def test_all_at_once_and_some_of_them_twice(capsys):
    texts = [*SPELLINGS.values(), "noise:0.1", "lag:0.001"]
    assert short_run(*(part for text in texts for part in ("--disturbance", text))) == 0
    rows = json.loads(Path("a/run.json").read_text())["disturbances"]
    assert [row["name"] for row in rows] == [*SPELLINGS, "noise-2", "lag-2"]
    first, second = (row["delivered"]["rms"] for row in rows if row["name"].startswith("noise"))
    assert not np.any(np.isclose(4.0 * np.array(second), first))
    capsys.readouterr()


@pytest.mark.parametrize("text", ["step:1e30N", "noise:1e14%", "sine:1e9N,on=tip-y"])
def test_a_disturbance_that_ends_the_run_is_reported_all_the_same(text: str, capsys):
    assert short_run("--disturbance", text) == 3
    [row] = json.loads(Path("a/run.json").read_text())["disturbances"]
    assert row["delivered"]
    out, err = capsys.readouterr()
    assert re.fullmatch(r"octarm: the run diverged at t = .*\n", err)
    assert "after 2 s" not in out  # no metrics


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("payload:nan", "mass of payload holds nan; it must be finite"),
        ("step:inf", "amplitude of step holds inf; it must be finite"),
        ("noise:-0.4", "ratio of noise is -0.4; it must be at least 0"),
        ("noise:0.4,time=0.0001", "a noise is 0.0001 s; it must be at least the physics step"),
        ("actuation-delay:11", "delay of actuation-delay is 11 s; it must be at most 10 s"),
        ("payload:1e300kg", "a module with mass 1e+300 kg; it must be between 1e-14 and 1e+14 kg"),
        (
            "nois:0.4",
            "unknown disturbance 'nois', did you mean 'noise'? the nearest of 19 are noise, ",
        ),
        ("payload:0.2,att=3", "payload has no key 'att', did you mean 'at'? known are mass, at"),
        ("loss:1/0", "share of loss has shape (2,); it must be one number, or 6"),
        ("step:1,on=theta4", "unknown coordinate 'theta4'"),
        ("sine:1,frequency=1000", "frequency of sine is 1000 Hz; it must be below half of the"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(text: str, sentence: str, capsys):
    assert short_run("--disturbance", text) == 2
    out, err = capsys.readouterr()
    assert out == "" and len(err.strip().splitlines()) == 1
    assert sentence in err
    assert not list(Path().iterdir())


def test_the_trajectory_holds_what_was_added_and_what_was_read():
    options = ("--disturbance", "step:0.2,at=0.01,on=theta1", "--disturbance", "quantisation:0.01")
    assert short_run(*options) == 0
    run, _ = runs.read_run(Path("a"))
    np.testing.assert_array_equal(run.disturbance[:, 3], np.where(run.t < 0.01 - 1e-9, 0.0, 0.2))
    np.testing.assert_array_equal(np.delete(run.disturbance, 3, axis=1), 0.0)
    assert np.max(np.abs(run.signals["q_measured"][:, 3:] - run.q[:, 3:])) > 1e-3


def test_what_begins_after_the_run_is_said_before_it(capsys):
    late = ["--disturbance", "payload:100g,at=30s", "--disturbance", "noise:0.1"]
    assert short_run(*late, duration="0.01") == 0
    assert capsys.readouterr().err == (
        "octarm: payload 0.1 begins at 30 s, and the run ends at 0.01 s before it\n"
    )
