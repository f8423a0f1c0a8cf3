"""Films of a run; each test is a process of its own, for MuJoCo chooses its renderer once."""

import os
import subprocess
import sys
from pathlib import Path

import av
import numpy as np
import pytest
from recordings import described, swinging, write_run

from octarm.arm.mjcf import nominal_parameters
from octarm.recordings.video import write_video

linux = pytest.mark.skipif(sys.platform != "linux", reason="EGL and OSMesa as on Linux")


@pytest.fixture
def run(tmp_path):
    folder = tmp_path / "a"
    folder.mkdir()
    about = described(parameters=nominal_parameters().to_dict())
    write_run(folder, swinging(rows=500, rate=500.0), about)
    return folder


def film(run, *options, **environment):
    command = [sys.executable, "-m", "octarm", "video", str(run), *options]
    kept = {k: v for k, v in os.environ.items() if k != "MUJOCO_GL"}
    return subprocess.run(
        command, env={**kept, **environment}, capture_output=True, text=True, check=False
    )


@linux
def test_a_film_shows_the_arm_moving(run, tmp_path):
    target = tmp_path / "run.mp4"
    options = ["--width", "160", "--height", "120", "--rate", "10"]
    done = film(run, "--out", str(target), *options)
    if done.returncode and "OpenGL" in done.stderr and not os.environ.get("CI"):
        pytest.skip(done.stderr)
    assert (done.returncode, done.stdout) == (0, f"wrote {target}\n")
    with av.open(str(target)) as container:
        stream = container.streams.video[0]
        assert (stream.width, stream.height, stream.average_rate) == (160, 120, 10)
        pictures = [
            frame.to_ndarray(format="rgb24").astype(int) for frame in container.decode(stream)
        ]
    assert len(pictures) == 11
    assert np.abs(pictures[5] - pictures[0]).max() > 60


@linux
def test_without_opengl_it_is_one_sentence(run, tmp_path):
    done = film(run, "--out", str(tmp_path / "x.mp4"), MUJOCO_GL="glfw", DISPLAY="")
    assert done.returncode == 2
    assert "libegl1 and libosmesa6" in done.stderr.splitlines()[-1]
    assert not (tmp_path / "x.mp4").exists()


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("run.avi", {}, "must end in .mp4"),
        ("run.mp4", {"size": (161, 120)}, "both must be even"),
        ("run.mp4", {"rate": 0.0}, "rate is 0"),
        ("run.mp4", {"speed": -1.0}, "speed -1"),
    ],
)
def test_what_cannot_be_filmed_is_refused(tmp_path, name, options, message):
    with pytest.raises(ValueError, match=message):
        write_video(tmp_path / name, swinging(rows=10), described(), **options)
    assert list(Path(tmp_path).iterdir()) == []
