"""Sensors on the plates that end groups: their arcs against other derivations, and in the loop."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.optimize import brentq

from controllers import make_controller
from octarm.arm.groups import Groups
from octarm.arm.kinematics import arc_tip
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.arm.plates import readings
from octarm.arm.rod import LAYOUTS
from octarm.disturbances.spelling import parse_disturbance
from octarm.errors import OctarmError
from octarm.interfaces import Instant
from octarm.simulation.engines import ENGINES
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout, simulate

ARM = nominal_parameters()
UNEQUAL = ArmParameters.from_dict(ARM.to_dict() | {"rest_length": [0.1, 0.14, 0.12]})
each_layout = pytest.mark.parametrize("layout", LAYOUTS)


def plate_of(layout: str, modules: int, arm: ArmParameters = ARM) -> Groups:
    return Groups.of(arm, modules, layout, "plates")


def moving(groups: Groups, seed: int, *batch: int) -> tuple[np.ndarray, np.ndarray]:
    n = groups.plant.modules
    x, v = np.random.default_rng(seed).normal(size=(2, *batch, 2 * n))
    straight = np.concatenate([groups.plant.rest_length, np.zeros(n)])
    return straight * (1.0 + 0.1 * x) + (1.2 / n) * (straight == 0.0) * (0.5 + x), v


def poses(groups: Groups, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places in the complex plane and angles of the base and of the plates, by walking along."""
    n, m = groups.plant.modules, groups.arm.modules
    place, angle, places, angles = 0.0j, 0.0, [0.0j], [0.0]
    rest = groups.plant.rest_length
    border = np.cumsum(groups.arm.rest_length)  # of groups of the unloaded arm
    for i in range(n):
        end, before = np.sum(rest[: i + 1]), np.sum(rest[:i])
        inside = [b for b in border[:-1] if before + 1e-9 < b < end - 1e-9]
        for b in inside:  # the stretch is on both sides of a border
            middle = 0.5 * (before + end)
            places.append(place + (0.5 * q[i] + b - middle) * np.exp(1j * angle))
            angles.append(angle)
        place, angle = place + q[i] * np.exp(1j * angle), angle + q[n + i]
        if groups.layout == "paper" and (i + 1) % (n // m) == 0:
            places.append(place)
            angles.append(angle)
    if groups.layout == "centred":
        places.append(place + 0.5 * groups.arm.rest_length[-1] / (n // m) * np.exp(1j * angle))
        angles.append(angle)
    return np.array(places), np.array(angles)


@pytest.mark.parametrize("arm", [ARM, UNEQUAL], ids=["alike", "unequal"])
@pytest.mark.parametrize("modules", [3, 6, 15])
@each_layout
def test_a_group_is_the_arc_whose_ends_are_its_plates(
    layout: str, modules: int, arm: ArmParameters
):
    """The length of the arc with the measured chord, by quadrature and root finding."""
    groups = plate_of(layout, modules, arm)
    q, v = moving(groups, modules)
    read, _ = readings(groups, q, v)
    places, angles = poses(groups, q)
    assert len(places) == 4
    np.testing.assert_allclose(read[3:], np.diff(angles), rtol=1e-12)
    for i, (chord, bend) in enumerate(zip(np.abs(np.diff(places)), np.diff(angles), strict=True)):

        def missing(length: float, bend: float = bend, chord: float = chord) -> float:
            along, _ = quad_vec(lambda x: length * np.exp(1j * bend * x), 0.0, 1.0, epsabs=1e-14)
            return float(abs(along) - chord)

        assert read[i] == pytest.approx(brentq(missing, 0.01, 1.0, xtol=1e-15), rel=1e-11)


@each_layout
def test_velocities_are_the_derivatives(layout: str):
    groups, eps = plate_of(layout, 15, UNEQUAL), 1e-6
    straight = np.concatenate([groups.plant.rest_length, np.zeros(15)])
    small = straight + np.concatenate(
        [np.zeros(15), np.full(15, 0.0119)]
    )  # the series, near its end
    bent, v = moving(groups, 1)
    for q in (straight, small, bent):
        (ahead, _), (behind, _) = (readings(groups, q + x * v, v) for x in (eps, -eps))
        _, rates = readings(groups, q, v)
        np.testing.assert_allclose(rates, (ahead - behind) / (2.0 * eps), rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("arm", [ARM, UNEQUAL], ids=["alike", "unequal"])
@each_layout
def test_of_a_straight_arm_plates_say_what_the_sums_are(layout: str, arm: ArmParameters):
    groups = plate_of(layout, 12, arm)
    q, v = moving(groups, 2)
    q[12:] = 0.0
    for one, other in zip(
        readings(groups, q, v), (groups.measured(q), groups.rates(v)), strict=True
    ):
        np.testing.assert_allclose(one, other, rtol=1e-14)


@each_layout
def test_on_arcs_plates_and_sums_come_to_the_same_with_the_square_of_the_modules(layout: str):
    arcs = np.array([0.13, 0.11, 0.12, 0.9, -1.3, 0.5])
    arm = ArmParameters.from_dict(ARM.to_dict() | {"rest_length": arcs[:3]})
    errors = []
    for n in (8, 16, 32):
        groups = plate_of(layout, 3 * n, arm)
        q = np.concatenate([groups.plant.rest_length, groups.each_module(arcs[3:] / n)])
        read, _ = readings(groups, q, np.zeros_like(q))
        np.testing.assert_allclose(read[3:], arcs[3:], rtol=1e-12)
        errors.append(np.abs(read - arcs)[:3])
        if layout == "paper":  # a polygon on a circle
            half = 0.5 * arcs[3:]
            exact = arcs[:3] * (half / n) / np.sin(half / n)
            np.testing.assert_allclose(read[:3], exact, rtol=1e-12)
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    np.testing.assert_allclose(orders, 2.0, atol=0.1)
    assert np.max(errors[-1]) < 2e-5


def test_one_arc_a_group_ends_where_arcs_end():
    """The chord of what is read is that of the plates, so a chain of such arcs has its lengths."""
    groups = plate_of("paper", 15)
    q, v = moving(groups, 3)
    read, _ = readings(groups, q, v)
    places, _ = poses(groups, q)
    for i in range(3):
        arc = arc_tip(np.array([read[i], read[3 + i]]))
        assert np.hypot(*arc) == pytest.approx(abs(places[i + 1] - places[i]), rel=1e-13)


def test_a_full_circle_has_no_chord_and_warns_of_nothing():
    groups = plate_of("paper", 6)
    q = np.concatenate([[0.06, 0.05] * 3, np.full(6, np.pi)])
    read, rates = readings(groups, q, np.ones(12))
    np.testing.assert_allclose(read[3:], 2.0 * np.pi)
    assert not np.any(np.abs(read[:3]) < 1.0)
    assert rates.shape == (6,)


@each_layout
def test_readings_have_the_same_bits_alone_and_in_a_batch(layout: str):
    groups = plate_of(layout, 15)
    q, v = moving(groups, 4, 7)
    alone = [readings(groups, *each) for each in zip(q, v, strict=True)]
    for order in (np.ascontiguousarray, np.asfortranarray):
        many = readings(groups, order(q), order(v))
        for part in (0, 1):
            np.testing.assert_array_equal(many[part], [each[part] for each in alone])


@pytest.mark.parametrize("engine", ENGINES)
@each_layout
def test_the_law_is_given_what_plates_say_and_errors_are_of_the_sums(layout: str, engine: str):
    options: dict[str, Any] = {
        "plant_modules": 6, "layout": layout, "sensing": "plates", "timestep": 1e-4,
        "engine": engine, "disturbances": [parse_disturbance("noise:0.4")],
    }  # fmt: skip
    law, groups = make_controller("smc-boundary", ARM), plate_of(layout, 6)
    seeds = [np.random.SeedSequence(0, spawn_key=(i,)) for i in range(5)]
    rows: list[list[np.ndarray]] = []

    def note(x: Instant) -> None:
        rows.append([x.q, x.measurement.q, x.measurement.v])

    simulate(load(batch=5, seed=seeds, **options), law, 0.02, note)
    batch = [np.stack(part, axis=1) for part in zip(*rows, strict=True)]
    for i in (0, 4):
        run = rollout(load(seed=seeds[i], **options), law, 0.02)
        place = run.signals["plant_q"]
        np.testing.assert_array_equal(run.q, groups.measured(place))
        seen = run.signals["q_measured"]
        np.testing.assert_array_equal(seen, readings(groups, place, np.zeros_like(place))[0])
        assert np.max(np.abs(seen - run.q)[:, :3]) > 1e-9
        for one, other in zip((run.q, seen, run.signals["v_measured"]), batch, strict=True):
            np.testing.assert_array_equal(one, other[i])


def test_faulty_sensors_read_the_plates():
    options: dict[str, Any] = {"plant_modules": 9, "timestep": 1e-4, "engine": "lagrange"}
    law = make_controller("computed-torque", ARM)
    late = [parse_disturbance("measurement-delay:0.001")]
    run = rollout(load(sensing="plates", disturbances=late, **options), law, 0.03)
    groups, place = plate_of("paper", 9), run.signals["plant_q"]
    seen, _ = readings(groups, place, np.zeros_like(place))
    np.testing.assert_array_equal(run.signals["q_measured"][10:], seen[:-10])


def test_sums_are_read_unless_asked_otherwise():
    options: dict[str, Any] = {"plant_modules": 9, "timestep": 1e-4, "engine": "lagrange"}
    law = make_controller("smc-boundary", ARM)
    one = rollout(load(**options), law, 0.02)
    other = rollout(load(**options, sensing="groups"), law, 0.02)
    assert one.digest == other.digest and "q_measured" not in one.signals
    np.testing.assert_array_equal(one.q, Groups.of(ARM, 9).measured(one.signals["plant_q"]))


@pytest.mark.parametrize(
    ("modules", "sensing", "sentence"),
    [
        (15, "plate", "unknown sensing 'plate', did you mean 'plates'"),
        (15, 3, "unknown sensing 3"),
        (
            None,
            "plates",
            "sensing is 'plates', that of a plant of more modules; plant_modules must",
        ),
    ],
)
def test_what_cannot_be_read_is_refused_in_a_sentence(modules: Any, sensing: Any, sentence: str):
    with pytest.raises(OctarmError, match=sentence):
        load(plant_modules=modules, sensing=sensing)
