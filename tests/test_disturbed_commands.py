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
from octarm.disturbances.fields import field_kinds
from octarm.disturbances.spelling import DISTURBANCES, parse_disturbance, spelling
from octarm.runs import folder as runs

_NAMES = "|".join(sorted(DISTURBANCES, key=len, reverse=True))
_SPELLING = re.compile(rf"(?<![\w-])({_NAMES}):(\S*[\w.])")


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def short_run(*options: str, duration: str = "0.05") -> int:
    return cli.main(["run", "--controller", "pd", "--duration", duration, "--out", "a", *options])


@pytest.fixture(scope="module")
def table() -> str:
    """The disturbances in the help, each followed by what is said of it."""
    from contextlib import redirect_stdout
    from io import StringIO

    out = StringIO()
    with redirect_stdout(out), pytest.raises(SystemExit):
        cli.main(["run", "--help"])
    return out.getvalue().partition("Disturbances, by what")[2].partition("options")[0]


def from_help(text: str) -> Disturbance:
    """A disturbance of the help, with a number for each word in capitals."""
    return parse_disturbance(re.sub(r"\b[A-Z]+\b", "0.25", text))


def test_every_spelling_in_the_help_works_and_all_are_there(table: str):
    found = [match[0] for match in _SPELLING.finditer(table)]
    assert len(found) >= len(DISTURBANCES)
    assert {from_help(text).name for text in found} == set(DISTURBANCES)


def test_the_help_names_all_keys_with_their_defaults(table: str):
    shown: dict[str, set[str]] = {name: set() for name in DISTURBANCES}
    starts = [*_SPELLING.finditer(table)]
    ends = [*(match.start() for match in starts[1:]), len(table)]
    for match, end in zip(starts, ends, strict=True):
        also = re.search(r"also (\S+)", table[match.end() : end])
        for item in f"{match[2]},{also[1] if also else ''}".split(",")[1:]:
            key, equals, default = item.partition("=")
            if equals:
                cls = DISTURBANCES[match[1]]
                field = next(f for f, k in field_kinds(cls).items() if (k.key or f) == key)
                fields = {f.name: f for f in dataclasses.fields(cls)}  # pyright: ignore
                assert str(fields[field].default) in (default, f"{default}.0"), match[0]
                shown[match[1]].add(key)
    assert "noise:rms=" in table
    shown["noise"].add("rms")
    for name, cls in DISTURBANCES.items():
        _, *others = [kind.key or field for field, kind in field_kinds(cls).items()]
        assert shown[name] == set(others)


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


@pytest.mark.parametrize("text", ["step:1e30", "noise:1e12", "sine:1e9,on=tip-y"])
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
        ("payload:1e300", "a module with mass 1e+300 kg; it must be between 1e-14 and 1e+14 kg"),
        ("nois:0.4", "unknown disturbance 'nois', did you mean 'noise'? known are noise, sine, p"),
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
