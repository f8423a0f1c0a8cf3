"""All references, by the names that users give them, and the parameters behind a name.

One of your own needs no line here: it is given as MODULE:NAME or FILE.py:NAME, see
`octarm.declared`. It is called with the pose at rest; a dataclass may declare parameters, fields
annotated with `octarm.fields.Quantity` or `Words` that have defaults, as the built-in ones do.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from typing import Any, cast

import numpy as np

from octarm.arm.limits import Limits
from octarm.arm.parameters import ArmParameters
from octarm.declared import BUILT_IN, Code, Declared, word_of
from octarm.errors import OctarmError, quoted
from octarm.fields import field_defaults, field_kinds, help_entry, parsed_fields, spelt_value
from octarm.interfaces import Motion
from octarm.references import named
from octarm.references.samples import Samples
from octarm.references.tip import TipPath

_LOOKS, _STRIDE = 400, 0.04731  # instants at which limits are looked at, and between them [s]


def _lacks(thing: Any) -> str:
    """What an object of a user lacks of a reference; empty if nothing."""
    try:
        pose = () if _suits_an_arm(thing) else (np.zeros(2),)
        inspect.signature(thing).bind(*pose)
    except (TypeError, ValueError):
        return (
            "cannot be called with one array, the pose at rest of shape (..., 2N), to return a "
            "motion as octarm.interfaces.Motion says"
        )
    return ""


# What makes a motion, given the pose `rest` about which it goes, shape (..., 2N) [m], [rad].
REFERENCES: Declared[Callable[..., Any]] = Declared(
    "reference",
    {
        "sine": named.BendSine,
        "sine-slides": named.SlideSine,
        "multi-sine": named.ThreeTones,
        "fast-sine": named.FastSine,
        "chirp": named.RisingSine,
        "tip": TipPath,
        "file": Samples,
        "minimum-jerk": named.MinimumJerk,
        "smooth-step": named.Step,
        "set-point": named.Jump,
    },
    _lacks,
)


def named_reference(name: str, rest: np.ndarray, arm: ArmParameters | None = None) -> Motion:
    """A reference such as `sine:amplitude=20deg,frequency=1` about the pose in which an arm hangs.

    The name is one of `REFERENCES`, MODULE:NAME or FILE.py:NAME; `rest` has shape (..., 2N) [m],
    [rad]. Sizes that are not given suit the arm, the nominal one when None. Raises OctarmError for
    an unknown name, with the known ones, for parameters that are not allowed, for a motion that
    leaves the limits of the arm, or if what is named makes no motion.
    """
    word, given = REFERENCES.split(name)
    thing: Any = REFERENCES[word]
    values = parameters_of(name)
    if _suits_an_arm(thing):
        motion: Any = thing(**values).start(named.Hanging(rest, arm))
    else:
        motion = thing(rest, **values)
    if not callable(motion):
        raise OctarmError(
            f"the reference {quoted(name)} makes {quoted(motion)}; it must make a function of "
            "time, as octarm.interfaces.Motion says"
        )
    if given and arm is not None and rest.ndim == 1 and not arm.batch_shape:
        _check_limits(name, cast(Motion, motion), Limits.of(arm))
    return cast(Motion, motion)


def parameters_of(name: str) -> dict[str, Any]:
    """The parameters of a reference that stand behind its name, by field.

    Raises OctarmError for an unknown name or parameter, or a value that is not allowed.
    """
    word, text = REFERENCES.split(name)
    thing = REFERENCES[word]
    kinds = _kinds(thing)
    values = parsed_fields(word, name, text, kinds, _usage(word, thing))
    if missing := [field for field in kinds if field not in (*values, *field_defaults(thing))]:
        raise OctarmError(f"{quoted(name)} has no {missing[0]}; it must read {_usage(word, thing)}")
    return {
        field: kinds[field].check(f"{kinds[field].key or field} of {quoted(name)}", value)
        for field, value in values.items()
    }


def recorded_word(name: str, code: Mapping[str, Code] = BUILT_IN) -> str:
    """The word for a reference of an experiment; see `octarm.declared.word_of`, also for errors."""
    head = name.partition(":")[0]
    return name if name not in code and is_built_in(head) else word_of(name, code)


def is_built_in(name: str) -> bool:
    """Whether a name, with parameters or not, means a motion that no file holds."""
    head = name.partition(":")[0]
    return head in REFERENCES and head != "file"


def help_text() -> str:
    """All built-in references: spelling with defaults, meaning and units, in 80 columns."""
    things: list[tuple[str, Any]] = [*REFERENCES.items()]
    return "\n".join(help_entry(_usage(name, thing), thing) for name, thing in things)


def _suits_an_arm(thing: Any) -> bool:
    """Whether it is started with the arm, rather than called with the pose at rest."""
    return isinstance(thing, type) and issubclass(thing, named.NamedReference)


def _kinds(thing: Any) -> dict[str, Any]:
    return field_kinds(thing) if isinstance(thing, type) and is_dataclass(thing) else {}


def _usage(name: str, thing: Any) -> str:
    """The spelling with the values that the nominal arm has where none are given."""
    kinds = _kinds(thing)
    defaults = {**field_defaults(thing), **getattr(thing, "nominal", {})} if kinds else {}
    parts = [
        f"{kind.key or field}={spelt_value(defaults[field])}"
        if field in defaults
        else field.upper()
        for field, kind in kinds.items()
    ]
    return f"{name}:{','.join(parts)}" if parts else name


def _check_limits(name: str, motion: Motion, limits: Limits) -> None:
    """Raises OctarmError for a motion that takes an arm apart, as numbers that are too large do."""
    for t in (i * _STRIDE for i in range(_LOOKS)):
        q, v, _ = motion(t)
        if not limits.hold(q, v):
            raise OctarmError(
                f"the reference {quoted(name)} leaves the limits of the arm at t = {t:.3g} s: "
                f"{limits.violation(q, v)}"
            )
