"""The command on an arm: arm."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

from octarm.commands import kinds
from octarm.commands.kinds import Work
from octarm.commands.terminal import surviving_output


def arm(
    *arms: Annotated[str, kinds.FILE_OR_ARM],
    from_rod: Annotated[str | None, kinds.text("KEY=VALUE,.."), kinds.SOURCE] = None,
    fit_modules: Annotated[int | None, kinds.whole(1, 60), kinds.SOURCE] = None,
    layout: Annotated[str, kinds.LAYOUT, kinds.SOURCE] = "paper",
    write: Annotated[Path | None, kinds.file(".toml"), kinds.OUTPUT] = None,
    out: Annotated[Path | None, kinds.file(".png"), kinds.OUTPUT] = None,
    force: Annotated[bool, kinds.OUTPUT] = False,
    controller: Annotated[tuple[str, ...], kinds.CONTROLLER, kinds.LOOP] = (),
    gains: Annotated[str | None, kinds.GAINS, kinds.LOOP] = None,
    roll_off: Annotated[float | None, kinds.HZ, kinds.LOOP] = None,
    control_period: Annotated[float | None, kinds.S, kinds.LOOP] = None,
    plant_modules: Annotated[int | None, kinds.COUNT, kinds.LOOP] = None,
) -> Work:
    r"""Say what the numbers of an arm mean.

    Prints how it hangs, its modes with frequencies and damping ratios, the longest stable physics
    step, the largest bends that the input range allows, and how well its matrices are conditioned.

    With --controller also whether the sampled loop about rest is stable: the longest control
    period, and what grows first beyond it. Nothing is simulated for that. Exit code 1 if a loop is
    unstable at --control-period.

    Args:
        arms: files NAME.toml with numbers and their units, or arms that come with octarm; the
            nominal arm when none is given
        from_rod: a chain of modules that stands for a rod, with the keys modules, layout (paper or
            centred), length [m], EA [N], EI [N m^2], density [kg/m], rotary_inertia [kg m],
            damping_time [s] and gravity [m/s^2]; BASE:TIP for a property that tapers
        fit_modules: go on with the arm of so many modules that stands best for this one, and say
            what error remains in statics, modes and transients
        layout: of the fitted modules, and of the plant of --plant-modules: paper or centred
        write: write the arm to this file, in SI units
        out: draw the arm into this file
        force: replace files that are there
        controller: look at the loop with this controller
        gains: its gains, as in octarm run
        roll_off: corner beyond which its force is rolled off, as in octarm run [Hz]
        control_period: time between control actions [s]; 0.0005 when not given
        plant_modules: modules of the true arm, as in octarm run

    Examples:
      octarm arm my-arm.toml --out my-arm.png
      octarm arm --from-rod length=.36,EA=240,EI=.384:.2,modules=15 --write rod.toml
      octarm arm --from-rod modules=30 --fit-modules 3 --write fitted.toml
      octarm arm eth --controller smc-boundary --controller afsmc \
        --control-period 0.001
      octarm arm --controller afsmc --plant-modules 15 --roll-off 60
    """
    kinds.check_free(force, write, out)
    for word in arms:
        kinds.check("ARM", word)
    from octarm.commands import arm as work

    loop = work.LoopOptions(controller, gains, roll_off, control_period, plant_modules, layout)
    source = work.Source(arms, from_rod, fit_modules, layout)
    return surviving_output(partial(work.arm, source, loop, write, out))
