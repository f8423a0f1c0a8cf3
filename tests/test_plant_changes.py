"""Changes of the true arm are what they say, when they say, and exactly nothing when neutral."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from octarm.arm.lagrange import equilibrium, potential_force
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.disturbances.active import ActiveDisturbances
from octarm.disturbances.episode import Episode, Plant, PlantChange
from octarm.disturbances.plant import (
    CyclicDrift,
    Drift,
    GravityTilt,
    Mismatch,
    Payload,
    RandomMismatch,
)
from octarm.references import named_reference

P = nominal_parameters()
FIELDS = [field.name for field in dataclasses.fields(ArmParameters)]
SINE = named_reference("sine", equilibrium(P))
SEEDS = np.random.SeedSequence(3).spawn(400)


def episode(timestep: float = 5e-4, arms: int | None = None, seeds=SEEDS) -> Episode:
    return Episode(
        parameters=P,
        timestep=timestep,
        reference=SINE,
        seeds=seeds[0] if arms is None else seeds[:arms],
        batch_shape=() if arms is None else (arms,),
    )


def plant_at(change: PlantChange, step: int, start: Episode) -> Plant:
    """The plant at a step, whatever happened before."""
    return change.start(start).apply(step, Plant(start.parameters))


def assert_same(one: Plant, other: Plant, row: int = 0) -> None:
    """Equal bits, field by field; `row` picks an arm of the other one."""
    for name in FIELDS:
        own, its = getattr(one.parameters, name), getattr(other.parameters, name)
        batch = len(other.parameters.batch_shape) and its.ndim > getattr(P, name).ndim
        np.testing.assert_array_equal(own, its[row] if batch else its, err_msg=name)
    angle = np.asarray(other.gravity_angle)
    np.testing.assert_array_equal(one.gravity_angle, angle.flat[row if angle.ndim else 0])


def test_a_payload_is_a_mass_at_the_tip_from_its_time_on():
    change, start = Payload(mass=0.25, at=0.3), episode()
    process = change.start(start)
    assert [k for k in range(2000) if process.changes_at(k)] == [0, 600]
    assert_same(process.apply(599, Plant(P)), Plant(P))
    loaded = process.apply(600, Plant(P)).parameters
    np.testing.assert_array_equal(loaded.mass, P.mass + np.array([0.0, 0.0, 0.25]))
    for name in set(FIELDS) - {"mass"}:
        np.testing.assert_array_equal(getattr(loaded, name), getattr(P, name))


@pytest.mark.parametrize("timestep", [5e-4, 7e-4, 1e-3, 3e-3, 1 / 3000])
def test_a_payload_comes_with_the_first_step_at_or_after_its_time(timestep: float):
    process = Payload(mass=0.1, at=0.3).start(episode(timestep))
    (step,) = (k for k in range(1, round(1.0 / timestep)) if process.changes_at(k))
    assert step * timestep >= 0.3 - 1e-12
    assert (step - 1) * timestep < 0.3 - 1e-9


def test_a_payload_stretches_every_column_by_its_weight():
    load = 0.2
    arm = plant_at(Payload(mass=load), 0, episode()).parameters
    lower = equilibrium(arm) - equilibrium(P)
    np.testing.assert_allclose(lower[:3], load * P.gravity / P.stiffness.sum(axis=0), rtol=1e-9)


def test_arms_pick_their_payloads_up_on_their_own():
    change = Payload(mass=np.array([0.1, 0.0, 0.3]), at=np.array([0.0, 0.1, 0.2]))
    process = change.start(episode(1e-3, arms=3))
    assert [k for k in range(500) if process.changes_at(k)] == [0, 100, 200]
    for k, extra in ((0, [0.1, 0.0, 0.0]), (199, [0.1, 0.0, 0.0]), (200, [0.1, 0.0, 0.3])):
        mass = process.apply(k, Plant(P)).parameters.mass
        np.testing.assert_array_equal(mass, P.mass + np.outer(extra, [0.0, 0.0, 1.0]))


@pytest.mark.parametrize("x", [-0.3, 0.0, 0.3, 1.7])
def test_mismatch_means_what_it_means_for_the_nominal_model(x: float):
    assert_same(plant_at(Mismatch(mismatch=x), 0, episode()), Plant(P.mismatched(x)))


def test_mismatch_has_further_factors():
    change = Mismatch(mismatch=0.2, mass=0.5, damping=0.0, rest_length=1.1, tilt=-0.2)
    plant = plant_at(change, 0, episode())
    expected = P.scaled(mass=1.2 * 0.5, inertia=1.2, stiffness=1.1, damping=0.0, rest_length=1.1)
    assert_same(plant, Plant(expected, -0.2))


def test_tilted_gravity_adds_up():
    active = ActiveDisturbances(
        [GravityTilt(angle=0.1), Mismatch(tilt=0.05), GravityTilt(angle=-0.4)], episode()
    )
    plant = active.plant(0)
    assert plant is not None
    assert plant.gravity_angle == pytest.approx(-0.25)
    assert active.plant(1) is None


def test_random_parameters_are_uniform_and_independent():
    """8800 numbers of 400 arms, at a level of 1e-4 split over what is tested."""
    plant = plant_at(RandomMismatch(share=0.2, rest_length=0.1, tilt=0.3), 0, episode(arms=400))
    columns = [
        (getattr(plant.parameters, name) / getattr(P, name)).reshape(400, -1) - 1.0
        for name in ("mass", "inertia", "stiffness", "damping", "rest_length")
    ]
    shares = [0.2, 0.2, 0.2, 0.2, 0.1]
    angle = np.asarray(plant.gravity_angle)[:, None] / 0.3
    u = np.hstack([*(c / s for c, s in zip(columns, shares, strict=True)), angle])
    assert u.shape == (400, 22)
    assert np.max(np.abs(u)) <= 1.0 + 1e-12
    level = 1e-4 / 22
    for j in range(22):
        assert stats.kstest(u[:, j], "uniform", (-1.0, 2.0)).pvalue > level
    cross = np.asarray(np.corrcoef(u.T))[np.triu_indices(22, 1)]
    assert np.max(np.abs(cross)) * 20.0 < stats.norm.isf(1e-4 / len(cross) / 2)


def test_random_parameters_are_the_same_draws_for_any_share():
    small = plant_at(RandomMismatch(share=0.1), 0, episode()).parameters
    large = plant_at(RandomMismatch(share=0.3, tilt=0.2), 0, episode()).parameters
    np.testing.assert_allclose(large.mass / P.mass - 1.0, 3.0 * (small.mass / P.mass - 1.0))
    np.testing.assert_array_equal(large.rest_length, P.rest_length)
    again = plant_at(RandomMismatch(share=0.1), 0, episode(1e-3)).parameters
    assert_same(Plant(again), Plant(small))
    other = plant_at(RandomMismatch(share=0.1), 0, episode(seeds=SEEDS[1:])).parameters
    assert not np.any(other.mass == small.mass)


def test_drift_is_a_ramp_up_to_its_limit():
    process = Drift(rate=-0.2, of="stiffness+mass", limit=0.3).start(episode())
    for step, factor in (
        (0, 1.0),
        (2000, 0.8),
        (2019, 0.8),
        (2020, 0.798),
        (2999, 0.702),
        (9**9, 0.7),
    ):
        arm = process.apply(step, Plant(P)).parameters
        np.testing.assert_allclose(arm.stiffness, factor * P.stiffness, rtol=1e-12)
        np.testing.assert_allclose(arm.mass, factor * P.mass, rtol=1e-12)
        np.testing.assert_array_equal(arm.damping, P.damping)


def test_cyclic_drift_is_a_sine():
    process = CyclicDrift(share=0.25, period=4.0, phase=0.5, of="damping").start(episode())
    for t in (0.0, 0.37, 1.0, 2.5, 100.0):
        arm = process.apply(round(t / 5e-4), Plant(P)).parameters
        factor = 1.0 + 0.25 * np.sin(2.0 * np.pi * t / 4.0 + 0.5)
        np.testing.assert_allclose(arm.damping, factor * P.damping, rtol=1e-12)


@pytest.mark.parametrize("timestep", [5e-4, 1e-3, 7e-4, 4e-3, 0.02, 1 / 3000])
@pytest.mark.parametrize("change", [Drift(rate=0.1), CyclicDrift(share=0.3, period=1.0)])
def test_drift_follows_a_grid_of_its_own(change: PlantChange, timestep: float):
    """It changes once every 10 ms, and at common times it is the same for every timestep."""
    process, fine = change.start(episode(timestep)), change.start(episode(1e-5))
    previous = None
    for k in range(round(0.5 / timestep)):
        plant = process.apply(k, Plant(P))
        centre = np.floor(k * timestep / 0.01 + 1e-6)  # what is there at 10 ms times this
        assert_same(plant, fine.apply(int(centre) * 1000, Plant(P)))
        moved = previous is None or centre != previous
        assert process.changes_at(k) == moved
        previous = centre


CHANGES = {
    "payload": lambda x: Payload(mass=np.abs(x), at=np.abs(x)),
    "mismatch": lambda x: Mismatch(mismatch=x, stiffness=1.0 + x, tilt=x),
    "random": lambda x: RandomMismatch(share=np.abs(x), rest_length=np.abs(x), tilt=np.abs(x)),
    "drift": lambda x: Drift(rate=10.0 * x, of="mass+damping+rest_length", limit=0.2),
    "cyclic": lambda x: CyclicDrift(share=np.abs(x), period=1.0 + np.abs(x), phase=x),
    "tilt": lambda x: GravityTilt(angle=x),
}


@pytest.mark.parametrize("kind", CHANGES)
def test_one_arm_equals_its_row_and_a_neutral_value_changes_nothing(kind: str):
    x = np.array([0.0, 0.11, -0.37, 0.29])
    batch = CHANGES[kind](x).start(episode(arms=4))
    for i in range(4):
        single = CHANGES[kind](float(x[i])).start(episode(seeds=SEEDS[i:]))
        for step in (0, 1, 220, 400, 777):
            own, its = (process.apply(step, Plant(P)) for process in (single, batch))
            assert_same(own, its, row=i)
            if i == 0:
                assert_same(own, Plant(P))


def test_changes_act_in_a_fixed_order_from_the_undisturbed_arm():
    """The payload is not scaled, whatever the order in which they are listed."""
    changes = [Payload(mass=0.2, at=0.1), Mismatch(mass=1.5), Drift(rate=0.1, of="mass")]
    for listed in (changes, changes[::-1]):
        active = ActiveDisturbances(listed, episode(1e-3))
        known = {k: plant for k in range(400) if (plant := active.plant(k)) is not None}
        assert sorted(known) == list(range(0, 400, 10))
        for k, plant in known.items():
            expected = P.mass * 1.5 * (1.0 + 0.1 * (k // 10 * 0.01))
            expected[-1] += 0.2 if k >= 100 else 0.0
            np.testing.assert_allclose(plant.parameters.mass, expected, rtol=1e-14)


def test_the_loaded_arm_needs_more_force():
    """What the changes are for: the controller's model is now wrong."""
    q = equilibrium(P)
    assert np.max(np.abs(potential_force(P, q))) < 1e-9
    heavy = plant_at(Payload(mass=0.2), 0, episode()).parameters
    np.testing.assert_allclose(potential_force(heavy, q)[:3], -0.2 * P.gravity, rtol=1e-9)


def test_impossible_changes_are_refused():
    for change, sentence in (
        (lambda: Payload(mass=-0.1), "mass of payload is -0.1 kg; it must be at least 0 kg"),
        (lambda: Payload(mass=np.nan), "mass of payload holds nan"),
        (lambda: Mismatch(mismatch=-1.0), "mismatch of mismatch is -1; it must be above -1"),
        (lambda: Mismatch(mass=0.0), "mass of mismatch is 0; it must be above 0"),
        (lambda: RandomMismatch(share=1.0), "share of random-mismatch is 1; it must be below 1"),
        (lambda: Drift(rate=0.1, of="weight"), "of of drift is 'weight'"),
        (lambda: Drift(rate=0.1, limit=1.0), "limit of drift is 1; it must be below 1"),
        (lambda: CyclicDrift(share=0.1, period=0.01), "period of cyclic-drift is 0.01 s; it must"),
        (lambda: Payload(mass=np.ones(3)).start(episode(arms=2)), r"has shape \(3,\); it must be"),
        (lambda: Payload(mass=np.ones(3)).start(episode()), "mass of payload has shape"),
    ):
        with pytest.raises(ValueError, match=sentence):
            change()
