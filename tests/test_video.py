"""Films of a run; what draws is a process of its own, for MuJoCo chooses its renderer once."""

import dataclasses
import os
import subprocess
import sys
from pathlib import Path

import av
import mujoco
import numpy as np
import pytest
from recordings import described, swinging, write_run

from octarm.arm.mjcf import nominal_parameters
from octarm.recordings import shapes
from octarm.recordings.stage import Stage
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


@pytest.mark.slow
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


def solids(run, row, **more):
    """Places, sizes and colours of what the film shows of a row, without drawing it."""
    about = described(parameters=nominal_parameters().to_dict(), **more)
    stage = Stage(run, np.arange(len(run)), about)
    scene = mujoco.MjvScene(Stage.model((160, 120)), 4000)
    stage.fill(scene, row)
    found = [(g.pos.copy(), g.size.copy(), g.rgba.copy()) for g in scene.geoms[: scene.ngeom]]
    return [np.array(column) for column in zip(*found, strict=True)]


def test_columns_of_a_film_meet_their_plates():
    run = swinging(rows=500, rate=500.0)
    places, sizes, colors = solids(run, 300)
    plates = shapes.plates(run.q[300])
    width = float(np.median(nominal_parameters().width))
    for side in (-0.5, 0.5):
        ends = shapes.smooth_arm(run.q[300], side * width, 9)
        np.testing.assert_allclose(
            np.linalg.norm(ends[:, -1] - plates.centers, axis=-1), 0.5 * width, rtol=1e-9
        )
        middles = 0.5 * (ends[:, -2] + ends[:, -1])  # of the last pieces, which reach the plates
        for middle in middles:
            assert np.linalg.norm(places - middle, axis=-1).min() < 1e-6
    assert np.any(colors[:, 3] < 1.0)  # the ghost
    assert np.isfinite(places).all() and np.all(sizes > 0.0)


def test_a_finer_plant_stands_beside_the_arm_that_is_measured():
    run = swinging(rows=500, rate=500.0)
    finer = np.repeat(run.q, 2, axis=1) / 2.0
    run = dataclasses.replace(run, signals={"plant_q": finer})
    plain = solids(run, 300)[0][:, 0]
    both = solids(run, 300, plant={"modules": 6, "layout": "centred"})[0][:, 0]
    length = float(np.sum(nominal_parameters().rest_length))
    assert plain.min() > -0.9 * length
    assert both.min() < -0.9 * length


@pytest.mark.slow
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
