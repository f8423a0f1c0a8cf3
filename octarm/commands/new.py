"""What `octarm new` does: commented files to start from, which run as they are."""

from __future__ import annotations

import os
import re
from pathlib import Path

from jinja2 import Template

from octarm.commands.kinds import NEW_FILES
from octarm.disturbances.spelling import DISTURBANCES
from octarm.errors import OctarmError, closest, printable, quoted
from octarm.files import write_text

_FILES = Path(__file__).resolve().parent / "starts"
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*([_-][A-Za-z0-9]+)*")
_NEXT = {
    "controller": "octarm run --controller {word}",
    "reference": "octarm run --reference {word}",
    "disturbance": "octarm run --disturbance {word}:5",
    "metric": "octarm run --metric {word}",
    "arm": "octarm run --arm {file}",
    "experiment": "octarm sweep {file} --out runs/{name}",
}


def new(kind: str, name: str) -> None:
    """`octarm new`: writes a file into the working folder."""
    if kind not in NEW_FILES:
        raise OctarmError(f"unknown kind {quoted(kind)}{closest(kind, NEW_FILES)}")
    if not _NAME.fullmatch(name):
        raise OctarmError(
            f"name is {quoted(name)}; it must be letters and digits, joined by - or _, such as "
            "my-law"
        )
    words = re.split("[_-]", name)
    hyphened = "-".join(words).lower()
    if kind == "disturbance" and (hyphened in DISTURBANCES or words[-1].isdigit()):
        raise OctarmError(
            f"{hyphened} cannot be the name of a disturbance: it is built in, or ends in a number"
        )
    (start,) = _FILES.glob(f"{kind}.*")
    suffix, column = Path(start.stem).suffix, "_".join(words).lower()
    named = {
        "file": f"{column if suffix == '.py' else hyphened}{suffix}",
        "Name": "".join(word[0].upper() + word[1:] for word in words),
        "name": hyphened,
        "column": column,
    }
    if os.path.lexists(named["file"]):
        raise OctarmError(f"{named['file']} exists; choose another name, or remove it")
    template = Template(start.read_text(encoding="utf-8"), keep_trailing_newline=True)
    write_text(named["file"], template.render(named))
    word = f"./{named['file']}:{named['Name']}"
    print(f"wrote {printable(named['file'])}")
    print(f"try it: {_NEXT[kind].format(word=word, **named)}")
