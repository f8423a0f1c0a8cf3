"""Worker processes: calls and answers, and why they cannot begin."""

import os
import subprocess
import sys
import time
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path

import pytest

from octarm.sweeps.workers import WorkerProcesses, WorkersError

ROOT = Path(__file__).parent.parent
SCRIPT = """
import octarm
from controllers import make_controller
from octarm.sweeps.spec_file import parse_spec
SPEC = '''
duration = 0.002
batch = 1
[grid]
controller = ["pd"]
mismatch = [-0.3, 0.3]
'''
def factory(*arguments, **options):
    return make_controller(*arguments, **options)
print("begun", flush=True)
"""
SWEEP = 'octarm.sweep(parse_spec(SPEC), {}, "out")\n'


class Odd(Exception):
    """An exception that pickle cannot make again."""

    def __init__(self, one: int, other: int) -> None:
        super().__init__("odd")


def fail(error: type[Exception], *arguments: object) -> None:
    raise error(*arguments)


def test_calls_are_answered_and_exceptions_handed_on():
    with WorkerProcesses(1) as processes:
        assert processes.submit(pow, 2, 10).result() == 1024
        first = processes.submit(os.getpid).result()
        with pytest.raises(FileNotFoundError, match="there"):
            processes.submit(fail, FileNotFoundError, 2, "there").result()
        for broken in ((Odd, 1, 2), (SystemExit, 3)):
            with pytest.raises(RuntimeError, match=broken[0].__name__):
                processes.submit(fail, *broken).result()
        assert processes.submit(os.getpid).result() == first != os.getpid()
        with pytest.raises(WorkersError, match="must be a function that they can import"):
            processes.submit(lambda: 1).result()


def test_one_that_dies_is_replaced_and_all_end_at_once():
    with WorkerProcesses(1) as processes:
        with pytest.raises(BrokenProcessPool):
            processes.submit(os._exit, 1).result()
        number = processes.submit(os.getpid).result()
        waiting = [processes.submit(time.sleep, 600.0) for _ in range(3)]
        processes.kill()
        for future in waiting:
            with pytest.raises(BrokenProcessPool):
                future.result()
    with pytest.raises(ProcessLookupError):
        os.kill(number, 0)


def script(folder: Path, end: str, *, text: bool = False) -> subprocess.CompletedProcess[str]:
    """Runs the script with an end, from a file or as the text of an option or standard input."""
    (folder / "script.py").write_text(SCRIPT + end)
    words = ["-c", SCRIPT + end] if text else ["script.py"]
    return subprocess.run(
        [sys.executable, *words], cwd=folder, capture_output=True, text=True, timeout=1800,
        check=False, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip


def check(done: subprocess.CompletedProcess[str], folder: Path, sentence: str) -> None:
    assert done.returncode == 1
    lines = done.stderr.splitlines()
    assert sentence in lines[-1]
    assert len(lines) <= 12 and done.stderr.count("Traceback") == 1
    assert done.stdout.splitlines() in (["begun"], ["begun"] * 2)  # here, and in one worker
    assert not (folder / "out").exists()


@pytest.mark.slow
@pytest.mark.parametrize("factory", ["make_controller", "factory"])
def test_a_script_that_sweeps_when_it_is_imported_is_told_so(factory, tmp_path):
    done = script(tmp_path, SWEEP.format(factory))
    check(done, tmp_path, 'must stand below `if __name__ == "__main__":`')
    assert "worker" in done.stderr.splitlines()[-1]


@pytest.mark.slow
def test_likewise_with_processes_of_its_own(tmp_path):
    end = (
        "from octarm.sweeps.workers import WorkerProcesses\n"
        "with WorkerProcesses(2) as pool:\n"
        "    octarm.sweep(parse_spec(SPEC), make_controller, 'out', executor=pool)\n"
    )
    check(script(tmp_path, end), tmp_path, 'must stand below `if __name__ == "__main__":`')


@pytest.mark.slow
def test_a_script_with_a_main_part_runs_with_a_factory_of_its_own(tmp_path):
    done = script(tmp_path, "if __name__ == '__main__':\n    " + SWEEP.format("factory"))
    assert (done.returncode, done.stderr) == (0, "")
    assert len(list((tmp_path / "out" / "episodes").iterdir())) == 2


@pytest.mark.slow
def test_standard_input_is_no_script_that_workers_can_import(tmp_path):
    for words in ([], ["-"]):
        done = subprocess.run(
            [sys.executable, *words], input=SCRIPT + SWEEP.format("make_controller"), text=True,
            cwd=tmp_path, capture_output=True, timeout=1800, check=False,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )  # fmt: skip
        check(done, tmp_path, "<stdin> is no file: save it as one")


@pytest.mark.slow
def test_a_program_without_a_file_sweeps_with_what_can_be_imported(tmp_path):
    done = script(tmp_path, SWEEP.format("factory"), text=True)
    check(done, tmp_path, "must be a function that they can import from a file")
    done = script(tmp_path, SWEEP.format("make_controller"), text=True)
    assert (done.returncode, done.stderr) == (0, "")
    done = script(tmp_path, SWEEP.format("lambda *a: make_controller(*a)").replace("out", "b"))
    check(done, tmp_path / "b", "must be a function that they can import from a file")
