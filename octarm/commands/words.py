"""What the words of a command line mean, as far as that is known without MuJoCo."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from controllers import CONTROLLERS, check_gains
from octarm.arm.file import read_arm
from octarm.arm.parameters import ArmParameters
from octarm.declared import Code, named
from octarm.disturbances.spelling import DISTURBANCES
from octarm.errors import OctarmError, closest, quoted
from octarm.metrics.declared import ACCUMULATORS
from octarm.references import REFERENCES


def named_words(
    controller: str, reference: str, disturbances: Sequence[str], metrics: Sequence[str]
) -> tuple[list[str], dict[str, Code]]:
    """The names of what an experiment is made of, given the words of the command line.

    Those of the controller, the reference, the disturbances and the metrics, and the code of what
    is not built in.

    Raises:
        OctarmError: for a word that means nothing.
    """
    return named(
        [
            (CONTROLLERS, controller),
            (REFERENCES, reference),
            *((DISTURBANCES, DISTURBANCES.split(text).word) for text in disturbances),
            *((ACCUMULATORS, word) for word in metrics),
        ]
    )


def true_arm(changes: Sequence[str], arm: str | None = None) -> ArmParameters:
    """The nominal arm, or that of a file, with other parameters, each spelt NAME:VALUES.

    Raises:
        OctarmError: if there is no such arm or parameter, or values are not allowed.
    """
    values = parameter_values("--parameter", changes)
    if arm is not None:
        nominal = read_arm(arm)
    else:
        from octarm.arm.mjcf import nominal_parameters  # imports MuJoCo

        nominal = nominal_parameters()
    try:
        return dataclasses.replace(nominal, **values)
    except OctarmError:
        given = np.size(values.get("mass", nominal.mass))
        if given != nominal.modules:  # all others would be blamed for the number of modules
            raise OctarmError(
                f"mass has {given} values; the other parameters need one for each of "
                f"{nominal.modules} modules, or as many new values"
            ) from None
        raise


def parameter_values(option: str, items: Sequence[str]) -> dict[str, npt.ArrayLike]:
    """Values by parameter of an arm, of the shapes of `named_values`.

    Raises:
        OctarmError: for an unknown parameter.
    """
    values = named_values(option, items)
    known = [field.name for field in dataclasses.fields(ArmParameters)]
    for name in values:
        if name not in known:
            raise OctarmError(f"unknown parameter {quoted(name)}{closest(name, known)}")
    return values


def gain_values(items: Sequence[str], *controllers: str) -> dict[str, npt.ArrayLike]:
    """Gains of all these controllers by name, of shape () or (k,), each spelt NAME:VALUES.

    Raises:
        OctarmError: if an item does not read so, or a controller has no such gain.
    """
    gains = named_values("--gain", items)
    for item, value in zip(items, gains.values(), strict=True):
        if np.ndim(value) > 1:
            raise OctarmError(
                f"--gain is {quoted(item)}; a gain is one number, or one a coordinate"
            )
    for controller in controllers:
        check_gains(controller, gains)
    return gains


def named_values(option: str, items: Sequence[str]) -> dict[str, npt.ArrayLike]:
    """Parses NAME:VALUES items to numbers or arrays of shape (k,) or (rows, k).

    Values are separated by `,`, rows by `;`.

    Raises:
        OctarmError: if an item has no name, or its values are not numbers.
    """
    values: dict[str, npt.ArrayLike] = {}
    for item in items:
        name, _, text = item.partition(":")
        if name in values:
            raise OctarmError(f"{option} gives {name} twice")
        try:
            table = np.array([[float(x) for x in row.split(",")] for row in text.split(";")])
        except ValueError:
            raise OctarmError(
                f"{option} is {quoted(item)}; it must read NAME:NUMBER, NAME:A,B,C or NAME:A,B;C,D"
            ) from None
        row = table[0] if len(table) == 1 else table
        values[name] = row[0] if row.shape == (1,) else row
    return values
