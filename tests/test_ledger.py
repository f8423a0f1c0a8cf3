"""The disturbance ledger: what it says was delivered is what MuJoCo and the controller got."""

import json

import numpy as np
import pytest
from arm_states import hand_set

from octarm.arm.mjcf import nominal_parameters
from octarm.disturbances import delivered
from octarm.disturbances.ledger import Ledger, asked, in_words
from octarm.disturbances.spelling import parse_disturbance
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout
from octarm.simulation.trajectory import Trajectory

P = nominal_parameters()


def watched(*texts: str, duration: float = 2.0, period: float = 0.001) -> tuple[Trajectory, list]:
    disturbances = [parse_disturbance(text) for text in texts]
    environment = load(disturbances=disturbances, control_period=period, seed=1)
    watching = Ledger(disturbances, environment.physics)
    environment.physics.watch = watching.step
    run = rollout(environment, hand_set("smc-boundary", P), duration)
    return run, watching.rows()


def test_noise_is_held_and_as_strong_as_asked():
    run, [row] = watched("noise:0.4,time=0.01", duration=4.0)
    assert row["name"] == "noise"
    assert row["asked"]["ratio"] == 0.4
    delivered = row["delivered"]
    assert delivered["hold"] == pytest.approx(0.01, rel=1e-9)
    assert delivered["corner"] == pytest.approx(0.443 / 0.01, rel=0.15)
    assert delivered["unexplained"] == 0.0
    # Of 400 normal numbers, four standard deviations.
    np.testing.assert_allclose(delivered["rms"], delivered["rms_asked"], rtol=4 / np.sqrt(800))
    mean_square = np.sqrt(np.mean(run.disturbance**2, axis=0))  # means over periods of two steps
    np.testing.assert_allclose(delivered["rms"], mean_square, rtol=0.02)


@pytest.mark.parametrize(("time", "hold"), [(0.0005, 0.0005), (0.0023, 0.0023), (0.004, 0.004)])
def test_the_corner_follows_the_correlation_time(time: float, hold: float):
    _, [row] = watched(f"noise:rms=1e-3,time={time}", duration=2.0, period=0.005)
    assert row["delivered"]["hold"] == pytest.approx(hold, rel=2e-3)
    assert row["delivered"]["corner"] == pytest.approx(0.443 / time, rel=0.15)


def test_a_noise_of_few_numbers_does_not_tell_its_spectrum():
    for text in ("noise:0.4,time=1", "noise:0.4", "noise:0"):
        _, [row] = watched(text, duration=0.05)
        assert "corner" not in row["delivered"]
    assert row["delivered"]["rms"] == [0.0] * 6


def test_a_sine_is_a_line():
    _, [row] = watched("sine:0.05,frequency=3,on=theta1")
    delivered = row["delivered"]
    assert delivered["frequency"] == pytest.approx(3.0, rel=1e-4)
    assert delivered["share_in_line"] > 0.999
    assert delivered["rms"][3] == pytest.approx(0.05 / np.sqrt(2.0), rel=1e-6)
    assert delivered["peak"] == pytest.approx([0, 0, 0, 0.05, 0, 0], abs=1e-12)


@pytest.mark.parametrize("frequency", [2.7, 11.31])
def test_a_frequency_need_not_fit_the_run(frequency: float):
    _, [row] = watched(f"sine:0.05,frequency={frequency},on=tip-y", period=0.005)
    assert row["delivered"]["frequency"] == pytest.approx(frequency, rel=0.01)
    _, [row] = watched(f"sine:0.05,frequency={frequency}", duration=1.0 / frequency)
    assert "frequency" not in row["delivered"]  # one period does not tell


def test_a_pulse_is_there_from_its_beginning_to_its_end():
    _, [row] = watched("pulse:1,at=0.3,length=0.2,on=tip-y", duration=1.0)
    assert row["delivered"]["from"] == pytest.approx(0.3)
    assert row["delivered"]["until"] == pytest.approx(0.5)


def test_times_and_sizes_are_of_the_whole_run(monkeypatch):
    monkeypatch.setattr(delivered, "_WINDOW", 100)
    _, [row] = watched("pulse:1,at=0.3,length=0.2,on=s1", duration=1.0)
    assert row["delivered"]["until"] == pytest.approx(0.5)
    assert row["delivered"]["rms"][0] == pytest.approx(np.sqrt(0.2))


@pytest.mark.parametrize("delay", [0.0, 0.0002, 0.0013, 0.00125, 0.02])
def test_delays_are_found_in_what_arrived(delay: float):
    _, rows = watched(f"actuation-delay:{delay}", f"measurement-delay:{delay}")
    assert rows[0]["delivered"]["delay"] == pytest.approx(delay)
    assert rows[1]["delivered"]["delay"] == pytest.approx(delay, abs=5e-6)


@pytest.mark.parametrize(("delay", "achieved"), [(2.2, 2.2), (3.0, None)])
def test_long_delays_are_found_and_unseen_ones_are_not(delay: float, achieved: float | None):
    """Longer than a period of the reference; and longer than the run."""
    listed = [parse_disturbance(f"measurement-delay:{delay}")]
    environment = load(disturbances=listed, timestep=2e-3)
    watching = Ledger(environment.task.disturbances, environment.physics)
    environment.physics.watch = watching.step
    still = hand_set("pd", P, {"K_p": 1e-9, "K_d": 1e-9})
    assert rollout(environment, still, 3.0).status == "ok"
    assert watching.rows()[0]["delivered"]["delay"] == achieved


def test_delays_one_after_another_are_told_apart():
    _, rows = watched("actuation-delay:0.004", "actuation-delay:0.01", duration=0.2)
    assert [row["delivered"]["delay"] for row in rows] == pytest.approx([0.004, 0.01])


def test_masses_are_read_from_the_model():
    _, [row] = watched("payload:0.2,at=0.05", duration=0.1)
    mass = row["delivered"]["mass"]
    assert mass["undisturbed"] == mass["start"] == P.mass.tolist()
    assert mass["end"] == mass["most"] == [*P.mass[:2], P.mass[2] + 0.2]
    assert mass["least"] == P.mass.tolist()
    _, [row] = watched("tilt:0.1", duration=0.01)
    assert row["delivered"]["gravity_angle"]["end"] == pytest.approx(0.1)
    assert list(row["delivered"]) == ["gravity_angle"]


def test_what_came_and_went_is_in_the_extremes():
    _, [row] = watched("cyclic-drift:0.2,period=0.1", duration=0.1005)
    stiffness = {k: np.array(v) / P.stiffness for k, v in row["delivered"]["stiffness"].items()}
    np.testing.assert_allclose(stiffness["end"], 1.0, rtol=1e-12)
    np.testing.assert_allclose(stiffness["most"], 1.0 + 0.2 * np.sin(0.4 * np.pi), rtol=1e-12)
    np.testing.assert_allclose(stiffness["least"], 1.0 - 0.2 * np.sin(0.4 * np.pi), rtol=1e-12)
    assert "in between" in in_words([row])[0]


def test_two_of_a_kind_have_rows_of_their_own():
    _, rows = watched("step:0.01,on=theta1", "step:0.02,on=theta2", duration=0.1)
    assert [row["name"] for row in rows] == ["step", "step-2"]
    assert [np.argmax(row["delivered"]["peak"]) for row in rows] == [3, 4]


def test_it_says_how_often_inputs_were_changed():
    run, [row] = watched("saturation:7/7/9/9/0.15/inf", duration=0.5, period=0.0005)
    share = np.mean(np.abs(run.tau) > [7.0, 7.0, 9.0, 9.0, 0.15, np.inf], axis=0)
    assert 0.1 < share[0] < 0.99
    np.testing.assert_allclose(row["delivered"]["share_changed"], share, atol=1e-12)
    assert "share changed (0." in in_words([row])[0]


def test_measurement_noise_is_what_the_controller_saw():
    run, [row] = watched("measurement-noise:0.001")
    seen = run.signals["q_measured"] - run.q  # from the first to the last, and no other
    rms = np.sqrt(np.mean(seen**2, axis=0))
    np.testing.assert_allclose(row["delivered"]["rms_change"][:6], rms, rtol=1e-12)
    np.testing.assert_allclose(row["delivered"]["rms_asked"][:6], rms, rtol=4 / np.sqrt(4000))


def test_every_episode_is_told_from_its_beginning():
    disturbances = [parse_disturbance(t) for t in ("payload:0.2,at=0.02", "noise:0.4", "lag:0.01")]
    environment = load(disturbances=disturbances)
    watching = Ledger(disturbances, environment.physics)
    environment.physics.watch = watching.step
    told = []
    for duration in (0.1, 0.03, 0.1):
        environment.task.next_episode = 0
        rollout(environment, hand_set("pd", P), duration)
        told.append(watching.rows())
    assert told[0] == told[2] != told[1]
    late = Ledger(disturbances, environment.physics)  # the arm still holds its load
    environment.physics.watch = late.step
    environment.task.next_episode = 0
    rollout(environment, hand_set("pd", P), 0.1)
    assert late.rows() == told[0]


@pytest.mark.parametrize("text", ["step:1e300N", "noise:1e302%", "measurement-noise:1e302%"])
def test_what_is_not_finite_is_not_a_number(text: str):
    _, [row] = watched(text, duration=0.01)
    written = json.dumps(row, allow_nan=False)
    assert "null" in json.dumps(row["delivered"]) and "unknown" in in_words([row])[0]
    assert in_words([json.loads(written)]) == in_words([row])


def test_a_disturbance_that_did_nothing_says_so():
    _, [row] = watched("payload:0.0", duration=0.01)
    assert row["delivered"] == {}
    assert in_words([row]) == ["  payload:0 -> nothing"]


def test_before_the_run_it_says_what_is_asked():
    listed = [parse_disturbance(text) for text in ("noise:0.4", "lag:0.1", "noise:0.1")]
    rows = asked(listed)
    assert [row["name"] for row in rows] == ["noise", "lag", "noise-2"]
    assert [list(row) for row in rows] == [["name", "asked"]] * 3
    assert Ledger(listed, load(disturbances=listed).physics).rows()[1]["delivered"] == {}
