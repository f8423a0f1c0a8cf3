"""The whole contract between the control loop and a controller.

Once every control period the loop measures the arm, asks the reference what is wanted, and calls
the controller:

    command, state = controller(state, measurement, reference)

`command.force` is a generalised force Q. The loop turns it into the actuators' input forces with
what a controller may know, tau = F_coeff(q measured)^-1 Q, and holds tau until the next period.
What of tau is beyond the arm's input range is cut off; a controller may know this too, see
`NominalModel.input_range`.

A controller is a frozen dataclass of gains, complete once constructed. It keeps nothing between
calls: what it has to remember is the `state` it returns, and that state is handed back at the next
call. The state that is passed in is consumed: its memory may be reused, so the caller goes on with
the returned one. A controller has no clock and no randomness. It never sees the true plant; it is
given a `NominalModel` when it is built, and asks that for all it has to know of the arm.

All arrays carry the coordinate on the last axis, in the order q = [s1..sN, theta1..thetaN], and
any batch axes before it: the same controller serves one arm and ten thousand. Gains broadcast
against the batch. SI units: slides in m, angles in rad.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np


class Measurement(NamedTuple):
    """What the sensors report at one instant.

    Attributes:
        t: time since the start of the episode [s].
        q: generalised coordinates, shape (..., 2N) [m], [rad].
        v: generalised velocities, shape (..., 2N) [m/s], [rad/s].
    """

    t: float
    q: np.ndarray
    v: np.ndarray


class Reference(NamedTuple):
    """What is wanted at one instant.

    Attributes:
        q: desired coordinates q_d, shape (..., 2N) [m], [rad].
        v: desired velocities, shape (..., 2N) [m/s], [rad/s].
        a: desired accelerations, shape (..., 2N) [m/s^2], [rad/s^2].
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


class Command(NamedTuple):
    """What a controller answers.

    Attributes:
        force: generalised force Q, shape (..., 2N) [N], [N m].
        signals: inner quantities worth recording, by name: the batch axes, then the signal's own,
            mostly (..., 2N), or (..., 2N, M) for M fuzzy rules a coordinate. The loop records
            what is there. Two names have a meaning for those who read the record: `s`, the sliding
            variable, shape (..., 2N) [m/s], [rad/s], and `reaching_bound`, the time within which
            s = 0 is promised, shape (..., 1) or (..., 2N) [s].
        layer: half width phi of the boundary layer around s = 0, broadcasts to (..., 2N) [m/s],
            [rad/s]; None where there is no layer. It is taken from the first command of a run.
    """

    force: np.ndarray
    signals: Mapping[str, np.ndarray] = MappingProxyType({})
    layer: np.ndarray | None = None


class Within(NamedTuple):
    """What happened at the m physics steps of one control period.

    Attributes:
        q: true coordinates when each step began, shape (m, ..., 2N) [m], [rad].
        q_d: desired coordinates then, broadcasts to the same shape [m], [rad].
        received: input forces that reached the arm in each step, shape (m, ..., 2N) [N]: those
            that were asked for, after the input range and all that is wrong with the actuators.
        plant_tip: as in `Instant` when each step began, shape (m, ..., 2) [m]; None where the plant
            is the arm itself, or there is one step.
    """

    q: np.ndarray
    q_d: np.ndarray
    received: np.ndarray
    plant_tip: np.ndarray | None = None


class Instant(NamedTuple):
    """One control instant as the loop hands it to its observers.

    Attributes:
        measurement: what the controller received.
        reference: what was wanted.
        command: what the controller answered.
        q: true coordinates, shape (..., 2N) [m], [rad].
        v: true velocities, shape (..., 2N) [m/s], [rad/s].
        tau: input forces that are asked for until the next instant, shape (..., 2N) [N].
        disturbance: generalised force that was added, mean over the period, shape (..., 2N) [N],
            [N m].
        plant_q: true coordinates of all modules of a plant of more modules, shape (..., 2K) [m],
            [rad]; None where the plant is the arm itself.
        plant_tip: where its tip is in the base frame, x along the hanging arm, y across, shape
            (..., 2) [m]; likewise.
        within: the physics steps of the period; None if they are not known.
    """

    measurement: Measurement
    reference: Reference
    command: Command
    q: np.ndarray
    v: np.ndarray
    tau: np.ndarray
    disturbance: np.ndarray
    plant_q: np.ndarray | None = None
    plant_tip: np.ndarray | None = None
    within: Within | None = None


# k consecutive control instants as named fields, each of shape (k, ...): `t`, `q`, `v`, `q_d`,
# `v_d`, `tau`, `force` and `disturbance` as in `Instant`, `plant_q` and `plant_tip` where there are
# any, the controller's signals by name, and `q_measured` and `v_measured` where one arm is recorded
# whose sensors do not read q and v. Those of `WITHIN` have shape (k, m, ...) for the m physics
# steps of a control period, see `Within`; but for `received` they are there only if m > 1, since
# for m = 1 they are `q`, `q_d` and `plant_tip`.
# The arrays are read-only for whoever gets them, and their memory may be used again afterwards.
Rows = Mapping[str, np.ndarray]
WITHIN = ("received", "q_steps", "q_d_steps", "plant_tip_steps")


class NominalModel(Protocol):
    """What a controller believes of the arm. `octarm.arm.nominal.LagrangeModel` is one.

    N modules have 2N coordinates. The batch axes of a model's parameters broadcast against those of
    the arguments; q, v, a and v_r have shape (..., 2N) [m], [rad] and their rates. A method raises
    OctarmError when the last axis of an argument is not 2N long.
    """

    @property
    def modules(self) -> int:
        """Number of modules N."""
        ...

    @property
    def coordinates(self) -> int:
        """Number of coordinates 2N."""
        ...

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the coordinates, in the order of q."""
        ...

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the coordinates, "m" or "rad", in the order of q."""
        ...

    @property
    def scale(self) -> np.ndarray:
        """The size of a large motion: the rest length, or 1 rad, shape (..., 2N) [m], [rad]."""
        ...

    @property
    def time_scale(self) -> np.ndarray:
        """How fast the arm is: 1 / omega of its fastest mode, shape () or (..., 1) [s]."""
        ...

    @property
    def force_scale(self) -> np.ndarray:
        """The force that moves each coordinate by `scale` in about `time_scale`, shape (..., 2N).

        In [N], [N m]: of similar arms it scales as all their forces do.
        """
        ...

    @property
    def descriptors(self) -> Mapping[str, np.ndarray]:
        """Ratios that similar arms have in common, by name, each of shape (...) [1]."""
        ...

    @property
    def input_range(self) -> tuple[np.ndarray, np.ndarray]:
        """The lowest and the highest input forces tau, each of shape (..., 2N) [N]."""
        ...

    def inverse_dynamics(
        self, q: np.ndarray, v: np.ndarray, a: np.ndarray, v_r: np.ndarray | None = None
    ) -> np.ndarray:
        """D(q) a + (C(q, v) + B) v_r + G(q), shape (..., 2N) [N], [N m]; v_r is v if not given."""
        ...

    def mass_matrix(self, q: np.ndarray) -> np.ndarray:
        """Inertia matrix D(q), shape (..., 2N, 2N)."""
        ...

    def kinetic_energy(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """1/2 v^T D(q) v, shape (...) [J]."""
        ...

    def potential_force(self, q: np.ndarray) -> np.ndarray:
        """G(q), the force that holds the arm still at q, shape (..., 2N) [N], [N m]."""
        ...

    def force_coefficients(self, q: np.ndarray) -> np.ndarray:
        """F_coeff(q) of Q = F_coeff(q) tau, shape (..., 2N, 2N) [1], [m]."""
        ...

    def shortfall(self, q: np.ndarray, force: np.ndarray) -> np.ndarray | None:
        """What of a force Q is lost when its input forces are cut off at their range.

        It is F_coeff(q) (tau - tau within the range) with tau = F_coeff(q)^-1 Q, shape (..., 2N)
        [N], [N m]; None if nothing is cut off of any arm.
        """
        ...

    def equilibrium(self) -> np.ndarray:
        """The coordinates at which the arm hangs still, shape (..., 2N) [m], [rad]."""
        ...

    def largest_inertia(self, q: np.ndarray) -> np.ndarray:
        """An upper bound on D_ii over all bends of modules as long as in q, shape (..., 2N)."""
        ...

    def largest_error(
        self, uncertainty: np.ndarray, q: np.ndarray, v: np.ndarray, a: np.ndarray, v_r: np.ndarray
    ) -> np.ndarray:
        """The largest error of `inverse_dynamics`, shape (..., 2N) [N], [N m].

        The uncertainty is the share in [0, 1) by which the parameters may be off, shape () or
        (..., 1).
        """
        ...


class Controller(Protocol):
    """Anything that can be called like a controller."""

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> Any:
        """The state before the first call, for arms of this batch shape; () for one arm."""
        ...

    def __call__(
        self, state: Any, measurement: Measurement, reference: Reference
    ) -> tuple[Command, Any]:
        """The command for this instant, and the state to pass in at the next one."""
        ...


# Makes a controller: from its name, its nominal model of the arm and the gains that differ from
# those of its gain set, which a keyword `gain_set` names. `controllers.make_controller` is one.
ControllerFactory = Callable[..., Controller]


class Knob(NamedTuple):
    """A factor by which tuning multiplies the recommended values of gains.

    The usual range, three decades both ways, is meant to be free: a search that ends at one of its
    ends says so. A narrower one needs a reason, which stands where the knob is declared.

    Attributes:
        name: of the knob, for people and files.
        low: smallest factor [1].
        high: largest factor [1].
        apart: whether slides and bends have a factor each.
        gains: names of the gains that it multiplies.
    """

    name: str
    low: float = 0.001
    high: float = 1000.0
    apart: bool = False
    gains: tuple[str, ...] = ()


class Tunable(Controller, Protocol):
    """A controller whose gains can be tuned."""

    def knobs(self) -> tuple[Knob, ...]:
        """What tuning may turn; every gain belongs to one knob at most."""
        ...

    def scales(self) -> Mapping[str, np.ndarray]:
        """What a gain is divided by to be a number that suits all similar arms, by name [SI].

        Each broadcasts to the shape of the gain. All gains that are numbers have one.
        """
        ...


class Motion(Protocol):
    """A desired motion: a pure function of time."""

    def __call__(self, t: float) -> Reference:
        """The desired coordinates, velocities and accelerations at time t [s]."""
        ...
