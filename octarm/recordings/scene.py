"""The 3D scene as rerun's entities: what stays, and what moves.

Almost everything is an instanced solid of which only places and turns change. All turns are about
the world's y axis, so that an angle is all that is new in each frame. Places and angles are rounded
to an eighth of a millimetre and a thousandth of a radian, which nobody sees: values that come again
compress well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from octarm.arm.kinematics import arc_tip
from octarm.arm.mjcf import world_position
from octarm.arm.parameters import ArmParameters
from octarm.disturbances.ledger import Drawn
from octarm.interfaces import Rows
from octarm.recordings import shapes
from octarm.recordings.shapes import module_colors

_PLATE, _BASE = 0xDEE2E8FF, 0x78808CFF
_TRAIL, _PATH, _GHOST = 0xFF4655FF, 0x8FA3B8FF, 0xC6D6EA22
_DISTURBANCE, _GRAVITY, _PAYLOAD = 0xC58BFFFF, 0xB8C0CCFF, 0xE08A3CFF
_CURVE = 0xFFFFFFFF  # of a plant of more modules
_FARTHEST = np.array([[-1.6, -1.6], [1.6, 1.6]])  # what the camera sees [lengths of the arm]
_ARROWS = np.array([[-0.7, -1.3], [0.7, 0.25]])  # and of arrows, beside which the arm stays large
_TRAIL_LENGTH = 1.0  # [s]
_FINE = 8192.0  # places are rounded to this part of a metre
_COARSE = 1024.0  # angles and lengths of pieces likewise

# Fields of `Rows` that the scene is made of; the last two are there for a plant of more modules.
DRAWN = ("t", "q", "q_d", "tau", "disturbance", "plant_q", "plant_tip")


def input_colors(count: int) -> np.ndarray:
    """One colour for each input, two columns a module, shape (count, 3)."""
    n = count // 2
    return np.repeat(module_colors(n), 2, axis=0) * np.tile([[1.0], [0.6]], (n, 1))


class Scene:
    """The entities of the scene of one run: `looks` once, `frames` for each block of rows.

    The force of disturbances is drawn if the run is `disturbed`. With a `finer` plant, of more
    modules, its true curve is drawn through the arm that its groups make one believe in, and the
    trail is that of its tip.
    """

    def __init__(
        self,
        parameters: ArmParameters,
        disturbances: Sequence[Drawn],
        *,
        disturbed: bool,
        finer: bool,
    ) -> None:
        self._modules, self._width = parameters.modules, float(np.median(parameters.width))
        self._length = float(np.sum(parameters.rest_length))
        self._weight = float(np.sum(parameters.mass) * parameters.gravity)
        self._arrow = 2.0 * self._width  # length of the arrow of the arm's weight [m]
        self._tilt = sum(disturbance.tilt for disturbance in disturbances)
        self._payloads = [d.load for d in disturbances if d.load is not None]
        self._disturbed, self._finer = disturbed, finer
        self._last: tuple[np.ndarray, np.ndarray] | None = None  # tip and desired tip
        reach, half = 1.12 * self._length + self._width, 0.5 * self._width
        # What the camera sees of x and z at least: lowest and highest [m].
        self._seen = np.array([[-0.42 * reach, half - reach], [0.42 * reach, half]])

    def looks(self) -> dict[str, Any]:
        """What of the scene stays the same, by entity."""
        n, w = self._modules, self._width
        solid: dict[str, Any] = {"fill_mode": "solid"}
        beside = [-1.6 * w, 0.0, 0.1 * w]
        down = self._arrow * np.array([math.sin(self._tilt), 0.0, -math.cos(self._tilt)])
        lines, cylinders = rr.LineStrips3D.from_fields, rr.Cylinders3D.from_fields
        ghosts = np.full(n * shapes.RIBS, _GHOST, dtype=np.uint32)
        looks: dict[str, Any] = {
            "world": rr.ViewCoordinates.RIGHT_HAND_Z_UP,
            "world/base": rr.Cylinders3D(
                lengths=0.15 * w, radii=0.75 * w, centers=[0, 0, 0.075 * w], colors=_BASE, **solid
            ),
            "world/plates": rr.Cylinders3D(lengths=0.07 * w, radii=0.7 * w, colors=_PLATE, **solid),
            "world/tube": cylinders(radii=[0.27 * w] * (n * shapes.TUBE_PIECES), **solid),
            "world/columns": cylinders(**solid),
            "world/desired": cylinders(radii=[0.37 * w] * len(ghosts), colors=ghosts, **solid),
            "world/trail": lines(colors=_TRAIL, radii=0.025 * w),
            "world/desired_path": lines(colors=_PATH, radii=0.012 * w),
            "world/skeleton": lines(colors=0xFFFFFFFF, radii=0.02 * w),
            "world/gravity": rr.Arrows3D(
                vectors=[down], origins=[beside], colors=_GRAVITY, radii=0.03 * w, labels=["g"]
            ),
        }
        if self._payloads:
            looks["world/payload"] = rr.Ellipsoids3D.from_fields(colors=_PAYLOAD, **solid)
        if self._finer:
            looks["world/plant"] = lines(colors=_CURVE, radii=0.14 * w)
        if self._disturbed:
            arrows = rr.Arrows3D.from_fields
            looks["world/disturbance"] = arrows(colors=_DISTURBANCE, radii=0.035 * w)
        return looks

    def frames(self, rows: Rows) -> dict[str, list[Any]]:
        """What moves, by entity, as columns with a frame for each of k rows."""
        q, q_d, w = rows["q"], rows["q_d"], self._width
        tip, desired_tip = shapes.tip(q), shapes.tip(q_d)
        if self._finer:
            tip = world_position(rows["plant_tip"])
            desired_tip = world_position(np.stack(arc_tip(q_d), axis=-1))
        last = self._last or (tip[0], desired_tip[0])
        self._last = tip[-1], desired_tip[-1]
        n, pieces = self._modules, shapes.COLUMN_PIECES
        bent = np.minimum(np.abs(q[:, n:]) / 0.4, 1.0)[..., None]  # which a module is brighter by
        tube_colors = module_colors(n) * (0.6 + 0.4 * bent) + 15.0 * (1.0 - bent)
        tube_colors = _bytes(np.repeat(tube_colors, shapes.TUBE_PIECES, axis=1))
        colors, radii = shapes.column_looks(rows["tau"], self._weight)
        colors = _bytes(np.repeat(colors, pieces, axis=1))
        radii = np.repeat(_rounded(w * radii, _FINE), pieces, axis=1)
        frames = {
            "world/tube": _cylinders(shapes.backbone(q, shapes.TUBE_PIECES), colors=tube_colors),
            "world/plates": _poses(shapes.plates(q)),
            "world/columns": _cylinders(shapes.columns(q, w), radii=radii, colors=colors),
            "world/desired": _cylinders(shapes.backbone(q_d, shapes.RIBS)),
            "world/trail": _strips(_steps(last[0], tip)),
            "world/desired_path": _strips(_steps(last[1], desired_tip)),
            "world/skeleton": _strips(shapes.skeleton(q)),
        }
        if self._payloads:
            carrying = rows["plant_q"] if self._finer else q
            places, radii = shapes.payload_balls(self._payloads, rows["t"], carrying, w)
            sizes = np.repeat(_rounded(radii, _FINE)[..., None], 3, axis=-1)
            frames["world/payload"] = [
                *_columns(rr.InstancePoses3D, translations=_rounded(places, _FINE)),
                *_columns(rr.Ellipsoids3D, half_sizes=sizes),
            ]
        if self._finer:
            curve = np.concatenate([shapes.skeleton(rows["plant_q"]), tip[:, None]], axis=1)
            frames["world/plant"] = _strips(curve)
        if self._disturbed:
            origins, forces = shapes.force_arrows(q, rows["disturbance"], 0.95 * w)
            vectors = forces * (self._arrow / self._weight)
            frames["world/disturbance"] = _columns(rr.Arrows3D, vectors=vectors, origins=origins)
            self._see(origins + vectors, _ARROWS)
        self._see(shapes.skeleton(q), _FARTHEST)
        return frames

    def _see(self, points: np.ndarray, most: np.ndarray) -> None:
        """Widens what the camera sees to most points, shape (k, points, 3), up to an end."""
        low = np.percentile(points[..., ::2].min(axis=1), 1.0, axis=0)
        high = np.percentile(points[..., ::2].max(axis=1), 99.0, axis=0)
        low, high = np.clip([low, high], self._length * most[0], self._length * most[1])
        self._seen = np.stack([np.minimum(self._seen[0], low), np.maximum(self._seen[1], high)])

    def view(self, name: str, root: str = "") -> rrb.Spatial3DView:
        """A camera in front of the arm, a little to the side, that sees all of what was drawn."""
        origin = f"{root}world"
        x, z = 0.5 * (self._seen[0] + self._seen[1])
        middle = np.array([x, 0.0, z])
        size = float(np.max((self._seen[1] - self._seen[0]) / [0.84, 1.0]))
        position = middle + 1.05 * size * np.array([0.33, -0.94, -0.03])
        cursor = rr.TimeRangeBoundary.cursor_relative
        before, now, after = (cursor(seconds=x) for x in (-_TRAIL_LENGTH, 0.0, _TRAIL_LENGTH))
        past = rrb.VisibleTimeRanges(timeline="t", start=before, end=now)
        around = rrb.VisibleTimeRanges(timeline="t", start=before, end=after)
        return rrb.Spatial3DView(
            origin=origin,
            name=name,
            eye_controls=rrb.EyeControls3D(position=position, look_target=middle, eye_up=[0, 0, 1]),
            line_grid=False,
            background=[13, 15, 19],
            overrides={
                f"{origin}/trail": past,
                f"{origin}/desired_path": around,
                f"{origin}/skeleton": rrb.EntityBehavior(visible=False),  # shown on request
            },
        )


def _columns(archetype: Any, **values: np.ndarray) -> list[Any]:
    """Columns of k frames of as many instances each, from arrays of shape (k, instances, ...)."""
    frames, count = next(iter(values.values())).shape[:2]
    flat = {name: array.reshape(-1, *array.shape[2:]) for name, array in values.items()}
    return [*archetype.columns(**flat).partition([count] * frames)]


def _poses(pieces: shapes.Pieces) -> list[Any]:
    """Where the pieces are, and how they are turned about the world's y axis."""
    frames, count = pieces.angles.shape
    angles = _rounded(pieces.angles.ravel(), _COARSE)
    kind = rr.components.RotationAxisAngle.arrow_type()
    axes = pa.array(np.tile(np.array([0.0, 1.0, 0.0], dtype=np.float32), len(angles)))
    turns = pa.StructArray.from_arrays(
        [pa.FixedSizeListArray.from_arrays(axes, type=kind.field("axis").type), pa.array(angles)],
        fields=[kind.field("axis"), kind.field("angle")],
    )
    places = _rounded(pieces.centers.reshape(-1, 3), _FINE)
    poses = rr.InstancePoses3D.columns(translations=places, rotation_axis_angles=turns)
    return [*poses.partition([count] * frames)]


def _cylinders(pieces: shapes.Pieces, **looks: np.ndarray) -> list[Any]:
    lengths = _rounded(shapes.OVERLAP * pieces.lengths, _COARSE)
    return [*_poses(pieces), *_columns(rr.Cylinders3D, lengths=lengths, **looks)]


def _strips(curves: np.ndarray) -> list[Any]:
    """One line a frame, from points of shape (k, points, 3)."""
    return _columns(rr.LineStrips3D, strips=_rounded(curves[:, None], _FINE))


def _steps(last: np.ndarray, points: np.ndarray) -> np.ndarray:
    """From each point to the next one, beginning at the last point of the block before."""
    return np.stack([np.concatenate([[last], points[:-1]]), points], axis=1)


def _rounded(values: np.ndarray, parts: float) -> np.ndarray:
    """Single precision, to that part of one."""
    return (np.round(values * parts) / parts).astype(np.float32)


def _bytes(colors: np.ndarray) -> np.ndarray:
    return np.clip(colors, 0.0, 255.0).astype(np.uint8)
