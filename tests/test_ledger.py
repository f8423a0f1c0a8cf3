"""The disturbance ledger: what it says was delivered is what MuJoCo and the controller got."""

import numpy as np
import pytest

from controllers import make_controller
from octarm.disturbances import parse_disturbance
from octarm.environment import load
from octarm.ledger import Ledger, in_words
from octarm.model import nominal_parameters
from octarm.rollout import rollout
from octarm.trajectory import Trajectory

P = nominal_parameters()


def watched(*texts: str, duration: float = 2.0, period: float = 0.001) -> tuple[Trajectory, list]:
    disturbances = [parse_disturbance(text) for text in texts]
    environment = load(disturbances=disturbances, control_period=period, seed=1)
    physics = environment.physics
    ledger = Ledger(disturbances, physics)
    physics.watch = ledger.step
    controller = make_controller("smc-boundary", P)
    run = rollout(environment, controller, duration, progress=lambda: ledger.instant(physics))
    return run, ledger.rows()


def test_noise_is_held_and_as_strong_as_asked():
    run, [row] = watched("noise:0.4,time=0.01", duration=4.0)
    assert row["name"] == "noise"
    assert row["asked"]["ratio"] == 0.4
    delivered = row["delivered"]
    assert delivered["hold"] == pytest.approx(0.01, rel=0.02)
    assert delivered["corner"] == pytest.approx(0.443 / 0.01, rel=0.35)
    assert delivered["unexplained"] == 0.0
    mean_square = np.sqrt(np.mean(run.disturbance**2, axis=0))  # means over periods of two steps
    np.testing.assert_allclose(delivered["rms"], mean_square, rtol=0.02)


def test_a_sine_is_a_line():
    _, [row] = watched("sine:0.05,frequency=3,on=theta1")
    delivered = row["delivered"]
    assert delivered["frequency"] == pytest.approx(3.0)
    assert delivered["share_in_line"] > 0.999
    assert delivered["rms"][3] == pytest.approx(0.05 / np.sqrt(2.0), rel=1e-6)
    assert delivered["peak"] == pytest.approx([0, 0, 0, 0.05, 0, 0], abs=1e-12)


def test_a_pulse_is_there_from_its_beginning_to_its_end():
    _, [row] = watched("pulse:1,at=0.3,length=0.2,on=tip-y", duration=1.0)
    assert row["delivered"]["from"] == pytest.approx(0.3)
    assert row["delivered"]["until"] == pytest.approx(0.5)


@pytest.mark.parametrize(("asked", "achieved"), [(0.0, 0.0), (0.0013, 0.0015), (0.02, 0.02)])
def test_delays_are_found_in_what_arrived(asked: float, achieved: float):
    _, rows = watched(f"actuation-delay:{asked}", f"measurement-delay:{asked}")
    assert [row["delivered"]["delay"] for row in rows] == pytest.approx([achieved] * 2)


def test_masses_are_read_from_the_model():
    _, [row] = watched("payload:0.2,at=0.05", duration=0.1)
    mass = row["delivered"]["mass"]
    assert mass["undisturbed"] == mass["start"] == P.mass.tolist()
    assert mass["end"] == pytest.approx([*P.mass[:2], P.mass[2] + 0.2])
    _, [row] = watched("tilt:0.1", duration=0.01)
    assert row["delivered"]["gravity_angle"]["end"] == pytest.approx(0.1)


def test_two_of_a_kind_have_rows_of_their_own():
    _, rows = watched("step:0.01,on=theta1", "step:0.02,on=theta2", duration=0.1)
    assert [row["name"] for row in rows] == ["step", "step-2"]
    assert [np.argmax(row["delivered"]["peak"]) for row in rows] == [3, 4]


def test_measurement_noise_is_what_the_controller_saw():
    run, [row] = watched("measurement-noise:0.001")
    seen = run.signals["q_measured"] - run.q
    rms = np.sqrt(np.mean(seen[1:] ** 2, axis=0))
    np.testing.assert_allclose(row["delivered"]["rms_change"][:6], rms, rtol=0.01)


def test_a_disturbance_that_did_nothing_says_so():
    _, [row] = watched("payload:0.0", duration=0.01)
    assert row["delivered"] == {}
    assert in_words([row]) == ["           payload  nothing"]
