"""Files as typed models: what they mean, and what is said when they are wrong."""

import datetime
import json
import math
import tomllib
from typing import Annotated, Any

import numpy as np
import pytest
from pydantic import Field, field_validator

from octarm.errors import FileError, OctarmError
from octarm.formats import (
    FORMAT,
    Array,
    Document,
    Model,
    check_format,
    one_of,
    parse_toml,
    read_json,
    read_toml,
    to_json,
    to_toml,
)


class Bounds(Model):
    """A table within the table."""

    low: float
    high: float = 1.0


class Example(Model):
    """A file."""

    count: Annotated[int, Field(ge=0)] = 0
    length: float = 1.0
    method: Annotated[str, one_of(["uniform", "sobol"])] = "uniform"
    bounds: Bounds | None = None
    values: Array[float] | Array[str] = ()
    record: Array[int | Annotated[str, one_of(["worst", "median"])]] = ()
    gains: dict[str, dict[str, float | Array[float]]] = Field(default_factory=dict)

    @field_validator("length")
    @classmethod
    def _not_seven(cls, length: float) -> float:
        if length == 7.0:
            raise OctarmError("another number")
        return length


def test_a_text_becomes_a_model():
    text = 'count = 2\nlength = 3\nrecord = ["worst", 4]\n[gains.pd]\nK = [1, 2.5]\nD = inf'
    model = parse_toml(text, "my.toml").read(Example)
    assert model.length == 3.0 and isinstance(model.length, float)
    assert model.record == ("worst", 4)
    assert model.gains == {"pd": {"K": (1.0, 2.5), "D": math.inf}}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("cuont = 1", "line 1: unknown key 'cuont', did you mean 'count'"),
        ("\ncount = -1", "line 2: count is -1; it must be at least 0"),
        ("count = true", "line 1: count is true; it must be a whole number"),
        ('length = "1"', 'line 1: length is "1"; it must be a number'),
        ("length = 7", "line 1: length is 7; it must be another number"),
        ('method = "unifrom"', "unknown method \"unifrom\", did you mean 'uniform'? known are"),
        ("bounds = 3", "line 1: bounds is 3; it must be a table"),
        ("[bounds]\nhigh = 2", "line 1: [bounds] needs a value of low"),
        ("[bounds]\nlow = 1\nhihg = 2", "line 3: unknown key 'hihg' in [bounds], did you mean"),
        ("values = 3", "values is 3; it must be a list"),
        ('values = [1, "a"]', 'values holds "a"; it must be a number'),
        ('record = ["wurst"]', "unknown record \"wurst\", did you mean 'worst'"),
        ("record = [2.5]", "record holds 2.5; it must be a whole number or a word"),
        ('[gains.pd]\n"K" = "a"', 'line 2: K is "a"; it must be a number or a list'),
        ("= 1", "my.toml: "),
    ],
)
def test_what_is_wrong_is_one_sentence_with_its_line(text: str, expected: str):
    with pytest.raises(OctarmError) as caught:
        parse_toml(text, "my.toml").read(Example)
    message = str(caught.value)
    assert message.startswith("my.toml") and expected in message and "\n" not in message


def test_what_is_written_is_read_back():
    content: dict[str, Any] = {
        "a": 1e-5,
        "b": [1.0, math.inf],
        "when": datetime.date(2020, 2, 3),
        "d": {"e.f": "é", "rows": [{"x": 1.0}, {"x": 2.0}]},
    }
    text = to_toml(content | {"none": None, "mixed": [1, {"x": 2}]})
    assert tomllib.loads(text) == content | {"mixed": [1, {"x": 2}]}
    assert "    {x = 1.0},\n    {x = 2.0}" in text
    odd = {"a": np.array([1.0, math.inf, math.nan]), "b": (-math.inf,)}
    assert json.loads(to_json(odd)) == {"a": [1.0, "inf", None], "b": ["-inf"]}
    assert json.loads(to_json({"a": [1], "b": {"c": [{}], "d": {}}})) == {
        "a": [1],
        "b": {"c": [{}], "d": {}},
    }


def test_files_that_cannot_be_read_are_named(tmp_path):
    (tmp_path / "a.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(FileError, match=r"a\.toml is not a text file"):
        read_toml(tmp_path / "a.toml")
    for read in (read_toml, read_json):
        with pytest.raises(FileError, match="b cannot be read: No such file"):
            read(tmp_path / "b")
    for text in ("{", "[1]"):
        (tmp_path / "c.json").write_text(text)
        with pytest.raises(OctarmError, match=r"c\.json"):
            read_json(tmp_path / "c.json")


def test_another_format_is_refused_by_its_version():
    check_format(Document("run.json", {"format": FORMAT}))
    with pytest.raises(OctarmError, match=r"run.json has format 4; .* reads format 3"):
        check_format(Document("run.json", {"format": 4}))
    with pytest.raises(OctarmError, match="has format 1"):
        check_format(Document("run.json", {}))
