"""Modules, and files as modules of their own: where they are, and importing them.

Where a module is, and what its file holds, is found without importing anything.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import importlib
import importlib.metadata
import inspect
import os
import sys
import types
from typing import Any

from octarm.errors import OctarmError, quoted
from octarm.files import read_bytes

ALLOWED = "it must be a known name, MODULE:NAME, or FILE.py:NAME"


@functools.cache
def entry_points(group: str) -> tuple[importlib.metadata.EntryPoint, ...]:
    """The entry points of installed packages in a group."""
    return tuple(importlib.metadata.entry_points(group=group))


def loaded(source: str) -> tuple[types.ModuleType, str]:
    """A module, or a file as a module of its own, and the SHA-256 of its file.

    Raises OctarmError if there is no such module or file, or it cannot be imported.
    """
    content = content_of(source)
    sha256 = sha256_of(content)
    try:
        if source.endswith(".py"):
            return _module_of(source, content), sha256
        return importlib.import_module(source), sha256
    except (Exception, SystemExit) as error:  # whatever a user's file may do
        what = f"{type(error).__name__}: {error}"
        raise OctarmError(f"{source} cannot be imported: {what}") from error


def _module_of(file: str, content: bytes) -> types.ModuleType:
    """The module that these bytes of a file are, made once."""
    name = f"octarm_file_{sha256_of(file.encode() + content)[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    module = types.ModuleType(name)
    module.__file__ = file
    sys.modules[name] = module  # where dataclasses look up annotations
    try:
        exec(compile(content, file, "exec"), vars(module))
    except BaseException:
        del sys.modules[name]
        raise
    return module


def content_of(source: str) -> bytes:
    """The bytes of a file, or of that of a module; nothing is imported.

    Raises FileError if the file cannot be read, OctarmError if there is no such module.
    """
    return read_bytes(located(source))


def located(source: str) -> str:
    """A file, or that of a module; modules may also be in the working folder.

    Packages above it are not imported, unlike by `importlib.util.find_spec`. Raises OctarmError if
    there is no such module, or it has no file.
    """
    if source.endswith(".py"):
        return source
    top, *parts = source.split(".")
    spec = _spec(top, None)
    if spec is None and any(map(os.path.exists, (top, f"{top}.py"))):
        sys.path.append(os.getcwd())  # as `python -m` does; processes that are started inherit it
        spec = _spec(top, None)
    name = top
    for part in parts:
        name = f"{name}.{part}"
        places = None if spec is None else spec.submodule_search_locations
        spec = None if places is None else _spec(name, places)
    if spec is None:
        path = os.path.join(top, *parts) + ".py"
        is_there = os.path.isfile(path)
        hint = f"; {top} is not that of this folder: give ./{path}:NAME" * is_there
        raise OctarmError(f"there is no module {quoted(name)}{hint or f'; {ALLOWED}'}")
    if not spec.has_location or spec.origin is None:
        raise OctarmError(f"module {quoted(name)} has no file; {ALLOWED}")
    return spec.origin


def is_module(name: str) -> bool:
    """Whether there is a module of this name."""
    with contextlib.suppress(OctarmError):
        return bool(located(name))
    return False


def _spec(name: str, places: Any) -> Any:
    specs = (finder.find_spec(name, places) for finder in sys.meta_path)
    return next((spec for spec in specs if spec is not None), None)


def distribution_of(source: str) -> str:
    """The installed package that a module belongs to; empty if it is not known, or for a file."""
    if source.endswith(".py"):
        return ""
    top = source.partition(".")[0]
    return next(iter(importlib.metadata.packages_distributions().get(top, ())), "")


def public_names(module: types.ModuleType) -> list[str]:
    """The classes and functions that a module itself defines."""
    return [
        name
        for name, thing in vars(module).items()
        if (inspect.isclass(thing) or inspect.isfunction(thing))
        and thing.__module__ == module.__name__
        and not name.startswith("_")
    ]


def sha256_of(content: bytes) -> str:
    """The SHA-256 of some bytes, in hexadecimal."""
    return hashlib.sha256(content).hexdigest()
