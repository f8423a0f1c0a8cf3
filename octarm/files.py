"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Generator
from pathlib import Path

from octarm.errors import FileError


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str]) -> Generator[Path]:
    """A neighbouring name to write to, which becomes `path` when the block ends well.

    Raises:
        FileError: if the place cannot be written; it names `path`. Nothing is left behind.
    """
    path = Path(path)
    if not path.name:
        raise FileError(f"{os.fspath(path)!r} is not the name of a file")
    part = path.with_name(path.name + ".part")
    try:
        part.touch()  # fails before the work rather than after
        yield part
        with open(part, "rb") as file:
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        raise FileError(f"{path} cannot be written: {error.strerror or error}") from error
    finally:
        with contextlib.suppress(OSError):
            part.unlink()


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
