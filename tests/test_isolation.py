"""A controller sees its nominal model and its readings, and never the plant."""
# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)

import gc
import json
import types
from collections import deque
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from dm_control.mujoco import wrapper
from dm_control.rl import control
from mujoco.batch import Batch
from test_disturbances import SPELLINGS

from controllers import CONTROLLERS, make_controller
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.commands import cli
from octarm.disturbances.active import ActiveDisturbances
from octarm.disturbances.episode import Disturbance, Episode
from octarm.disturbances.ledger import Ledger
from octarm.disturbances.spelling import parse_disturbance
from octarm.interfaces import Command, Controller, Measurement, Reference
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout, simulate
from octarm.simulation.task import TrackingTask

P = nominal_parameters()
ALL = [parse_disturbance(text) for text in SPELLINGS.values()]
OF_THE_PLANT = (
    mujoco.MjModel,
    mujoco.MjData,
    mujoco.MjSpec,
    wrapper.MjModel,
    wrapper.MjData,
    Batch,
    control.Physics,
    control.Environment,
    control.Task,
    TrackingTask,
    ActiveDisturbances,
    Disturbance,
    Episode,
    Ledger,
    np.random.Generator,
    np.random.SeedSequence,
)


class Witness:
    """A controller that keeps all that a law is called with, as it was given."""

    def __init__(self, law: Controller) -> None:
        self.law = law
        self.given: list[Any] = []

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> Any:
        return self.law.initial_state(batch_shape)

    def __call__(
        self, state: Any, measurement: Measurement, reference: Reference
    ) -> tuple[Command, Any]:
        self.given += [state, measurement, reference]
        command, state = self.law(state, measurement, reference)
        self.given += [command, state]
        return command, state


def reachable(roots: Iterable[Any]) -> Iterator[Any]:
    """Every object that can be got at from these, one reference after another.

    Code is left out, with the modules that it sees: `test_layers` says what controllers import.
    """
    code = (types.ModuleType, types.CodeType, types.FrameType, types.BuiltinFunctionType)
    seen: set[int] = set()
    waiting = deque(roots)
    kept = []  # so that no number is used again
    while waiting:
        thing = waiting.popleft()
        if id(thing) in seen or isinstance(thing, code):
            continue
        seen.add(id(thing))
        kept.append(thing)
        yield thing
        if isinstance(thing, types.FunctionType):
            waiting += [thing.__closure__, thing.__defaults__, thing.__kwdefaults__, thing.__dict__]
        else:
            waiting += gc.get_referents(thing)
            if isinstance(thing, np.ndarray):  # into which the collector does not look
                waiting += [thing.base, *(thing.flat if thing.dtype.hasobject else ())]


def plant_arrays(environment: control.Environment) -> list[np.ndarray]:
    """All memory of MuJoCo's model and data, or of a batch."""
    physics = environment.physics
    if physics.batch_shape:
        batch = physics.batch
        fields = ["qpos", "qvel", "ctrl", "qfrc_applied"]
        expanded = ["body_mass", "body_inertia", "tendon_stiffness", "opt.gravity"]
        bound = [batch.bind(name) for name in fields]
        return [batch.state, *bound, *(batch.expand(name) for name in expanded)]
    out = []
    for holder in (physics.model.ptr, physics.data.ptr, physics.model.ptr.opt):
        for name in dir(holder):
            value = None if name.startswith("_") else getattr(holder, name, None)
            if isinstance(value, np.ndarray) and value.size:
                out.append(value)
    assert len(out) > 300
    return out


def test_the_search_finds_what_is_hidden():
    """Otherwise the tests below would show nothing."""
    environment = load()
    hidden = [
        {"deep": [(environment,)]},
        lambda: environment,
        environment.step,  # a bound method
        type("Controller", (), {"plant": environment}),
        iter([environment]),
        np.array([environment], dtype=object),
    ]
    for thing in hidden:
        assert any(isinstance(x, mujoco.MjModel) for x in reachable([thing]))
    view = environment.physics.data.ptr.qpos[1:][:2]
    assert any(np.may_share_memory(view, other) for other in plant_arrays(environment))


@pytest.mark.parametrize("batch", [None, 2])
@pytest.mark.parametrize("name", CONTROLLERS)
def test_no_controller_can_reach_the_plant(name: str, batch: int | None):
    environment = load(disturbances=ALL, batch=batch)
    law = make_controller(name, P.mismatched(-0.3))
    witness = Witness(law)
    simulate(environment, witness, 0.005, lambda instant: None)
    things = list(reachable([law, *witness.given]))
    assert len(witness.given) == 50
    for thing in things:
        assert not isinstance(thing, OF_THE_PLANT), f"{name} reaches a {type(thing).__name__}"
    memory = plant_arrays(environment)
    mine = [thing for thing in things if isinstance(thing, np.ndarray) and thing.size]
    assert len(mine) > 10
    for array in mine:
        assert not any(np.may_share_memory(array, other) for other in memory)


def test_the_models_share_no_memory_whatever_the_mismatch():
    environment = load(parameters=P)
    for nominal in (P, P.mismatched(0.0), P.mismatched(0.3), P.scaled()):
        for name in ("mass", "inertia", "width", "stiffness", "damping", "rest_length", "gravity"):
            own = getattr(nominal, name)
            assert not own.flags.writeable
            memory = plant_arrays(environment)
            assert not any(np.may_share_memory(own, other) for other in memory)


class Vandal:
    """Writes into all that it is given, as far as it can."""

    def __init__(self, arrays: str, force: float = 0.1) -> None:
        self.arrays, self.force = arrays, force
        self.wrote = 0

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> None:
        del batch_shape

    def __call__(
        self, state: None, measurement: Measurement, reference: Reference
    ) -> tuple[Command, None]:
        for array in (measurement.q, measurement.v, *reference):
            if self.arrays == "views":
                with pytest.raises(ValueError, match="read-only"):
                    array[...] = 1e3
            elif self.arrays == "bases" and array.base is not None:
                array.base[...] = 1e3  # behind the view's back
            self.wrote += 1
        return Command(np.full_like(measurement.q, self.force), {}), state


@pytest.mark.parametrize("batch", [None, 2])
@pytest.mark.parametrize("listed", [[], ALL], ids=["undisturbed", "disturbed"])
def test_writing_into_what_it_is_given_moves_nothing(listed: list[Disturbance], batch: int | None):
    rows: dict[str, list[np.ndarray]] = {}
    for arrays in ("none", "views", "bases"):
        # Inputs do not depend on the readings: forces between neighbours.
        environment = load(disturbances=listed, batch=batch, actuation="internal")
        vandal = Vandal(arrays)
        seen = rows[arrays] = []
        simulate(environment, vandal, 0.01, lambda instant, seen=seen: seen.append(instant.q))
        assert vandal.wrote == 100
    np.testing.assert_array_equal(rows["views"], rows["none"])
    np.testing.assert_array_equal(rows["bases"], rows["none"])


def test_changing_the_answer_afterwards_moves_nothing():
    class Late(Vandal):
        """Reuses one array for all its answers, and writes nonsense into the last one."""

        answer = np.zeros(6)

        def __call__(self, state, measurement, reference):
            self.answer[...] = 1e7
            self.answer = np.full_like(measurement.q, self.force)
            return Command(self.answer, {}), state

    runs = [rollout(load(disturbances=ALL), kind("none"), 0.01) for kind in (Vandal, Late)]
    assert runs[0].digest == runs[1].digest


def test_no_callback_of_the_process_is_used():
    rollout(load(disturbances=ALL), make_controller("pd", P), 0.005)
    for name in dir(mujoco):
        if name.startswith("get_mjcb_"):
            assert getattr(mujoco, name)() is None


def test_the_nominal_model_stands_beside_the_true_one(tmp_path: Path):
    """The truth that the controller does not know is in the ledger, not in its model."""
    options = ["--mismatch", "-0.3", "--disturbance", "payload:0.2", "--disturbance", "tilt:0.1"]
    out = str(tmp_path / "run")
    assert cli.main(["run", "--duration", "0.01", "--out", out, *options]) == 0
    description = json.loads((tmp_path / "run/run.json").read_text())
    true, nominal = (ArmParameters.from_dict(description[k]) for k in ("parameters", "nominal"))
    assert true.to_dict() == P.to_dict()
    assert nominal.to_dict() == P.mismatched(-0.3).to_dict()
    load_row, tilt_row = description["disturbances"]
    assert load_row["delivered"]["mass"]["end"] == [0.3, 0.25, 0.4]
    assert tilt_row["delivered"]["gravity_angle"]["end"] == pytest.approx(0.1)
