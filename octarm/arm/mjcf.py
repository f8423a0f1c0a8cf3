"""From MJCF to a compiled model, for any parameters and any number of modules.

`models/octarm.xml` is the template. Its base frame hangs from the ceiling: x down along the arm,
y to the right, so that a point (x, y) of `octarm.lagrange` is (y, 0, -x) in MuJoCo's world frame.
MuJoCo orders the coordinates along the arm, q = [s1, theta1, s2, ..]; outside this module they are
always in the paper's order, q = [s1..sN, theta1..thetaN].

The motors exert F_coeff(q) tau, eq (2), in every state: `ctrl` holds tau, and then tau of the
modules from the second on once more, for the motors that put the reactions on the ground.
"""

from __future__ import annotations

import copy
import functools
import itertools
import operator
import re
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np

from octarm.arm.lagrange import NO_EQUILIBRIUM, newton, potential_hessian
from octarm.arm.parameters import MOST_MODULES, ArmParameters
from octarm.errors import FileError, OctarmError

_COLUMN_SIDES = ((1, 1.0), (2, -1.0))  # column 1 lengthens with +theta
_FARTHEST = 1e9  # [m], [rad]; of springs so soft, MuJoCo's forces are nothing but rounding
_NUMBER = re.compile(r"(?<=_)\d+(?=(_[a-z]+)?$)")  # of its module, in the name of a part


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

    Raises OctarmError if it is not within 1e-7 to 0.1 s.
    """
    if timestep is None:
        return _nominal_step()
    if not 1e-7 <= timestep <= 0.1:
        raise OctarmError(f"timestep is {timestep:g} s; it must be between 1e-07 and 0.1 s")
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
    if p.batch_shape:
        raise OctarmError(f"parameters have batch axes {p.batch_shape}; a model describes one arm")
    if p.modules > MOST_MODULES:
        raise OctarmError(
            f"the arm has {p.modules} modules; it must have at most {MOST_MODULES}, since the time "
            "of a physics step grows with their square"
        )
    spec = mujoco.MjSpec.from_string(_xml(p.modules))
    spec.option.timestep = physics_step(timestep)
    nominal = nominal_parameters()
    low, high = p.input_bounds(())
    for i in range(1, p.modules + 1):
        body = spec.body(f"module_{i}")
        body.mass, body.inertia = p.mass[i - 1], [p.inertia[i - 1]] * 3
        for column, (a, _) in enumerate(_COLUMN_SIDES, start=2 * (i - 1)):
            spec.actuator(f"push_{a}_{i}").ctrlrange = [low[column], high[column]]
    for geom in spec.geoms:
        if (number := _NUMBER.search(geom.name)) and (i := int(number[0])):
            alike = min(i, nominal.modules) - 1  # the module of the template that it is drawn like
            longer = float(p.rest_length[i - 1] / nominal.rest_length[alike])
            wider = float(p.widths[i - 1] / nominal.widths[alike])
            geom.fromto = np.array(geom.fromto) * np.tile([longer, wider, 1.0], 2)
            geom.size = np.array(geom.size) * wider
    spec.site("tip").pos = [float(p.tip_length), 0.0, 0.0]
    return spec


def _xml(modules: int) -> str:
    """The template cut to N modules, or extended by copies of its last one with other numbers."""
    root = ElementTree.parse(model_path()).getroot()
    bodies = list(root.iter("body"))  # each within the one before it, from the base on
    last, tip = len(bodies) - 1, bodies[-1][-1]
    bodies[-1].remove(tip)
    on_parent = copy.deepcopy([part for part in bodies[-2] if _module_of(part) == last])
    for body in bodies:
        body[:] = [part for part in body if _module_of(part) <= modules]
    for section in root:
        if section.tag in ("tendon", "actuator", "sensor"):
            section[:] = [*_for_all_modules(section, last, modules)]
    for key in root.iter("key"):
        key.set("qpos", " 0" * (2 * modules))
    for i in range(last + 1, modules + 1):
        copies = [_renumbered(part, last, i) for part in on_parent]
        bodies[-1].extend(copies)
        bodies += [part for part in copies if part.tag == "body"]
    bodies[modules].append(tip)
    return ElementTree.tostring(root, "unicode")


def _for_all_modules(
    section: ElementTree.Element, last: int, modules: int
) -> Iterator[ElementTree.Element]:
    """Its parts for N modules, those of further ones behind those of the template's last one."""
    for number, group in itertools.groupby(section, _module_of):
        parts = list(group)
        yield from parts if number <= modules else ()
        for i in range(last + 1, modules + 1) if number == last else ():
            yield from (_renumbered(part, last, i) for part in parts)


def _renumbered(part: ElementTree.Element, last: int, i: int) -> ElementTree.Element:
    """A copy for module i of a part of the template's last module."""
    text = ElementTree.tostring(part, "unicode")
    return ElementTree.fromstring(re.sub(rf'_{last}(?=["_])', f"_{i}", text))


def _module_of(part: ElementTree.Element) -> int:
    """The number of its module, which its name has; 0 for what belongs to none."""
    number = _NUMBER.search(part.get("name", ""))
    return int(number[0]) if number else 0


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
        () or shape (n,) [rad]. True if inertias changed: MuJoCo's constants must then follow.
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
        for row, free in () if self._plain else enumerate((p.rest_length, p.rest_angle)):
            self._field("jnt_stiffness")[..., self._dof[row]] = p.backbone_stiffness[..., row, :]
            self._field("dof_damping")[..., self._dof[row]] = p.backbone_damping[..., row, :]
            self._field("qpos_spring")[..., self._qpos[row]] = free
        return bool(changed)
