"""Files that appear whole or not at all, one or several together."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import tempfile
import threading
from collections.abc import Generator, Mapping
from pathlib import Path

from octarm.errors import FileError, quoted, similar
from octarm.interrupts import held_interrupts

_PART = ".{}.new.part"  # the name that a file has until it is whole


@contextlib.contextmanager
def writing(path: str | os.PathLike[str]) -> Generator[None]:
    """Lets an OSError of the block become a FileError that names the file or folder."""
    try:
        yield
    except OSError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(f"{path} cannot be written: {error.strerror or error}") from error


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str], part: Path | None = None) -> Generator[Path]:
    """A name to write to, whose content becomes that of `path` when the block ends well.

    A link keeps its place, and the file that it leads to is replaced. What is no regular file, such
    as a device or a pipe, stays what it is and is written to at the end. The name to write to may
    be given as `part`, in the same folder, where others are to find it. Raises FileError if the
    place cannot be written; nothing is left behind.
    """
    path = Path(path)
    if not path.name:
        raise FileError(f"{quoted(os.fspath(path))} is not the name of a file")
    target = path.resolve() if path.is_symlink() else path
    special = target.exists() and not target.is_file()
    lock = None
    try:
        with writing(path):
            if part is None:
                part, lock = _temporary(None if special else target.parent, path.name)
            part.touch()  # fails before the work rather than after
            yield part
            if special:
                with open(part, "rb") as source, open(target, "wb") as sink:
                    shutil.copyfileobj(source, sink)
                return
            _settle(part)
            os.replace(part, target)
    finally:
        if part is not None:
            with contextlib.suppress(OSError):
                part.unlink()
        if lock is not None:
            os.close(lock)


def _settle(part: Path) -> None:
    """Waits until a file is on disk; raises OSError if it has no room there."""
    with open(part, "rb") as file:
        os.fsync(file.fileno())


def _temporary(folder: Path | None, name: str) -> tuple[Path, int | None]:
    """A new file to write to, or what a killed process has left, and a lock if there is one."""
    if folder is not None:
        part = folder / _PART.format(name)
        lock = _locked(part)
        if lock is not None:
            os.truncate(part, 0)
            return part, lock
    return _unique(folder, name), None


def _unique(folder: Path | None, name: str) -> Path:
    """A new file with a name that nobody else has and the permissions that a new file has."""
    handle, path = tempfile.mkstemp(".part", f".{name}.", folder)
    os.close(handle)
    mask = os.umask(0)
    os.umask(mask)
    os.chmod(path, 0o666 & ~mask)
    return Path(path)


def _locked(path: Path) -> int | None:
    """A descriptor of a file that holds a lock on it; None if another process has one."""
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    except OSError:  # somebody else's
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(handle), os.stat(path)):  # another one may just have moved it
            return handle
    except OSError:  # locked, moved, or a file system without locks
        pass
    os.close(handle)
    return None


def write_files(contents: Mapping[Path, bytes]) -> None:
    """Writes several files: all of them, or none if one has no room.

    Folders that are missing are made, and removed if nothing is written. Raises FileError if one
    cannot be written.
    """
    made: list[Path] = []
    parts: dict[Path, Path] = {}
    lock, path = None, Path()
    try:
        for path, content in contents.items():
            missing = [p for p in (path.parent, *path.parent.parents) if not p.exists()]
            path.parent.mkdir(parents=True, exist_ok=True)
            made = [*missing, *made]
            if path.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            target = path.resolve()
            if not parts:  # the lock on the first one holds for all of them
                parts[target], lock = _temporary(target.parent, target.name)
            elif lock is not None:
                parts[target] = target.with_name(_PART.format(target.name))
            else:
                parts[target] = _unique(target.parent, target.name)
            parts[target].write_bytes(content)
            _settle(parts[target])
        with held_interrupts():
            for target, part in parts.items():
                os.replace(part, target)
        made = []
    except OSError as error:
        raise FileError(f"{path} cannot be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            for part in parts.values():
                part.unlink(missing_ok=True)
            for folder in made:  # as long as nobody else has put something there
                folder.rmdir()
        if lock is not None:
            os.close(lock)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes a text file whole or not at all; raises FileError if it cannot be written."""
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """The bytes of a file; raises FileError if it cannot be read."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise unreadable(path, error) from None


def unreadable(path: str | os.PathLike[str], error: OSError) -> FileError:
    """What to raise for a file that cannot be read; it names one of a similar name, if any."""
    path, meant = Path(path), ""
    if error.errno == errno.ENOENT and path.parent.is_dir():
        meant = similar(path.name, (file.name for file in path.parent.glob(f"*{path.suffix}")))
    return FileError(f"{path} cannot be read: {error.strerror}{meant}")


@contextlib.contextmanager
def piped(path: Path) -> Generator[str]:
    """A name for a library to write `path` through, if the library hangs on a full disk.

    The name is that of a pipe, and a thread copies what comes out of it to the file. Raises OSError
    if the file cannot be written, a full disk included.
    """
    failures: list[OSError] = []
    file = open(path, "wb")
    source, sink = os.pipe()

    def copy() -> None:
        with open(source, "rb", buffering=0) as pipe:
            try:
                with file:
                    while chunk := pipe.read(1 << 16):
                        file.write(chunk)
                        file.flush()  # the process may be killed
            except OSError as error:
                failures.append(error)
            while pipe.read(1 << 20):  # the writer would wait for a reader that is gone
                pass

    thread = threading.Thread(target=copy, daemon=True)
    thread.start()
    try:
        yield f"/dev/fd/{sink}"
    finally:
        os.close(sink)
    thread.join(60.0)
    if failures or thread.is_alive():
        raise failures[0] if failures else TimeoutError("the writer did not finish")
