"""What is wrong in a loop is blamed on whoever said it: an argument, the reference, the law."""
# pyright: reportArgumentType=false
# (that is what these tests are about)

import dataclasses
import re

import numpy as np
import pytest

import octarm
from controllers import make_controller
from octarm.disturbances.spelling import parse_disturbance
from octarm.errors import OctarmError
from octarm.interfaces import Command, Reference
from octarm.simulation.rollout import simulate

ZERO, REST = np.zeros(6), np.repeat([0.12, 0.0], 3)


def still(t):
    return Reference(REST, ZERO, ZERO)


@dataclasses.dataclass(frozen=True)
class Law:
    """Answers what it is told to from an instant on, and nothing wrong before."""

    answer: object = None
    since: float = 0.0

    def initial_state(self, batch_shape=()):
        return ()

    def __call__(self, state, measurement, reference):
        if measurement.t < self.since:
            return Command(np.zeros_like(measurement.q), {"s": measurement.q}), state
        return self.answer(measurement) if callable(self.answer) else self.answer


BAD_ARGUMENTS = {
    "seed is 1.5; it must be a whole number": {"seed": 1.5},
    "seed is True; it must be": {"seed": True},
    "seed is None; it must be": {"seed": None},
    "seed is 'x'; it must be": {"seed": "x"},
    "seed is -1; it must be at least 0": {"seed": -1},
    "seed holds 3; it must hold a SeedSequence": {"seed": [3]},
    "batch is 2.0; it must be a whole number": {"batch": 2.0},
    "batch is True; it must be": {"batch": True},
    "batch is '2'; it must be": {"batch": "2"},
    "batch is 0; it must be": {"batch": 0},
    "threads is 0.5; it must be a whole number": {"batch": 2, "threads": 0.5},
    "threads is 0; it must be": {"batch": 2, "threads": 0},
    "reference is None; it must be a function of time or one of sine,": {"reference": None},
    "reference is 5; it must be": {"reference": 5},
    "unknown reference 'sin', did you mean 'sine'": {"reference": "sin"},
    "disturbances is 'noise:0.1'; it must be a list": {"disturbances": "noise:0.1"},
    "disturbances is Payload": {"disturbances": parse_disturbance("payload:0.1")},
    "disturbances holds 0.1; it must be": {"disturbances": [0.1]},
    "disturbances is None; it must be": {"disturbances": None},
    "parameters is {'mass': 1}; it must be ArmParameters": {"parameters": {"mass": 1}},
    "timestep is 'x'; it must be a number": {"timestep": "x"},
    "timestep is True; it must be a number": {"timestep": True},
    "timestep is nan s": {"timestep": float("nan")},
    "control_period is [0.01]; it must be a number": {"control_period": [0.01]},
    "control period is -1 s": {"control_period": -1},
    "duration is (1+0j); it must be a number": {"duration": 1 + 0j},
    "unknown actuation None; known are f-coeff": {"actuation": None},
    "unknown actuation ['internal'], did you mean 'internal'?": {"actuation": ["internal"]},
}


@pytest.mark.parametrize("sentence", BAD_ARGUMENTS)
def test_an_argument_of_load_is_named(sentence):
    with pytest.raises(OctarmError, match=f"^{re.escape(sentence)}"):
        octarm.load(**BAD_ARGUMENTS[sentence])


def test_numbers_of_numpy_are_numbers():
    environment = octarm.load(
        batch=np.int64(2), seed=np.int32(3), timestep=np.float64(1e-3), duration=np.int64(1)
    )
    assert environment.physics.batch_shape == (2,)


BAD_REFERENCES = {
    "the reference answers ([0": lambda t: tuple([0.0] * 6 for _ in range(3)),
    "the reference answers None at t = 0 s; it must be a Reference": lambda t: None,
    "the reference's q at t = 0 s is [0.0, ": lambda t: Reference([0.0] * 6, ZERO, ZERO),
    "the reference's q at t = 0 s holds nan; it must be finite": lambda t: Reference(
        REST * np.nan, ZERO, ZERO
    ),
    "the reference's a at t = 0 s holds inf": lambda t: Reference(REST, ZERO, ZERO + np.inf),
    "the reference's v at t = 0 s has shape (5,); it must be (6,)": lambda t: Reference(
        REST, np.zeros(5), ZERO
    ),
    "the reference's q at t = 0 s has shape (2, 6); it must be (6,)": lambda t: Reference(
        np.zeros((2, 6)), ZERO, ZERO
    ),
    "the reference's v at t = 0 s is 0.0; it must be": lambda t: Reference(REST, 0.0, ZERO),
    "the reference's a at t = 0 s is array([0.+0.j": lambda t: Reference(REST, ZERO, ZERO + 0j),
    "the reference's q at t = 0 s is array(['a'": lambda t: Reference(np.full(6, "a"), ZERO, ZERO),
}


@pytest.mark.parametrize("sentence", BAD_REFERENCES)
@pytest.mark.parametrize("disturbance", [[], ["noise:0.1"]], ids=["plain", "noise"])
def test_a_reference_is_blamed_when_it_is_given(sentence, disturbance):
    acting = [parse_disturbance(text) for text in disturbance]
    with pytest.raises(OctarmError, match=f"^{re.escape(sentence)}"):
        octarm.load(BAD_REFERENCES[sentence], disturbances=acting)


@pytest.mark.parametrize("batch", [None, 2])
def test_a_reference_is_blamed_when_it_goes_wrong_on_the_way(batch):
    environment = octarm.load(
        lambda t: still(t) if t < 0.004 else Reference(REST * np.nan, ZERO, ZERO), batch=batch
    )
    sentence = r"^the reference's q at t = 0\.004 s holds nan; it must be finite$"
    with pytest.raises(OctarmError, match=sentence):
        simulate(environment, make_controller("pd", octarm.nominal_parameters()), 0.01)


def test_arms_of_a_batch_may_share_a_reference_or_have_their_own():
    for shape in ((6,), (1, 6), (3, 6)):
        parts = [np.broadcast_to(x, shape) for x in (REST, ZERO, ZERO)]
        environment = octarm.load(lambda t, parts=parts: Reference(*parts), batch=3)
        assert environment.reset().observation["q"].shape == (3, 6)
    with pytest.raises(OctarmError, match=r"has shape \(2, 6\); it must be \(3, 6\)"):
        octarm.load(lambda t: Reference(*[np.zeros((2, 6))] * 3), batch=3)


BAD_ANSWERS = {
    "the controller answers None; it must be a pair, a Command and the state": None,
    "the controller answers Command(": Command(ZERO),
    "the controller answers (array([": (ZERO, ()),
    "the controller answers (Command(": (Command(ZERO), (), ()),
    "the controller's force is [0.0, 0.0": (Command([0.0] * 6), ()),
    "the controller's force is None": (Command(None), ()),
    "the controller's force is array([0.+0.j": (Command(ZERO + 0j), ()),
    "the controller's force is array(['a'": (Command(np.full(6, "a")), ()),
    "the controller's force is array([None": (Command(np.full(6, None)), ()),
    "the controller's force has shape (5,); the arm needs (6,)": (Command(np.zeros(5)), ()),
    "the controller's signals are [1]; they must be a dict": (Command(ZERO, [1]), ()),
    "the controller's signal 'x' is 'word'": (Command(ZERO, {"x": "word"}), ()),
    "the controller's signal 'x' is array([0.+0.j": (Command(ZERO, {"x": ZERO + 0j}), ()),
    "the controller's signal 3 is ": (Command(ZERO, {3: ZERO}), ()),
    "the controller's layer is [1, 2]; it must be": (Command(ZERO, {}, [1, 2]), ()),
    "the controller's layer is 'wide'; it must be": (Command(ZERO, {}, "wide"), ()),
}


@pytest.mark.parametrize("sentence", BAD_ANSWERS)
def test_a_law_is_blamed_for_its_answer(sentence):
    for run in (octarm.rollout, simulate):
        with pytest.raises(OctarmError, match=f"^{re.escape(sentence)}"):
            run(octarm.load(still), Law(BAD_ANSWERS[sentence]), 0.01)


@pytest.mark.parametrize(
    ("answer", "sentence"),
    [
        (lambda m: (Command(m.q * 0j), ()), r"the controller's force is array\(\[0\.\+0\.j"),
        (lambda m: (Command(0.0 * m.q), ()), r"the controller's signal 's' is 'absent' at t = "),
        (
            lambda m: (Command(0.0 * m.q, {"s": ZERO[:5]}), ()),
            "the controller's signal 's' is a",
        ),
        (lambda m: None, "the controller answers None"),
    ],
    ids=["complex", "absent", "narrow", "none"],
)
def test_a_law_is_blamed_when_it_goes_wrong_on_the_way(answer, sentence):
    with pytest.raises(OctarmError, match=f"^{sentence}"):
        octarm.rollout(octarm.load(still), Law(answer, since=0.004), 0.01)


def test_what_a_loop_is_given_is_named():
    environment, law = octarm.load(still), make_controller("pd", octarm.nominal_parameters())
    for run in (octarm.rollout, simulate):
        for arguments, sentence in (
            ((law, environment, 1.0), "the environment is ProportionalDerivative"),
            ((None, law, 1.0), "the environment is None; it must be what octarm.load returns"),
            ((environment, None, 1.0), "the controller is None; it must be an object with"),
            ((environment, type(law), 1.0), "the controller is <class"),
            ((environment, lambda *_: None, 1.0), "the controller is <function"),
            ((environment, law, "long"), "duration is 'long'; it must be a number"),
            ((environment, law, None), "duration is None; it must be a number"),
            ((environment, law, True), "duration is True; it must be a number"),
            ((environment, law, -1.0), "duration is -1 s; it must be positive"),
            ((environment, law, float("nan")), "duration is nan s; it must be positive"),
        ):
            with pytest.raises(OctarmError, match=f"^{re.escape(sentence)}"):
                run(*arguments)
