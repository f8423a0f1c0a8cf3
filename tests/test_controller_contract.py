"""What every controller promises, whatever its law: one suite over the whole table of names."""

import dataclasses
import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from controllers import CONTROLLERS, make_controller
from controllers.law import gain_fields
from octarm.arm.lagrange import equilibrium, mass_matrix
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.interfaces import Controller, Measurement, Reference
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout

P = nominal_parameters()
NOT_MODEL_BASED = {"pd", "fuzzy"}
MODEL_BASED = [name for name in CONTROLLERS if name not in NOT_MODEL_BASED]
CALLS = 4  # consecutive ones, for the controllers that learn or integrate
PERIOD = 5e-4  # [s]

# Every controller at its recommended gains, and with its switching gain derived where it can be.
CASES = [
    pytest.param(name, gains, id=" ".join([name, *gains]))
    for name, kind in CONTROLLERS.items()
    for gains in ({}, *({f.replaced_by: 0.3} for f in gain_fields(kind).values() if f.replaced_by))
]
every_case = pytest.mark.parametrize(("name", "gains"), CASES)

Instant = tuple[Measurement, Reference]


def instants(batch: tuple[int, ...], p: ArmParameters = P, seed: int = 0) -> list[Instant]:
    """Random instants, one for each of the consecutive calls."""
    draw, n = np.random.default_rng(seed), p.modules
    scale = np.repeat([0.02, 0.3], n)

    def near(center: np.ndarray | float, size: float) -> np.ndarray:
        return center + size * scale * draw.normal(size=(*batch, 2 * n))

    rest = equilibrium(p)
    return [
        (
            Measurement(k * PERIOD, near(rest, 1.0), near(0.0, 5.0)),
            Reference(near(rest, 1.0), near(0.0, 5.0), near(0.0, 25.0)),
        )
        for k in range(CALLS)
    ]


def changed(instant: Instant, change) -> Instant:
    """The instant with each of its arrays changed by a function."""
    (t, q, v), reference = instant
    return Measurement(t, change(q), change(v)), Reference(*map(change, reference))


def rows(seen: list[Instant], index: Any) -> list[Instant]:
    """What some of the arms see."""
    return [changed(instant, lambda x: x[index]) for instant in seen]


def answers(
    controller: Controller, seen: list[Instant], batch: tuple[int, ...]
) -> Iterator[dict[str, np.ndarray]]:
    """Force and signals of consecutive calls, by name."""
    state = controller.initial_state(batch)
    for instant in seen:
        command, state = controller(state, *instant)
        yield {"force": command.force, **command.signals}


def arrays_in(thing: Any) -> Iterator[np.ndarray]:
    """The arrays in a state, a controller, or whatever is made of them."""
    if isinstance(thing, np.ndarray):
        yield thing
    elif dataclasses.is_dataclass(thing):
        for field in dataclasses.fields(thing):
            yield from arrays_in(getattr(thing, field.name))
    elif isinstance(thing, dict):
        yield from arrays_in(list(thing.values()))
    elif isinstance(thing, tuple | list):
        for part in thing:
            yield from arrays_in(part)


def assert_same(one: dict[str, np.ndarray], other: dict[str, np.ndarray], index: Any = ...) -> None:
    """Equal bit for bit; `index` says which arm of the second is the first."""
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name][index], err_msg=name)


@every_case
def test_an_arm_gets_the_same_bits_alone_and_in_any_batch(name: str, gains: dict):
    controller, seen = make_controller(name, P.mismatched(-0.3), gains), instants((257,))
    batch = list(answers(controller, seen, (257,)))
    contiguous = [changed(instant, np.asfortranarray) for instant in seen]
    for one, other in zip(batch, answers(controller, contiguous, (257,)), strict=True):
        assert_same(other, one)
    for i in (0, 1, 128, 256):
        alone = answers(controller, rows(seen, i), ())
        batch_of_1 = answers(controller, rows(seen, slice(i, i + 1)), (1,))
        for single, first, all_arms in zip(alone, batch_of_1, batch, strict=True):
            assert_same(single, all_arms, i)
            assert_same(single, first, 0)


@every_case
def test_calls_are_deterministic_and_start_again_from_the_initial_state(name: str, gains: dict):
    controller, seen = make_controller(name, P.mismatched(0.3), gains), instants((4,))
    before = [changed(instant, np.copy) for instant in seen]
    first = list(answers(controller, seen, (4,)))
    kept = [{key: array.copy() for key, array in answer.items()} for answer in first]
    list(answers(controller, instants((5,), seed=1), (5,)))
    for answer, again, copy in zip(first, answers(controller, seen, (4,)), kept, strict=True):
        assert_same(answer, again)
        assert_same(answer, copy)  # an answer stays as it was given
    for instant, copy in zip(seen, before, strict=True):
        for now, then in zip(arrays_in(instant), arrays_in(copy), strict=True):
            np.testing.assert_array_equal(now, then)
    with pytest.raises(dataclasses.FrozenInstanceError):
        controller.nominal = P  # pyright: ignore[reportAttributeAccessIssue]


@every_case
@pytest.mark.parametrize("batch", [(), (3,), (2, 3)], ids=str)
def test_answers_are_finite_floats_of_constant_shape(name: str, gains: dict, batch: tuple):
    controller = make_controller(name, P, gains)
    given = list(answers(controller, instants(batch), batch))
    alone = next(answers(controller, instants(()), ()))
    for answer in given:
        assert answer["force"].shape == (*batch, 6)
        assert answer.keys() == alone.keys()
        for key, array in answer.items():
            assert isinstance(array, np.ndarray), key
            assert array.shape == batch + alone[key].shape and array.ndim > len(batch), key
            assert array.dtype == np.float64 and np.all(np.isfinite(array)), key


@every_case
@pytest.mark.parametrize("batch", [(), (3,)], ids=str)
def test_no_two_things_share_memory(name: str, gains: dict, batch: tuple):
    """What a caller does to one array must not change another one."""
    controller = make_controller(name, P, gains)
    state = controller.initial_state(batch)
    for instant in instants(batch):
        command, state = controller(state, *instant)
        fresh = [command.force, *command.signals.values(), *arrays_in(state)]
        for one, other in itertools.combinations(fresh, 2):
            assert not np.shares_memory(one, other)
        for one, other in itertools.product(fresh, arrays_in([*instant, controller])):
            assert not np.shares_memory(one, other)


@every_case
def test_a_batch_may_share_one_reference(name: str, gains: dict):
    controller, seen = make_controller(name, P, gains), instants((3,))
    shared = [(measurement, Reference(*(x[0] for x in r))) for measurement, r in seen]
    same = [(measurement, Reference(*(x[[0, 0, 0]] for x in r))) for measurement, r in seen]
    one, other = (list(answers(controller, given, (3,))) for given in (shared, same))
    for answer, expected in zip(one, other, strict=True):
        assert_same(answer, expected)


@every_case
def test_the_parts_add_up(name: str, gains: dict):
    controller, seen = make_controller(name, P, gains), instants((50,))
    for instant, answer in zip(seen, answers(controller, seen, (50,)), strict=True):
        parts = [answer[part] for part in ("switching", "feedback") if part in answer]
        if "equivalent" in answer:
            np.testing.assert_allclose(answer["equivalent"] + parts[0], answer["force"], atol=1e-9)
        if "V" in answer:
            s, D = answer["s"], mass_matrix(P, instant[0].q)
            V = 0.5 * np.einsum("ni,nij,nj->n", s, D, s)
            np.testing.assert_allclose(answer["V"], V[:, None], rtol=1e-9)


PARTS = "s equivalent switching V"
REPORTED = {
    "pd": "s equivalent feedback",
    "computed-torque": "s equivalent feedback",
    "smc": PARTS,
    "smc-boundary": PARTS,
    "smc-integral": f"{PARTS} integral",
    "super-twisting": f"{PARTS} w",
    "fuzzy": "s fuzzy",
    "fsmc": PARTS,
    "afsmc-consequent": f"{PARTS} f_hat E theta",
    "afsmc": f"{PARTS} f_hat E theta alpha sigma",
}
ONE_AN_ARM, ONE_A_RULE = ("V",), ("theta", "alpha", "sigma")


@pytest.mark.parametrize("name", REPORTED)
def test_the_quantities_of_the_theory_are_reported(name: str):
    answer = next(answers(make_controller(name, P), instants((4,)), (4,)))
    shapes = dict.fromkeys(REPORTED[name].split(), (4, 6))
    shapes |= {key: (4, 1) for key in shapes if key in ONE_AN_ARM}
    shapes |= {key: (4, 6, 5) for key in shapes if key in ONE_A_RULE}
    assert {key: array.shape for key, array in answer.items() if key != "force"} == shapes


@every_case
def test_gains_broadcast_along_the_batch(name: str, gains: dict):
    """A batch of arms, each with its own gains, is the same as each arm on its own."""
    plain: Any = make_controller(name, P, gains)
    factors = (1.0, 0.8, 1.25)
    fields = {field.name: getattr(plain, field.name) for field in dataclasses.fields(plain)}
    own = {
        key.rstrip("_"): [factor * value for factor in factors]
        for key, value in fields.items()
        if isinstance(value, np.ndarray)
    }
    many = make_controller(name, P, {key: _stacked(key, values) for key, values in own.items()})
    seen = instants((3,))
    batch = list(answers(many, seen, (3,)))
    for i in range(3):
        single = make_controller(name, P, {key: values[i] for key, values in own.items()})
        alone = answers(single, rows(seen, i), ())
        for one, all_arms in zip(alone, batch, strict=True):
            assert_same(one, all_arms, i)


def _stacked(name: str, values: list) -> np.ndarray:
    """One gain an arm: (n, 1) or (n, 2N), and (n, 1, M) for M rules that all coordinates share."""
    table = np.stack(values)
    if name in ("alpha0", "sigma0"):
        return table[:, None, :] if table.ndim == 2 else table
    return table[:, None] if table.ndim == 1 else table


WRONG = {
    "q has shape (5,); its last axis must hold 6 coordinates for 3 modules": {"q": 5},
    "v has shape (7,); its last axis must hold 6 coordinates for 3 modules": {"v": 7},
    "a_d has shape (1,); its last axis must hold 6 coordinates for 3 modules": {"a_d": 1},
    "the batch axes of one instant do not fit: q (2, 6), v (3, 6), q_d (6,), v_d (6,), a_d (6,)": {
        "q": (2, 6),
        "v": (3, 6),
    },
}


@pytest.mark.parametrize("name", CONTROLLERS)
@pytest.mark.parametrize("message", WRONG)
def test_a_wrong_shape_is_refused_in_one_sentence(name: str, message: str):
    arrays = {key: np.zeros(WRONG[message].get(key, 6)) for key in ("q", "v", "q_d", "v_d", "a_d")}
    q, v, *wanted = arrays.values()
    controller = make_controller(name, P)
    with pytest.raises(ValueError) as refusal:
        controller(controller.initial_state(), Measurement(0.0, q, v), Reference(*wanted))
    assert str(refusal.value) == message


@pytest.mark.parametrize("name", CONTROLLERS)
@pytest.mark.parametrize("modules", [1, 5])
def test_any_number_of_modules(name: str, modules: int):
    n = np.ones(modules)
    arm = ArmParameters(
        mass=0.2 * n,
        inertia=5e-4 * n,
        width=0.08,
        stiffness=1000.0 * np.ones((2, modules)),
        damping=10.0 * np.ones((2, modules)),
        rest_length=0.1 * n,
        gravity=9.81,
    )
    run = rollout(load(parameters=arm), make_controller(name, arm), 0.3)
    assert run.status == "ok"
    largest = 0.03 if name in REPORTED and name not in NOT_MODEL_BASED else 0.1
    if name == "fuzzy":  # whose force is bounded by what the last angle of a longer arm needs
        largest = 0.3
    assert np.max(np.abs(run.error[-100:])) < largest


@pytest.mark.parametrize("name", MODEL_BASED)
def test_the_exact_model_tracks_the_default_reference_below_one_percent(name: str):
    rms = rms_error_over_half_a_period(make_controller(name, P))
    assert np.all(rms[3:5] < 0.01 * AMPLITUDE)
    assert np.all(rms[:3] < 1e-5) and rms[5] < 1e-3


@pytest.mark.parametrize("name", sorted(NOT_MODEL_BASED))
def test_the_others_follow_it_from_afar(name: str):
    rms = rms_error_over_half_a_period(make_controller(name, P.mismatched(-0.3)))
    assert np.all(rms[3:5] < 0.1 * AMPLITUDE)


AMPLITUDE = np.array([0.35, 0.25])  # of theta1 and theta2 in the default sine [rad]


def rms_error_over_half_a_period(controller: Controller) -> np.ndarray:
    """On the default sine of 0.5 Hz, once the arm has reached it."""
    run = rollout(load(), controller, 1.5)
    assert run.status == "ok"
    return np.sqrt(np.mean(run.error[run.t >= 0.5] ** 2, axis=0))
