"""References suit their arm, take parameters, and are recorded with them."""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import octarm
from octarm.arm.actuation import GroundedActuation
from octarm.arm.file import read_arm, shipped_arms
from octarm.arm.kinematics import tip_position
from octarm.arm.lagrange import equilibrium, inverse_dynamics
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.commands import cli
from octarm.errors import OctarmError
from octarm.references import (
    REFERENCES,
    Chirp,
    Hanging,
    MultiSine,
    SetPoint,
    SetPoints,
    Sine,
    SmoothStep,
    named_reference,
)
from octarm.references.catalogue import help_text
from octarm.references.tip import TipPath
from octarm.sweeps.spec_file import parse_spec

P = nominal_parameters()
REST = equilibrium(P)
NAMES = [name for name in REFERENCES if name != "file"]


def of_modules(modules: int) -> ArmParameters:
    """An arm of the nominal one's modules, over and over."""
    i = np.arange(modules) % P.modules
    names = ("mass", "inertia", "stiffness", "damping", "rest_length")
    return dataclasses.replace(P, **{name: getattr(P, name)[..., i] for name in names})


ARMS = {
    **{name: read_arm(name) for name in shipped_arms()},
    "x0.1": P.scaled(mass=0.1, inertia=0.1, stiffness=0.1, damping=0.1),
    "x10": P.scaled(mass=10.0, inertia=10.0, stiffness=10.0, damping=10.0),
    **{f"{n} modules": of_modules(n) for n in (1, 2, 5, 10)},
}


def world(p: ArmParameters, q: np.ndarray) -> np.ndarray:
    """The tip along and across the hanging arm, shape (..., 2) [m]."""
    return tip_position(q, p.tip_length)[..., [2, 0]] * [-1.0, 1.0]


def test_on_the_nominal_arm_they_are_bit_for_bit_what_they_were():
    def first_two(slides: tuple[float, ...] = (0, 0), bends: tuple[float, ...] = (0, 0)):
        return np.array([*slides, 0.0, *bends, 0.0])

    still = 0.0 * REST
    big = first_two((0.008, 0.006), (0.20, 0.15))
    fast = first_two((0.015, 0.012), (0.6, 0.5))
    before = {
        "sine": Sine(center=REST, amplitude=first_two(bends=(0.35, 0.25)), frequency=0.5),
        "sine-slides": Sine(center=REST, amplitude=first_two((0.02, 0.015)), frequency=0.5),
        "multi-sine": MultiSine(
            tones=(
                Sine(center=REST, amplitude=1.0 * big, frequency=0.3, phase=0.0),
                Sine(center=still, amplitude=0.5 * big, frequency=0.3 * 2**0.5, phase=1.0),
                Sine(center=still, amplitude=0.25 * big, frequency=0.3 * 5**0.5, phase=2.0),
            )
        ),
        "fast-sine": MultiSine(
            tones=(
                Sine(center=REST, amplitude=fast, frequency=1.6),
                Sine(center=still, amplitude=0.5 * fast, frequency=1.6 * 2**0.5, phase=1.0),
            )
        ),
        "smooth-step": SmoothStep(
            start=REST, goal=REST + first_two((0.01, 0.01), (0.35, 0.25)), begin=0.5, duration=1.0
        ),
        "set-point": SetPoint(q=REST + first_two(bends=(0.2, 0.15))),
    }
    for name, motion in before.items():
        for arm in (P, None):
            now = named_reference(name, REST, arm)
            for t in (0.0, 0.313, 0.9, 1.7, 12.1):
                np.testing.assert_array_equal(now(t), motion(t), name)
    np.testing.assert_array_equal(
        named_reference("sine:amplitude=0.35,frequency=0.5", REST, P)(0.3), before["sine"](0.3)
    )


@pytest.mark.parametrize("arm", ARMS)
def test_they_suit_any_arm(arm: str):
    """What follows them exactly needs inputs within the range, and less than a tenth spare."""
    p = ARMS[arm]
    rest, (low, high) = equilibrium(p), p.input_bounds(())
    for name in NAMES:
        if name == "tip" and p.modules == 1 and not p.tip_length:
            with pytest.raises(OctarmError, match="moves along one line only"):
                named_reference(name, rest, p)
            continue
        motion = named_reference(name, rest, p)
        q, v, a = np.array([motion(t) for t in np.arange(0.0, 10.0, 0.0213)]).transpose(1, 0, 2)
        assert np.max(np.abs(q - rest)) > 1e-3 * np.max(p.rest_length), name
        tau = GroundedActuation(p.widths).inputs(q, inverse_dynamics(p, q, v, a))
        assert np.all((tau > 0.9 * low) & (tau < 0.9 * high)), name


def test_similar_arms_have_similar_references():
    length, mass, time = 0.31, 3.7, 0.47  # the lowest mode is no slower
    other = P.scaled(
        mass=mass, inertia=mass * length**2, width=length, stiffness=mass / time**2,
        damping=mass / time, rest_length=length, gravity=length / time**2, tip_length=length,
        input_range=mass * length / time**2,
    )  # fmt: skip
    unit = np.repeat([length, 1.0], 3)
    for name in NAMES:
        one, same = named_reference(name, REST, P), named_reference(name, REST * unit, other)
        for t in (0.4, 1.3, 7.7):
            for mine, theirs in zip(one(t), same(t), strict=True):
                np.testing.assert_allclose(theirs, mine * unit, rtol=1e-7, atol=1e-9, err_msg=name)


def test_each_arm_of_a_batch_has_its_own_size_bit_for_bit():
    many = P.scaled(stiffness=np.array([1.0, 10.0, 30.0])[:, None, None], rest_length=0.9)
    rest = equilibrium(many)
    for name in [name for name in NAMES if name != "tip"]:
        together = named_reference(name, rest, many)(0.7)
        for i in range(3):
            alone = named_reference(name, rest[i], many.arm(i))(0.7)
            for part, row in zip(alone, together, strict=True):
                np.testing.assert_array_equal(np.broadcast_to(row, rest.shape)[i], part)
    assert len({*named_reference("sine", rest, many)(0.5).q[:, 3].tolist()}) > 1
    with pytest.raises(OctarmError, match="a path of the tip needs one arm"):
        named_reference("tip", rest, many)


def test_a_given_size_is_that_of_the_first_coordinate_on_every_arm():
    eth = read_arm("eth")
    rest = equilibrium(eth)
    quarter = named_reference("sine:amplitude=10deg,frequency=1", rest, eth)(0.25)
    size = np.deg2rad(10.0)
    np.testing.assert_allclose(quarter.q - rest, [0, 0, size, size / 1.4], atol=1e-12)
    both = named_reference("set-point:5deg", rest, eth)(0.0).q - rest
    assert both[2] == pytest.approx(np.deg2rad(5.0))
    assert named_reference("sine-slides:1mm", rest, eth)(0.5).q[0] - rest[0] == pytest.approx(1e-3)


def test_the_frequency_of_a_chirp_changes_evenly():
    chirp = named_reference("chirp:0.3,from=0.5,to=2.5,duration=4s", REST, P)
    for t in (0.37, 1.63, 3.87, 5.13):  # the rate of the angle, of which q is the sine
        q, v, _ = chirp(t)
        rate = v[3] / np.sqrt(0.3**2 - (q[3] - REST[3]) ** 2)
        assert abs(rate) == pytest.approx(2.0 * np.pi * (0.5 + 0.5 * min(t, 4.0)), rel=1e-9)
    one = np.array([1.0])
    up = Chirp(center=0.0 * one, amplitude=one, start=1.0, end=1.0, duration=3.0)
    same = Sine(center=0.0 * one, amplitude=one, frequency=1.0)
    np.testing.assert_allclose(up(3.7), same(3.7), atol=1e-12)


def test_minimum_jerk_set_points_are_the_closed_form_from_rest_to_rest():
    motion = named_reference("minimum-jerk:20deg/-10deg,begin=1,duration=2,pause=0.5", REST, P)
    one, two = np.deg2rad([20.0, -10.0])
    assert isinstance(motion, SetPoints)
    for t, start, goal, begin in ((1.7, 0.0, one, 1.0), (4.1, one, two, 3.5)):
        x, way = (t - begin) / 2.0, goal - start
        q, v, a = (part[3] for part in motion(t))
        assert q == pytest.approx(start + way * (10 * x**3 - 15 * x**4 + 6 * x**5))
        assert v == pytest.approx(way * (30 * x**2 - 60 * x**3 + 30 * x**4) / 2.0)
        assert a == pytest.approx(way * (60 * x - 180 * x**2 + 120 * x**3) / 4.0)
    for t, place in ((0.4, 0.0), (3.2, one), (9.0, two)):
        q, v, a = motion(t)
        np.testing.assert_allclose(q - REST, [0, 0, 0, place, place / 1.4, 0], atol=1e-12)
        assert not v.any() and not a.any()


@pytest.mark.parametrize("arm", ["octarm", "eth", "fabric", "5 modules"])
@pytest.mark.parametrize("path", ["circle", "line", "eight"])
def test_the_tip_is_on_its_path_and_the_path_is_closed(arm: str, path: str):
    p = ARMS[arm]
    hanging = Hanging(equilibrium(p), p)
    tip = TipPath(path=path, period=2.0, angle=0.0 if path == "line" else 0.4)
    motion, size = tip.start(hanging), tip.size_for(hanging)
    place, turn = world(p, hanging.rest), np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False) + 0.05
    for round_ in (1, 4):
        t = 2.0 * (round_ + turn / (2.0 * np.pi))
        tips = np.array([world(p, motion(x).q) for x in t]) - place
        c, s = np.cos(turn), np.sin(turn)
        along, across = {"circle": (c, s), "line": (0 * c, s), "eight": (s * c, s)}[path]
        cos, sin = np.cos(tip.angle), np.sin(tip.angle)
        expected = np.stack([cos * along + sin * across, cos * across - sin * along], axis=-1)
        np.testing.assert_allclose(tips, size * expected, rtol=0.0, atol=1e-9)
    start = motion(0.0)
    np.testing.assert_allclose(start.q, hanging.rest, atol=1e-12)
    np.testing.assert_allclose(start.v, 0.0, atol=1e-6)
    h = 1e-5
    for t in (0.31, 1.7, 2.9, 5.03):
        before, now, after = motion(t - h), motion(t), motion(t + h)
        np.testing.assert_allclose(now.v, (after.q - before.q) / (2 * h), atol=1e-8)
        np.testing.assert_allclose(now.a, (after.v - before.v) / (2 * h), atol=1e-7)


def test_the_pose_of_the_tip_is_the_closest_one_to_rest():
    """No small change of q that leaves the tip in place comes closer."""
    motion = named_reference("tip:circle,size=6cm", REST, P)
    weights = np.repeat([1.0 / 0.12**2, 1.0], 3)
    rng = np.random.default_rng(1)
    for t in (3.4, 4.0, 5.2):
        q = motion(t).q
        J = np.stack(
            [(world(P, q + d) - world(P, q - d)) / 2e-6 for d in 1e-6 * np.eye(6)], axis=-1
        )
        free = np.eye(6) - np.linalg.pinv(J) @ J
        slope = free @ (weights * (q - REST))
        np.testing.assert_allclose(slope, 0.0, atol=1e-5)
        way = free @ rng.normal(size=6)
        assert way @ (weights * way) > 0.0


@pytest.mark.parametrize(
    ("word", "arm", "sentence"),
    [
        ("tip:circle,size=1m", "octarm", r"cannot follow the circle of size 1 m: .* mm along"),
        ("tip:line,size=10cm", "eth", "beyond the input range"),
        ("tip:square", "octarm", "known are circle, line, eight"),
        ("tip:size=-1cm", "octarm", "must be above 0 m"),
        ("sine:amplitud=1", "octarm", "did you mean 'amplitude'"),
        ("sine:amplitude=1m", "octarm", "its unit must be rad, mrad or deg"),
        ("sine:amplitude=20", "octarm", "at most 3.14159 rad; in degrees it is spelt 20deg"),
        ("sine:0.1,amplitude=0.2", "octarm", "gives amplitude twice"),
        ("sine:0.1,0.2", "octarm", "it must read sine:amplitude=0.35,frequency=0.5"),
        ("sine:1,frequency=90", "octarm", "theta1 moves at 565.5 rad/s, faster than 50"),
        ("sine-slides:10cm", "eth", "leaves the limits of the arm .* s1 is"),
        ("chirp:to=0", "octarm", "it must be above 0 Hz"),
        ("sin:amplitude=1", "octarm", "unknown reference 'sin', did you mean 'sine'"),
        ("file:", "octarm", "it must read file:PATH,spline=quintic"),
        ("file:nowhere.csv", "octarm", "nowhere.csv cannot be read"),
    ],
)
def test_what_is_wrong_is_one_sentence(word: str, arm: str, sentence: str):
    p = ARMS[arm]
    with pytest.raises(OctarmError, match=sentence) as raised:
        named_reference(word, equilibrium(p), p)
    assert "\n" not in str(raised.value)


def samples(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    t = np.linspace(0.0, 2.0, 21)
    bends = 0.2 * np.sin(t) ** 2
    rows = "".join(f"{a!r},{b!r}\n" for a, b in zip(t.tolist(), bends.tolist(), strict=True))
    (folder / "some, motion.csv").write_text(f"# of theta2\nt, theta2\n{rows}")
    q = np.tile(REST, (len(t), 1))
    q[:, 4] = bends
    np.savez(folder / "motion.npz", t=t, q=q)
    np.savetxt(folder / "bare.csv", np.column_stack([t, q]), delimiter=",", fmt="%.17g")
    return t, bends


@pytest.mark.parametrize("file", ["some, motion.csv", "motion.npz", "bare.csv"])
@pytest.mark.parametrize("spline", ["", ",spline=cubic"])
def test_a_file_is_followed_through_its_samples(tmp_path: Path, file: str, spline: str):
    t, bends = samples(tmp_path)
    motion = named_reference(f"file:{tmp_path / file}{spline}", REST, P)
    for now, bend in zip(t.tolist(), bends.tolist(), strict=True):
        np.testing.assert_allclose(motion(now).q - REST, [0, 0, 0, 0, bend, 0], atol=1e-12)
    h = 1e-5
    for now in (0.333, 1.21):
        before, here, after = motion(now - h), motion(now), motion(now + h)
        np.testing.assert_allclose(here.v, (after.q - before.q) / (2 * h), atol=1e-8)
        np.testing.assert_allclose(here.a, (after.v - before.v) / (2 * h), atol=1e-6)
        still = [0, 1, 2, 3, 5]  # without any rounding, or they would seem to move
        np.testing.assert_array_equal(here.q[still], REST[still])
        assert not np.any([here.v[still], here.a[still]])


@pytest.mark.parametrize(
    ("name", "text", "sentence"),
    [
        ("a.csv", "t,theta4\n0,0\n", "a column 'theta4', did you mean 'theta"),
        ("a.csv", "time,theta1\n0,0\n", "it has no column t"),
        ("a.csv", "t,theta1\n0,0\n1,x\n", "line 3 has 'x'; it must be a number"),
        ("a.csv", "t,theta1\n0,0\n1\n", "line 3 has 1 values; it must have 2: t, theta1"),
        ("a.csv", "t,theta1\n0,0\n1,0\n", "at least 6"),
        ("a.csv", "t,theta1\n" + "0,0\n" * 7, "one after another"),
        ("a.csv", "t,theta1\n" + "".join(f"{i},nan\n" for i in range(9)), "must be finite"),
        ("a.csv", "t,t\n0,0\n", "two columns of the same name"),
        ("a.csv", "", "holds no samples"),
        ("a.npz", "no archive", "is no NPZ file"),
    ],
)
def test_a_file_without_a_motion_is_one_sentence(
    tmp_path: Path, name: str, text: str, sentence: str
):
    (tmp_path / name).write_text(text)
    with pytest.raises(OctarmError, match=sentence) as raised:
        named_reference(f"file:{tmp_path / name}", REST, P)
    assert name in str(raised.value)


def test_parameters_and_files_are_recorded_and_verified(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    samples(tmp_path)
    short = ["--controller", "pd", "--duration", "0.02"]
    assert cli.main(["run", *short, "--reference", "sine:20deg,frequency=1", "--out", "a"]) == 0
    said = json.loads(Path("a/run.json").read_text())
    assert said["reference"]["name"] == "sine:20deg,frequency=1" and said["code"] == {}
    assert said["reference"]["amplitude"][3] == pytest.approx(np.deg2rad(20.0))
    assert cli.main(["run", *short, "--reference", "file:bare.csv", "--out", "b"]) == 0
    said = json.loads(Path("b/run.json").read_text())
    assert said["reference"] == {"name": "file:bare.csv"}
    assert said["code"]["file:bare.csv"]["path"] == f"file:{tmp_path}/bare.csv"
    assert len(said["code"]["file:bare.csv"]["sha256"]) == 64
    assert cli.main(["verify", "a", "b"]) == 0
    with open("bare.csv", "a") as file:
        file.write("\n")
    capsys.readouterr()
    assert cli.main(["verify", "b"]) == 1
    assert "bare.csv was changed since" in capsys.readouterr().out
    said["code"] = {}
    Path("b/run.json").write_text(json.dumps(said))
    assert cli.main(["verify", "b"]) == 2
    assert "not recorded with its SHA-256" in capsys.readouterr().err


def test_a_spec_takes_them_and_names_the_line_of_a_wrong_one(tmp_path: Path):
    samples(tmp_path)
    text = (
        'controller = "pd"\n[grid]\n'
        'reference = ["sine", "sine:frequency=1", "file:./bare.csv", "file:./motion.npz"]\n'
    )
    spec = parse_spec(text, f"{tmp_path}/spec.toml")
    assert spec.references == ("sine", "sine:frequency=1", "file:bare.csv", "file:motion.npz")
    assert {*spec.code} == {"file:bare.csv", "file:motion.npz"}
    kept = parse_spec(spec.to_toml())
    assert kept.content() == spec.content()
    for word, sentence in (
        ("sine:frequenzy=1", "line 3: sine has no key 'frequenzy', did you mean 'frequency'"),
        ("sin:frequency=1", "line 3: unknown reference 'sin'"),
        ("file:gone.csv", "line 3: .*gone.csv cannot be read"),
    ):
        with pytest.raises(OctarmError, match=sentence):
            parse_spec(text.replace("sine:frequency=1", word), f"{tmp_path}/spec.toml")


def test_parameters_of_a_reference_of_a_users_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["new", "reference", "swing"]) == 0
    short = ["run", "--controller", "pd", "--duration", "0.02", "--out", "a"]
    word = "./swing.py:Swing:amplitude=10deg"
    assert cli.main([*short, "--reference", word]) == 0
    said: dict[str, Any] = json.loads(Path("a/run.json").read_text())
    assert said["reference"]["name"] == "Swing:amplitude=10deg"
    assert said["reference"]["amplitude"] == pytest.approx(np.deg2rad(10.0))
    assert said["code"]["Swing"]["path"] == f"{tmp_path}/swing.py:Swing"
    assert cli.main(["verify", "a"]) == 0
    capsys.readouterr()
    assert cli.main([*short, "--force", "--reference", word.replace("10deg", "10m")]) == 2
    assert "its unit must be rad, mrad or deg" in capsys.readouterr().err
    environment = octarm.load(f"{tmp_path}/swing.py:Swing:amplitude=0.2,frequency=1")
    assert environment.task.reference(0.25).q[3] == pytest.approx(0.2)


def test_help_lists_each_with_its_parameters_units_and_defaults():
    text = help_text()
    for line in (
        "  sine:amplitude=0.35,frequency=0.5",
        "  chirp:amplitude=0.35,from=0.1,to=1.6,duration=8",
        "  minimum-jerk:points=0.35/-0.35/0,begin=0.5,duration=1,pause=0.5",
        "  tip:path=circle,size=0.04,period=3,angle=0",
        "  file:PATH,spline=quintic",
    ):
        assert line in text.splitlines()
    assert "amplitude [rad], frequency [Hz]" in " ".join(text.split())
    assert max(map(len, text.splitlines())) <= 80
