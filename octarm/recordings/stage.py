"""What a film shows at an instant: the shapes of the recording as MuJoCo's solids, and captions."""
# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from octarm.arm.parameters import ArmParameters
from octarm.palette import BRIGHT_MODULES
from octarm.recordings import shapes
from octarm.recordings.channels import disturbances_of
from octarm.recordings.titles import events_of, title_of, wrapped
from octarm.simulation.trajectory import Trajectory

_XML = """
<mujoco>
  <visual>
    <global offwidth="{0}" offheight="{1}" fovy="32"/>
    <quality offsamples="4" numslices="24" numstacks="6"/>
    <headlight ambient=".35 .35 .35" diffuse=".32 .32 .32" specular=".1 .1 .1"/>
  </visual>
  <asset>
    <texture type="skybox" builtin="gradient" rgb1=".10 .115 .14" rgb2=".03 .035 .045" width="64"
      height="64"/>
  </asset>
  <worldbody>
    <light pos="1 -3 2" dir="-.3 .9 -.6" diffuse=".3 .3 .3" castshadow="false"/>
  </worldbody>
</mujoco>
"""
_PIECES = 8  # of a tube or column, for each module
_TRAIL = 24  # pieces of the trail
_SECONDS = 1.0  # that the trail goes back
_PLATE, _BASE, _GHOST = (0.87, 0.89, 0.91, 1.0), (0.47, 0.5, 0.55, 1.0), (0.78, 0.86, 1.0, 0.22)
_TIP, _PAYLOAD, _FORCE = (1.0, 0.27, 0.33, 1.0), (0.88, 0.54, 0.24, 1.0), (0.77, 0.55, 1.0, 1.0)
_SMALLEST = 0.02  # of the longest arrow; a smaller one is not drawn


class Stage:
    """The arm of one run, its desired arm as a ghost, and what acts on it.

    Attributes:
        camera: MuJoCo's, which sees all of what is drawn.
    """

    def __init__(self, run: Trajectory, rows: np.ndarray, description: Mapping[str, Any]) -> None:
        """The stage of a run of one arm, of which these rows will be drawn."""
        p = ArmParameters.from_dict(description["parameters"])
        self._run, self._width, self._modules = run, float(np.median(p.width)), p.modules
        self._length = float(np.sum(p.rest_length))
        self._weight = float(np.sum(p.mass) * p.gravity)
        loads = (each.carried() for each in disturbances_of(description).values())
        self._solids: Any = ()
        self._payloads = [load for load in loads if load is not None]
        self._plant = run.signals.get("plant_q") if description.get("plant") else None
        self._beside = 0.0 if self._plant is None else 1.1 * self._length
        reach = 1.12 * self._length + self._width
        few = rows[:: max(1, len(rows) // 200)]
        tips = shapes.skeleton(run.q[few])[..., ::2].reshape(-1, 2)
        farthest = 1.6 * self._length
        tips = np.clip(tips, -farthest, farthest)
        low = np.minimum([-0.4 * reach, 0.3 * self._width - reach], tips.min(axis=0, initial=0.0))
        high = np.maximum([0.4 * reach, 0.5 * self._width], tips.max(axis=0, initial=0.0))
        low[0] -= self._beside
        self.camera = mujoco.MjvCamera()
        above = 0.05 * (high[1] - low[1])  # room for the title
        self.camera.lookat[:] = 0.5 * (low[0] + high[0]), 0.0, 0.5 * (low[1] + high[1]) + above
        self.camera.azimuth, self.camera.elevation = 104.0, -4.0
        self.camera.distance = 1.9 * float(np.max((high - low) / [1.25, 1.0]))

    @staticmethod
    def model(size: tuple[int, int]) -> mujoco.MjModel:
        """Light and ground for pictures of this width and height [pixel], without an arm."""
        return mujoco.MjModel.from_xml_string(_XML.format(*size))

    def fill(self, scene: mujoco.MjvScene, row: int) -> None:
        """Puts the solids of a row into a scene."""
        self._solids = scene.geoms  # whose list takes time to make
        run, side = self._run, np.array([-self._beside, 0.0, 0.0])
        q, tau = run.q[row], run.tau[row]
        self._arm(scene, q, np.zeros(3), tau)
        ribs = shapes.smooth_arm(run.q_d[row], points=_PIECES + 1)
        for line in ribs:
            self._tube(scene, line, 0.4 * self._width, _GHOST)
        true = q if self._plant is None else self._plant[row]
        if self._plant is not None:
            self._arm(scene, true, side, np.repeat(tau.reshape(self._modules, 2),
                      len(true) // len(q), axis=0).ravel())  # fmt: skip
        since = int(np.searchsorted(run.t, float(run.t[row]) - _SECONDS))
        trail = run.q if self._plant is None else self._plant
        tips = shapes.tip(trail[np.round(np.linspace(since, row, _TRAIL)).astype(np.int64)]) + side
        self._tube(scene, tips, 0.035 * self._width, _TIP)
        balls = shapes.payload_balls(self._payloads, run.t[[row]], true[None], self._width)
        for centers, (size,) in balls:
            if size:
                self._add(scene, "SPHERE", [size] * 3, centers[0] + side, _PAYLOAD)
        if np.any(force := run.disturbance[row]):
            self._arrows(scene, q, force)
        self._solids = ()  # they are the renderer's, and may not outlive it

    def _arm(self, scene: mujoco.MjvScene, q: np.ndarray, at: np.ndarray, tau: np.ndarray) -> None:
        """Base, tubes, columns and plates; the plates of a group of modules are at its end."""
        w, n = self._width, len(q) // 2
        group, base = n // self._modules, np.array([0.0, 0.0, 0.075 * w])
        self._add(scene, "CYLINDER", [0.75 * w, 0.075 * w, 0.0], at + base, _BASE)
        points = max(2, _PIECES // group) + 1
        for i, line in enumerate(shapes.smooth_arm(q, points=points)):
            color = BRIGHT_MODULES[i // group % len(BRIGHT_MODULES)]
            rgba = [int(color[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
            self._tube(scene, line + at, 0.27 * w, [*rgba, 1.0])
        colors, sizes = shapes.column_looks(tau, self._weight)
        for a, side in enumerate((-0.5, 0.5)):
            for i, line in enumerate(shapes.smooth_arm(q, side * w, points)):
                rgba = [*(colors[2 * i + a] / 255.0), 1.0]
                self._tube(scene, line + at, w * float(sizes[2 * i + a]), rgba)
        plates = shapes.plates(q)
        for center, angle in list(zip(plates.centers, plates.angles, strict=True))[
            group - 1 :: group
        ]:
            cos, sin = math.cos(angle), math.sin(angle)
            turn = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
            self._add(scene, "CYLINDER", [0.7 * w, 0.035 * w, 0.0], center + at, _PLATE, turn)

    def _arrows(self, scene: mujoco.MjvScene, q: np.ndarray, force: np.ndarray) -> None:
        """The forces of disturbances, on the scale on which the arm's weight is two widths."""
        starts, forces = shapes.force_arrows(q, force, 0.95 * self._width)
        ways = forces * (2.0 * self._width / self._weight)
        sizes = np.linalg.norm(ways, axis=-1)
        for start, way, size in zip(starts, ways, sizes, strict=True):
            if size > max(_SMALLEST * sizes.max(), 1e-3 * self._length):
                geom = self._next(scene)
                if geom is not None:
                    kind, width = mujoco.mjtGeom.mjGEOM_ARROW, 0.05 * self._width
                    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(),
                                        np.array(_FORCE, dtype=np.float32))  # fmt: skip
                    mujoco.mjv_connector(geom, kind, width, start, start + way)

    def _tube(self, scene: mujoco.MjvScene, line: np.ndarray, radius: float, rgba: Any) -> None:
        """A round tube along points of shape (k, 3), whose pieces overlap a little."""
        for start, end in itertools.pairwise(line):
            geom = self._next(scene) if np.linalg.norm(end - start) > 1e-9 else None
            if geom is None:
                continue
            kind, more = mujoco.mjtGeom.mjGEOM_CYLINDER, 0.04 * (end - start)
            mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(),
                                np.array(rgba, dtype=np.float32))  # fmt: skip
            mujoco.mjv_connector(geom, kind, radius, start - more, end + more)

    def _add(
        self, scene: mujoco.MjvScene, kind: str, size: Any, at: Any, rgba: Any, turn: Any = None
    ) -> None:
        geom = self._next(scene)
        if geom is not None:
            turn = np.eye(3) if turn is None else turn
            mujoco.mjv_initGeom(geom, getattr(mujoco.mjtGeom, f"mjGEOM_{kind}"), np.array(size),
                                np.array(at, dtype=float), np.ravel(turn),
                                np.array(rgba, dtype=np.float32))  # fmt: skip

    def _next(self, scene: mujoco.MjvScene) -> Any:
        """The next solid of a scene; None if it is full."""
        if scene.ngeom >= scene.maxgeom:
            return None
        scene.ngeom += 1
        return self._solids[scene.ngeom - 1]


class Captions:
    """The words of a film: what is run above, what acts and the time below."""

    def __init__(
        self, run: Trajectory, description: Mapping[str, Any], size: tuple[int, int]
    ) -> None:
        """The words of a run, for pictures of this width and height [pixel]."""
        self._run, self._size = run, size
        self._letter = max(8, round(size[1] / 34))
        fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
        self._font = ImageFont.truetype(str(fonts / "DejaVuSans.ttf"), self._letter)
        letters = max(12, int(size[0] / (0.55 * self._letter)))
        self._title = wrapped(title_of(description), letters)
        self._events = events_of(description)
        self._plant = description.get("plant")

    def on(self, picture: np.ndarray, row: int) -> np.ndarray:
        """A picture with the words of a row, shape (height, width, 3)."""
        image, (width, height), pad = Image.fromarray(picture), self._size, self._letter // 2
        draw, t = ImageDraw.Draw(image), float(self._run.t[row])
        draw.multiline_text((pad, pad), self._title, fill=(236, 240, 245), font=self._font)
        draw.text((width - pad, height - pad), f"t = {t:.2f} s", fill=(236, 240, 245),
                  font=self._font, anchor="rs")  # fmt: skip
        now: dict[str, str] = {}
        for at, name, text in self._events:
            if at <= t:
                now[name] = text
        words = [(text, (224, 138, 60)) for text in now.values() if text]
        if row == len(self._run) - 1 and self._run.status != "ok":
            words.append((self._run.status, (255, 90, 95)))
        words.append(("pale: desired", (170, 188, 214)))
        if self._plant:
            true = f"left: the true arm, of {self._plant['modules']} modules"
            words.append((f"{true}; right: what is measured of it", (170, 188, 214)))
        for k, (text, color) in enumerate(reversed(words)):
            place = (pad, height - pad - round(1.3 * k * self._letter))
            draw.text(place, text, fill=color, font=self._font, anchor="ls")
        return np.asarray(image)
