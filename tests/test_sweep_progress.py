"""One sees how far a sweep is, also while its shards are at work."""

import io
import re
import sys
import threading
import time
from concurrent.futures import Executor, Future

import pyarrow as pa
import pytest
from test_sweep import SPEC, run

from controllers import make_controller
from octarm.sweeps import progress
from octarm.sweeps.progress import Note, ProgressBar, notes_in
from octarm.sweeps.shards import run_shard
from octarm.sweeps.spec_file import parse_spec


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> pa.Table:
    return run(tmp_path_factory.mktemp("undisturbed") / "sweep")


def test_a_shard_notes_how_far_it_is(tmp_path, monkeypatch, undisturbed):
    spec, shares = parse_spec(SPEC), []
    monkeypatch.setattr(progress, "_EVERY", 0.0)
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "1").write_text("0.9")  # of a process that was killed
    with notes_in(tmp_path / "notes") as notes:
        note, other = (Note(notes / name, spec.duration) for name in ("1", "0"))
        assert note.share() == 0.0
        table = run_shard(spec, 1, make_controller, note, lambda _: shares.append(note.share()))
        assert note.share() == pytest.approx(1.0, abs=0.05)
        assert other.share() == 0.0
        other.file.write_text("nan?")  # half of a note
        assert other.share() == 0.0
    assert not (tmp_path / "notes").exists()
    assert shares == sorted(shares) and len(set(shares)) == 40  # of every control period
    assert undisturbed.slice(4, 4).equals(
        table.drop_columns("wall_time").replace_schema_metadata(None)
    )
    short = parse_spec('controller = "pd"\nduration = 0.001')
    run_shard(short, 0, make_controller, Note(tmp_path / "not there" / "0", 0.001))


def test_parts_of_shards_are_reported_while_they_are_at_work(tmp_path, undisturbed):
    class Slow(Executor):
        """Says after a moment that half of the shard is done, and then runs it."""

        def submit(self, fn, /, *args, **kwargs):
            def late() -> None:
                args[-1].file.write_text("0.5")
                time.sleep(1.5 if args[1] == 0 else 0.0)
                future.set_result(fn(*args, **kwargs))

            future = Future()
            threading.Thread(target=late).start()
            return future

    parts = []
    assert run(tmp_path / "s", executor=Slow(), progress=parts.append).equals(undisturbed)
    assert parts[:2] == [0.0, 2.0]  # of four episodes
    assert parts == sorted(parts) and parts[-1] == len(undisturbed)
    assert not (tmp_path / "s" / ".progress").exists()


class Terminal(io.StringIO):
    """What a program takes for one."""

    def isatty(self) -> bool:
        return True


def test_the_bar_moves_with_the_parts_of_shards(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    bar = ProgressBar(parse_spec('controller = "pd"\nepisodes = 40\nduration = 10.0'))
    bar.update(10)  # were there already
    bar.update(15.9)
    assert "15/40" in terminal.getvalue()
    time.sleep(0.01)
    bar.update(18)
    shown = terminal.getvalue().rpartition("\r")[2]
    assert "18/40" in shown and " 45%" in shown
    speed = re.search(r"<00:0\d, ([\d.]+) episodes/s, ([\d.]+) simulated s/s", shown)
    assert speed is not None
    assert float(speed[2]) == pytest.approx(10.0 * float(speed[1]), rel=0.2)
    bar.update(40)
    assert "40/40" in terminal.getvalue()
