"""The colours of all pictures: one look for each controller, and one colour for each module.

No controller shares a colour with a module, so that a picture of one is not read as the other.
"""

from __future__ import annotations

import zlib
from typing import NamedTuple


class Look(NamedTuple):
    """How a controller is drawn in every figure and on every page, whatever the ground."""

    color: str  # hexadecimal
    marker: str  # Matplotlib's letter


# The colour-blind can tell the first five apart; after Okabe and Ito. The order is that of the
# figures of the paper.
COLORS = (
    "#0a72b8", "#d55e00", "#00956c", "#c569a0", "#dd9500",
    "#3aa3dd", "#7d6bd0", "#8c8c8c", "#b0413e", "#7a8f1f",
)  # fmt: skip
MARKERS = "os^Dv<>PXp"
_CONTROLLERS = (
    "afsmc", "smc-boundary", "smc", "smc-integral", "super-twisting",
    "afsmc-consequent", "fsmc", "pd", "computed-torque", "fuzzy",
)  # fmt: skip
LOOKS = {
    name: Look(color, marker)
    for name, color, marker in zip(_CONTROLLERS, COLORS, MARKERS, strict=True)
}
OTHERS = ("#4f9da6", "#a5673f", "#5c73a8", "#9a5fc0", "#b86b7b", "#5f8f4e")
_OTHER_MARKERS = "d*1"

# Of the modules from the base to the tip, on white and on dark ground.
MODULES = (
    "#9b7a12", "#12807f", "#a01f72", "#4a3fb5", "#5d4a3a", "#2f6e1f", "#8a2be2", "#8f2f1f",
)  # fmt: skip
BRIGHT_MODULES = (
    "#f2c84b", "#3ccfcf", "#f07cc8", "#9b89ff", "#c9a58a", "#86d36a", "#d68cff", "#ff8a70",
)  # fmt: skip


def look_of(controller: str) -> Look:
    """The look of a controller by its name, built in or not, whatever else is drawn with it."""
    if controller in LOOKS:
        return LOOKS[controller]
    key = zlib.crc32(controller.encode(errors="backslashreplace"))
    color, marker = key % len(OTHERS), key // len(OTHERS) % len(_OTHER_MARKERS)
    return Look(OTHERS[color], _OTHER_MARKERS[marker])
