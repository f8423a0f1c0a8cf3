"""What counts as an arm, and how a wrong one is refused."""

from __future__ import annotations

import dataclasses
import json
from typing import Any

import numpy as np
import pytest

from octarm import ArmParameters

FIELDS = [f.name for f in dataclasses.fields(ArmParameters)]


def fields(**changed: Any) -> dict[str, Any]:
    """A valid arm of two modules, with some fields changed."""
    valid = {
        "mass": [0.3, 0.2],
        "inertia": [6e-4, 4e-4],
        "width": 0.08,
        "stiffness": [[1200.0, 1000.0], [1100.0, 900.0]],
        "damping": [[12.0, 10.0], [11.0, 9.0]],
        "rest_length": [0.12, 0.1],
        "gravity": 9.81,
        "tip_length": 0.02,
        "input_range": [[-20.0, -20.0, 0.0, -9.0], [20.0, 0.0, 20.0, 9.0]],
        "rest_angle": [0.1, -0.2],
        "backbone_stiffness": [[300.0, 0.0], [0.2, 0.5]],
        "backbone_damping": [[3.0, 2.0], [0.01, 0.0]],
    }
    return valid | changed


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("mass", 0.3, r"mass has shape \(\)"),
        ("mass", [], r"mass has shape \(0,\)"),
        ("inertia", [1.0, 2.0, 3.0], r"inertia has shape \(3,\); it must be \(\.\.\., 2\)"),
        ("stiffness", [1.0, 2.0], r"stiffness has shape \(2,\); it must be \(\.\.\., 2, 2\)"),
        ("stiffness", np.ones((3, 2)), r"stiffness has shape \(3, 2\); it must be \(\.\.\., 2, 2"),
        ("damping", np.ones((2, 3)), r"damping has shape \(2, 3\); it must be \(\.\.\., 2, 2\)"),
        ("mass", [0.3, -0.2], r"mass holds -0\.2"),
        ("mass", [0.3, 0.0], r"mass holds 0"),
        ("inertia", [-1e-4, 1e-4], r"inertia holds -0\.0001"),
        ("width", 0.0, r"width holds 0"),
        ("stiffness", [[1, 1], [0, 1]], r"stiffness holds 0"),
        ("damping", [[1, 1], [-3, 1]], r"damping holds -3"),
        ("rest_length", [0.1, 0.0], r"rest_length holds 0"),
        ("mass", [0.3, np.nan], r"mass holds nan"),
        ("gravity", np.inf, r"gravity holds inf"),
        ("gravity", -np.inf, r"gravity holds -inf"),
        ("mass", "heavy", r"mass .*'heavy'"),
        ("width", "8 cm", r"width .*'8 cm'"),
        ("gravity", {"z": -9.81}, r"gravity .*'z'"),
        ("stiffness", [[1, 2], [3]], r"stiffness .*\[\[1, 2\], \[3\]\]"),
        ("mass", [[1, 2], [3]], r"mass .*\[\[1, 2\], \[3\]\]"),
    ],
)
def test_a_bad_field_is_refused_with_its_name_and_value_in_one_sentence(field, value, said):
    with pytest.raises(ValueError, match=rf"^{said}") as caught:
        ArmParameters(**fields(**{field: value}))
    message = str(caught.value)
    assert "\n" not in message
    assert ". " not in message


def test_an_arm_may_be_undamped_and_may_stand_or_float():
    for gravity in (-9.81, 0.0):
        assert ArmParameters(**fields(damping=np.zeros((2, 2)), gravity=gravity)).modules == 2


@pytest.mark.parametrize("n", [1, 2, 5])
def test_the_number_of_modules_comes_from_the_arrays(n):
    one = np.ones(n)
    p = ArmParameters(
        mass=one,
        inertia=one,
        width=1.0,
        stiffness=[one, one],
        damping=[one, one],
        rest_length=one,
        gravity=1.0,
    )
    assert (p.modules, p.coordinates, p.batch_shape) == (n, 2 * n, ())


def test_arrays_are_float_copies_that_cannot_be_written():
    given = np.array([1, 2])
    p = ArmParameters(**fields(mass=given))
    given[0] = 7
    np.testing.assert_array_equal(p.mass, [1.0, 2.0])
    for name in FIELDS:
        value = getattr(p, name)
        assert value.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            value[...] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        p.width = 1.0  # pyright: ignore[reportAttributeAccessIssue]


def test_fields_must_be_named():
    with pytest.raises(TypeError):
        ArmParameters([1.0], [1.0], 1.0, [[1.0]] * 2, [[1.0]] * 2, [1.0], 1.0)  # type: ignore


@pytest.mark.parametrize(
    ("changed", "batch"),
    [
        ({"gravity": [9.8, 9.9, 1.6]}, (3,)),
        ({"mass": np.ones((3, 2))}, (3,)),
        ({"mass": np.ones((3, 2)), "width": np.ones((5, 1, 1))}, (5, 3)),
        ({"stiffness": np.ones((4, 2, 2)), "gravity": np.ones(4)}, (4,)),
    ],
)
def test_any_field_may_carry_batch_axes(changed, batch):
    p = ArmParameters(**fields(**changed))
    assert p.batch_shape == batch
    assert p.modules == 2


def test_batch_axes_that_do_not_fit_are_refused_by_name():
    with pytest.raises(ValueError, match=r"batch axes .* mass \(3,\), width \(4,\)"):
        ArmParameters(**fields(mass=np.ones((3, 2)), width=np.ones((4, 1))))


def test_scaled_multiplies_the_named_fields_and_no_other():
    p = ArmParameters(**fields())
    scaled = p.scaled(mass=2.0, stiffness=[[1.0, 0.5], [2.0, 3.0]])
    expected = fields(mass=[0.6, 0.4], stiffness=[[1200.0, 500.0], [2200.0, 2700.0]])
    # The backbone follows the mean of a module's columns.
    expected["backbone_stiffness"] = [[450.0, 0.0], [0.2 * 1.5, 0.5 * 1.75]]
    for name in FIELDS:
        np.testing.assert_allclose(getattr(scaled, name), expected[name], rtol=1e-15)
    np.testing.assert_array_equal(p.mass, [0.3, 0.2])


def test_scaling_by_a_batch_of_factors_gives_a_batch_of_arms():
    p = ArmParameters(**fields()).scaled(mass=[[1.0], [2.0], [3.0]], gravity=[1.0, 0.5, 0.0])
    assert p.batch_shape == (3,)
    np.testing.assert_allclose(p.mass, [[0.3, 0.2], [0.6, 0.4], [0.9, 0.6]])


def test_an_unknown_field_is_refused_by_name():
    p = ArmParameters(**fields())
    with pytest.raises(ValueError, match=r"unknown parameter 'weight'.*known are mass, inertia"):
        p.scaled(weight=2.0)


@pytest.mark.parametrize("factor", [-1.0, 0.0, np.nan, "heavy", [1.0, 2.0, 3.0]])
def test_a_bad_factor_is_refused_with_the_name_of_its_field(factor):
    with pytest.raises(ValueError, match="mass"):
        ArmParameters(**fields()).scaled(mass=factor)


@pytest.mark.parametrize("x", [-0.999, -0.3, 0.0, 0.3, 2.0])
def test_mismatch_scales_mass_inertia_damping_by_1_plus_x_and_stiffness_by_half_of_it(x):
    p = ArmParameters(**fields())
    wrong = p.mismatched(x)
    for name in FIELDS:
        factor = {"mass": 1 + x, "inertia": 1 + x, "damping": 1 + x, "stiffness": 1 + x / 2}
        factor |= {f"backbone_{kind}": factor[kind] for kind in ("damping", "stiffness")}
        expected = getattr(p, name) * factor.get(name, 1.0)
        np.testing.assert_array_equal(getattr(wrong, name), expected)


@pytest.mark.parametrize("x", [-1.0, -1.5, np.nan, np.inf])
def test_a_mismatch_that_leaves_no_arm_is_refused(x):
    with pytest.raises(ValueError, match=rf"^mismatch is {x:g}; .*above -1"):
        ArmParameters(**fields()).mismatched(x)


@pytest.mark.parametrize("changed", [{}, {"mass": np.ones((3, 2)), "width": np.ones((5, 1, 1))}])
def test_json_gives_the_same_numbers_back(changed):
    p = ArmParameters(**fields(**changed)).scaled(mass=1.0 / 3.0)
    back = ArmParameters.from_dict(json.loads(json.dumps(p.to_dict())))
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(back, name), getattr(p, name))


def test_a_dictionary_with_a_missing_or_an_unknown_field_is_refused():
    missing = fields()
    del missing["inertia"]
    with pytest.raises(ValueError, match=r"missing or unknown: inertia$"):
        ArmParameters.from_dict(missing)
    with pytest.raises(ValueError, match=r"missing or unknown: colour$"):
        ArmParameters.from_dict(fields(colour="red"))


def test_the_bend_without_force_and_the_backbone_follow_what_they_belong_to():
    p = ArmParameters(**fields()).scaled(rest_length=2.0, damping=[[1.0, 2.0], [3.0, 4.0]])
    np.testing.assert_allclose(p.rest_angle, [0.2, -0.4])
    np.testing.assert_allclose(p.backbone_damping, [[6.0, 6.0], [0.02, 0.0]])
    straight = ArmParameters(**fields(rest_angle=0.0, backbone_stiffness=0.0))
    assert not straight.scaled(stiffness=[[2.0], [1.0]]).backbone_stiffness.any()


def test_an_arm_that_is_straight_without_force_takes_any_number_of_modules():
    p = ArmParameters(**fields(rest_angle=0.0, backbone_stiffness=0.0, backbone_damping=0.0))
    two = {"stiffness": p.stiffness[:, :1], "damping": p.damping[:, :1]}
    one = {name: getattr(p, name)[:1] for name in ("mass", "inertia", "rest_length")}
    cut = dataclasses.replace(p, **one, **two, input_range=(-1.0, 1.0))
    assert cut.rest_angle.shape == (1,)
    assert not {"rest_angle", "backbone_damping"} & cut.to_dict().keys()
