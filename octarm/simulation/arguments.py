"""Whether arguments, and answers of code that users write, are what the loop can work with.

What is wrong is blamed on whoever said it: an argument, the reference or the controller.
"""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from octarm.arm.parameters import ArmParameters
from octarm.disturbances.episode import Disturbance
from octarm.errors import OctarmError, quoted
from octarm.interfaces import Command
from octarm.references import REAL, REFERENCES
from octarm.simulation.stepping import AnyPhysics

_DISTURBANCES = "a list of disturbances, such as ['noise:10%'], or of those of octarm.disturbances"


def whole_number(name: str, value: Any, at_least: int, at_most: int | None = None) -> int:
    """An argument that counts something; a number with a point or a truth value counts nothing.

    Raises OctarmError unless it is a whole number of at least and at most so much.
    """
    try:
        number = None if isinstance(value, bool | np.bool) else operator.index(value)
    except TypeError:
        number = None
    if number is None:
        raise OctarmError(f"{name} is {quoted(cast(object, value))}; it must be a whole number")
    if number < at_least or (at_most is not None and number > at_most):
        most = "" if at_most is None else f" and at most {at_most}"
        raise OctarmError(f"{name} is {quoted(number)}; it must be at least {at_least}{most}")
    return number


def check_real(name: str, value: Any) -> None:
    """Raises OctarmError unless an argument is a real number, of any size."""
    if isinstance(value, bool) or not isinstance(value, float | int | np.floating | np.integer):
        raise OctarmError(f"{name} is {quoted(cast(object, value))}; it must be a number")


def check_load(reference: Any, disturbances: Any, parameters: Any, seed: Any, **times: Any) -> None:
    """Raises OctarmError for arguments of `octarm.load` that are things of another kind."""
    for name, value in times.items():
        if value is not None:
            check_real(name, value)
    if isinstance(reference, type) or not (isinstance(reference, str) or callable(reference)):
        known = ", ".join(REFERENCES)
        raise OctarmError(
            f"reference is {quoted(reference)}; it must be a function of time or one of {known}"
        )
    if isinstance(disturbances, str) or not isinstance(disturbances, Sequence):
        raise OctarmError(f"disturbances is {quoted(disturbances)}; it must be {_DISTURBANCES}")
    for item in cast("Sequence[object]", disturbances):
        if not isinstance(item, str | Disturbance):
            raise OctarmError(f"disturbances holds {quoted(item)}; it must be {_DISTURBANCES}")
    if parameters is not None and not isinstance(parameters, ArmParameters):
        raise OctarmError(f"parameters is {quoted(parameters)}; it must be ArmParameters")
    if isinstance(seed, list | tuple):
        for item in cast("Sequence[object]", seed):
            if not isinstance(item, np.random.SeedSequence):
                raise OctarmError(f"seed holds {quoted(item)}; it must hold a SeedSequence an arm")
    elif not isinstance(seed, np.random.SeedSequence):
        whole_number("seed", seed, 0)


def check_simulation(environment: Any, controller: Any, duration: Any) -> None:
    """Raises OctarmError for arguments of the loop that are things of another kind."""
    try:
        physics = environment.physics
    except AttributeError:
        physics = None
    if not isinstance(physics, AnyPhysics):
        raise OctarmError(
            f"the environment is {quoted(environment)}; it must be what octarm.load returns"
        )
    if environment.task.flat:
        raise OctarmError(
            "the environment has flat observations; a loop needs them one by one, as octarm.load "
            "gives them without flat_observation"
        )
    check_real("duration", duration)
    if (
        isinstance(controller, type)
        or not callable(controller)
        or not callable(getattr(controller, "initial_state", None))
    ):
        raise OctarmError(
            f"the controller is {quoted(controller)}; it must be an object with initial_state that "
            "can be called, as octarm.interfaces.Controller says"
        )


def commanded(answer: Any, shape: tuple[int, ...], *, first: bool) -> tuple[Command, Any]:
    """What a controller answers: a command and its state, the force of this shape (..., 2N).

    Signals and layer are looked at at the `first` answer of a run. Raises OctarmError unless the
    force is an array of real numbers, of this shape.
    """
    pair = cast("tuple[Any, ...]", answer)
    if type(answer) is not tuple or len(pair) != 2 or not isinstance(pair[0], Command):
        raise OctarmError(
            f"the controller answers {quoted(pair)}; it must be a pair, a Command and the state"
        )
    command, force = pair[0], pair[0].force
    if type(force) is not np.ndarray or force.dtype.kind not in REAL:
        raise OctarmError(
            f"the controller's force is {quoted(force)}; it must be an array of real numbers"
        )
    if force.shape != shape:
        raise OctarmError(f"the controller's force has shape {force.shape}; the arm needs {shape}")
    if first:
        _check_signals(command, shape)
    return command, pair[1]


def _check_signals(command: Command, shape: tuple[int, ...]) -> None:
    signals: Any = command.signals
    if not isinstance(signals, Mapping):
        raise OctarmError(f"the controller's signals are {quoted(signals)}; they must be a dict")
    for name, signal in cast("Mapping[object, Any]", signals).items():
        array = np.asarray(signal)
        if not isinstance(name, str) or array.dtype.kind not in REAL + "b":
            raise OctarmError(
                f"the controller's signal {quoted(name)} is {quoted(signal)}; it must have a name "
                "and be an array of real numbers"
            )
    if command.layer is not None:
        layer = np.asarray(command.layer)
        fits = layer.ndim <= len(shape) and all(
            n in (1, m) for n, m in zip(layer.shape[::-1], shape[::-1], strict=False)
        )
        if layer.dtype.kind not in REAL or not fits:
            raise OctarmError(
                f"the controller's layer is {quoted(command.layer)}; it must be real numbers that "
                f"broadcast to {shape}"
            )
