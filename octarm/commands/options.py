"""Tables of options: each is declared once, and the work of a command takes it whole.

A command takes such a table as a parameter; its fields are options like the others.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from octarm.commands import kinds
from octarm.errors import OctarmError, closest, quoted
from octarm.units import Range, is_bare, is_like_a_number

if TYPE_CHECKING:
    from octarm.arm.parameters import ArmParameters
    from octarm.disturbances.varied import Varied


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class ModelOptions:
    """What is changed of an arm, and what the controller believes of it.

    Attributes:
        mismatch: error of the controller's model: mass, inertia and damping times 1 + X,
            stiffness times 1 + X/2
        nominal: a further factor on a parameter of the controller's model, e.g. mass:70%
        model: what the controller believes before mismatch and factors: a file NAME.toml, or an
            arm that comes with octarm; an arm of more modules is controlled in as many groups as
            it has modules; the true arm when not given
        parameter: a parameter of the true arm and, without --model, of the model, e.g.
            mass:300g,250g,200g, or input_range:-12,12 for the lowest and highest force of the
            columns [N]
        plant_modules: modules of the true arm, a multiple of the model's: a chain of the same rod,
            of which the controller knows groups; the model's modules when not given
        layout: of such a chain: paper, or centred with hinges in the middle of elements
        sensing: what is read of it: groups for sums over groups of modules, or plates for arcs
            between the plates that end them
    """

    mismatch: Annotated[float, kinds.MISMATCH, kinds.MODEL] = 0.0
    nominal: Annotated[tuple[str, ...], kinds.kind("NAME:FACTOR"), kinds.MODEL] = ()
    model: Annotated[str | None, kinds.ARM, kinds.MODEL] = None
    parameter: Annotated[tuple[str, ...], kinds.kind("NAME:VALUES"), kinds.MODEL] = ()
    plant_modules: Annotated[int | None, kinds.COUNT, kinds.MODEL] = None
    layout: Annotated[str, kinds.LAYOUT, kinds.MODEL] = "paper"
    sensing: Annotated[str, kinds.SENSING, kinds.MODEL] = "groups"

    def of(self, arm: str | None) -> ArmOptions:
        """The same options of an arm."""
        return ArmOptions(arm=arm, **vars(self))

    def factors(self) -> Mapping[str, Any]:
        """The further factors of the controller's model, by parameter; raises OctarmError."""
        return _parameters("--nominal", self.nominal)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class OneArm:
    """An arm, before what is changed of it.

    Attributes:
        arm: the true arm and the controller's model of it: a file NAME.toml, or an arm that comes
            with octarm, see octarm arm --help; the nominal arm when not given
    """

    arm: Annotated[str | None, kinds.ARM, kinds.MODEL] = None


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class ArmOptions(ModelOptions, OneArm):
    """The arm, and what the controller believes of it; `arm` is the first of the options."""

    def true_arm(self) -> ArmParameters:
        """The arm; raises OctarmError if there is no such one, or no such parameter."""
        values = _parameters("--parameter", self.parameter)
        if self.arm is not None:
            from octarm.arm.file import read_arm

            arm = read_arm(self.arm)
        else:
            from octarm.arm.mjcf import nominal_parameters  # imports MuJoCo

            arm = nominal_parameters()
        try:
            return dataclasses.replace(arm, **values)
        except OctarmError:
            import numpy as np

            given = np.size(values.get("mass", arm.mass))
            if given != arm.modules:  # all others would be blamed for the number of modules
                raise OctarmError(
                    f"mass has {given} values; the other parameters need one for each of "
                    f"{arm.modules} modules, or as many new values"
                ) from None
            raise

    def both(self) -> tuple[ArmParameters, ArmParameters]:
        """The arm, and the controller's model of it; raises OctarmError if one cannot be."""
        from octarm.arm.file import read_arm

        factors, true = self.factors(), self.true_arm()
        believed = true if self.model is None else read_arm(self.model)
        return true, believed.mismatched(self.mismatch).scaled(**factors)

    def command(self) -> list[str]:
        """The words of a command line that give the same options."""
        return _spelt(self)


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class GainOptions:
    """The gains of the controller.

    Attributes:
        gains: those to start from, scaled by the controller's model: tuned, recommended (set by
            hand), or a file NAME.toml of octarm tune; tuned ones, in octarm tune recommended
            ones, when not given
        gain: one gain in SI or with its unit, e.g. lambda:15/s or K:1.6,1.0,0.8,0.4,0.25,0.03 in
            the order of q
        roll_off: corner of a roll-off of the force that the controller asks for [Hz]
    """

    gains: Annotated[str | None, kinds.GAINS, kinds.GAIN] = None
    gain: Annotated[tuple[str, ...], kinds.kind("NAME:VALUES"), kinds.GAIN] = ()
    roll_off: Annotated[float | None, kinds.HZ, kinds.GAIN] = None

    def values(self, *controllers: str) -> Mapping[str, Any]:
        """The gains that are given one by one, by name: numbers [SI] and texts with a unit.

        Raises OctarmError if one does not read so, or one of the controllers does not have it.
        """
        from controllers import gains_in_si

        gains = _named_values("--gain", self.gain)
        for item, value in zip(self.gain, gains.values(), strict=True):
            if isinstance(value, list) and isinstance(value[0], list):
                raise OctarmError(
                    f"--gain is {quoted(item)}; a gain is one number, or one a coordinate"
                )
        for controller in controllers:
            gains_in_si(controller, gains)
        return gains if self.roll_off is None else {**gains, "roll_off": self.roll_off}

    def command(self) -> list[str]:
        """The words of a command line that give the same options."""
        return _spelt(self)


FACTOR = Range("1", plausible=20.0)
ANY_MODEL, NOMINAL_ARM, USUAL_GAINS = ModelOptions(), ArmOptions(), GainOptions()


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class MarginOptions:
    """What a margin is sought of, and by which runs.

    Attributes:
        disturbance: NAME or NAME:KEY=VALUE,.. for what varies, also nominal-mismatch;
            NAME:VALUE[,KEY=VALUE..] for what acts as well; octarm run --help lists them
        bound: a column of octarm sweep and its largest absolute value; all are to be met
        low: value to begin with, which is to be borne; 0 when not given
        high: value up to which is tried, greater or smaller than low; a usual one when not given
        seeds: number of seeds
        share: share of the seeds that have to meet the bounds; 1 for all of them
        metric: what is measured as well, FILE.py:NAME or MODULE:NAME; for a bound of your own
        arm: the true arms and the controllers' models of them, as in octarm run; the nominal arm
            when not given
        reference: the desired motion, NAME[:KEY=VALUE..], as in octarm run
        duration: length of each run [s]
        settle: when errors and other metrics of the steady regime begin to count [s]
        timestep: physics step [s], or auto for one that suits the fastest mode of all arms
        control_period: time between control actions [s]
        seed: seed of all that is random
        start: where runs begin, as in octarm run: rest, random or moving
        start_share: share of what the inputs reach within which the start is drawn
        engine: what steps the arms, mujoco or lagrange; lagrange where it is installed, when not
            given
        csv: also write the table to this file
        json: also write everything: the margins of each seed, and the coarse grid
        force: replace files that are there
    """

    disturbance: Annotated[tuple[str, ...], kinds.VARIED, kinds.SOUGHT] = ()
    bound: Annotated[tuple[str, ...], kinds.BOUND, kinds.SOUGHT] = ()
    low: Annotated[str | None, kinds.AMOUNT, kinds.SOUGHT] = None
    high: Annotated[str | None, kinds.AMOUNT, kinds.SOUGHT] = None
    seeds: Annotated[int, kinds.COUNT, kinds.SOUGHT] = 36
    share: Annotated[float, kinds.SHARE, kinds.SOUGHT] = 0.9
    metric: Annotated[tuple[str, ...], kinds.METRIC, kinds.SOUGHT] = ()
    arm: Annotated[tuple[str, ...], kinds.ARM, kinds.MODEL] = ()
    model: ModelOptions = ANY_MODEL
    gain_options: GainOptions = USUAL_GAINS
    reference: Annotated[str, kinds.REFERENCE, kinds.RUNS] = "sine"
    duration: Annotated[float, kinds.DURATION, kinds.RUNS] = 6.0
    settle: Annotated[float, kinds.SETTLE, kinds.RUNS] = 2.0
    timestep: Annotated[float | str | None, kinds.STEP, kinds.RUNS] = None
    control_period: Annotated[float | None, kinds.PERIOD, kinds.RUNS] = None
    seed: Annotated[int, kinds.N, kinds.RUNS] = 0
    start: Annotated[str, kinds.START, kinds.RUNS] = "rest"
    start_share: Annotated[float, kinds.SHARE, kinds.RUNS] = 0.1
    engine: Annotated[str | None, kinds.ENGINE, kinds.RUNS] = None
    csv: Annotated[Path | None, kinds.file(), kinds.OUTPUT] = None
    json: Annotated[Path | None, kinds.file(), kinds.OUTPUT] = None
    force: Annotated[bool, kinds.OUTPUT] = False

    @property
    def models(self) -> list[ArmOptions]:
        """The options of each arm."""
        return [self.model.of(name) for name in self.arm or (None,)]

    def varied(self) -> Varied:
        """What varies, the one disturbance without a value.

        Raises OctarmError for options that cannot be meant.
        """
        from octarm.disturbances.varied import NOMINAL, is_varied, parse_varied
        from octarm.metrics.declared import check_measures
        from octarm.simulation.engines import check_engine, usual_engine

        check_engine(self.engine or usual_engine())
        if not self.bound:
            raise OctarmError("no bound is given; --bound METRIC:VALUE, such as tip_rms_error:0.01")
        if not self.metric:  # which may have any name
            check_measures(bound.partition(":")[0] for bound in self.bound)
        varying = [text for text in self.disturbance if is_varied(text)]
        if len(varying) != 1:
            raise OctarmError(
                "one --disturbance goes without a value, the one whose largest value is sought; "
                f"here it is {' and '.join(varying) or 'none'}"
            )
        varied = parse_varied(varying[0], self.low, self.high)
        if varied.name == NOMINAL and self.model.mismatch:
            raise OctarmError(f"--mismatch is given, but {NOMINAL} is what varies")
        return varied


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class TuneOptions:
    """What gains are tuned for, and how.

    Attributes:
        reference: the desired motion, instead of those of the scenarios
        disturbance: NAME:VALUE[,KEY=VALUE..], what acts as well; octarm run --help lists them
        out: file to write; CONTROLLER.toml when not given; the search keeps its state beside it
        budget: what the search may simulate, all arms counted [s]; 16000 s take minutes. The last
            trials, of the best of its last generation, come on top
        seed: seed of the search
        resume: go on with the search that was interrupted
        force: replace gains that are there, and begin an interrupted search anew
        engine: what steps the arms of the search, mujoco or lagrange; lagrange where it is
            installed, when not given. The last trials, which choose the gains, run on mujoco
        workers: processes; one a core when not given; the gains do not depend on them
    """

    reference: Annotated[str | None, kinds.REFERENCE, kinds.EXPERIMENT] = None
    disturbance: Annotated[tuple[str, ...], kinds.DISTURBANCE, kinds.EXPERIMENT] = ()
    model: ArmOptions = NOMINAL_ARM
    gain_options: GainOptions = USUAL_GAINS
    out: Annotated[Path | None, kinds.file(".toml")] = None
    budget: Annotated[float, kinds.BUDGET] = 16000.0
    seed: Annotated[int, kinds.N] = 0
    resume: bool = False
    force: bool = False
    engine: Annotated[str | None, kinds.ENGINE] = None
    workers: Annotated[int | None, kinds.whole(1, 4096)] = None


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class SweepOptions:
    """With what a sweep is run.

    Attributes:
        out: folder to write
        workers: processes, one thread each; one a core when not given
        resume: go on with the sweep that was begun in the folder
        force: replace a sweep that is there
        dry_run: print the number of episodes, and the time and disk they take; run nothing
        cluster: run on the dask cluster with the scheduler of this address, or on `local`, one of
            this machine
        wait_for_workers: how long the cluster may have no worker, at the beginning or later [s]
        engine: what steps the arms, mujoco or lagrange, which is many times as fast; it takes the
            place of the spec's
    """

    out: Annotated[Path | None, kinds.DIR] = None
    workers: Annotated[int | None, kinds.whole(1, 4096)] = None
    resume: bool = False
    force: bool = False
    dry_run: bool = False
    cluster: Annotated[str | None, kinds.kind("ADDRESS")] = None
    wait_for_workers: Annotated[float, kinds.S] = 60.0
    engine: Annotated[str | None, kinds.ENGINE] = None


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class SourceOptions:
    """From what an arm is made.

    Attributes:
        from_rod: a chain of modules that stands for a rod, with the keys modules, layout (paper or
            centred), length [m], EA [N], EI [N m^2], density [kg/m], rotary_inertia [kg m],
            damping_time [s] and gravity [m/s^2], in SI or with a unit as in length=36cm;
            BASE:TIP for a property that tapers
        fit_modules: go on with the arm of so many modules that stands best for this one, and say
            what error remains in statics, modes and transients
        layout: of the fitted modules, and of the plant of --plant-modules: paper or centred
    """

    from_rod: Annotated[str | None, kinds.kind("KEY=VALUE,.."), kinds.SOURCE] = None
    fit_modules: Annotated[int | None, kinds.whole(1, 60), kinds.SOURCE] = None
    layout: Annotated[str, kinds.LAYOUT, kinds.SOURCE] = "paper"


@Parameter(name="*")
@dataclasses.dataclass(frozen=True, kw_only=True)
class LoopOptions:
    """Which sampled loops are looked at.

    Attributes:
        controller: look at the loop with this controller
        gains: its gains, as in octarm run
        roll_off: corner beyond which its force is rolled off, as in octarm run [Hz]
        control_period: time between control actions [s]; 0.0005 when not given
        plant_modules: modules of the true arm, as in octarm run
        model: what the controller believes, as in octarm run
    """

    controller: Annotated[tuple[str, ...], kinds.CONTROLLER, kinds.LOOP] = ()
    gains: Annotated[str | None, kinds.GAINS, kinds.LOOP] = None
    roll_off: Annotated[float | None, kinds.HZ, kinds.LOOP] = None
    control_period: Annotated[float | None, kinds.PERIOD, kinds.LOOP] = None
    plant_modules: Annotated[int | None, kinds.COUNT, kinds.LOOP] = None
    model: Annotated[str | None, kinds.ARM, kinds.LOOP] = None


ARMS, SEARCH, SHARDS = MarginOptions(), TuneOptions(), SweepOptions()
ARM_ITSELF, NO_LOOP = SourceOptions(), LoopOptions()


def _spelt(options: ArmOptions | GainOptions) -> list[str]:
    """The options that are not as usual, a word each."""
    spelt: list[str] = []
    for field in dataclasses.fields(options):
        value: Any = getattr(options, field.name)
        if value != field.default:
            option = f"--{field.name.replace('_', '-')}"
            spelt += [f"{option}={x}" for x in (value if field.default == () else (value,))]
    return spelt


def _parameters(option: str, items: Sequence[str]) -> dict[str, Any]:
    """Values by parameter of an arm; raises OctarmError for an unknown one."""
    from octarm.arm.parameters import PARAMETERS

    values = _named_values(option, items)
    for name, value in values.items():
        if name not in PARAMETERS:
            raise OctarmError(f"unknown parameter {quoted(name)}{closest(name, PARAMETERS)}")
        kind = PARAMETERS[name] if option == "--parameter" else FACTOR
        values[name] = _converted(f"{name} of {option}", value, kind)
    return values


def _converted(name: str, value: Any, kind: Range) -> Any:
    """Texts as numbers, and lists of them."""
    if isinstance(value, str):
        return kind.parse(name, value)
    sizes = [x for x in value if isinstance(x, str) and x.strip("-+ ") not in ("0", "inf")]
    if kind.unit != "1" and len({*map(is_bare, sizes)}) > 1:
        raise OctarmError(
            f"{name} is {quoted(','.join(value))}; each number needs its unit, or none"
        )
    return [_converted(name, x, kind) for x in value]


def _named_values(option: str, items: Sequence[str]) -> dict[str, Any]:
    """Each NAME:VALUES as a text, texts with `,` between them, or rows with `;` between them.

    Raises OctarmError if an item has no name, or its values are not numbers, with a unit or not.
    """
    values: dict[str, Any] = {}
    for item in items:
        name, _, text = item.partition(":")
        if name in values:
            raise OctarmError(f"{option} gives {name} twice")
        rows = [row.split(",") for row in text.split(";")]
        alike = all(len(row) == len(rows[0]) for row in rows)
        if not alike or not all(map(is_like_a_number, (x for row in rows for x in row))):
            raise OctarmError(
                f"{option} is {quoted(item)}; it must read NAME:NUMBER, NAME:A,B,C or NAME:A,B;C,D"
            )
        row = rows if len(rows) > 1 else rows[0]
        values[name] = row[0] if len(rows[0]) == len(rows) == 1 else row
    return values
