"""What `octarm run` is asked for."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated

from octarm.options.argument import Option

_EXPERIMENT = "the experiment"
_MODEL = "the arm, and the model that the controller believes"
_GAINS = "gains"
_SIMULATION = "simulation"
_OUTPUT = "output"


@dataclasses.dataclass(frozen=True)
class Run:
    """Run one controller on the arm and record it.

    Writes a run folder: run.rrd (the recording), run.npz (all arrays), run.json (what was run).

    Examples:
      octarm run --view
      octarm run --controller afsmc --mismatch -0.3 --out runs/adaptive
      octarm run --disturbance noise:0.4 --disturbance payload:0.2,at=3
      octarm run --controller smc --gain lambda:20 --parameter mass:0.4,0.3,0.2

    Disturbances, by what they act on; keys with their defaults:

    forces
      noise:RATIO,time=0.01,on=all   band-limited white noise, RATIO of the input
                                     amplitude; noise:rms=SIZE gives its size
      sine:SIZE,frequency=1,on=theta1
                                     [N] at tip-x, tip-y or on a slide, [N m] on
                                     a bend; also phase=0,at=0,length=inf
      pulse:SIZE,at=0,length=0.1,on=theta1
                                     the same for a while, from `at` [s] on
      step:SIZE,at=0,on=theta1       the same to the end

    the arm
      payload:MASS,at=0              [kg] at the tip, from `at` [s] on
      mismatch:X,mass=1,stiffness=1  true parameters: X as --mismatch, or factors;
                                     also inertia=1,damping=1,rest_length=1,tilt=0
      random-mismatch:SHARE          every parameter off by a random share up to
                                     SHARE; also rest_length=0,tilt=0
      drift:RATE,of=stiffness,limit=0.5
                                     [1/s], steadily up to the limit
      cyclic-drift:SHARE,period=10   to and fro; also phase=0,of=stiffness
      tilt:ANGLE                     [rad], gravity out of the hanging line

    the inputs
      actuation-delay:TIME           [s], to the nearest physics step
      dead-zone:WIDTH  saturation:LIMIT
                                     [N]
      slew:RATE  lag:TIME            [N/s], [s]
      loss:SHARE,at=0                of effectiveness; loss:0/0/0.5/0/0/0 for
                                     each column

    the readings
      measurement-delay:TIME         [s], to the nearest physics step
      measurement-noise:RMS,rate=100 share of the rest length, [rad]; rate times
                                     that on v; also time=0.001
      quantisation:STEP,rate=100     likewise
    """

    controller: Annotated[str, Option("CONTROLLER", "the control law", _EXPERIMENT)] = (
        "smc-boundary"
    )
    reference: Annotated[str, Option("REFERENCE", "the desired motion", _EXPERIMENT)] = "sine"
    disturbance: Annotated[
        tuple[str, ...],
        Option(
            "DISTURBANCE",
            "NAME:VALUE[,KEY=VALUE..], what acts on the arm unknown to the controller; see below",
            _EXPERIMENT,
        ),
    ] = ()
    duration: Annotated[float, Option("S", "length of the run [s]", _EXPERIMENT)] = 10.0
    seed: Annotated[
        int,
        Option(
            "N", "seed of all that is random; an undisturbed run has nothing random", _EXPERIMENT
        ),
    ] = 0

    mismatch: Annotated[
        float,
        Option(
            "X",
            "error of the controller's model: mass, inertia and damping times 1 + X, stiffness "
            "times 1 + X/2",
            _MODEL,
        ),
    ] = 0.0
    nominal: Annotated[
        tuple[str, ...],
        Option(
            "NAME:FACTOR",
            "a further factor on a parameter of the controller's model, e.g. mass:0.7",
            _MODEL,
        ),
    ] = ()
    parameter: Annotated[
        tuple[str, ...],
        Option(
            "NAME:VALUES",
            "a parameter of the true arm and of the model, e.g. mass:0.3,0.25,0.2 [kg]",
            _MODEL,
        ),
    ] = ()

    gains: Annotated[
        str | None,
        Option(
            "GAINS",
            "those to start from: tuned (for a control period of 0.0005 s), recommended (set by "
            "hand, lower), or a file NAME.toml of octarm tune; tuned ones when not given",
            _GAINS,
        ),
    ] = None
    gain: Annotated[
        tuple[str, ...],
        Option(
            "NAME:VALUES",
            "one gain, e.g. lambda:15 or K:1.6,1.0,0.8,0.4,0.25,0.03 in the order of q",
            _GAINS,
        ),
    ] = ()

    timestep: Annotated[
        float | None,
        Option(
            "S",
            "physics step [s]; that of models/octarm.xml, 0.0005 s, when not given",
            _SIMULATION,
        ),
    ] = None
    control_period: Annotated[
        float | None,
        Option(
            "S",
            "time between control actions [s], whole physics steps; one step when not given",
            _SIMULATION,
        ),
    ] = None
    actuation: Annotated[
        str,
        Option(
            "ACTUATION",
            "how input forces act: f-coeff as in eq (2), internal between neighbouring modules",
            _SIMULATION,
        ),
    ] = "f-coeff"

    out: Annotated[
        Path | None,
        Option("DIR", "run folder to write; runs/DATE-TIME-CONTROLLER when not given", _OUTPUT),
    ] = None
    view: Annotated[
        bool, Option("", "open the recording in the viewer when the run is done", _OUTPUT)
    ] = False
