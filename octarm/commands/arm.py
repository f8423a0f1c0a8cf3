"""What `octarm arm` does."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from controllers import CONTROLLERS, make_controller
from octarm.arm.file import Arm, arm_toml, cannot_hang, read_arm, read_arm_file
from octarm.arm.fit import fit_modules
from octarm.arm.groups import grouped, groups_of
from octarm.arm.mjcf import nominal_parameters, physics_step
from octarm.arm.parameters import ArmParameters
from octarm.arm.rod import PROFILES, PROPERTIES, Rod, arm_from_rod
from octarm.arm.summary import ArmSummary
from octarm.checks.stability import check_period, linear_plant, loop_at_rest, stability_lines
from octarm.commands.yours import LoopOptions, SourceOptions
from octarm.declared import named
from octarm.errors import ExitCode, OctarmError, printable, quoted
from octarm.fields import Quantity, Words, parsed_fields
from octarm.files import write_files, write_text

# The keys of --from-rod; what tapers has a number at the base and one at the tip.
_ROD: dict[str, Any] = {
    **{
        name: Quantity(**dataclasses.asdict(kind), each=name in PROFILES)
        for name, kind in PROPERTIES.items()
    },
    "modules": Quantity("1"),
    "layout": Words(),
}


def arm(
    names: Sequence[str],
    source: SourceOptions,
    loop: LoopOptions,
    write: Path | None,
    out: Path | None,
) -> int:
    """`octarm arm`: prints what arms are; draws and writes one."""
    several = _arms(names, source)
    if (write or out) and len(several) != 1:
        raise OctarmError(f"{len(several)} arms are given; --write and --out take one")
    stable = True
    for each in several:
        summary = ArmSummary.of(each)
        print("\n".join(summary.lines()))
        if loop.controller:
            stable &= _print_stability(each.parameters, loop, source.layout)
        if write is not None:
            write_text(write, arm_toml(each))
            print(f"wrote {printable(str(write))}")
        if out is not None:
            from octarm.reports.arm_figures import arm_figure  # takes a second to import

            write_files({out: arm_figure(summary).png})
            print(f"wrote {printable(str(out))}")
        if each is not several[-1]:
            print()
    return ExitCode.FINE if stable or loop.control_period is None else ExitCode.CHECK_FAILED


def _print_stability(p: ArmParameters, loop: LoopOptions, layout: str) -> bool:
    """Says whether the loops of an arm are stable; whether all are that have a slope."""
    period = physics_step() if loop.control_period is None else loop.control_period
    check_period(period)
    short, _ = named((CONTROLLERS, word) for word in loop.controller)
    gains = {} if loop.roll_off is None else {"roll_off": loop.roll_off}
    model = p if loop.model is None else read_arm(loop.model)
    laws = [make_controller(word, model, gains, gain_set=loop.gains) for word in loop.controller]
    groups = grouped(p, model)
    chain = loop.plant_modules is not None or groups is not None
    finer = groups_of(p, loop.plant_modules, layout, groups=groups) if chain else None
    on = "" if finer is None else f", on a plant of {finer.plant.modules} modules ({finer.layout})"
    print(f"sampled loop about rest, the model {printable(loop.model or 'exact')}{on}")
    plant = linear_plant(p, finer)
    loops = {n: loop_at_rest(plant, law, period) for n, law in zip(short, laws, strict=True)}
    print("\n".join(stability_lines(loops, period)))
    low, high = p.input_bounds(())
    if np.any(low == 0.0) or np.any(high == 0.0):
        print(
            "columns that only push, or only pull, give no force of the other sign at rest: what "
            "is said here holds where they are under load"
        )
    return all(loop.stable for loop in loops.values())


def _arms(names: Sequence[str], source: SourceOptions) -> list[Arm]:
    """The arms that are meant; of fitted ones it prints what error remains."""
    if source.from_rod is None:
        given = [*map(read_arm_file, names)] or [Arm(nominal_parameters(), "the nominal arm")]
    elif names:
        raise OctarmError(f"--from-rod is given, and so is {quoted(names[0])}; one or the other")
    else:
        given = [_from_rod(source.from_rod)]
    if source.fit_modules is None:
        return given
    fitted: list[Arm] = []
    modules, layout = source.fit_modules, source.layout
    for each in given:
        fit = fit_modules(each.parameters, modules, layout)
        print(f"{printable(each.name)}, fitted by {modules} modules, layout {layout}\n{fit}\n")
        note = f"all numbers fitted to {each.name}, layout {layout}"
        fitted.append(Arm(fit.parameters, f"{modules} modules for {each.name}", converted=(note,)))
    return fitted


def _from_rod(text: str) -> Arm:
    """The arm that KEY=VALUE,.. means."""
    given: dict[str, Any] = dict(
        parsed_fields("--from-rod", text, text.replace(":", "/"), _ROD, "KEY=VALUE,..")
    )
    modules, layout = given.pop("modules", None), given.pop("layout", "paper")
    if modules is None or not modules.is_integer():
        raise OctarmError(f"--from-rod is {quoted(text)}; it needs modules=N, a whole number")
    rod = Rod(**{key: np.asarray(value).tolist() for key, value in given.items()})
    p = arm_from_rod(rod, int(modules), layout)
    if violation := cannot_hang(p):
        raise OctarmError(violation)
    numbers = ", ".join(
        f"{key} = {':'.join(f'{x:g}' for x in np.atleast_1d(value))}"
        for key, value in dataclasses.asdict(rod).items()
    )
    return Arm(
        p,
        f"a rod of {int(modules)} modules, layout {layout}",
        converted=(f"columns, masses and inertias from a rod with {numbers} in SI units",),
    )
