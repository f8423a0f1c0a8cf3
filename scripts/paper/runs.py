"""Runs over time that no sweep can give, and all studies on one set of processes, resumable.

Every run is a request: it knows its file, and what it simulates; whoever is there already is left
alone. What comes out does not depend on the number of processes, or on interruptions.
"""

from __future__ import annotations

import functools
import threading
import time
from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from dm_control.rl import control
from tqdm import tqdm

from controllers import make_controller
from octarm import load
from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import nominal_parameters
from octarm.disturbances.forces import BandLimitedNoise
from octarm.files import whole_file
from octarm.interfaces import Instant, Measurement, Reference, Rows
from octarm.recordings.recording import run_recording
from octarm.runs import folder as run_folder
from octarm.runs.experiment import Experiment, run_into
from octarm.simulation.environment import whole_periods
from octarm.simulation.recorder import Recorder
from octarm.simulation.rollout import copied, simulate
from octarm.sweeps.execute import sweep
from octarm.sweeps.workers import WorkerProcesses, cores
from paper.studies import (
    BENDS,
    CONTROLLERS,
    MODELS,
    NOISE,
    PROPOSED,
    SEED,
    TIME,
    UNGUARDED,
    WRONG,
    Cast,
    Effort,
    Part,
    Variant,
)

SWEEPS = "sweeps"  # folder
EVERY = 0.01  # [s]; between two rows of a series
LONG = {PROPOSED: "long-guarded", UNGUARDED: "long-unguarded"}  # series that show drift
ARMS = 1024  # side by side, when a step is timed
_TURNS = 60


class Request(Protocol):
    """A run that is written to a file."""

    @property
    def seconds(self) -> float:
        """What is simulated, all arms counted [s]."""
        ...

    def file(self, out: Path) -> Path:
        """Where it stands when it is done."""
        ...

    def write(self, out: Path) -> object:
        """Runs it and writes the file, whole or not at all."""
        ...


class _ArmsRecorder(Recorder):
    """Also records the desired accelerations, and which arms are within their limits."""

    def __init__(self, physics: Any, hand_on: Callable[[Rows], object], **options: Any) -> None:
        super().__init__(hand_on, **options)
        self._physics = physics

    def row(self, instant: Instant) -> dict[str, np.ndarray]:
        """The recorded fields of one instant; see `Recorder.row`."""
        more = {"a_d": np.atleast_2d(instant.reference.a), "intact": self._physics.intact()}
        return super().row(instant) | more


def record(
    environment: control.Environment,
    variant: Variant,
    mismatch: np.ndarray,
    duration: float,
    fields: Collection[str],
    stride: int = 1,
) -> dict[str, np.ndarray]:
    """Fields of every `stride`-th control instant of a batch of arms, each of shape (T, n, ...).

    There are also `a_d`, the desired accelerations, and `intact`, shape (T, n), whether an arm was
    within its limits. A field that the controller does not have is left out.

    Args:
        environment: with n arms.
        variant: what controls them.
        mismatch: errors of their nominal models, shape (n,) [1].
        duration: [s].
        fields: names, see `octarm.interfaces.Rows`.
        stride: 1 for all instants.
    """
    nominal = nominal_parameters().mismatched(mismatch)
    controller = make_controller(variant.controller, nominal, variant.gains)
    blocks: list[Rows] = []
    recorder = _ArmsRecorder(
        environment.physics, lambda rows: blocks.append(copied(rows)), fields=fields, stride=stride
    )
    simulate(environment, controller, duration, recorder)
    recorder.flush()
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


class Series(NamedTuple):
    """What n arms did at T instants.

    Attributes:
        t: shape (T,) [s].
        q_d: desired coordinates, shape (T, 2N) [m], [rad].
        q: true ones, shape (T, n, 2N); NaN from when an arm left its limits.
        E: gain of the compensation, shape (T, n, 2N) [N], [N m]; empty where there is none.
        mismatch: shape (n,) [1].
        noise: shape (n,) [1].
        diverged_at: shape (n,) [s]; NaN for arms that stayed within their limits.
    """

    t: np.ndarray
    q_d: np.ndarray
    q: np.ndarray
    E: np.ndarray
    mismatch: np.ndarray
    noise: np.ndarray
    diverged_at: np.ndarray

    def of(self, mismatch: float, noise: float) -> np.ndarray:
        """The coordinates of some of the arms, shape (T, k, 2N)."""
        return self.q[:, (self.mismatch == mismatch) & (self.noise == noise)]

    @classmethod
    def read(cls, path: Path) -> Series:
        """What `SeriesRequest.write` wrote."""
        with np.load(path, allow_pickle=False) as file:
            return cls(**{name: file[name] for name in cls._fields})


class SeriesRequest(NamedTuple):
    """Arms of one variant over time: what figures 1 and 2 show, and what drifts.

    Attributes:
        name: of the file.
        variant: what controls them.
        reference: what they shall do.
        mismatches: model errors, each with and without noise [1].
        seeds: of the noise; those of the sweeps.
        quiet: whether there is an arm without noise for each model error, too.
        duration: [s].
    """

    name: str
    variant: Variant
    reference: str
    mismatches: tuple[float, ...]
    seeds: int
    quiet: bool
    duration: float

    @property
    def seconds(self) -> float:
        """What is simulated, all arms counted [s]."""
        return len(self.mismatches) * (self.seeds + self.quiet) * self.duration

    def file(self, out: Path) -> Path:
        """Where the arrays stand."""
        return out / "series" / f"{self.name}.npz"

    def run(self) -> Series:
        """Runs the arms."""
        seeds = [*([-1] if self.quiet else []), *range(self.seeds)]
        mismatch = np.repeat(self.mismatches, len(seeds))
        noise = np.tile([0.0 if seed < 0 else NOISE for seed in seeds], len(self.mismatches))
        environment = load(
            self.reference,
            disturbances=[BandLimitedNoise(ratio=noise[:, None], correlation_time=TIME)],
            batch=len(noise),
            seed=[np.random.SeedSequence(SEED, spawn_key=(max(i, 0),)) for i in seeds]
            * len(self.mismatches),
        )
        stride = whole_periods(EVERY, environment.control_timestep())
        fields = ("q", "q_d", "E")
        rows = record(environment, self.variant, mismatch, self.duration, fields, stride)
        lost = ~rows["intact"][:, :, None]
        t = EVERY * np.arange(len(lost))
        q = np.where(lost, np.nan, rows["q"])
        E = np.where(lost, np.nan, rows["E"]) if "E" in rows else np.empty(0)
        q_d, diverged_at = rows["q_d"][:, 0], environment.physics.diverged_at()
        return Series(t, q_d, q, E, mismatch, noise, diverged_at)

    def write(self, out: Path) -> None:
        """Writes the arrays, whole or not at all."""
        with whole_file(self.file(out)) as part, open(part, "wb") as file:
            np.savez(file, allow_pickle=False, **self.run()._asdict())


def name_of(label: str, reference: str) -> str:
    """The name of a series of figures 1 and 2."""
    return f"{reference}-{label}"


def series_requests(variants: Cast, effort: Effort) -> list[SeriesRequest]:
    """Those of figures 1 and 2 in both readings, and the long ones."""
    figures = [
        SeriesRequest(
            name=name_of(label, reference),
            variant=variants[label],
            reference=reference,
            mismatches=MODELS,
            seeds=effort.seeds,
            quiet=True,
            duration=effort.short,
        )
        for label in effort.series
        for reference in effort.references
    ]
    long = [
        SeriesRequest(name, variants[label], BENDS, (WRONG,), effort.seeds, False, effort.long)
        for label, name in (LONG.items() if effort.long else ())
    ]
    return figures + long


class SingleRequest(NamedTuple):
    """A run of one arm without noise, in a run folder with a recording.

    Attributes:
        name: of its folder.
        variant: what controls it.
        reference: what it shall do.
        mismatch: of the nominal model [1].
        duration: [s].
    """

    name: str
    variant: Variant
    reference: str
    mismatch: float
    duration: float

    @property
    def seconds(self) -> float:
        """What is simulated, in arms of a batch that cost as much as a single one [s]."""
        return 8.0 * self.duration

    def file(self, out: Path) -> Path:
        """The last file of its folder that is written."""
        return out / "runs" / self.name / run_folder.ARRAYS

    def write(self, out: Path) -> None:
        """Runs it into its folder."""
        true = nominal_parameters()
        experiment = Experiment(
            controller=self.variant.controller,
            gains=self.variant.gains,
            nominal=true.mismatched(self.mismatch),
            parameters=true,
            reference=self.reference,
            duration=self.duration,
        )
        environment, controller = experiment.begin(make_controller)
        announced = experiment.announcement(environment, controller)
        folder = self.file(out).parent
        run_into(folder, environment, controller, announced, recording=run_recording, partial=False)


def single_requests(variants: Cast, effort: Effort) -> list[SingleRequest]:
    """All lines of figure 1."""
    return [
        SingleRequest(
            f"{name_of(label, reference)}-{100 * model:+.0f}",
            variants[label],
            reference,
            model,
            effort.short,
        )
        for reference in (effort.references if effort.complete else ())
        for label in effort.series
        for model in MODELS
    ]


def run_all(
    parts: Sequence[Part], requests: Sequence[Request], out: Path, workers: int = 0
) -> None:
    """Runs what is not there yet.

    Args:
        parts: the sweeps.
        requests: all other runs.
        out: folder.
        workers: number of processes; one a core when 0.

    Raises:
        OctarmError: if the folder holds results of other studies.
        OSError: if it cannot be written.
        KeyboardInterrupt: if interrupted; what was finished is kept.
    """
    for folder in {out / SWEEPS, *(request.file(out).parent for request in requests)}:
        folder.mkdir(parents=True, exist_ok=True)
    lock, count = threading.Lock(), workers or cores()
    with (
        tqdm(
            total=sum(job.seconds for job in (*parts, *requests)),
            unit=" simulated s", unit_scale=True, disable=None, leave=False,
        ) as bar,
        WorkerProcesses(count) as processes,
    ):  # fmt: skip
        pool = _Pool(processes)

        def advance(seconds: float) -> None:
            with lock:
                bar.update(seconds)

        def run_sweep(part: Part) -> None:
            sweep(
                part.spec,
                make_controller,
                out / SWEEPS / part.name,
                executor=pool,
                in_flight=2,
                resume=True,
                progress=lambda episodes: advance(episodes * part.spec.duration),
            )

        def run_request(request: Request) -> None:
            if not request.file(out).is_file():
                pool.submit(request.write, out).result()
            advance(request.seconds)

        jobs = [
            *((part.seconds, functools.partial(run_sweep, part)) for part in parts),
            *((run.seconds, functools.partial(run_request, run)) for run in requests),
        ]
        longest_first = sorted(jobs, key=lambda job: -job[0])
        pool.do([job for _, job in longest_first], count + 1)


class _Pool(Executor):
    """Processes that several threads may give work to, until it is stopped."""

    def __init__(self, processes: WorkerProcesses) -> None:
        self._processes, self._lock, self._stopped = processes, threading.Lock(), False

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        with self._lock:
            if self._stopped:
                raise RuntimeError("the processes were stopped")
            return self._processes.submit(fn, *args, **kwargs)

    def do(self, jobs: Sequence[Callable[[], object]], threads: int) -> None:
        """Does jobs, some at a time; the first error, or an interrupt, ends them all."""
        with ThreadPoolExecutor(threads) as pool:
            futures = [pool.submit(job) for job in jobs]
            try:
                for future in as_completed(futures):
                    future.result()
            except BaseException:
                with self._lock:
                    self._stopped = True
                    self._processes.kill()
                pool.shutdown(cancel_futures=True)
                raise


class Cost(NamedTuple):
    """What a controller's step costs on this machine; it differs from run to run.

    Attributes:
        label: of the variant.
        many: an arm of `ARMS` side by side: the arithmetic [s].
        alone: one arm alone: mostly what Python and NumPy take for each call [s].
    """

    label: str
    many: float
    alone: float


def costs(variants: Cast) -> list[Cost]:
    """The shortest of many steps of each tuned controller, in turns so that all meet the same."""
    steppers = {
        (name, arms): _stepper(variants[name], arms) for name in CONTROLLERS for arms in (ARMS, 1)
    }
    best = dict.fromkeys(steppers, np.inf)
    for _ in range(_TURNS):
        for key, step in steppers.items():
            begun = time.perf_counter()
            step()
            best[key] = min(best[key], time.perf_counter() - begun)
    return [Cost(name, best[name, ARMS] / ARMS, best[name, 1]) for name in CONTROLLERS]


def _stepper(variant: Variant, arms: int) -> Callable[[], None]:
    """A function that goes on by one control instant, 0.5 ms; the arms are near the reference."""
    arm = nominal_parameters()
    controller = make_controller(variant.controller, arm.mismatched(WRONG), variant.gains)
    draw, size = np.random.default_rng(0), np.repeat([0.01, 0.3], arm.modules)
    shape = (arms, len(size)) if arms > 1 else (len(size),)

    def near(center: np.ndarray, scale: float) -> np.ndarray:
        return np.asfortranarray(center + scale * size * draw.normal(size=shape))

    q, v = near(equilibrium(arm), 1.0), near(np.zeros(shape), 3.0)
    reference = Reference(near(q, 0.02), near(v, 0.5), near(np.zeros(shape), 10.0))
    state, t = controller.initial_state(shape[:-1]), 0.0

    def step() -> None:
        nonlocal state, t
        _, state = controller(state, Measurement(t, q, v), reference)
        t += 5e-4

    return step
