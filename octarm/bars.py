"""The one kind of bar that says how far something is: on terminals and in notebooks alone."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tqdm import tqdm


def bar(iterable: Iterable[Any] | None = None, **options: Any) -> tqdm[Any]:
    """A bar of tqdm, with its options; it goes when it is closed, or where it cannot be seen."""
    from tqdm.auto import tqdm  # which loads asyncio

    return tqdm(iterable, disable=not visible(), leave=False, **options)


def visible() -> bool:
    """Whether bars are seen: standard error is a terminal, or a cell of Jupyter is running."""
    ipython: Any = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    notebook = shell is not None and "IPKernelApp" in shell.config
    return notebook or (sys.stderr is not None and sys.stderr.isatty())
