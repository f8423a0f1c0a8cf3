"""Arms from TOML files: what numbers and units mean, and how a wrong file is refused."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest

import octarm
from controllers import make_controller
from octarm.arm import lagrange
from octarm.arm.file import Arm, arm_of, arm_toml, read_arm_file, shipped_arms
from octarm.arm.file_content import quantity
from octarm.arm.parameters import ArmParameters
from octarm.arm.reach import reach
from octarm.arm.rod import Rod, arm_from_rod
from octarm.checks.validation import random_arm
from octarm.errors import FileError, OctarmError
from octarm.formats import parse_toml
from octarm.references import Sine
from octarm.units import UNITS

FILE = """\
name = "two modules"
mass = { value = [300, 200], unit = "g" }
inertia = "600 kg mm^2"
width = "80 mm"
rest_length = "12 cm"
stiffness = "1.2 N/mm"
damping = "12 N s/m"
input_range = { value = [-12, 12.5], unit = "N" }
"""
FIELDS = [field.name for field in dataclasses.fields(ArmParameters)]


def parsed(text: str) -> ArmParameters:
    return arm_of(parse_toml(text, "arm.toml")).parameters


def changed(**lines: str | None) -> str:
    """The file with other values of some keys, or without them."""
    text = FILE
    for key, value in lines.items():
        text = re.sub(rf"(?m)^{key} = .*\n", "", text)
        text += f"{key} = {value}\n" if value is not None else ""
    return text


def test_numbers_are_converted_and_broadcast():
    p = parsed(FILE)
    expected = {
        "mass": [0.3, 0.2], "inertia": [6e-4, 6e-4], "width": [0.08], "rest_length": [0.12, 0.12],
        "stiffness": np.full((2, 2), 1200.0), "damping": np.full((2, 2), 12.0), "gravity": 9.81,
        "tip_length": 0.0, "input_range": [[-12.0], [12.5]],
        "rest_angle": [0.0, 0.0], "backbone_stiffness": np.zeros((2, 2)),
        "backbone_damping": np.zeros((2, 2)),
    }  # fmt: skip
    assert expected.keys() == set(FIELDS)
    for name, value in expected.items():
        np.testing.assert_allclose(getattr(p, name), value, rtol=1e-15, err_msg=name)


@pytest.mark.parametrize(
    ("lines", "field", "expected"),
    [
        ({"mass": '["0.3 kg", "200 g"]'}, "mass", [0.3, 0.2]),
        ({"mass": '"0.3 kg"', "modules": "2"}, "mass", [0.3, 0.3]),
        ({"width": '["80 mm", "6 cm"]'}, "width", [0.08, 0.06]),
        ({"gravity": '"-9.81 m/s^2"'}, "gravity", -9.81),
        ({"tip_length": '"20 mm"'}, "tip_length", 0.02),
        ({"rest_angle": '["10 deg", "-0.1 rad"]'}, "rest_angle", [np.pi / 18.0, -0.1]),
        (
            {"stiffness": '{ value = [[1200, 1000], [1100, 900]], unit = "N/m" }'},
            "stiffness",
            [[1200.0, 1000.0], [1100.0, 900.0]],
        ),
        ({"damping": '[["12 N s/m"], ["9 N s/m"]]'}, "damping", [[12.0, 12.0], [9.0, 9.0]]),
        (
            {"input_range": '{ value = [[0, -9], [20, 9]], unit = "N" }'},
            "input_range",
            [[0.0, 0.0, -9.0, -9.0], [20.0, 20.0, 9.0, 9.0]],
        ),
        (
            {"input_range": '{ value = [[0, 0, -9, 0], [20, 1, 9, 2]], unit = "N" }'},
            "input_range",
            [[0.0, 0.0, -9.0, 0.0], [20.0, 1.0, 9.0, 2.0]],
        ),
        ({"input_range": '["0 N", "inf N"]'}, "input_range", [[0.0], [np.inf]]),
        ({"input_range": None}, "input_range", [[-np.inf], [np.inf]]),
        ({"damping": None, "damping_time": '"10 ms"'}, "damping", np.full((2, 2), 12.0)),
        (
            {"rest_length": '{ value = [[124], [116]], unit = "mm" }'},
            "rest_length",
            [0.12, 0.12],
        ),
        ({"rest_length": '{ value = [[124], [116]], unit = "mm" }'}, "rest_angle", [0.1, 0.1]),
    ],
)  # fmt: skip
def test_every_form_of_a_value(lines: dict[str, str], field: str, expected: list):
    np.testing.assert_allclose(getattr(parsed(changed(**lines)), field), expected, rtol=1e-14)


def module_matrices(p: ArmParameters) -> np.ndarray:
    """What each module has along s and theta: stiffness and damping, shape (2, N, 2)."""
    n = p.modules
    diagonals = [np.diag(f(p)) for f in (lagrange.stiffness_matrix, lagrange.damping_matrix)]
    return np.stack([np.stack([x[:n], x[n:]], axis=-1) for x in diagonals])


@pytest.mark.parametrize("columns", [None, '"1.2 N/mm"', '[["1.2 N/mm"], ["1.0 N/mm"]]'])
@pytest.mark.parametrize(("axial", "bending"), [(3000.0, 2.0), (900.0, 1.5), (5000.0, 0.5)])
def test_a_module_has_the_axial_and_bending_stiffness_that_the_file_gives(columns, axial, bending):
    """Whether columns would give more or less; their difference stays."""
    text = changed(
        stiffness=columns,
        axial_stiffness=f'"{axial} N/m"',
        bending_stiffness=f'"{bending} N m/rad"',
    )
    p = parsed(text)
    np.testing.assert_allclose(module_matrices(p)[0], [[axial, bending]] * 2, rtol=1e-14)
    assert np.all(p.stiffness > 0.0)
    difference = 200.0 if columns and "1.0" in columns else 0.0
    np.testing.assert_allclose(p.stiffness[0] - p.stiffness[1], difference, atol=1e-9)
    damped = parsed(
        changed(damping=None, axial_damping='"30 N s/m"', bending_damping='"0.01 N m s"')
    )
    np.testing.assert_allclose(module_matrices(damped)[1], [[30.0, 0.01]] * 2, rtol=1e-14)


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ({"width": "0.08"}, r'line \d+: width is 0\.08; it must be given with a unit'),
        ({"width": '"80 mn"'}, r'line \d+: width is "80 mn"; it must be in m, cm, mm or um'),
        ({"width": '"80xm"'}, r'width is "80xm"; it must be in m, cm, mm or um'),
        ({"width": '"80 N"'}, r"width is .*; it must be in m, cm, mm or um"),
        ({"width": "true"}, r"width is true; it must be"),
        ({"width": '{ value = 80 }'}, r"width is .*; it must be a table such as { value = "),
        ({"width": '{ value = "80", unit = "mm" }'}, r"width is .*; it must be a table"),
        ({"mass": '{ value = [1, [2]], unit = "g" }'}, r"mass is .*; it must be a list of as"),
        ({"mass": "[]"}, r'mass is \[\]; it must be a number with a unit'),
        ({"width": '"nan m"'}, r"width is .*; it must be a number with a unit"),
        ({"mass": None, "modules": "2"}, r"it needs a value of mass$"),
        ({"damping": None}, r"it needs a value of damping$"),
        ({"mass": '"1 kg"'}, r"it needs a value of modules, since no list says how many there are"),
        ({"with": '"80 mm"'}, r"line \d+: unknown key 'with', did you mean 'width'"),
        ({"modules": "3"}, r"line 2: mass has 2 values; it needs 1 or 3, one for each module"),
        ({"modules": "101"}, r"modules is 101; it must be at most 100"),
        ({"mass": '["0.3 kg", "-1 kg"]'}, r"line \d+: mass holds -1; it must be above 0"),
        ({"stiffness": '[["1 N/m"], ["1 N/m"], ["1 N/m"]]'}, r"stiffness has 3 x 1 values"),
        ({"input_range": '["1 N", "2 N"]'}, r"line \d+: input_range goes from 1 to 2"),
        ({"input_range": '["1 N", "2 N", "3 N"]'}, r"input_range has 3 values; it needs a pair"),
        ({"damping_time": '"1 s"'}, r"damping_time is given beside damping"),
        ({"gravity": '["1 m/s^2", "2 m/s^2"]'}, r"gravity has 2 values; it is one number"),
        ({"bending_stiffness": '"-1 N m"'}, r"line 9: bending_stiffness holds -1; it must be at"),
        ({"width": '"0 m"'}, r"line \d+: width holds 0; it must be above 0"),
        ({"mass": '["30 kg", "300 kg"]'}, r"this arm cannot hang in one piece: at rest s1 is"),
        ({"gravity": '"-1e9 m/s^2"'}, r"this arm cannot hang in one piece: at rest s1 is "),
        (
            {"stiffness": '[["1.2 N/mm"], ["1 N/m"]]', "bending_stiffness": '"0.001 N m/rad"'},
            r"line \d+: stiffness of the columns of module 1 differs by more than its axial",
        ),
        (
            {"rest_length": '[["12 cm"], ["11 cm"]]', "rest_angle": '"0.1 rad"'},
            r"line \d+: rest_angle is given beside two rows of rest_length",
        ),
    ],
)  # fmt: skip
def test_a_wrong_file_is_refused_in_one_sentence(lines: dict[str, str | None], said: str):
    with pytest.raises(OctarmError, match=said) as caught:
        parsed(changed(**lines))
    message = str(caught.value)
    assert message.startswith("arm.toml")
    assert "\n" not in message


@pytest.mark.parametrize("kind", UNITS)
def test_every_unit_is_read_and_the_first_one_is_of_the_si(kind: str):
    first, *_ = units = UNITS[kind]
    assert quantity(kind, f"2 {first}") == 2.0
    for unit, size in units.items():
        np.testing.assert_allclose(
            quantity(kind, {"value": [1, 2.0], "unit": unit}), [size, 2 * size]
        )
    for spelling in ("3 kg·mm²", "3kg mm^2", "3e0 kg*mm^2", " +3. kgmm^2 "):
        assert quantity("inertia", spelling) == pytest.approx(3e-6)
    assert quantity("length", "-inf m") == -np.inf
    for wrong in ("1.2.3 m", "m", "1 2 m", "0x10 m", "1e m", "", "3"):
        with pytest.raises(ValueError, match=r"a number with a unit|in m, cm, mm or um"):
            quantity("length", wrong)


ROD = """\
input_range = { value = [-5, 5], unit = "N" }
[rod]
length = "36 cm"
EA = "240 N"
EI = { value = [0.4, 0.2], unit = "N m^2" }
density = "2.1 g/mm"
rotary_inertia = "3.3e-3 kg m"
damping_time = "10 ms"
modules = 7
layout = "centred"
"""


def test_a_file_may_give_a_rod():
    p = parsed(ROD)
    rod = Rod(length=0.36, EA=240.0, EI=(0.4, 0.2), density=2.1, rotary_inertia=3.3e-3)
    expected = dataclasses.replace(arm_from_rod(rod, 7, "centred"), input_range=(-5.0, 5.0))
    for name in FIELDS:
        np.testing.assert_allclose(getattr(p, name), getattr(expected, name), rtol=1e-14)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('EA = "240 N"\n', "", r"\[rod\] needs a value of EA"),
        ('"240 N"', '"-240 N"', r"line 4: EA holds -240; it must be finite and above 0"),
        ('"240 N"', "240", r'EA is 240; it must be given with a unit, such as "240 N"'),
        ('"centred"', '"centered"', r"unknown layout \"centered\", did you mean 'centred'"),
        ("modules = 7", "moduls = 7", r"unknown key 'moduls' in \[rod\], did you mean 'modules'"),
        ("[rod]", 'width = "8 cm"\n[rod]', r"width is given beside \[rod\]"),
    ],
)
def test_a_wrong_rod_is_refused(old: str, new: str, said: str):
    with pytest.raises(OctarmError, match=said):
        parsed(ROD.replace(old, new))


@pytest.mark.parametrize("modules", [1, 3, 5])
def test_a_file_that_is_written_gives_the_same_arm_back(modules: int, tmp_path: Path):
    draw = np.random.default_rng(modules)
    arm = dataclasses.replace(
        random_arm(draw, modules),
        tip_length=0.03,
        input_range=draw.uniform(1.0, 9.0, (2, 2 * modules)) * [[-1.0], [1.0]],
        rest_angle=draw.uniform(-0.3, 0.3, modules),
        backbone_stiffness=draw.uniform(0.0, 1.0, (2, modules)),
        backbone_damping=draw.uniform(0.0, 0.1, (2, modules)),
    )
    file = tmp_path / "arm.toml"
    file.write_text(arm_toml(Arm(arm, "an arm", ("a paper",), (), ("its mass",))), encoding="utf-8")
    back = read_arm_file(file)
    assert (back.name, back.source, back.converted, back.assumed) == (
        "an arm", ("a paper",), (), ("its mass",),
    )  # fmt: skip
    for name in FIELDS:
        given, read = getattr(arm, name), getattr(back.parameters, name)
        left = 1e-7 if name.startswith("backbone") else 1e-13  # of the whole less the columns
        np.testing.assert_allclose(read, given, rtol=1e-11, atol=left, err_msg=name)
    plain = random_arm(draw, modules)
    file.write_text(arm_toml(Arm(plain)), encoding="utf-8")
    back = octarm.read_arm(file)
    for name in FIELDS:
        np.testing.assert_allclose(getattr(back, name), getattr(plain, name), rtol=1e-11)
    assert back.entries.plain


def test_files_that_are_not_there_and_names_that_are_unknown():
    with pytest.raises(FileError, match=r"none\.toml cannot be read"):
        octarm.read_arm("none.toml")
    if known := list(shipped_arms()):
        with pytest.raises(
            OctarmError, match=rf"unknown arm '{known[0]}x', did you mean '{known[0]}'"
        ):
            octarm.read_arm(f"{known[0]}x")


def test_the_nominal_arm_as_a_file_is_that_of_the_model():
    p, nominal = octarm.read_arm("octarm"), octarm.nominal_parameters()
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(p, name), getattr(nominal, name))


@pytest.mark.parametrize("name", sorted(shipped_arms()))
@pytest.mark.parametrize("controller", ["smc-boundary", "afsmc"])
def test_a_published_arm_says_where_it_comes_from_and_tracks_a_sine(name: str, controller: str):
    """With the gains that it gets by itself, below 2 % of the amplitude with an exact model."""
    arm = read_arm_file(name)
    assert arm.source and arm.assumed
    p = arm.parameters
    rest = lagrange.equilibrium(p)
    bends = np.repeat([0.0, 1.0], p.modules)
    held = np.minimum(0.4 * reach(p).alike[1], 0.2)  # what the damping takes is not known there
    motion = Sine(center=rest, amplitude=held * bends, frequency=0.5)
    run = octarm.rollout(
        octarm.load(motion, parameters=p), make_controller(controller, p), duration=2.0
    )
    assert run.status == "ok"
    late = run.error[run.t > 1.0][:, p.modules :]
    assert np.sqrt(np.mean(late**2, axis=0)).max() < 0.02 * held


@pytest.mark.parametrize("name", sorted(shipped_arms()))
def test_both_engines_move_a_published_arm_alike(name: str):
    p = octarm.read_arm(name)
    low, high = p.input_bounds(())
    motions = []
    for engine in ("mujoco", "lagrange"):
        environment = octarm.load(parameters=p, engine=engine)
        environment.reset()
        draw = np.random.default_rng(0)
        for _ in range(200):
            environment.step(0.2 * draw.uniform(low, high))
        motions.append(environment.physics.q())
    np.testing.assert_allclose(*motions, rtol=0, atol=1e-12)
