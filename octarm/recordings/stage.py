"""What a film shows at an instant: the shapes of the recording as MuJoCo's solids, and captions."""
# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from octarm.arm.parameters import ArmParameters
from octarm.recordings import shapes
from octarm.recordings.channels import disturbances_of
from octarm.recordings.words import events_of, title_of, wrapped
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
_TRAIL = 24  # points of the trail
_SECONDS = 1.0  # that the trail goes back
_PLATE, _BASE, _GHOST = (222, 227, 232, 255), (120, 128, 140, 255), (199, 219, 255, 56)
_TIP, _PAYLOAD, _FORCE = (255, 69, 84, 255), (224, 138, 61, 255), (196, 140, 255, 255)
_SMALLEST = 0.02  # of the longest arrow; a smaller one is not drawn


class Stage:
    """The arm of one run, its desired arm as a ghost, and what acts on it.

    Attributes:
        camera: MuJoCo's, which sees all of what is drawn in these rows.
    """

    def __init__(self, run: Trajectory, rows: np.ndarray, description: Mapping[str, Any]) -> None:
        p = ArmParameters.from_dict(description["parameters"])
        self._run, self._width, self._modules = run, float(np.median(p.width)), p.modules
        self._length = float(np.sum(p.rest_length))
        self._weight = float(np.sum(p.mass) * p.gravity)
        loads = (each.load for each in disturbances_of(description))
        self._payloads = [load for load in loads if load is not None]
        self._plant = run.signals.get("plant_q") if description.get("plant") else None
        offset = 0.0 if self._plant is None else 1.1 * self._length
        self._side = np.array([-offset, 0.0, 0.0])  # where a plant of more modules stands
        self._solids: Any = ()
        reach = 1.12 * self._length + self._width
        few = rows[:: max(1, len(rows) // 200)]
        tips = shapes.skeleton(run.q[few])[..., ::2].reshape(-1, 2)
        tips = np.clip(tips, -1.6 * self._length, 1.6 * self._length)
        low = np.minimum([-0.4 * reach, 0.3 * self._width - reach], tips.min(axis=0, initial=0.0))
        high = np.maximum([0.4 * reach, 0.5 * self._width], tips.max(axis=0, initial=0.0))
        low[0] -= offset
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
        run, w, path = self._run, self._width, self._run.q
        q, tau = run.q[row], run.tau[row]
        self._arm(scene, q, tau, np.zeros(3))
        self._cylinders(scene, shapes.backbone(run.q_d[row], _PIECES), 0.4 * w, _GHOST)
        if self._plant is not None:
            path, pairs = self._plant, tau.reshape(self._modules, 2)
            each = np.repeat(pairs, path.shape[1] // len(q), axis=0).ravel()
            self._arm(scene, path[row], each, self._side)
        since = int(np.searchsorted(run.t, float(run.t[row]) - _SECONDS))
        few = np.round(np.linspace(since, row, _TRAIL)).astype(np.int64)
        trail = shapes.pieces_of(shapes.tip(path[few]) + self._side)
        self._cylinders(scene, trail, 0.035 * w, _TIP)
        balls = shapes.payload_balls(self._payloads, run.t[[row]], path[[row]], w)
        for place, size in zip(*(x[0] for x in balls), strict=True):
            if size:
                self._add(scene, "SPHERE", [size] * 3, place + self._side, _PAYLOAD)
        if np.any(force := run.disturbance[row]):
            self._arrows(scene, q, force)
        self._solids = ()  # they are the renderer's, and may not outlive it

    def _arm(self, scene: mujoco.MjvScene, q: np.ndarray, tau: np.ndarray, at: np.ndarray) -> None:
        """Base, tubes, columns and plates; the plates of a group of modules are at its end."""
        w, n = self._width, len(q) // 2
        group, base = n // self._modules, np.array([0.0, 0.0, 0.075 * w])
        pieces = max(2, _PIECES // group)
        self._add(scene, "CYLINDER", [0.75 * w, 0.075 * w, 0.0], at + base, _BASE)
        colors = np.repeat(shapes.module_colors(self._modules), group * pieces, axis=0)
        self._cylinders(scene, shapes.backbone(q, pieces), 0.27 * w, colors, at)
        colors, radii = (np.repeat(x, pieces, 0) for x in shapes.column_looks(tau, self._weight))
        self._cylinders(scene, shapes.columns(q, w, pieces), w * radii, colors, at)
        plates = shapes.Pieces(*(x[group - 1 :: group] for x in shapes.plates(q)))
        plates = plates._replace(lengths=plates.lengths + 0.07 * w / shapes.OVERLAP)
        self._cylinders(scene, plates, 0.7 * w, _PLATE, at)

    def _arrows(self, scene: mujoco.MjvScene, q: np.ndarray, force: np.ndarray) -> None:
        """The forces of disturbances, on the scale on which the arm's weight is two widths."""
        starts, forces = shapes.force_arrows(q, force, 0.95 * self._width)
        ways = forces * (2.0 * self._width / self._weight)
        sizes = np.linalg.norm(ways, axis=-1)
        for start, way, size in zip(starts, ways, sizes, strict=True):
            if size > max(_SMALLEST * sizes.max(), 1e-3 * self._length):
                geom = self._add(scene, "ARROW", np.zeros(3), start, _FORCE)
                if geom is not None:
                    kind, width = mujoco.mjtGeom.mjGEOM_ARROW, 0.05 * self._width
                    mujoco.mjv_connector(geom, kind, width, start, start + way)

    def _cylinders(
        self, scene: mujoco.MjvScene, pieces: shapes.Pieces, radii: Any, colors: Any, at: Any = 0.0
    ) -> None:
        """A cylinder a piece; radii and colours are those of each piece, or one for all."""
        radii = np.broadcast_to(radii, pieces.lengths.shape)
        colors = np.broadcast_to(colors, (len(radii), np.shape(colors)[-1]))
        parts = zip(*pieces, radii, colors, strict=True)
        for center, angle, length, radius, color in parts:
            if length > 1e-9:
                cos, sin = np.cos(angle), np.sin(angle)
                turn = [cos, 0.0, sin, 0.0, 1.0, 0.0, -sin, 0.0, cos]
                size = [radius, 0.5 * shapes.OVERLAP * length, 0.0]
                self._add(scene, "CYLINDER", size, center + at, color, turn)

    def _add(
        self, scene: mujoco.MjvScene, kind: str, size: Any, at: Any, color: Any, turn: Any = None
    ) -> Any:
        """The next solid of a scene, of a colour from 0 to 255; None if the scene is full."""
        if scene.ngeom >= scene.maxgeom:
            return None
        geom, scene.ngeom = self._solids[scene.ngeom], scene.ngeom + 1
        turn = np.eye(3).ravel() if turn is None else np.array(turn)
        rgba = np.array([*color, 255.0][:4], dtype=np.float32) / np.float32(255.0)
        kind = getattr(mujoco.mjtGeom, f"mjGEOM_{kind}")
        mujoco.mjv_initGeom(geom, kind, np.array(size), np.asarray(at, dtype=float), turn, rgba)
        return geom


class Captions:
    """The words of a film of this size [pixel]: what is run above, what acts and the time below."""

    def __init__(
        self, run: Trajectory, description: Mapping[str, Any], size: tuple[int, int]
    ) -> None:
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
        now = {name: text for at, name, text in self._events if at <= t}
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
