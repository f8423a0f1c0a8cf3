"""One look for each controller, apart from those of the modules."""

import itertools

import numpy as np

from controllers import CONTROLLERS
from octarm.palette import BRIGHT_MODULES, LOOKS, MODULES, OTHERS, look_of


def lab(color: str) -> np.ndarray:
    """CIE L*a*b*, in which equal distances look alike."""
    linear = np.array([int(color[k : k + 2], 16) for k in (1, 3, 5)]) / 255.0
    linear = np.where(linear > 0.04045, ((linear + 0.055) / 1.055) ** 2.4, linear / 12.92)
    matrix = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
    xyz = matrix @ linear / [0.9505, 1.0, 1.089]
    x, y, z = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16.0 / 116.0)
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


def test_controllers_and_modules_never_look_alike():
    colors = [*(look.color for look in LOOKS.values()), *OTHERS, *MODULES]
    for one, other in itertools.combinations(colors, 2):
        assert np.linalg.norm(lab(one) - lab(other)) > 10.0, (one, other)
    for one, other in itertools.combinations(BRIGHT_MODULES[:3], 2):
        assert np.linalg.norm(lab(one) - lab(other)) > 40.0


def test_every_controller_has_a_look_of_its_own():
    names = CONTROLLERS.names()
    assert set(names) == set(LOOKS)
    assert len({look_of(name).color for name in names}) == len(names)
    assert len({look_of(name).marker for name in names}) == len(names)


def test_the_look_of_another_one_depends_on_its_name_alone():
    assert look_of("feedforward") == look_of("feedforward")
    looks = {look_of(f"law-{k}") for k in range(200)}
    assert len(looks) == 18
    assert not looks & set(LOOKS.values())


def test_colors_are_seen_on_white_and_on_dark_ground():
    for color in [*(look.color for look in LOOKS.values()), *OTHERS]:
        assert 40.0 < lab(color)[0] < 72.0, color
