"""A sweep's TOML file: what it means, and what is said when it is wrong."""

import dataclasses
from pathlib import Path
from typing import Annotated, Any, ClassVar

import pytest

from controllers import make_controller
from octarm.arm.mjcf import nominal_parameters
from octarm.disturbances.episode import Force
from octarm.disturbances.forces import BandLimitedNoise, PulseForce
from octarm.disturbances.spelling import DISTURBANCES
from octarm.errors import FileError
from octarm.fields import Amount, Quantity
from octarm.sweeps.plan import Plan
from octarm.sweeps.spec_file import parse_spec, read_spec

SPEC = """\
seed = 3
episodes = 4
duration = 2          # a whole number is a number, too
reference = "multi-sine"
batch = 10

[grid]
controller = ["smc-boundary", "pd"]
mismatch = [-0.3, 0.3]

[grid.disturbance]
payload = [0, 0.2]
noise.ratio = [0.0, 0.4]
noise.time = [0.01, 0.05]

[grid.disturbance.drift]
rate = [0.0, 0.1]
of = ["stiffness", "damping"]

[random.disturbance]
actuation-delay = { low = 0.0, high = 0.005, method = "sobol" }
measurement-noise.rate = { low = 1.0, high = 2.0 }

[disturbance]
tilt = 0.1
measurement-noise.rms = 0.001

[gains.pd]
K_p = 100

[record]
episodes = ["worst", 7]
"""


def test_a_spec_says_what_is_in_it():
    spec = parse_spec(SPEC)
    assert (spec.seed, spec.episodes, spec.duration, spec.batch) == (3, 4, 2.0, 10)
    assert (spec.timestep, spec.control_period, spec.actuation) == (None, None, "f-coeff")
    assert {axis.name: axis.values for axis in spec.axes} == {
        "controller": ("smc-boundary", "pd"),
        "reference": ("multi-sine",),
        "drift.of": ("stiffness", "damping"),
        "mismatch": (-0.3, 0.3),
        "noise": (0.0, 0.4),
        "noise.time": (0.01, 0.05),
        "drift": (0.0, 0.1),
        "payload": (0.0, 0.2),
    }
    assert {a.name: (*a.values, a.method) for a in spec.random} == {
        "actuation-delay": (0.0, 0.005, "sobol"),
        "measurement-noise.rate": (1.0, 2.0, "uniform"),
    }
    assert spec.fixed == {"tilt": {"angle": 0.1}, "measurement-noise": {"rms": 0.001}}
    assert spec.gains == {"pd": {"K_p": 100.0}}
    assert spec.record == ("worst", 7)


def test_a_spec_can_be_written_and_read_back():
    for text in (SPEC, 'controller = "pd"\n[grid.disturbance]\nsaturation = [inf, 1e-5]'):
        spec = parse_spec(text)
        again = parse_spec(spec.to_toml())
        assert dataclasses.replace(again, text=spec.text) == spec
        assert again.hash() == spec.hash()


def test_axes_of_words_come_first_since_they_share_no_batch():
    words = [axis.words for axis in parse_spec(SPEC).axes]
    assert words == sorted(words, reverse=True)


def test_the_least_spec_is_a_controller():
    spec = parse_spec('[grid]\ncontroller = ["pd"]')
    assert {axis.name: axis.values for axis in spec.axes} == {
        "controller": ("pd",),
        "reference": ("sine",),
        "mismatch": (0.0,),
    }


def test_every_disturbance_can_be_an_axis_and_has_a_column_of_its_own():
    values = {"saturation": 10.0, "drift": 0.0}
    lines = [f"{name} = [{values.get(name, 0.1)}]" for name in DISTURBANCES]
    spec = parse_spec('controller = "pd"\n[grid.disturbance]\n' + "\n".join(lines))
    columns = [axis.name for axis in spec.axes]
    assert len(set(columns)) == len(columns) == 3 + len(DISTURBANCES)
    assert "disturbance.mismatch" in columns  # of the true arm; `mismatch` is the nominal model's


def test_a_disturbance_from_outside_can_be_an_axis(monkeypatch):
    @dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
    class Wall(Force):
        name: ClassVar[str] = "wall"
        stiffness: Annotated[Amount, Quantity("N m/rad", at_least=0.0)]
        distance: Annotated[Amount, Quantity("rad", key="angle")] = 0.2

        def start(self, episode):
            return lambda step, q: 0.0 * q

    monkeypatch.setitem(DISTURBANCES, "wall", Wall)
    text = 'controller = "pd"\n[grid.disturbance]\nwall = [0.0, 5.0]\nwall.angle = [0.1]'
    spec = parse_spec(text.replace("wall = ", "wall.stiffness = "))
    assert {axis.name for axis in spec.axes[3:]} == {"wall", "wall.angle"}
    (wall,) = Plan(spec).episode(1).disturbances  # the last value of stiffness
    assert isinstance(wall, Wall) and (wall.stiffness, wall.distance) == (5.0, 0.1)
    assert parse_spec(spec.to_toml()).hash() == spec.hash()
    with pytest.raises(ValueError, match="stiffness of wall is -1 N m/rad; it must be at least 0"):
        parse_spec('controller = "pd"\n[disturbance]\nwall = -1')


def test_the_hash_is_that_of_what_is_asked_for():
    base = parse_spec(SPEC)
    same = SPEC.replace("payload = [0, 0.2]\n", "").replace(
        "noise.ratio", "payload = [0.0, 2e-1]\nnoise.ratio"
    )
    assert parse_spec("# a remark\n" + same).hash() == base.hash()
    assert parse_spec(SPEC.replace('["worst", 7]', "[]")).hash() == base.hash()  # changes no row
    for old, new in (
        ("seed = 3", "seed = 4"),
        ("batch = 10", "batch = 11"),
        ("[0, 0.2]", "[0.2, 0]"),
        ("high = 0.005", "high = 0.006"),
        ("tilt = 0.1", "tilt = 0.2"),
        ("K_p = 100", "K_p = 101"),
    ):
        assert old in SPEC
        assert parse_spec(SPEC.replace(old, new)).hash() != base.hash()


@pytest.mark.parametrize(
    ("line", "text", "expected"),
    [
        (1, "sede = 1", "unknown key 'sede', did you mean 'seed'"),
        (1, "seeds = 3", "unknown key 'seeds', did you mean 'episodes' at the top, the number of"),
        (2, "[grid]\nseed = [0, 1]", "unknown key 'seed' in [grid], did you mean 'episodes' at"),
        (1, "noise = 0.4", "unknown key 'noise', did you mean 'disturbance.noise'? "),
        (1, "seed = -1", "seed is -1; it must be at least 0"),
        (1, "seed = true", "seed is true"),
        (1, "episodes = 2.5", "episodes is 2.5"),
        (1, "duration = 0", "duration is 0; it must be above 0"),
        (1, 'duration = "long"', 'duration is "long"'),
        (1, 'actuation = "magic"', 'unknown actuation "magic"; known are f-coeff, internal'),
        (1, 'reference = "sinus"', "unknown reference \"sinus\", did you mean 'sine'"),
        (1, "mismatch = -1.0", "mismatch is -1.0; it must be above -1"),
        (2, "seed = 1\nbatch = 0", "batch is 0"),
        (1, "[gird]\nnoise = [1]", "unknown key 'gird', did you mean 'grid'"),
        (
            3,
            "[grid]\nmismatch = [0.1]\nnoise = [1]",
            "in [grid], did you mean 'disturbance.noise'",
        ),
        (2, "[grid]\nmismatch = 0.1", "mismatch is 0.1; it must be a list"),
        (2, "[grid]\nmismatch = []", "mismatch is []"),
        (
            2,
            "[grid]\nmismatch = [0.1, 0.1]",
            "mismatch is [0.1, 0.1]; it must be without the same value twice",
        ),
        (2, '[grid]\nmismatch = [0.1, "a"]', 'mismatch holds "a"; it must be a number'),
        (2, "[grid]\nmismatch = [[0.1]]", "mismatch holds [0.1]; it must be a number"),
        (2, "[grid]\nreference = [1.0]", "reference holds 1.0; it must be a word"),
        (2, '[grid]\nreference = ["lines"]', 'unknown reference "lines"'),
        (2, '[grid]\ncontroller = ["pd"]', "controller is given twice"),
        (2, "[grid.disturbance]\nnois = [1]", "unknown disturbance 'nois', did you mean 'noise'"),
        (2, "[grid.disturbance]\nnoise = [-1]", "ratio of noise is -1; it must be at least 0"),
        (2, '[grid.disturbance]\nnoise = ["a"]', "ratio of noise is 'a'"),
        (2, "[grid.disturbance]\ndrift.speed = [1]", "drift has no key 'speed'; known are rate"),
        (2, "[grid.disturbance]\ndrift.limit = [0.1]", "drift needs a value of rate"),
        (1, '[grid.disturbance.drift]\nof = ["all"]\nrate = [1]', "of of drift is 'all'"),
        (
            2,
            "[random]\nmismatch = { low = 1, high = 1 }",
            'mismatch is {"low": 1, "high": 1}; it must be such that',
        ),
        (2, "[random]\nmismatch = { low = 0, hihg = 1 }", "'hihg' in [random.mismatch], did you"),
        (2, "[random.mismatch]\nlow = -2\nhigh = 1", "low is -2; it must be above -1"),
        (2, '[random]\nmismatch = {low=0, high=1, method="x"}', 'unknown method "x"'),
        (2, "[random.disturbance]\ndrift.of = {low=0, high=1}", "drift.of is made of words"),
        (2, "[disturbance]\nnoise = -1", "ratio of noise is -1"),
        (1, "[gains.smc]\nK = 1", "gains of 'smc', which is no controller of this sweep"),
        (2, '[gains.pd]\nK_p = "a"', 'K_p is "a"; it must be a number or a list'),
        (2, "[record]\nepisodes = [-1]", "episodes holds -1; it must be at least 0 or a word"),
        (2, '[record]\nepisodes = ["wurst"]', "did you mean 'worst'"),
        (2, '[record]\nepisode = ["worst"]', "unknown key 'episode' in [record]"),
        (
            4,
            "[grid.disturbance]\nnoise = [1]\n[random.disturbance]\nnoise = {low=0, high=1}",
            "noise is an axis of the grid, too",
        ),
        (
            4,
            "[grid.disturbance]\nnoise = [1]\n[disturbance]\nnoise.ratio = 0.4",
            "noise is an axis, too",
        ),
    ],
)
def test_what_is_wrong_is_said_with_its_line(line: int, text: str, expected: str):
    with pytest.raises(ValueError) as caught:
        parse_spec('controller = "pd"\n' + text, "my.toml")
    message = str(caught.value)
    assert message.startswith(f"my.toml, line {line + 1}: ")
    assert expected in message
    assert "\n" not in message


def test_what_is_missing_or_no_toml_is_said():
    with pytest.raises(ValueError, match=r"my.toml: there is no controller"):
        parse_spec("seed = 1", "my.toml")
    with pytest.raises(ValueError, match=r"my.toml: .*at line 2, column 1"):
        parse_spec("seed = 1\n= 2", "my.toml")


def test_a_file_that_is_no_text_is_refused(tmp_path):
    file = tmp_path / "spec.toml"
    file.write_bytes(b"\xff\xfe")
    with pytest.raises(ValueError, match="not a text file"):
        read_spec(file)
    with pytest.raises(FileError, match=r"other\.toml cannot be read"):
        read_spec(tmp_path / "other.toml")


SEVERAL = """\
controller = "pd"
[grid.disturbance]
pulse-2.at = [1.0, 2.0]
noise = [0.0, 0.4]
pulse = [0.1]
[random.disturbance]
noise-2 = { low = 0.0, high = 0.2 }
[disturbance]
noise-2.time = 0.5
pulse-2.amplitude = 0.2
"""


def test_a_second_disturbance_of_a_class_has_its_number():
    spec = parse_spec(SEVERAL)
    assert [axis.name for axis in spec.axes[2:]] == ["mismatch", "noise", "pulse", "pulse-2.at"]
    assert [(axis.name, axis.disturbance) for axis in spec.random] == [("noise-2", "noise-2")]
    assert spec.fixed == {"noise-2": {"correlation_time": 0.5}, "pulse-2": {"amplitude": 0.2}}
    assert dataclasses.replace(parse_spec(spec.to_toml()), text=spec.text) == spec
    plan = Plan(spec)
    (noise, second), (pulse, late) = (
        [d for d in plan.episode(1).disturbances if d.name == name] for name in ("noise", "pulse")
    )
    assert isinstance(noise, BandLimitedNoise) and isinstance(second, BandLimitedNoise)
    assert (noise.ratio, noise.correlation_time) == (0.0, 0.01)
    assert isinstance(second.ratio, float)
    assert 0.0 < second.ratio < 0.2 and second.correlation_time == 0.5
    assert isinstance(pulse, PulseForce) and isinstance(late, PulseForce)
    assert (pulse.amplitude, pulse.at, late.amplitude, late.at) == (0.1, 0.0, 0.2, 2.0)


GAINS = """\
controller = "pd"
[arm]
modules = 3
[gains]
K_p = [1, 2, 3, 4, 5, 6]
K_d = 10
"""


@pytest.fixture
def gain_file(tmp_path) -> Path:
    (tmp_path / "pd.toml").write_text(GAINS)
    return tmp_path / "spec.toml"


def test_a_gain_set_is_for_all_controllers_or_for_each():
    base = '[grid]\ncontroller = ["pd", "smc"]\n'
    assert parse_spec(base).gain_sets == {}
    spec = parse_spec('gain_set = "recommended"\n' + base)
    assert spec.gain_sets == {"pd": "recommended", "smc": "recommended"}
    assert spec.hash() != parse_spec(base).hash()
    each = parse_spec(base + '[gain_set]\nsmc = "tuned"')
    assert each.gain_sets == {"smc": "tuned"}
    for one in (spec, each):
        again = parse_spec(one.to_toml())
        assert again.gain_sets == one.gain_sets and again.hash() == one.hash()


def test_gains_of_a_file_become_part_of_the_spec(gain_file):
    text = 'controller = "pd"\ngain_set = "pd.toml"\n[gains.pd]\nK_d = 20'
    spec = parse_spec(text, str(gain_file))
    gains = {"K_p": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0], "K_d": 10.0}
    assert spec.gain_sets == {"pd": {"controller": "pd", "gains": gains, "arm": {"modules": 3.0}}}
    assert spec.gains == {"pd": {"K_d": 20.0}}
    made: Any = spec.controller("pd", nominal_parameters(), make_controller)
    assert made.K_d == 20.0
    assert made.K_p[1] == pytest.approx(2.0 * made.scales()["K_p"][1])
    assert not spec.text
    assert parse_spec(spec.to_toml()).hash() == spec.hash()  # without the file


@pytest.mark.parametrize(
    ("line", "text", "expected"),
    [
        (1, 'gain_set = "tund"', 'unknown gain_set "tund"; known are tuned, recommended, or NAME'),
        (2, '[gain_set]\npd = "tund"', 'unknown gain_set "tund"; known are'),
        (2, '[gain_set]\nsmc = "tuned"', "gains of 'smc', which is no controller of this sweep"),
        (2, '[gain_set]\npd = "other.toml"', "other.toml cannot be read: No such file"),
        (2, "[disturbance]\nnoise-2 = 0.1", "there is a noise-2, but no noise"),
        (2, "[disturbance]\nnoise-1 = 0.1", "unknown disturbance 'noise-1', did you mean 'noise'"),
        (3, "[disturbance]\npulse = 1\npulse-2.at = 1", "pulse-2 needs a value of amplitude"),
    ],
)
def test_what_is_wrong_with_sets_and_second_ones_is_said(line: int, text: str, expected: str):
    with pytest.raises(ValueError) as caught:
        parse_spec('controller = "pd"\n' + text, "my.toml")
    assert str(caught.value).startswith(f"my.toml, line {line + 1}: ")
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('"pd"', '"smc"', 'pd.toml, line 1: holds gains of "smc", not of pd'),
        ("[arm]", "[leg]", "pd.toml: it needs a value of arm"),
        ("modules = 3", "modules = true", "pd.toml, line 3: modules is true; it must be a number"),
        ("K_d = 10", 'K_d = "a"', 'pd.toml, line 6: K_d is "a"; it must be a number or a list'),
        ("[gains]", "gains", "pd.toml: "),
    ],
)
def test_what_is_wrong_with_a_file_of_gains_is_said(gain_file, old, new, expected):
    file = gain_file.with_name("pd.toml")
    file.write_text(GAINS.replace(old, new))
    with pytest.raises(ValueError) as caught:
        parse_spec('controller = "pd"\ngain_set = "pd.toml"', str(gain_file))
    assert expected in str(caught.value)
