"""The command on what is your own: new."""

from __future__ import annotations

from functools import partial
from typing import Annotated

from octarm.commands import kinds
from octarm.commands.kinds import Work


def new(kind: Annotated[str, kinds.KIND], name: Annotated[str, kinds.text("NAME")], /) -> Work:
    """Write a commented file to start from, which runs as it is.

    Into the working folder, as NAME.py with a class of this name, or NAME.toml. A file that is
    there already stays as it is. What you make of it needs no place in octarm: every command takes
    FILE.py:NAME, or MODULE:NAME of an installed package.

    Args:
        kind: what it is to be
        name: of your own, such as my-law

    Examples:
      octarm new controller my-law
      octarm new disturbance soft-wall
      octarm new experiment first
    """
    from octarm.commands import new as work

    return partial(work.new, kind, name)
