"""Command lines in processes that begin at once: forked from one that has imported everything."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

_PARENT = """
import json, os, resource, sys
sys.path[:0] = ["tests", "scripts"]
from octarm.__main__ import command_line
from octarm.commands import cli
from octarm.commands.app import parse
import matplotlib.backends.backend_agg, matplotlib.backends.backend_svg
import octarm.recordings.recording
for words in json.loads(sys.argv[1]):
    parse(words)
exec(sys.argv[2])

def begin(words, folder, closed, full, free):
    os.chdir(folder)
    files = [os.devnull, "out", "err"]
    for number in range(3):
        handle = os.open("/dev/full" if number in full else files[number], os.O_RDWR | os.O_CREAT)
        os.dup2(handle, number)
        os.close(handle)
    for number in closed:
        os.close(number)
        setattr(sys, ("stdin", "stdout", "stderr")[number], None)
    if free is not None:
        cli.check_open_files = lambda: None
        limit = len(os.listdir("/dev/fd")) - 1 + free
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))
    sys.argv[1:] = words
    return command_line()

for line in sys.stdin:
    child = os.fork()
    if not child:
        code = 99
        try:
            code = begin(**json.loads(line))
            for stream in (sys.stdout, sys.stderr):
                stream.flush()
        except BaseException:
            sys.excepthook(*sys.exc_info())
        finally:
            os._exit(code)
    print(child, flush=True)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


class Forked:
    """Runs one command line after another, each in a process of its own."""

    def __init__(self, parent: subprocess.Popen[str]) -> None:
        self._parent = parent

    def start(
        self,
        words: Sequence[str],
        folder: Path,
        *,
        closed: Sequence[int] = (),
        full: Sequence[int] = (),
        free: int | None = None,
    ) -> int:
        """Starts a command; its output goes to the files `out` and `err`.

        Args:
            words: after `octarm`.
            folder: in which it runs.
            closed: standard streams that are closed.
            full: standard streams that take nothing.
            free: number of files that it may open.

        Returns:
            The number of the process.
        """
        how = {"words": words, "folder": str(folder), "closed": closed, "full": full, "free": free}
        for name in ("out", "err"):
            (folder / name).write_text("")
        assert self._parent.stdin is not None
        self._parent.stdin.write(json.dumps(how) + "\n")
        self._parent.stdin.flush()
        return self._number()

    def wait(self) -> int:
        """The exit code of the command, or the number of the signal that ended it, negative."""
        return self._number()

    def run(self, words: Sequence[str], folder: Path, **how: Any) -> int:
        """Runs a command; its exit code."""
        self.start(words, folder, **how)
        return self.wait()

    def _number(self) -> int:
        assert self._parent.stdout is not None
        return int(self._parent.stdout.readline())


@contextlib.contextmanager
def forked(*commands: Sequence[str], code: str = "") -> Generator[Forked]:
    """A process that forks; the modules of some commands are imported, and some code is run."""
    with subprocess.Popen(
        [sys.executable, "-c", _PARENT, json.dumps(commands), code],
        cwd=Path(__file__).parent.parent, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as parent:  # fmt: skip
        yield Forked(parent)
        parent.communicate()
