"""Files that are whole or absent, one or several, on a disk that fills up at any place."""

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from octarm import files
from octarm.errors import FileError
from octarm.files import whole_file, write_files, write_text

NAMES = ["tables/a.csv", "tables/b.csv", "figures/c.png", "page.html"]


def everything(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def full_at(count: int, monkeypatch) -> None:
    """The disk has no room for so many files and one more, as the last moment finds out."""
    settle, seen = files._settle, []

    def refuse(part: Path) -> None:
        if len(seen) == count:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        seen.append(part)
        settle(part)

    monkeypatch.setattr(files, "_settle", refuse)


@pytest.mark.parametrize("earlier", [False, True])
@pytest.mark.parametrize("room", range(len(NAMES) + 1))
def test_a_set_of_files_is_whole_or_absent(room, earlier, tmp_path, monkeypatch):
    if earlier:
        write_files({tmp_path / "out" / name: b"before" for name in NAMES})
    (tmp_path / "mine").touch()
    before = everything(tmp_path)
    full_at(room, monkeypatch)
    contents = {tmp_path / "out" / name: name.encode() for name in NAMES}
    if room == len(NAMES):
        write_files(contents)
        assert all(path.read_bytes() == content for path, content in contents.items())
    else:
        with pytest.raises(FileError, match=rf"{NAMES[room]} cannot be written: No space left"):
            write_files(contents)
        assert everything(tmp_path) == before
        assert not earlier or all(path.read_bytes() == b"before" for path in contents)


@pytest.mark.parametrize("room", range(0, 9, 2))
def test_the_figures_of_a_run_are_whole_or_absent(room, tmp_path, monkeypatch):
    from octarm.commands import cli

    monkeypatch.chdir(tmp_path)
    assert cli.main(["run", "--duration", "0.01", "--out", "a"]) == 0
    full_at(room, monkeypatch)
    assert cli.main(["plot", "a", "--out", "x/y"]) == (0 if room == 8 else 2)
    assert len(everything(tmp_path)) == 4 + (10 if room == 8 else 0)


def test_a_folder_in_the_place_of_a_file_stops_the_set(tmp_path):
    (tmp_path / "b").mkdir()
    with pytest.raises(FileError, match="b cannot be written: Is a directory"):
        write_files({tmp_path / "a": b"", tmp_path / "b": b""})
    assert everything(tmp_path) == {"b"}


def test_links_of_a_set_keep_their_places(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "link").symlink_to("elsewhere/real")
    write_files({tmp_path / "link": b"1", tmp_path / "plain": b"2"})
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "elsewhere" / "real").read_bytes() == b"1"


def test_what_a_killed_process_left_is_used_again(tmp_path):
    left = tmp_path / ".a.new.part"
    left.write_text("half of what was")
    write_text(tmp_path / "a", "new")
    assert everything(tmp_path) == {"a"} and (tmp_path / "a").read_text() == "new"
    left.write_text("half of what was")
    write_files({tmp_path / "a": b"once more"})
    assert everything(tmp_path) == {"a"} and (tmp_path / "a").read_text() == "once more"


def test_two_that_write_the_same_file_do_not_share_a_part(tmp_path):
    with whole_file(tmp_path / "a") as one, whole_file(tmp_path / "a") as other:
        assert one != other
        one.write_text("one")
        other.write_text("other")
        write_files({tmp_path / "a": b"a third", tmp_path / "b": b""})
        assert (tmp_path / "a").read_text() == "a third"
    assert (tmp_path / "a").read_text() == "one"  # it ended last
    assert everything(tmp_path) == {"a", "b"}


def test_a_mapped_run_keeps_one_file_open(tmp_path):
    from octarm.commands import cli
    from octarm.simulation.trajectory import Trajectory

    assert cli.main(["run", "--duration", "0.01", "--out", str(tmp_path / "a")]) == 0
    before = len(os.listdir("/dev/fd"))
    run = Trajectory.load(tmp_path / "a" / "run.npz", mapped=True)
    assert len(os.listdir("/dev/fd")) <= before + 1
    assert not run.q.flags.writeable
    with np.load(tmp_path / "a" / "run.npz") as arrays:
        assert all(np.array_equal(arrays[name], x) for name, x in run.arrays())
