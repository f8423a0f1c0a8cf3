"""Controllers, references, disturbances and metrics by name: ours, those of packages, a user's own.

Each is given by a word, everywhere in the same way:

- a name, such as `sine`: built in, or an entry point of an installed package, in the group
  `octarm.controllers`, `octarm.references`, `octarm.disturbances` or `octarm.metrics`;
- an import path, `my_lab.laws:Backstepping`;
- a file, `./backstepping.py:Backstepping`, which need not belong to any package.

What is not built in is recorded as `Code`: its import path or file, and the SHA-256 of the file.
Whoever runs it again gets it from `word_of`, which refuses a file that is not what it was; whoever
only looks at results never imports it, and goes by what `Code.declares` says.
"""

from __future__ import annotations

import collections
import contextlib
import importlib
import importlib.metadata
import inspect
import operator
import os
import re
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

from pydantic import Field

from octarm import importing
from octarm.errors import OctarmError, closest, quoted
from octarm.files import read_bytes
from octarm.formats import Model

T = TypeVar("T")
Kind = Literal["controller", "reference", "disturbance", "metric"]

_NAME = r"[A-Za-z_][\w.]*"
# The file or module, the name in it, and what follows, such as the numbers of a disturbance.
_PATH = re.compile(rf"(.+\.py|[A-Za-z_]\w*(?:\.\w+)*):({_NAME})(?::(.*))?", re.DOTALL)
# A file of samples, which is data and no code, and what follows: file:PATH[,KEY=VALUE]*.
_SAMPLES = re.compile(r"file:(.+?)((?:,[a-z][a-z0-9-]*=.*)?)", re.DOTALL)
_PARTS = re.compile(r"[^/:.]+")


class Code(Model):
    """Where something comes from that is not built in.

    Attributes:
        kind: what it is used as.
        path: `MODULE:NAME`, or `FILE.py:NAME` with the absolute path of the file; of a motion in a
            file of samples `file:PATH` and its parameters.
        sha256: of the file that holds it; files that this one imports are not covered.
        distribution: the installed package that brought it; empty if there is none.
        declares: what a reader of results has to know of it: of a disturbance the fields by key,
            of metrics their declarations by name.
    """

    kind: Kind
    path: str
    sha256: str
    distribution: str = ""
    declares: dict[str, dict[str, Any]] = Field(default_factory=dict)


# The code of an experiment of which all is built in.
BUILT_IN: Mapping[str, Code] = types.MappingProxyType({})


class CodeChanged(OctarmError):
    """Code that is not what it was when it was recorded, or is gone; it is not run."""


class Spelt(NamedTuple):
    """A word taken apart: what it names, and what follows after a colon."""

    word: str
    rest: str


class Declared(collections.UserDict[str, T]):
    """Things of one kind. Iteration and `in` are of those that are built in.

    `table[word]` finds all of them; an OctarmError says what is wrong with a word.
    """

    def __init__(
        self,
        kind: Kind,
        built_in: Mapping[str, T],
        check: Callable[[Any], str],
        declares: Callable[[T], dict[str, dict[str, Any]]] = lambda thing: {},
    ) -> None:
        """A table of what is built in.

        The check says what an object of a user lacks, such as "has no method start", or nothing;
        `declares` is for `Code`.
        """
        super().__init__(built_in)
        self.kind: Kind = kind
        self._check, self._declares = check, declares

    def __missing__(self, word: str) -> T:
        return self._found(word)[0]

    def get(self, key: str, default: Any = None) -> Any:
        """What is built in under a name."""
        return self.data.get(key, default)

    def names(self) -> list[str]:
        """The names of all that is built in or that an installed package brings."""
        return [*self, *(point for point in self._points() if point not in self)]

    def split(self, text: str) -> Spelt:
        """The word with which a text begins, and the rest: `noise:0.4`, `./gust.py:Gust:5,at=1`."""
        name, _, rest = text.partition(":")
        match = None if name in self or name in self._points() else _PATH.fullmatch(text)
        if match is None or not ("/" in name or "." in name or importing.is_module(name)):
            return Spelt(name, rest)
        return Spelt(f"{match[1]}:{match[2]}", match[3] or "")

    def named_by(self, text: str) -> Spelt:
        """The word that names something, and its parameters, which not all kinds have."""
        has_parameters = self.kind in ("reference", "disturbance")
        return self.split(text) if has_parameters else Spelt(text, "")

    def code(self, text: str) -> Code | None:
        """Where something comes from; None for what is built in.

        Raises OctarmError for a word that means nothing of this kind, FileError for a file of
        samples that cannot be read.
        """
        word, samples = self.named_by(text).word, samples_of(text)
        if word not in self:
            return self._found(word)[1]
        if samples is None:
            return None
        sha256 = importing.sha256_of(read_bytes(samples))
        return Code(kind=self.kind, path=absolute(text), sha256=sha256)

    def check(self, text: str, *more: str) -> None:
        """Raises OctarmError for a word that can mean nothing of this kind; no code is imported.

        More names may be known where the word stands.
        """
        word = self.named_by(text).word
        if word not in (*self, *more):
            importing.content_of(self._located(word, *more)[0])

    def _points(self) -> dict[str, importlib.metadata.EntryPoint]:
        return {point.name: point for point in importing.entry_points(f"octarm.{self.kind}s")}

    def _located(
        self, word: str, *more: str
    ) -> tuple[str, str, importlib.metadata.EntryPoint | None]:
        """The file or module of what is not built in, its name there, and its entry point."""
        point = None if ":" in word else self._points().get(word)
        path = absolute(word if point is None else point.value)
        match = _PATH.fullmatch(path)
        if match is None or match[3] is not None:
            if word.endswith(".py") or ":" in word:
                raise OctarmError(f"{self.kind} is {quoted(word)}; {importing.ALLOWED}")
            known = closest(word, (*more, *self.names()))
            raise OctarmError(f"unknown {self.kind} {quoted(word)}{known}")
        return match[1], match[2], point

    def _found(self, word: str) -> tuple[T, Code]:
        """A thing that is not built in, and where it comes from."""
        source, name, point = self._located(word)
        path = f"{source}:{name}"
        module, sha256 = importing.loaded(source)
        try:
            thing: Any = operator.attrgetter(name)(module)
        except AttributeError:
            known = importing.public_names(module)
            hint = closest(name, known) if known else ""
            raise OctarmError(f"{source} holds no {quoted(name)}{hint}") from None
        if lacks := self._check(thing):
            raise OctarmError(f"{path} is no {self.kind} of octarm: it {lacks}")
        installed = None if point is None else point.dist
        return thing, Code(
            kind=self.kind,
            path=path,
            sha256=sha256,
            distribution=installed.name if installed else importing.distribution_of(source),
            declares=self._declares(thing),
        )


def lacking(cls: type, **methods: Sequence[str]) -> str:
    """Which of some methods a class lacks, or has with other arguments; empty if none."""
    held = {name: value for base in reversed(cls.__mro__) for name, value in vars(base).items()}
    for name, arguments in methods.items():
        if name not in held or name in vars(cls).get("__abstractmethods__", ()):
            return f"has no method {name}"
        try:
            inspect.signature(held[name]).bind(cls, *arguments)
        except TypeError:
            return f"has a method {name} that does not take ({', '.join(('self', *arguments))})"
    return ""


def absolute(word: str, folder: Path | None = None) -> str:
    """A word with the absolute path of its file, if it has one, seen from a folder or from here."""
    match, before = _SAMPLES.fullmatch(word), "file:"
    if match is None:
        match, before = _PATH.fullmatch(word), ""
        if match is None or not match[1].endswith(".py"):
            return word
    file = (folder or Path()) / Path(match[1]).expanduser()
    return before + os.path.abspath(file) + word[match.end(1) :]


def samples_of(word: str) -> Path | None:
    """The file of samples that a word names; None if it names none."""
    match = _SAMPLES.fullmatch(word)
    return None if match is None else Path(match[1])


def short_name(word: str) -> str:
    """What a word is called by itself: the name of the class or function, or the word."""
    match = _PATH.fullmatch(word)
    return word if match is None else match[2]


def named(words: Iterable[tuple[Declared[Any], str]]) -> tuple[list[str], dict[str, Code]]:
    """Names for the words of one experiment, short and unique, and the code that they stand for.

    What is built in, an entry point, or a disturbance keeps its name. Others are called as in their
    file, `Backstepping`, or `laws.Backstepping` and so on where that would mean two things. Raises
    OctarmError for a word that means nothing, or two disturbances of the same name.
    """
    words = list(words)
    codes = [table.code(text) for table, text in words]
    paths = {code.path for code in codes if code is not None}
    spelt = [table.named_by(text) for table, text in words]
    taken = {word for word, _ in spelt if ":" not in word}
    names: list[str] = []
    known: dict[str, Code] = {}
    for (table, _), (word, rest), code in zip(words, spelt, codes, strict=True):
        if code is not None and table.kind == "disturbance":
            word = str(table[word].name)  # by which its random numbers are called
        elif code is not None and (":" in word or samples_of(code.path)):
            rest = "" if samples_of(code.path) else rest
            word = _short(code.path, paths - {code.path}, {*table, *taken})
        if code is not None and known.setdefault(word, code) != code:
            raise OctarmError(
                f"{known[word].path} and {code.path} are both called {word}; give one of them "
                "another name"
            )
        names.append(f"{word}:{rest}" if rest else word)
    return names, known


def word_of(name: str, code: Mapping[str, Code]) -> str:
    """The word for a name of an experiment, whose code is what it was.

    Raises OctarmError for a path that is no name of the experiment, CodeChanged if the file that
    holds it has another SHA-256, or is gone. Nothing has been imported then.
    """
    head, colon, parameters = name.partition(":")
    if name not in code:
        if colon and head in code and code[head].kind == "reference":
            return f"{word_of(head, code)}:{parameters}"
        if ":" in name:  # a file of results may hold anything
            raise OctarmError(f"{quoted(name)} is code that is not recorded with its SHA-256")
        return name
    path, sha256 = code[name].path, code[name].sha256
    try:
        now = importing.sha256_of(read_bytes(file_of(path)))
    except OctarmError as error:
        raise CodeChanged(f"{name} cannot be run again: {error}") from None
    if now != sha256:
        raise CodeChanged(
            f"{path} was changed since: its file has the SHA-256 {now[:12]}.. and had "
            f"{sha256[:12]}..; it is not run"
        )
    return path


def file_of(path: str) -> Path:
    """The file of what MODULE:NAME or FILE.py:NAME names; OctarmError if there is none."""
    return samples_of(path) or Path(importing.located(path.rpartition(":")[0]))


def distributions(code: Mapping[str, Code]) -> dict[str, str]:
    """The versions of the installed packages that brought some code, by name."""
    versions: dict[str, str] = {}
    for name in dict.fromkeys(each.distribution for each in code.values() if each.distribution):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            versions[name] = importlib.metadata.version(name)
    return versions


def _short(path: str, others: set[str], taken: set[str]) -> str:
    """The shortest end of a path that is neither taken nor the end of another path."""
    ends, *rest = map(_ends, (path, *others))
    free = (end for end in ends if end not in taken and not any(end in other for other in rest))
    return next(free, path)


def _ends(path: str) -> list[str]:
    """The ends of a path, of which the first is the shortest."""
    match = _SAMPLES.fullmatch(path)
    if match is not None:
        parts = Path(match[1]).parts
        files = (os.path.join(*parts[k:]) for k in reversed(range(len(parts))))
        return [f"file:{file}{match[2]}" for file in files]
    parts = _PARTS.findall(path.replace(".py:", ":"))
    return [".".join(parts[k:]) for k in reversed(range(len(parts)))]
