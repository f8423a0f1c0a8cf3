"""A folder that has a package or module `controllers` of its own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

LAW = "import this_is_nowhere\n"
OWN = {
    "package": "controllers/__init__.py",
    "module": "controllers.py",
    "namespace": "controllers/x",
}
ASKED = ["-m", "octarm", "run", "--controller", "SMC"]


@pytest.fixture(params=OWN)
def own(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """What the working folder holds, by its kind."""
    file = tmp_path / OWN[request.param]
    file.parent.mkdir(exist_ok=True)
    file.write_text(LAW)
    return request.param


def python(folder: Path, *words: str, **environment: str) -> tuple[int, str]:
    """The exit code and the errors of Python in a folder."""
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, capture_output=True, text=True, check=False,
        env={**os.environ, **environment},
    )  # fmt: skip
    return done.returncode, done.stderr


def test_octarm_works_beside_it(own: str, tmp_path: Path):
    code, error = python(tmp_path, *ASKED)
    assert (code, error.partition("?")[0]) == (
        2, "octarm: unknown controller 'SMC', did you mean 'smc'",
    )  # fmt: skip


def test_what_python_would_find_first_is_named(own: str, tmp_path: Path):
    code, error = python(tmp_path, *ASKED, PYTHONPATH=str(tmp_path))
    assert code == 2 and len(error.splitlines()) == 1
    if own == "namespace":  # which goes after every package
        assert "did you mean 'smc'" in error
        return
    place = tmp_path / OWN[own].removesuffix("/__init__.py")
    assert error.startswith(f"octarm: {place} would be imported in place of octarm's own package")


def test_a_module_of_a_folder_that_is_not_found_first_is_given_as_a_file(tmp_path: Path):
    (tmp_path / "controllers").mkdir()
    (tmp_path / "controllers" / "mine.py").write_text(LAW)
    code, error = python(tmp_path, *ASKED[:-1], "controllers.mine:Law")
    assert code == 2 and "give ./controllers/mine.py:NAME" in error
