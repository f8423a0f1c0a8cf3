"""What the nominal arm of three modules gets wrong: the numbers of the README's limits."""

import numpy as np
import pytest

from octarm.arm.groups import Groups
from octarm.arm.kinematics import arc_tip, jacobian, tip
from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import nominal_parameters
from octarm.checks.rod_study import frequencies, static_tip

ARM = nominal_parameters()
ROD = Groups.of(ARM, 60, "centred").plant  # converged to a part in a thousand


def compliance(arm) -> float:
    """Deflection of the hanging tip by a small force across it [m/N]."""
    gravity = np.array([9.81, 0.0])
    across = static_tip(arm, np.array([0.0, 0.01]), gravity)
    return float((across - static_tip(arm, np.zeros(2), gravity))[1] / 0.01)


def test_the_arm_is_too_stiff_by_1_8_and_theta3_does_not_move_its_tip():
    lumped, rod = compliance(ARM), compliance(ROD)
    assert lumped == pytest.approx(0.0163, abs=1e-4)
    assert rod == pytest.approx(0.0299, abs=1e-4)
    assert rod / lumped == pytest.approx(1.8, abs=0.05)
    assert np.all(jacobian(equilibrium(ARM))[-1, :, -1] == 0.0)


@pytest.mark.parametrize(
    ("arm", "bending", "axial"),
    [
        (ARM, [2.20, 8.91, 14.57], [6.89, 17.12, 24.46]),
        (ROD, [2.10, 9.85, 22.06], [8.30, 22.35, 36.40]),
    ],
)
def test_its_modes_are_not_those_of_the_rod(arm, bending: list[float], axial: list[float]):
    bends, stretches = frequencies(arm)
    np.testing.assert_allclose(bends[:3], bending, rtol=4e-3)
    np.testing.assert_allclose(stretches[:3], axial, rtol=4e-3)


def test_its_tip_is_36_mm_from_the_end_of_arcs():
    q = equilibrium(ARM)
    q[3:5] = 0.35, 0.25
    lumped, arcs = np.array(tip(q)), np.array(arc_tip(q))
    assert np.hypot(*(lumped - arcs)) == pytest.approx(0.0363, abs=2e-4)
    assert lumped[1] / arcs[1] == pytest.approx(0.76, abs=0.005)
