"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import tempfile
import threading
from collections.abc import Generator
from pathlib import Path

from octarm.errors import FileError, quoted


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str], part: Path | None = None) -> Generator[Path]:
    """A name to write to, whose content becomes that of `path` when the block ends well.

    A link keeps its place, and the file that it leads to is replaced. What is no regular file, such
    as a device or a pipe, stays what it is and is written to at the end.

    Args:
        path: of the file.
        part: the name to write to, in the same folder, where others are to find it; a name that
            nobody else has if None.

    Raises:
        FileError: if the place cannot be written; it names `path`. Nothing is left behind.
    """
    path = Path(path)
    if not path.name:
        raise FileError(f"{quoted(os.fspath(path))} is not the name of a file")
    target = path.resolve() if path.is_symlink() else path
    special = target.exists() and not target.is_file()
    try:
        if part is None:
            part = _temporary(None if special else target.parent, path.name)
        part.touch()  # fails before the work rather than after
        yield part
        if special:
            if target.is_dir():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
            with open(part, "rb") as source, open(target, "wb") as sink:
                shutil.copyfileobj(source, sink)
            return
        with open(part, "rb") as file:
            os.fsync(file.fileno())
        os.replace(part, target)
    except OSError as error:
        if isinstance(error, FileError):
            raise
        raise FileError(f"{path} cannot be written: {error.strerror or error}") from error
    finally:
        if part is not None:
            with contextlib.suppress(OSError):
                part.unlink()


def _temporary(folder: Path | None, name: str) -> Path:
    """A new file with a name of its own and the permissions that a new file has."""
    handle, path = tempfile.mkstemp(".part", f".{name}.", folder)
    os.close(handle)
    mask = os.umask(0)
    os.umask(mask)
    os.chmod(path, 0o666 & ~mask)
    return Path(path)


def write_text(path: str | os.PathLike[str], text: str) -> None:
    """Writes a text file whole or not at all.

    Raises:
        FileError: if it cannot be written.
    """
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")


@contextlib.contextmanager
def piped(path: Path) -> Generator[str]:
    """A name for a library to write `path` through, if the library hangs on a full disk.

    On POSIX the name is that of a pipe, and a thread copies what comes out of it to the file.

    Raises:
        OSError: if the file cannot be written, a full disk included.
    """
    if os.name != "posix":
        yield str(path)
        return
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
