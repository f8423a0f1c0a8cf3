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
from octarm.interfaces import Controller
from octarm.sweeps import under_way
from octarm.sweeps.bar import ProgressBar
from octarm.sweeps.parser import parse_spec
from octarm.sweeps.under_way import Notes, Watched, run_noted_shard


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> pa.Table:
    return run(tmp_path_factory.mktemp("undisturbed") / "sweep")


def test_who_runs_a_shard_notes_how_far_it_is(tmp_path, monkeypatch, undisturbed):
    spec, seen = parse_spec(SPEC), []
    monkeypatch.setattr(under_way, "_EVERY", 0.0)
    with Notes(tmp_path / "notes") as notes:

        def factory(*given) -> Controller:
            return Watched(make_controller(*given), lambda _: seen.append(notes.share(1)))

        table = run_noted_shard(spec, 1, factory, notes.file(1))
        assert notes.share(1) == pytest.approx(1.0, abs=0.05)
        assert notes.share(0) == 0.0
        notes.file(0).write_text("nan?")  # half of a note
        assert notes.share(0) == 0.0
        notes.forget(1)
        assert notes.share(1) == 0.0
    assert not (tmp_path / "notes").exists()
    assert seen == sorted(seen) and len(set(seen)) == 40  # of every control period
    assert undisturbed.slice(4, 4).equals(
        table.drop_columns("wall_time").replace_schema_metadata(None)
    )
    run_noted_shard(parse_spec('controller = "pd"\nduration = 0.001'), 0, make_controller,
                    tmp_path / "not there" / "0")  # fmt: skip


def test_parts_of_shards_are_reported_while_they_are_at_work(tmp_path, undisturbed):
    class Slow(Executor):
        """Says after a moment that half of the shard is done, and then runs it."""

        def submit(self, fn, /, *args, **kwargs):
            def late() -> None:
                args[-1].write_text("0.5")
                time.sleep(1.5 if args[1] == 0 else 0.0)
                future.set_result(fn(*args, **kwargs))

            future = Future()
            threading.Thread(target=late).start()
            return future

    parts = []
    assert run(tmp_path / "s", executor=Slow(), under_way=parts.append).equals(undisturbed)
    assert parts[0] == 2.0  # of four episodes
    assert parts[-1] == 0.0
    assert not (tmp_path / "s" / ".under-way").exists()


class Terminal(io.StringIO):
    """What a program takes for one."""

    def isatty(self) -> bool:
        return True


def test_the_bar_moves_with_the_parts_of_shards(monkeypatch):
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    bar = ProgressBar(parse_spec('controller = "pd"\nepisodes = 40\nduration = 10.0'))
    bar.update(10)  # were there already
    bar.go_on(5.9)
    assert "15/40" in terminal.getvalue()
    time.sleep(0.01)
    bar.update(8)
    shown = terminal.getvalue().rpartition("\r")[2]
    assert "18/40" in shown and " 45%" in shown
    speed = re.search(r"<00:0\d, ([\d.]+) episodes/s, ([\d.]+) simulated s/s", shown)
    assert speed is not None
    assert float(speed[2]) == pytest.approx(10.0 * float(speed[1]), rel=0.2)
    bar.update(22)
    assert "40/40" in terminal.getvalue()
