"""The place of a run on disk: claimed by one process, filled, and only then in the way of nothing.

A claim is a lock on the folder itself, which dies with its process. A folder that is replaced is
exchanged with the new one in one step where the system can do that (Linux); elsewhere it has
another name for a moment, and the next call brings it back if the process was killed just then.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import re
import shutil
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

from octarm.errors import OctarmError
from octarm.files import writing
from octarm.runs.folder import ARRAYS, BLOCKS, DESCRIPTION, RECORDING

_FILE = re.compile(
    "|".join(rf"{name}(\.part)?|\.{name}\..*\.part" for name in (RECORDING, ARRAYS, DESCRIPTION))
    + f"|{BLOCKS}"
)
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # of Linux's renameat2


@contextmanager
def new_folder(folder: Path) -> Generator[Path]:
    """A folder to fill, which no other run can take meanwhile.

    Where nothing stands it has its final name from the start, so that what a killed run leaves is
    found there. An earlier run is replaced only when the block ends well; until then the folder
    has another name. Anything else that stands there is left alone, and so is, if the block fails,
    everything that this run has not made.

    Raises:
        OctarmError: if the name is taken by something that is not a run, or by a run that is still
            being written.
        FileError: if the place cannot be written; it names the folder.
        KeyboardInterrupt: if interrupted; it says that nothing was written.
    """
    folder = folder.resolve()
    spare = folder.with_name(f".{folder.name}.part")
    earlier = folder.with_name(f".{folder.name}.old")
    try:
        with writing(folder):
            if earlier.exists() and not folder.exists():  # a process was killed between two renames
                earlier.rename(folder)
            with _claimed(folder, _made(folder)):
                names = {path.name for path in folder.iterdir()}
                if names and not (DESCRIPTION in names and all(map(_FILE.fullmatch, names))):
                    raise _taken(folder)
                for stale in (spare, earlier):  # of killed processes: this one has the place
                    shutil.rmtree(stale, ignore_errors=True)
                if not names:
                    with _on_failure(lambda: _empty(folder)), _kept_in_reserve():
                        yield folder
                    return
                if Path.cwd().is_relative_to(folder):
                    raise OctarmError(
                        f"{folder} holds an earlier run, and is the current folder; it cannot be "
                        "replaced from within"
                    )
                with _replacing(folder, spare, earlier), _kept_in_reserve():
                    yield spare
    except KeyboardInterrupt:
        raise KeyboardInterrupt("nothing was written") from None


def _made(folder: Path) -> list[Path]:
    """Makes a folder and the parents that it needs; those that this call has made, inmost first."""
    made: list[Path] = []
    for attempt in range(10):
        try:
            for path in (*reversed(folder.parents), folder):
                with contextlib.suppress(FileExistsError):
                    path.mkdir()
                    made.insert(0, path)
            break
        except FileNotFoundError:  # another run failed, and removed a parent that it had made
            if attempt == 9:
                raise
    if not folder.is_dir():
        raise _taken(folder)
    return made


def _taken(folder: Path) -> OctarmError:
    return OctarmError(f"{folder} exists and is not an earlier run; choose another --out")


@contextmanager
def _claimed(folder: Path, made: list[Path]) -> Generator[None]:
    """Holds a lock on the folder, which dies with this process.

    Folders that were made for it go if it cannot be opened, or the block fails. Raises OctarmError
    if another process, or another thread, holds it.
    """

    def remove() -> None:
        for path in made:
            path.rmdir()

    with _on_failure(remove):
        handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            mine = os.path.samestat(os.fstat(handle), os.stat(folder))
        except (BlockingIOError, FileNotFoundError):
            mine = False
        except OSError:  # some network file systems have no locks
            mine = True
        if not mine:  # the folder was replaced between the two calls, or is locked
            raise OctarmError(f"another run is being written to {folder}; choose another --out")
        with _on_failure(remove):
            yield
    finally:
        os.close(handle)


@contextmanager
def _on_failure(undo: Callable[[], object]) -> Generator[None]:
    """Undoes something as far as it can be if the block fails."""
    try:
        yield
    except BaseException:
        with contextlib.suppress(OSError):  # a parent in which something stands stays
            undo()
        raise


def _empty(folder: Path) -> None:
    for path in folder.iterdir():
        if _FILE.fullmatch(path.name):
            path.unlink()


@contextmanager
def _kept_in_reserve() -> Generator[None]:
    """Keeps a few files open, so that a block that fails for want of some can be cleaned up."""
    with contextlib.ExitStack() as reserve:
        for _ in range(3):
            reserve.enter_context(open(os.devnull, "rb"))
        yield


@contextmanager
def _replacing(folder: Path, spare: Path, earlier: Path) -> Generator[None]:
    """Lets a spare folder take the place of a run when the block ends well."""
    try:
        spare.mkdir()
        shutil.copymode(folder, spare)
        yield
        if not _exchanged(folder, spare):
            folder.rename(earlier)
            spare.rename(folder)
    except OctarmError as error:
        raise type(error)(str(error).replace(str(spare), str(folder))) from error
    finally:
        if earlier.exists() and not folder.exists():
            earlier.rename(folder)
        for leftover in (spare, earlier):
            shutil.rmtree(leftover, ignore_errors=True)


def _exchanged(one: Path, other: Path) -> bool:
    """Lets two folders change names in one step; False if the system cannot do that."""
    rename = getattr(ctypes.CDLL(None), "renameat2", None)
    paths = map(os.fsencode, (one, other))
    return rename is not None and not rename(
        _AT_FDCWD, next(paths), _AT_FDCWD, next(paths), _RENAME_EXCHANGE
    )
