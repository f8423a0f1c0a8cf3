"""From MJCF to a compiled model, for any parameters and any number of modules.

`models/octarm.xml` is the template. Its base frame hangs from the ceiling: x down along the arm,
y to the right, so that a point (x, y) of `octarm.lagrange` is (y, 0, -x) in MuJoCo's world frame.
MuJoCo orders the coordinates along the arm, q = [s1, theta1, s2, ..]; outside this module they are
always in the paper's order, q = [s1..sN, theta1..thetaN].

The motors exert F_coeff(q) tau, eq (2), in every state: `ctrl` holds tau, and then tau of the
modules from the second on once more, for the motors that put the reactions on the ground.
"""

from __future__ import annotations

import functools
import operator
import warnings
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from octarm.arm.lagrange import NO_EQUILIBRIUM, newton, potential_hessian
from octarm.arm.modes import check_step
from octarm.arm.parameters import MOST_MODULES, ArmParameters
from octarm.errors import FileError, OctarmError

_COLUMN_SIDES = ((1, 1.0), (2, -1.0))  # column 1 lengthens with +theta
_FARTHEST = 1e9  # [m], [rad]; of springs so soft, MuJoCo's forces are nothing but rounding
_PARTS = ("column_1", "column_2", "backbone")


def model_path() -> Path:
    """The file `octarm.xml`, in a checkout or in a package; raises FileError if it is missing."""
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
    return read_parameters(template_model())


def read_parameters(model: mujoco.MjModel) -> ArmParameters:
    """The parameters of a compiled arm, read by the names in `models/octarm.xml`.

    The arm hangs along the negative z axis of the world.
    """
    modules = range(1, model.nq // 2 + 1)
    bodies = [model.body(f"module_{i}") for i in modules]
    columns = [[model.tendon(f"column_{a}_{i}") for i in modules] for a in (1, 2)]
    widths = [2.0 * model.wrap_prm[model.tendon_adr[column.id] + 1] for column in columns[0]]
    pushes = [model.actuator(f"push_{a}_{i}").ctrlrange for i in modules for a in (1, 2)]
    alike = all(np.array_equal(push, pushes[0]) for push in pushes)
    rest = [model.tendon_lengthspring[c.id, 0] for c in columns[0]]
    joints = [[model.joint(f"{kind}_{i}") for i in modules] for kind in ("s", "theta")]
    free = [[model.qpos_spring[j.qposadr[0]] for j in row] for row in joints]
    return ArmParameters(
        mass=[body.mass[0] for body in bodies],
        inertia=[body.inertia[2] for body in bodies],
        width=widths[:1] if len(set(widths)) == 1 else widths,
        stiffness=[[model.tendon_stiffness[c.id] for c in row] for row in columns],
        damping=[[model.tendon_damping[c.id] for c in row] for row in columns],
        rest_length=free[0] if np.any(free) else rest,
        gravity=-model.opt.gravity[2],
        tip_length=model.site("tip").pos[0],
        input_range=np.transpose(pushes[:1] if alike else pushes),
        rest_angle=free[1],
        backbone_stiffness=[[model.jnt_stiffness[j.id] for j in row] for row in joints],
        backbone_damping=[[model.dof_damping[j.dofadr[0]] for j in row] for row in joints],
    )


def physics_step(timestep: float | None = None) -> float:
    """A physics step [s]; that of `models/octarm.xml` when it is not given.

    Raises OctarmError if it is not within what `octarm.arm.modes.check_step` allows.
    """
    if timestep is None:
        return _nominal_step()
    check_step(timestep)
    return timestep


@functools.cache
def _nominal_step() -> float:
    return float(template_model().opt.timestep)


def build_model(
    parameters: ArmParameters | None = None, timestep: float | None = None
) -> mujoco.MjModel:
    """Compiles one arm, the nominal one when none is given, for any number of modules.

    Its keyframe `hanging` is the loaded equilibrium. The step is that of `physics_step`. Raises
    OctarmError if an argument is not allowed, or there is no equilibrium.
    """
    parameters = nominal_parameters() if parameters is None else parameters
    return _compiled(_arm_spec(parameters, timestep), parameters)


def build_slim_model(
    parameters: ArmParameters | None = None, timestep: float | None = None
) -> mujoco.MjModel:
    """The model of `build_model` without what no state depends on, so that a step takes less time.

    Geoms, sensors, cameras and lights are left out. A step gives the same bits.
    """
    parameters = nominal_parameters() if parameters is None else parameters
    spec = _arm_spec(parameters, timestep)
    for part in (*spec.sensors, *spec.geoms, *spec.cameras, *spec.lights):
        spec.delete(part)
    return _compiled(spec, parameters)


def _arm_spec(p: ArmParameters, timestep: float | None) -> mujoco.MjSpec:
    """The template with as many modules, and with all parameters that are more than numbers."""
    spec = mujoco.MjSpec.from_string(model_path().read_text(encoding="utf-8"))
    spec.option.timestep = physics_step(timestep)
    if p.batch_shape:
        raise OctarmError(f"parameters have batch axes {p.batch_shape}; a model describes one arm")
    if p.modules > MOST_MODULES:
        raise OctarmError(
            f"the arm has {p.modules} modules; it must have at most {MOST_MODULES}, since the time "
            "of a physics step grows with their square"
        )
    _set_modules(spec, p.modules)
    nominal = nominal_parameters()
    low, high = p.input_bounds(())
    for i in range(1, p.modules + 1):
        body = spec.body(f"module_{i}")
        body.mass, body.inertia = p.mass[i - 1], [p.inertia[i - 1]] * 3
        for column, (a, _) in enumerate(_COLUMN_SIDES, start=2 * (i - 1)):
            spec.actuator(f"push_{a}_{i}").ctrlrange = [low[column], high[column]]
        alike = min(i, nominal.modules) - 1  # the module of the template that it is drawn like
        longer = float(p.rest_length[i - 1] / nominal.rest_length[alike])
        wider = float(p.widths[i - 1] / nominal.widths[alike])
        for name in (*_sleeves(i), *_rods(i)):
            geom = spec.geom(name)
            geom.fromto = np.array(geom.fromto) * np.tile([longer, wider, 1.0], 2)
            geom.size = np.array(geom.size) * wider
    spec.site("tip").pos = [float(p.tip_length), 0.0, 0.0]
    return spec


def _compiled(spec: mujoco.MjSpec, parameters: ArmParameters) -> mujoco.MjModel:
    """The model with all parameters, hanging at rest in its keyframe."""
    try:
        with warnings.catch_warnings(action="ignore"):  # absurd numbers have no equilibrium
            model = spec.compile()
    except ValueError as error:
        raise OctarmError(f"MuJoCo refuses these parameters: {error}") from None
    PlantFields(model, lambda name: operator.attrgetter(name)(model)).write(parameters)
    data = mujoco.MjData(model)

    def residual(qpos: np.ndarray) -> np.ndarray:
        data.qpos[:] = qpos
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        return data.qfrc_bias - data.qfrc_passive

    order = paper_order(model)[0]

    def linearised(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """By MuJoCo's forces; the slope, which only sets the way there, is the analytic one."""
        qpos = np.empty_like(q)
        qpos[order] = q
        return residual(qpos)[order], potential_hessian(parameters, q)

    unloaded = np.concatenate([parameters.rest_length, parameters.rest_angle])
    with warnings.catch_warnings(action="ignore"):
        mujoco.mj_setConst(model, data)
        rest = newton(linearised, unloaded, 1e-13)
    if np.max(np.abs(rest)) > _FARTHEST:
        raise OctarmError(NO_EQUILIBRIUM)
    model.key("hanging").qpos[order] = rest
    return model


def paper_order(model: mujoco.MjModel) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the paper's coordinates in qpos and in qvel, each of shape (2N,)."""
    modules = range(1, model.nq // 2 + 1)
    joints = [model.joint(f"{kind}_{i}") for kind in ("s", "theta") for i in modules]
    return np.array([j.qposadr[0] for j in joints]), np.array([j.dofadr[0] for j in joints])


def rest_of(model: mujoco.MjModel) -> np.ndarray:
    """The loaded equilibrium of a model in the paper's order, shape (2N,) [m], [rad]."""
    return model.key("hanging").qpos[paper_order(model)[0]]


def world_position(position: np.ndarray) -> np.ndarray:
    """Points (x, y) of the base plane, shape (..., 2), in the world frame, shape (..., 3) [m]."""
    x, y = position[..., 0], position[..., 1]
    return np.stack([y, np.zeros_like(y), -x], axis=-1)


class PlantFields:
    """The arrays of a compiled model that hold an arm's parameters, for one arm or a batch."""

    def __init__(self, model: mujoco.MjModel, field: Callable[[str], np.ndarray]) -> None:
        """Takes the arrays by name, each with the batch's axis, if any, before the model's own."""
        modules = range(1, model.nq // 2 + 1)
        self._bodies = [model.body(f"module_{i}").id for i in modules]
        self._tendons = [[model.tendon(f"column_{a}_{i}").id for i in modules] for a in (1, 2)]
        self._bends = [[model.tendon_adr[t] + 1 for t in column] for column in self._tendons]
        self._reactions = [
            [model.actuator(f"reaction_{a}_{i}").id for i in modules[1:]] for a in (1, 2)
        ]
        springs = model.jnt_stiffness, model.dof_damping, model.qpos_spring
        self._plain = not any(map(np.any, springs))
        self._qpos, self._dof = (x.reshape(2, -1) for x in paper_order(model))
        self._field = field

    def write(self, p: ArmParameters, gravity_angle: np.ndarray | float = 0.0) -> bool:
        """Writes the parameters, of all arms or with the batch's axis (n,).

        The angle by which gravity turns from the hanging arm towards +y of the base frame has shape
        () or shape (n,) [rad].

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
        columns = zip(self._tendons, self._bends, self._reactions, strict=True)
        for a, (column, bends, reactions) in enumerate(columns):
            lever = _COLUMN_SIDES[a][1] * 0.5 * p.widths
            self._field("tendon_stiffness")[..., column] = p.stiffness[..., a, :]
            self._field("tendon_damping")[..., column] = p.damping[..., a, :]
            length = p.rest_length if p.entries.plain else p.rest_length + lever * p.rest_angle
            self._field("tendon_lengthspring")[..., column, :] = length[..., None]
            self._field("wrap_prm")[..., bends] = lever
            self._field("actuator_gear")[..., reactions, 5] = lever[..., 1:]
        self._plain &= p.entries.plain
        if not self._plain:
            self._write_backbone(p)
        return bool(changed)

    def _write_backbone(self, p: ArmParameters) -> None:
        stiffness, damping, relaxed = map(
            self._field, ("jnt_stiffness", "dof_damping", "qpos_spring")
        )
        for row, free in enumerate((p.rest_length, p.rest_angle)):
            stiffness[..., self._dof[row]] = p.backbone_stiffness[..., row, :]
            damping[..., self._dof[row]] = p.backbone_damping[..., row, :]
            relaxed[..., self._qpos[row]] = free


def _set_modules(spec: mujoco.MjSpec, modules: int) -> None:
    """Cuts the template to N modules, or extends it by modules like its last one."""
    in_template = len(spec.tendons) // 2
    if modules == in_template:
        return
    for i in range(2, in_template + 1):  # their motors come after all others
        for part in (spec.site(f"reaction_{i}"), *map(spec.actuator, _reactions(i))):
            spec.delete(part)
    spec.delete(spec.sensor("tip_position"))
    spec.delete(spec.site("tip"))
    if modules < in_template:
        for name in _sleeves(modules + 1):
            spec.delete(spec.geom(name))
        spec.delete(spec.body(f"module_{modules + 1}"))  # with all that refers to it
    for i in range(in_template + 1, modules + 1):
        _add_module(spec, i)
    for i in range(2, modules + 1):
        _add_reaction(spec, i)
    tip = spec.body(f"module_{modules}").add_site(name="tip", size=[0.008] * 3)
    tip.rgba = [0.84, 0.15, 0.16, 1]
    _add_sensor(spec, "tip", "position", "FRAMEPOS", "SITE")
    spec.key("hanging").qpos = np.zeros(2 * modules)


def _sleeves(i: int) -> list[str]:
    """The geoms of module i on the body that it stands on."""
    return [f"{part}_{i}_sleeve" for part in _PARTS]


def _rods(i: int) -> list[str]:
    """The geoms of module i on its own body."""
    return [f"plate_{i}", *(f"{part}_{i}_rod" for part in _PARTS)]


def _reactions(i: int) -> list[str]:
    return [f"reaction_{a}_{i}" for a, _ in _COLUMN_SIDES]


def _add_module(spec: mujoco.MjSpec, i: int) -> None:
    parent = spec.body(f"module_{i - 1}")
    body = parent.add_body(name=f"module_{i}", mass=1.0, inertia=[1.0] * 3, explicitinertial=True)
    joints = [
        body.add_joint(spec.find_default(kind), name=f"{name}_{i}")
        for kind, name in (("slide", "s"), ("hinge", "theta"))
    ]
    for owner, geoms in ((parent, _sleeves), (body, _rods)):
        for name, name_alike in zip(geoms(i), geoms(i - 1), strict=True):
            alike: mujoco.MjsGeom = spec.geom(name_alike)
            owner.add_geom(alike.classname, name=name, size=alike.size, fromto=alike.fromto)
    for joint in joints:
        _add_sensor(spec, joint.name, "position", "JOINTPOS", "JOINT")
        _add_sensor(spec, joint.name, "velocity", "JOINTVEL", "JOINT")
    for a, side in _COLUMN_SIDES:
        tendon = spec.add_tendon(name=f"column_{a}_{i}")
        for joint, moment in zip(joints, (1.0, side), strict=True):
            tendon.wrap_joint(joint.name, moment)
        push = spec.add_actuator(spec.find_default("column"), name=f"push_{a}_{i}")
        push.trntype, push.target = mujoco.mjtTrn.mjTRN_TENDON, tendon.name
        _add_sensor(spec, tendon.name, "length", "TENDONPOS", "TENDON")
        _add_sensor(spec, tendon.name, "velocity", "TENDONVEL", "TENDON")


def _add_reaction(spec: mujoco.MjSpec, i: int) -> None:
    name = f"reaction_{i}"
    spec.body(f"module_{i - 1}").add_site(spec.find_default("reaction"), name=name)
    for motor_name in _reactions(i):
        motor = spec.add_actuator(spec.find_default("column"), name=motor_name, group=1)
        motor.trntype, motor.target = mujoco.mjtTrn.mjTRN_SITE, name


def _add_sensor(spec: mujoco.MjSpec, target: str, quantity: str, kind: str, of: str) -> None:
    sensor = getattr(mujoco.mjtSensor, f"mjSENS_{kind}")
    thing = getattr(mujoco.mjtObj, f"mjOBJ_{of}")
    spec.add_sensor(name=f"{target}_{quantity}", type=sensor, objtype=thing, objname=target)
