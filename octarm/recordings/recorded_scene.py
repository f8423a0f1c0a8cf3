"""The 3D scene as rerun's entities: what stays, and what moves.

Almost everything is an instanced solid of which only places and turns change. All turns are about
the world's y axis, so that an angle is all that is new in each frame. Places and angles are rounded
to an eighth of a millimetre and a thousandth of a radian, which nobody sees: what comes again
compresses.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from octarm.arm.parameters import ArmParameters
from octarm.recordings import scene

MODULE_COLORS = ["FF9F43", "40A9FF", "48C987", "E76EBE", "F1D64A", "9B89FF", "4DD0D0", "FF7864"]
HIDDEN = ("skeleton",)  # shown on request
_PLATE, _BASE = 0xDEE2E8FF, 0x78808CFF
_TRAIL, _PATH, _GHOST = 0xFF4655FF, 0x8FA3B8FF, 0xC6D6EA22
_RELAXED, _PULL, _PUSH = (112, 118, 126), (240, 243, 248), (232, 62, 62)
_DISTURBANCE, _GRAVITY, _PAYLOAD = 0xC58BFFFF, 0xB8C0CCFF, 0xB8A06AFF
_STEEL = 7850.0  # [kg/m^3]; a payload is drawn as a ball of it
_TRAIL_LENGTH = 1.0  # [s]


def module_colors(count: int) -> np.ndarray:
    """One colour a module, shape (count, 3)."""
    return np.resize([list(bytes.fromhex(color)) for color in MODULE_COLORS], (count, 3))


class Scene:
    """What the scene of one run consists of; `looks` once, `frames` for each block."""

    def __init__(self, parameters: ArmParameters, disturbances: list[dict[str, Any]]) -> None:
        """The scene of an arm under disturbances as `run.json` lists them."""
        self.modules = parameters.modules
        self.width = float(parameters.width)
        self.length = float(np.sum(parameters.rest_length))
        self.weight = float(np.sum(parameters.mass) * parameters.gravity)
        self._tilt = _tilt(disturbances)
        self.payloads = [
            (float(entry["asked"]["mass"]), float(entry["asked"].get("at", 0.0)))
            for entry in disturbances
            if entry["name"].startswith("payload") and np.isscalar(entry["asked"].get("mass"))
        ]
        self._before: tuple[np.ndarray, np.ndarray] | None = None

    def looks(self) -> dict[str, Any]:
        """What of the scene stays the same, by entity."""
        n, w = self.modules, self.width
        solid: dict[str, Any] = {"fill_mode": "solid"}
        down = [self.weight_length() * math.sin(self._tilt), 0.0, 0.0]
        down[2] = -self.weight_length() * math.cos(self._tilt)
        lines = rr.LineStrips3D.from_fields
        out: dict[str, Any] = {
            "world": rr.ViewCoordinates.RIGHT_HAND_Z_UP,
            "world/base": rr.Cylinders3D(
                lengths=0.15 * w, radii=0.75 * w, centers=[0, 0, 0.075 * w], colors=_BASE, **solid
            ),
            "world/plates": rr.Cylinders3D(lengths=0.07 * w, radii=0.7 * w, colors=_PLATE, **solid),
            "world/tube": rr.Cylinders3D.from_fields(
                radii=[0.27 * w] * (n * scene.PIECES), **solid
            ),
            "world/columns": rr.Cylinders3D.from_fields(**solid),
            "world/desired": rr.Cylinders3D.from_fields(
                radii=[0.37 * w] * (n * scene.RIBS),
                colors=np.full(n * scene.RIBS, _GHOST, dtype=np.uint32),
                **solid,
            ),
            "world/trail": lines(colors=_TRAIL, radii=0.025 * w),
            "world/desired_path": lines(colors=_PATH, radii=0.012 * w),
            "world/skeleton": lines(colors=0xFFFFFFFF, radii=0.02 * w),
            "world/gravity": rr.Arrows3D(
                vectors=[down],
                origins=[[-1.6 * w, 0.0, 0.1 * w]],
                colors=_GRAVITY,
                radii=0.03 * w,
                labels=["g"],
            ),
        }
        if self.payloads:
            out["world/payload"] = rr.Ellipsoids3D.from_fields(colors=_PAYLOAD, **solid)
        return out

    def weight_length(self) -> float:
        """How long an arrow of the arm's weight is [m]."""
        return 2.0 * self.width

    def frames(
        self,
        t: np.ndarray,
        q: np.ndarray,
        q_d: np.ndarray,
        tau: np.ndarray,
        disturbance: np.ndarray | None,
    ) -> dict[str, list[Any]]:
        """What moves, by entity, each as columns for T frames.

        Args:
            t: times, shape (T,) [s].
            q: coordinates, shape (T, 2N) [m], [rad].
            q_d: desired coordinates, shape (T, 2N) [m], [rad].
            tau: input forces, shape (T, 2N) [N].
            disturbance: generalised force that was added, shape (T, 2N) [N], [N m].
        """
        count, w = len(t), self.width
        tip, wanted = scene.tip(q), scene.tip(q_d)
        before = (tip[0], wanted[0]) if self._before is None else self._before
        trail, path = (
            np.stack([np.concatenate([[first], now[:-1]]), now], axis=1)
            for first, now in zip(before, (tip, wanted), strict=True)
        )
        self._before = tip[-1], wanted[-1]
        out: dict[str, list[Any]] = {
            "world/tube": [*_solids(scene.tube(q)), *self._tube_colors(q)],
            "world/plates": _poses(scene.plates(q)),
            "world/columns": [*_solids(scene.columns(q, w)), *self._column_looks(tau)],
            "world/desired": _solids(scene.ribs(q_d)),
            "world/trail": _strips(trail[:, None]),
            "world/desired_path": _strips(path[:, None]),
            "world/skeleton": _strips(scene.skeleton(q)[:, None]),
        }
        if self.payloads:
            out["world/payload"] = self._payloads(t, q, tip)
        if disturbance is not None:
            origins, forces = scene.force_arrows(q, disturbance, 0.95 * w)
            vectors = forces * (self.weight_length() / self.weight)
            arrows = rr.Arrows3D.columns(
                vectors=vectors.reshape(-1, 3), origins=origins.reshape(-1, 3)
            )
            out["world/disturbance"] = [*arrows.partition([origins.shape[1]] * count)]
        return out

    def disturbance_look(self) -> Any:
        """How the arrows of the disturbances look."""
        return rr.Arrows3D.from_fields(colors=_DISTURBANCE, radii=0.035 * self.width)

    def view(self, name: str, *, origin: str = "world") -> rrb.Spatial3DView:
        """A camera in front of the arm, a little to the side, the same for every run of it."""
        reach = 1.12 * self.length + self.width
        middle = np.array([0.0, 0.0, 0.5 * self.width - 0.5 * reach])
        position = middle + 1.05 * reach * np.array([0.33, -0.94, -0.03])
        cursor = rr.TimeRangeBoundary.cursor_relative

        def around(before: float, after: float) -> rrb.VisibleTimeRanges:
            return rrb.VisibleTimeRanges(
                timeline="t", start=cursor(seconds=-before), end=cursor(seconds=after)
            )

        return rrb.Spatial3DView(
            origin=origin,
            name=name,
            eye_controls=rrb.EyeControls3D(position=position, look_target=middle, eye_up=[0, 0, 1]),
            line_grid=False,
            background=[13, 15, 19],
            overrides={
                f"{origin}/trail": around(_TRAIL_LENGTH, 0.0),
                f"{origin}/desired_path": around(_TRAIL_LENGTH, _TRAIL_LENGTH),
                **{f"{origin}/{name}": rrb.EntityBehavior(visible=False) for name in HIDDEN},
            },
        )

    def _payloads(self, t: np.ndarray, q: np.ndarray, tip: np.ndarray) -> list[Any]:
        """Balls of steel below the last plate, of no size until they are there."""
        masses = np.array([mass for mass, _ in self.payloads])
        radii = np.cbrt(0.75 * masses / (math.pi * _STEEL))
        along = -np.sum(q[:, self.modules :], axis=1)[:, None]
        below = np.stack([-np.sin(along), np.zeros_like(along), -np.cos(along)], axis=-1)
        places = tip[:, None] + below * (radii + 0.035 * self.width)[:, None]
        begun = t[:, None] >= [at for _, at in self.payloads]
        sizes = np.repeat((begun * radii)[..., None], 3, axis=-1)
        balls = rr.Ellipsoids3D.columns(half_sizes=_rounded(sizes.reshape(-1, 3), 8192.0))
        poses = rr.InstancePoses3D.columns(translations=_rounded(places.reshape(-1, 3), 8192.0))
        counts = [len(masses)] * len(t)
        return [*poses.partition(counts), *balls.partition(counts)]

    def _tube_colors(self, q: np.ndarray) -> list[Any]:
        """The colour of the module, the brighter the more it is bent."""
        n = self.modules
        bent = np.minimum(np.abs(q[:, n:]) / 0.4, 1.0)[..., None]
        colors = module_colors(n) * (0.6 + 0.4 * bent) + 15.0 * (1.0 - bent)
        return _colors(np.repeat(colors, scene.PIECES, axis=1), rr.Cylinders3D)

    def _column_looks(self, tau: np.ndarray) -> list[Any]:
        """Red and thick where a column pushes, white and thick where it pulls."""
        size = np.tanh(tau / (0.8 * self.weight))[..., None]
        toward = np.where(size > 0.0, _PUSH, _PULL)
        colors = np.array(_RELAXED) + np.abs(size) ** 0.6 * (toward - np.array(_RELAXED))
        radii = _rounded(self.width * (0.055 + 0.075 * np.abs(size[..., 0])), 8192.0)
        radii = np.repeat(radii, scene.COLUMN_PIECES, axis=1)
        sizes = rr.Cylinders3D.columns(radii=radii.reshape(-1))
        return [
            *sizes.partition([radii.shape[1]] * len(radii)),
            *_colors(np.repeat(colors, scene.COLUMN_PIECES, axis=1), rr.Cylinders3D),
        ]


def _poses(pieces: scene.Pieces) -> list[Any]:
    frames, count = pieces.angles.shape
    angles = _rounded(pieces.angles.ravel(), 1024.0)
    kind = rr.components.RotationAxisAngle.arrow_type()
    axes = pa.array(np.tile(np.array([0.0, 1.0, 0.0], dtype=np.float32), len(angles)))
    turns = pa.StructArray.from_arrays(
        [pa.FixedSizeListArray.from_arrays(axes, type=kind.field("axis").type), pa.array(angles)],
        fields=[kind.field("axis"), kind.field("angle")],
    )
    poses = rr.InstancePoses3D.columns(
        translations=_rounded(pieces.centers.reshape(-1, 3), 8192.0),
        rotation_axis_angles=turns,
    )
    return [*poses.partition([count] * frames)]


def _solids(pieces: scene.Pieces) -> list[Any]:
    """Cylinders that overlap a little, so that there is no gap where they bend."""
    frames, count = pieces.lengths.shape
    lengths = _rounded(1.08 * pieces.lengths.ravel(), 1024.0)
    columns = rr.Cylinders3D.columns(lengths=lengths)
    return [*_poses(pieces), *columns.partition([count] * frames)]


def _rounded(values: np.ndarray, parts: float) -> np.ndarray:
    """Single precision, to that part of one."""
    return (np.round(values * parts) / parts).astype(np.float32)


def _strips(curves: np.ndarray) -> list[Any]:
    frames, count, *shape = curves.shape
    strips = _rounded(curves.reshape(-1, *shape), 8192.0)
    return [*rr.LineStrips3D.columns(strips=strips).partition([count] * frames)]


def _colors(colors: np.ndarray, kind: Any) -> list[Any]:
    flat = np.clip(colors, 0.0, 255.0).astype(np.uint8).reshape(-1, 3)
    return [*kind.columns(colors=flat).partition([colors.shape[1]] * len(colors))]


def _tilt(disturbances: list[dict[str, Any]]) -> float:
    """By which angle gravity is turned at the start, where that is known [rad]."""
    total = 0.0
    for entry in disturbances:
        asked = entry["asked"].get({"tilt": "angle", "mismatch": "tilt"}.get(entry["name"], ""))
        total += asked if isinstance(asked, int | float) else 0.0
    return total
