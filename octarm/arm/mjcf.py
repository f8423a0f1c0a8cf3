"""From MJCF to a compiled model, for any parameters and any number of modules.

`models/octarm.xml` is the template. Its base frame hangs from the ceiling: x down along the arm,
y to the right, so that a point (x, y) of `octarm.lagrange` is (y, 0, -x) in MuJoCo's world frame.
MuJoCo orders the coordinates along the arm, q = [s1, theta1, s2, ..]; outside this module they are
always in the paper's order, q = [s1..sN, theta1..thetaN].
"""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from octarm.arm.parameters import ArmParameters
from octarm.arrays import coordinate_names as coordinate_names
from octarm.errors import FileError, OctarmError

_COLUMN_SIDES = ((1, 1.0), (2, -1.0))  # column 1 lengthens with +theta
_PARTS = ("column_1", "column_2", "backbone")


def model_path() -> Path:
    """The file `octarm.xml`, in a checkout or in an installed package.

    Raises:
        FileError: if it is missing.
    """
    package = Path(__file__).resolve().parent.parent
    for folder in (package.parent / "models", package / "models"):
        if (folder / "octarm.xml").is_file():
            return folder / "octarm.xml"
    raise FileError(f"models/octarm.xml is missing beside {package}; reinstall octarm")


def template_model() -> mujoco.MjModel:
    """`models/octarm.xml` as it stands."""
    return mujoco.MjModel.from_xml_path(str(model_path()))


@functools.cache
def nominal_parameters() -> ArmParameters:
    """The nominal arm: the numbers of `models/octarm.xml`."""
    return ArmParameters.from_model(template_model())


@functools.cache
def nominal_input_limit() -> float:
    """Bound on the absolute input forces [N]: the actuators' range in `models/octarm.xml`."""
    return float(template_model().actuator_ctrlrange[0, 1])


def build_model(
    parameters: ArmParameters | None = None, timestep: float | None = None
) -> mujoco.MjModel:
    """Compiles the arm with these parameters, for any number of modules.

    Args:
        parameters: one arm's parameters (no batch axes); the nominal ones when not given.
        timestep: physics step [s]; that of `models/octarm.xml` when not given.

    Returns:
        The compiled model. Its keyframe `hanging` is the loaded equilibrium.

    Raises:
        OctarmError: if the parameters have batch axes, the timestep is not between 1e-7 and
            0.1 s, or there is no equilibrium.
    """
    parameters = nominal_parameters() if parameters is None else parameters
    return _compiled(_arm_spec(parameters, timestep), parameters)


def build_slim_model(
    parameters: ArmParameters | None = None, timestep: float | None = None
) -> mujoco.MjModel:
    """The model of `build_model` without what no state depends on, so that a step takes less time.

    Geoms, sites, sensors, cameras and lights are left out. A step gives the same bits. Arguments
    and errors are those of `build_model`.
    """
    parameters = nominal_parameters() if parameters is None else parameters
    spec = _arm_spec(parameters, timestep)
    for part in (*spec.sensors, *spec.geoms, *spec.sites, *spec.cameras, *spec.lights):
        spec.delete(part)
    return _compiled(spec, parameters)


def _arm_spec(parameters: ArmParameters, timestep: float | None) -> mujoco.MjSpec:
    """The template with these parameters."""
    spec = mujoco.MjSpec.from_file(str(model_path()))
    if timestep is not None:
        if not 1e-7 <= timestep <= 0.1:
            raise OctarmError(f"timestep is {timestep:g} s; it must be between 1e-07 and 0.1 s")
        spec.option.timestep = timestep
    if parameters.batch_shape:
        raise OctarmError(
            f"parameters have batch axes {parameters.batch_shape}; a model describes one arm"
        )
    _set_modules(spec, parameters.modules)
    _set_parameters(spec, parameters)
    return spec


def _compiled(spec: mujoco.MjSpec, parameters: ArmParameters) -> mujoco.MjModel:
    """The model, with what cannot be written into a specification."""
    try:
        model = spec.compile()
    except ValueError as error:
        raise OctarmError(f"MuJoCo refuses these parameters: {error}") from None
    for a, side in _COLUMN_SIDES:
        for i in range(1, parameters.modules + 1):
            theta = model.tendon_adr[model.tendon(f"column_{a}_{i}").id] + 1
            model.wrap_prm[theta] = side * 0.5 * parameters.width
    data = mujoco.MjData(model)
    mujoco.mj_setConst(model, data)
    model.key("hanging").qpos[:] = _static_equilibrium(model, data)
    return model


def paper_order(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Where the paper's coordinates stand in MuJoCo's vectors.

    Returns:
        Indices into qpos and into qvel, each of shape (2N,), so that `qpos[index]` is q.
    """
    modules = range(1, model.nu // 2 + 1)
    joints = [model.joint(f"{kind}_{i}") for kind in ("s", "theta") for i in modules]
    return np.array([j.qposadr[0] for j in joints]), np.array([j.dofadr[0] for j in joints])


def world_position(position: np.ndarray) -> np.ndarray:
    """Points (x, y) of the base plane, shape (..., 2), in the world frame, shape (..., 3) [m]."""
    x, y = position[..., 0], position[..., 1]
    return np.stack([y, np.zeros_like(y), -x], axis=-1)


class PlantFields:
    """The arrays of a compiled model that hold an arm's parameters, for one arm or a batch."""

    def __init__(self, model: mujoco.MjModel, field: Callable[[str], np.ndarray]) -> None:
        """Takes the arrays by name, each with the batch's axis, if any, before the model's own."""
        modules = range(1, model.nu // 2 + 1)
        self._bodies = [model.body(f"module_{i}").id for i in modules]
        self._tendons = [[model.tendon(f"column_{a}_{i}").id for i in modules] for a in (1, 2)]
        self._bends = [[model.tendon_adr[t] + 1 for t in column] for column in self._tendons]
        self._field = field

    def write(self, p: ArmParameters, gravity_angle: np.ndarray | float = 0.0) -> bool:
        """Writes the parameters.

        Args:
            p: of all arms, or with the batch's axis (n,).
            gravity_angle: by which gravity turns from the hanging arm towards +y of the base
                frame, shape () or (n,) [rad].

        Returns:
            Whether inertias changed, so that the caller must make MuJoCo's constants follow.
        """
        mass, inertia = self._field("body_mass"), self._field("body_inertia")
        changed = np.any(mass[..., self._bodies] != p.mass) or np.any(
            inertia[..., self._bodies, 0] != p.inertia
        )
        mass[..., self._bodies] = p.mass
        inertia[..., self._bodies, :] = p.inertia[..., None]
        g, angle = np.asarray(p.gravity), np.asarray(gravity_angle)
        self._field("opt.gravity")[...] = np.stack(
            np.broadcast_arrays(g * np.sin(angle), 0.0, -g * np.cos(angle)), axis=-1
        )
        for a, (column, bends) in enumerate(zip(self._tendons, self._bends, strict=True)):
            self._field("tendon_stiffness")[..., column] = p.stiffness[..., a, :]
            self._field("tendon_damping")[..., column] = p.damping[..., a, :]
            self._field("tendon_lengthspring")[..., column, :] = p.rest_length[..., None]
            if p.width.ndim:  # one arm's width stands in its model from the start
                side = _COLUMN_SIDES[a][1]
                self._field("wrap_prm")[..., bends] = side * 0.5 * p.width[..., None]
        return bool(changed)


def _set_modules(spec: mujoco.MjSpec, modules: int) -> None:
    """Cuts the template to N modules, or extends it by modules like its last one."""
    in_template = len(spec.actuators) // 2
    if modules == in_template:
        return
    if modules < in_template:
        for geom in _geoms_of(spec, modules + 1)[0]:
            spec.delete(geom)
        spec.delete(spec.body(f"module_{modules + 1}"))  # with all that refers to it
    else:
        spec.delete(spec.sensor("tip_position"))
        spec.delete(spec.site("tip"))
        for i in range(in_template + 1, modules + 1):
            _add_module(spec, i)
    _add_tip(spec, modules)
    spec.key("hanging").qpos = np.zeros(2 * modules)


def _geoms_of(spec: mujoco.MjSpec, i: int) -> tuple[list[mujoco.MjsGeom], list[mujoco.MjsGeom]]:
    """The pictures of module i: those on the body it stands on, and those on its own."""
    sleeves, rods = _geom_names(i)
    return [spec.geom(name) for name in sleeves], [spec.geom(name) for name in rods]


def _geom_names(i: int) -> tuple[list[str], list[str]]:
    rods = [f"{part}_{i}_rod" for part in _PARTS]
    return [f"{part}_{i}_sleeve" for part in _PARTS], [f"plate_{i}", *rods]


def _add_module(spec: mujoco.MjSpec, i: int) -> None:
    """Adds module i like the one before it."""
    parent = spec.body(f"module_{i - 1}")
    body = parent.add_body(name=f"module_{i}", mass=1.0, inertia=[1.0] * 3, explicitinertial=True)
    slide = body.add_joint(spec.find_default("slide"), name=f"s_{i}")
    hinge = body.add_joint(spec.find_default("hinge"), name=f"theta_{i}")
    owners, models, names = (parent, body), _geoms_of(spec, i - 1), _geom_names(i)
    for owner, alike, called in zip(owners, models, names, strict=True):
        for geom, name in zip(alike, called, strict=True):
            owner.add_geom(geom.classname, name=name, size=geom.size, fromto=geom.fromto)
    for joint in (slide, hinge):
        _add_sensors(spec, joint.name, "JOINT", "position")
    for a, side in _COLUMN_SIDES:
        tendon = spec.add_tendon(name=f"column_{a}_{i}")
        tendon.wrap_joint(slide.name, 1.0)
        tendon.wrap_joint(hinge.name, side)
        spec.add_actuator(
            spec.find_default("column"),
            name=f"push_{a}_{i}",
            trntype=mujoco.mjtTrn.mjTRN_TENDON,
            target=tendon.name,
        )
        _add_sensors(spec, tendon.name, "TENDON", "length")


def _add_sensors(spec: mujoco.MjSpec, target: str, kind: str, position: str) -> None:
    """Sensors of the position and the velocity of a joint or a tendon."""
    for name, quantity in ((position, "POS"), ("velocity", "VEL")):
        spec.add_sensor(
            name=f"{target}_{name}",
            type=getattr(mujoco.mjtSensor, f"mjSENS_{kind}{quantity}"),
            objtype=getattr(mujoco.mjtObj, f"mjOBJ_{kind}"),
            objname=target,
        )


def _add_tip(spec: mujoco.MjSpec, modules: int) -> None:
    spec.body(f"module_{modules}").add_site(
        name="tip", size=[0.008] * 3, rgba=[0.84, 0.15, 0.16, 1]
    )
    spec.add_sensor(
        name="tip_position",
        type=mujoco.mjtSensor.mjSENS_FRAMEPOS,
        objtype=mujoco.mjtObj.mjOBJ_SITE,
        objname="tip",
    )


def _set_parameters(spec: mujoco.MjSpec, p: ArmParameters) -> None:
    """Writes the parameters into a template with as many modules, all but the tendons' width."""
    nominal = nominal_parameters()
    wider = float(p.width / nominal.width)
    spec.option.gravity = [0.0, 0.0, -float(p.gravity)]
    for i in range(1, p.modules + 1):
        body = spec.body(f"module_{i}")
        body.mass = p.mass[i - 1]
        body.inertia = [p.inertia[i - 1]] * 3
        for a, _ in _COLUMN_SIDES:
            tendon = spec.tendon(f"column_{a}_{i}")
            tendon.stiffness = [p.stiffness[a - 1, i - 1], 0.0, 0.0]
            tendon.damping = [p.damping[a - 1, i - 1], 0.0, 0.0]
            tendon.springlength = [p.rest_length[i - 1]] * 2
        longer = float(p.rest_length[i - 1] / nominal.rest_length[min(i, nominal.modules) - 1])
        for geom in itertools.chain(*_geoms_of(spec, i)):
            geom.fromto = np.array(geom.fromto) * np.tile([longer, wider, 1.0], 2)
            geom.size = np.array(geom.size) * wider


def _static_equilibrium(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    """qpos at which gravity and springs balance, by Newton's method on MuJoCo's own forces.

    Raises:
        OctarmError: if it does not converge: the springs are too soft for this weight.
    """

    def residual(qpos: np.ndarray) -> np.ndarray:
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        return data.qfrc_bias - data.qfrc_passive

    qpos = np.zeros(model.nq)
    qpos[0::2] = ArmParameters.from_model(model).rest_length
    nudges = 1e-6 * np.eye(model.nq)
    with contextlib.suppress(np.linalg.LinAlgError):
        for _ in range(50):
            slope = [(residual(qpos + h) - residual(qpos - h)) / 2e-6 for h in nudges]
            step = np.linalg.solve(np.stack(slope, axis=1), residual(qpos))
            qpos = qpos - step
            if np.all(np.abs(step) < 1e-13 * np.maximum(1.0, np.abs(qpos))):
                return qpos
    raise OctarmError("no static equilibrium was found: stiffness is too low for this weight")
