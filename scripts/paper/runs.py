"""Arms of one variant side by side over time, in one way for all that is looked at in them.

Figures 1 and 2 show coordinates, the drift of the gain E is a question of long runs, and the
Lyapunov functions need every control instant. All are arms under the one loop with a recorder of
the fields that are wanted; what is kept of the rows is for the request to say.
"""

from __future__ import annotations

import itertools
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from benchmarks.controller_step import controller_call
from benchmarks.figures import fastest

import octarm
from octarm.disturbances.forces import BandLimitedNoise
from octarm.errors import ExitCode, OctarmError
from octarm.interfaces import Instant, Rows
from octarm.simulation.engines import MUJOCO, usual_engine
from octarm.simulation.recorder import Recorder
from octarm.simulation.rollout import simulate
from paper import lyapunov
from paper.studies import BENDS, MODELS, NOISE, RATE, SEED, SETTLED, TIME, WRONG, Effort
from paper.variants import ARM, CONTROLLERS, PROPOSED, UNGUARDED, Variant

EVERY = 0.01  # between two instants that figures show [s]
STRIDE = round(EVERY * RATE)  # the same in control instants
LONG = {PROPOSED: "long-guarded", UNGUARDED: "long-unguarded"}
FEWER = 16  # seeds of hand-set gains, which the figures over time do not show
ARMS = 1024  # side by side, when a step of a controller is timed
Arrays = dict[str, np.ndarray]


class Request(NamedTuple):
    """Arms of one variant: for each model error one without noise, and one for each seed."""

    name: str  # of the file
    variant: Variant  # what controls the arms
    reference: str  # name of their desired motion
    duration: float  # [s]
    # What is recorded: fields of the record, `lost`, whether an arm has left its limits, and
    # `wanted_a`, the desired acceleration.
    fields: tuple[str, ...]
    # It makes the arrays that are kept from the recorded rows.
    keep: Callable[[Request, Rows], Mapping[str, np.ndarray]]
    mismatches: tuple[float, ...] = MODELS  # model errors [1]
    seeds: int = 0  # number of seeds of the noise; they are those of the sweeps
    quiet: bool = True  # whether there are arms without noise
    stride: int = 1  # between two control instants that are recorded
    rate: float = RATE  # of control [Hz]
    engine: str = MUJOCO  # that steps the arms

    @property
    def mismatch(self) -> np.ndarray:
        """Of the nominal model of each arm, shape (n,) [1]."""
        return np.repeat(self.mismatches, self.seeds + self.quiet)

    @property
    def noise(self) -> np.ndarray:
        """Rms over the input's amplitude of each arm, shape (n,) [1]."""
        return np.tile([0.0] * self.quiet + [NOISE] * self.seeds, len(self.mismatches))

    @property
    def nominal(self) -> octarm.ArmParameters:
        """What the controllers believe, with batch axis (n,)."""
        return ARM.mismatched(self.mismatch)

    @property
    def seconds(self) -> float:
        """What is simulated, all arms counted [s]."""
        return len(self.mismatch) * self.duration

    def perform(self) -> Arrays:
        """Runs the arms; what is kept of them."""
        period = 1.0 / self.rate
        seeds = [*[0] * self.quiet, *range(self.seeds)] * len(self.mismatches)
        environment = octarm.load(
            self.reference, control_period=period, timestep=min(period, 1.0 / RATE),
            engine=self.engine, **noisy_arms(self.noise, seeds),
        )  # fmt: skip
        blocks: list[Rows] = []
        whole = 1 + round(self.duration * self.rate) // self.stride
        recorder = Recorder(blocks.append, rows=whole, fields=self.fields, stride=self.stride)

        def observe(instant: Instant) -> None:
            lost = ~environment.physics.intact()
            more = {"lost": lost, "wanted_a": np.atleast_2d(instant.reference.a)}
            command = instant.command._replace(signals={**instant.command.signals, **more})
            recorder(instant._replace(command=command))

        simulate(environment, self.variant.controls(self.nominal), self.duration, observe)
        recorder.flush()
        with np.errstate(all="ignore"):  # a diverged arm may hold anything
            kept = self.keep(self, blocks[0])
        return {**kept, "diverged_at": environment.physics.diverged_at()}


def noisy_arms(noise: npt.ArrayLike, seeds: Sequence[int]) -> dict[str, Any]:
    """What `octarm.load` takes for arms under noise of some strengths, shape (n,), and seeds."""
    ratio = np.asarray(noise)[:, None]
    return {
        "batch": len(ratio),
        "disturbances": [BandLimitedNoise(ratio=ratio, correlation_time=TIME)]
        if ratio.any()
        else [],
        "seed": [np.random.SeedSequence(SEED, spawn_key=(i,)) for i in seeds],
    }


def requests(variants: Mapping[str, Variant], effort: Effort) -> Iterator[Request]:
    """Those of figures 1 and 2 in both readings, the long ones, those of the Lyapunov functions."""
    fields = ("q", "q_d", "lost", "E")
    for label, reference in itertools.product(effort.labels, effort.readings):
        seeds = effort.seeds if label in CONTROLLERS else min(effort.seeds, FEWER)
        name, who = name_of(label, reference), variants[label]
        yield Request(name, who, reference, effort.duration, fields, kept, seeds=seeds)
    for label, name in LONG.items() if effort.long else ():
        yield Request(
            name, variants[label], BENDS, effort.long, fields, kept, mismatches=(WRONG,),
            seeds=effort.seeds, quiet=False, stride=STRIDE, engine=usual_engine(),
        )  # fmt: skip
    places = [(BENDS, rate) for rate in effort.rates]
    places += [(reference, RATE) for reference in effort.readings if reference != BENDS]
    for label, (reference, rate) in itertools.product(effort.lyapunov, places):
        yield Request(
            f"lyapunov-{name_of(label, reference)}-{rate:g}-Hz", variants[label], reference,
            effort.duration, lyapunov.FIELDS, lyapunov.counts, rate=rate,
        )  # fmt: skip


def name_of(label: str, reference: str) -> str:
    """The name of the runs of figures 1 and 2."""
    return f"{reference}-{label.replace(', ', '-')}"


class Series(NamedTuple):
    """What n arms did at T instants."""

    t: np.ndarray  # shape (T,) [s]
    q_d: np.ndarray  # desired coordinates, shape (T, 2N) [m], [rad]
    q: np.ndarray  # true ones, shape (T, n, 2N); NaN from when an arm left its limits
    E: np.ndarray  # gain of the compensation, shape (T, n, 2N) [N], [N m]; empty if none
    mismatch: np.ndarray  # shape (n,) [1]
    noise: np.ndarray  # shape (n,) [1]
    diverged_at: np.ndarray  # shape (n,) [s]; NaN for arms that stayed within their limits
    moved: np.ndarray  # how far noise moves an arm, rms of all instants that count, shape (n, 2N)

    def of(self, mismatch: float, noise: float) -> np.ndarray:
        """The coordinates of some of the arms, shape (T, k, 2N)."""
        return self.q[:, (self.mismatch == mismatch) & (self.noise == noise)]


def kept(request: Request, rows: Rows) -> Arrays:
    """The fields of `Series`, less `diverged_at`."""
    few = {name: values[:: STRIDE // request.stride] for name, values in rows.items()}
    lost = few["lost"][..., None]
    return {
        "t": EVERY * np.arange(len(lost)),
        "q_d": few["q_d"][:, 0],
        "q": np.where(lost, np.nan, few["q"]),
        "E": np.where(lost, np.nan, few["E"]) if "E" in few else np.empty(0),
        "mismatch": request.mismatch,
        "noise": request.noise,
        "moved": moved(request, rows["q"]) if request.quiet else np.empty(0),
    }


def moved(request: Request, q: np.ndarray) -> np.ndarray:
    """How far noise moves arms from the one without noise and with the same model.

    It is the rms over all instants of the steady regime, of coordinates at every control instant,
    shape (T, n, 2N), to shape (n, 2N) [m], [rad]. The noise is held for 10 ms: instants that are
    10 ms apart would all see it at the same age.
    """
    steady = q[round(SETTLED * request.rate) :]
    groups = steady.reshape(len(steady), len(request.mismatches), 1 + request.seeds, q.shape[-1])
    squares = np.square(groups - groups[:, :, :1])
    return np.sqrt(np.sum(squares, axis=0) / max(len(steady), 1)).reshape(q.shape[1:])


def record(request: Request, model: float, folder: Path) -> None:
    """Has `octarm run` write the folder of one arm without noise; OctarmError if it does not."""
    variant = request.variant
    command = [sys.executable, "-m", "octarm", "run", "--out", str(folder),
               "--controller", variant.controller, "--reference", request.reference,
               f"--mismatch={model}", "--duration", str(request.duration)]  # fmt: skip
    for name, gain in variant.gains.items():  # SI, the same for every model
        command += ["--gain", f"{name}:{','.join(map(repr, np.atleast_1d(gain).tolist()))}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in (ExitCode.FINE, ExitCode.DIVERGED):
        raise OctarmError(f"{folder.name} was not recorded: {done.stderr.strip()}")


class Cost(NamedTuple):
    """What a step of a controller costs on this machine; timings differ from run to run."""

    many: float  # an arm of `ARMS` side by side: the arithmetic [s]
    alone: float  # one arm alone: mostly what Python and NumPy take for each call [s]


def costs(variants: Mapping[str, Variant], seconds: float = 0.1) -> dict[str, Cost]:
    """The shortest of many steps of each tuned controller, each measured for so long [s]."""
    batches = ((ARMS,), ())
    calls = [controller_call(n, b, variants[n].gains) for n in CONTROLLERS for b in batches]
    times = fastest(calls, seconds)
    pairs = zip(CONTROLLERS, times[::2], times[1::2], strict=True)
    return {name: Cost(many / ARMS, alone) for name, many, alone in pairs}
