"""The place of a run: claimed by one, replaced whole, and nothing of anybody else is touched."""

import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from octarm.errors import FileError, OctarmError
from octarm.files import write_text
from octarm.runs import place
from octarm.runs.place import new_folder

posix = pytest.mark.skipif(os.name != "posix", reason="locks and signals as on POSIX")


def write(folder: Path, text: str = "{}") -> None:
    with new_folder(folder) as here:
        (here / "run.json").write_text(text)
        (here / "run.npz").write_bytes(b"arrays")


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_a_failed_run_removes_what_it_made_and_nothing_else(tmp_path):
    with pytest.raises(ZeroDivisionError), new_folder(tmp_path / "runs" / "a") as here:
        (here / "run.json").touch()
        write(tmp_path / "runs" / "b")  # another run, under the parent that this one made
        (tmp_path / "runs" / "notes.txt").touch()
        raise ZeroDivisionError
    assert names(tmp_path / "runs") == {"b", "notes.txt"}
    assert names(tmp_path / "runs" / "b") == {"run.json", "run.npz"}


def test_a_failed_run_leaves_no_empty_parents_and_no_foreign_file_goes(tmp_path):
    for foreign in (False, True):
        with pytest.raises(ZeroDivisionError), new_folder(tmp_path / "x" / "y" / "a") as here:
            (here / "run.rrd.part").touch()
            if foreign:
                (here / "mine.txt").touch()
            raise ZeroDivisionError
        left = names(tmp_path / "x" / "y" / "a") if foreign else names(tmp_path)
        assert "mine.txt" in left if foreign else not left


@posix
def test_a_place_is_claimed_by_one_run(tmp_path):
    with new_folder(tmp_path / "a") as here:
        with pytest.raises(OctarmError, match="another run is being written to"):
            write(tmp_path / "a")
        (here / "run.json").write_text("first")
    with new_folder(tmp_path / "a") as here:  # and while it is being replaced
        with pytest.raises(OctarmError, match="another run is being written to"):
            write(tmp_path / "a")
        (here / "run.json").write_text("second")
    assert (tmp_path / "a" / "run.json").read_text() == "second"
    assert names(tmp_path) == {"a"}


@posix
def test_a_file_system_without_locks_does(tmp_path, monkeypatch):
    def flock(handle: int, operation: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("fcntl.flock", flock)
    write(tmp_path / "a")
    write(tmp_path / "a", "again")
    assert (tmp_path / "a" / "run.json").read_text() == "again"


def test_an_earlier_run_stays_until_the_new_one_is_whole(tmp_path):
    write(tmp_path / "a", "before")
    with pytest.raises(KeyboardInterrupt, match="nothing was written"), new_folder(tmp_path / "a"):
        assert (tmp_path / "a" / "run.json").read_text() == "before"
        raise KeyboardInterrupt
    assert (tmp_path / "a" / "run.json").read_text() == "before"
    assert names(tmp_path) == {"a"}


def test_without_an_exchange_in_one_step_the_next_call_brings_the_earlier_run_back(
    tmp_path, monkeypatch
):
    write(tmp_path / "a", "before")
    (tmp_path / "a").rename(tmp_path / ".a.old")  # what a kill between two renames leaves
    (tmp_path / ".a.part").mkdir()
    with pytest.raises(ZeroDivisionError), new_folder(tmp_path / "a"):
        raise ZeroDivisionError
    assert (tmp_path / "a" / "run.json").read_text() == "before"
    assert names(tmp_path) == {"a"}
    monkeypatch.setattr(place, "_exchanged", lambda one, other: False)
    write(tmp_path / "a", "after")
    assert (tmp_path / "a" / "run.json").read_text() == "after"
    assert names(tmp_path) == {"a"}


def test_the_current_folder_is_filled_but_not_replaced(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(Path())
    assert names(tmp_path) == {"run.json", "run.npz"}
    with pytest.raises(OctarmError, match="is the current folder"):
        write(Path())
    assert names(Path()) == {"run.json", "run.npz"}


@pytest.mark.parametrize("name", ["a.txt", "a.txt/b"])
def test_what_is_no_run_is_left_alone(name, tmp_path):
    (tmp_path / "a.txt").write_text("mine")
    with pytest.raises(OctarmError, match=r"not an earlier run|cannot be written"):
        write(tmp_path / name)
    assert (tmp_path / "a.txt").read_text() == "mine"
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "mine").touch()
    with pytest.raises(OctarmError, match="not an earlier run"):
        write(tmp_path / "b")
    assert names(tmp_path / "b") == {"mine"}


@posix
@pytest.mark.slow
def test_a_run_over_an_earlier_one_is_killed_at_any_instant(tmp_path):
    code = (
        "import sys; from pathlib import Path; from octarm.runs.place import new_folder\n"
        "folder = Path(sys.argv[1])\n"
        "print('begun', flush=True)\n"
        "for i in range(10**9):\n"
        "    with new_folder(folder) as here:\n"
        "        for name in ('run.json', 'run.npz'): (here / name).write_text(str(i))\n"
    )
    folder = tmp_path / "a"
    write(folder, "0")
    (folder / "run.npz").write_text("0")
    for kill in range(20):
        process = subprocess.Popen(
            [sys.executable, "-c", code, str(folder)], stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None and process.stdout.readline() == "begun\n"
        time.sleep(0.01 + 0.003 * kill)
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        texts = {(folder / name).read_text() for name in ("run.json", "run.npz")}
        assert len(texts) == 1, "a run is whole, or it is the earlier one"
    with new_folder(folder) as here:
        (here / "run.json").touch()
    assert names(tmp_path) == {"a"}


def test_a_text_goes_through_links_and_devices(tmp_path):
    (tmp_path / "real").write_text("old")
    (tmp_path / "link").symlink_to("real")
    write_text(tmp_path / "link", "new")
    assert (tmp_path / "link").is_symlink() and (tmp_path / "real").read_text() == "new"
    write_text("/dev/null", "nothing")
    assert not Path("/dev/null").is_file()
    assert names(tmp_path) == {"real", "link"}
    with pytest.raises(FileError, match="Is a directory"):
        write_text(tmp_path, "text")


def test_a_new_file_has_the_permissions_of_a_new_file(tmp_path):
    (tmp_path / "plain").touch()
    write_text(tmp_path / "whole", "text")
    assert (tmp_path / "whole").stat().st_mode == (tmp_path / "plain").stat().st_mode
