"""Arms of one variant side by side over time, in one way for all that is looked at in them.

All are arms under the one loop with a recorder of the fields that are wanted; what is kept of the
rows is for the request to say: coordinates for figures 1 and 2, the gain E for its drift in long
runs, and counts for Lyapunov functions, which need every control instant.

The Lyapunov function of the sliding modes is V = 1/2 s^T D s, eq (32), with the true arm's D. That
of the adaptive law is all of eq (80). Its optima may be any that the proof can do with, and are set
when the run is over:

    theta* = 0,  alpha* = alpha0,  sigma* = sigma0,  E*_j = sup |eps_j|,
    eps_j = F_j + (alpha_j - alpha0)^T B_j theta_j + (sigma_j - sigma0)^T C_j theta_j

F_j is the error of the model. Then V' = sum_j s_j eps_j - E*_j |s_j| - s^T (B + K_v) s <= 0 in
continuous time, with sgn(s), and without safeguards. What is counted is how often V is larger at a
control instant than at the one before.
"""

import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product
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
from octarm.lagrange import inverse_dynamics, kinetic_energy
from octarm.simulation.engines import MUJOCO
from octarm.simulation.recorder import Recorder
from octarm.simulation.rollout import simulate
from paper.studies import BENDS, MODELS, NOISE, RATE, SEED, SETTLED, TIME, WRONG, Effort
from paper.variants import ARM, CONTROLLERS, PROPOSED, UNGUARDED, Variant

EVERY = 0.01  # between two instants that figures show [s]
STRIDE = round(EVERY * RATE)  # the same in control instants
LONG = {PROPOSED: "long-guarded", UNGUARDED: "long-unguarded"}
FEWER = 16  # seeds of hand-set gains, which the figures over time do not show
ARMS = 1024  # side by side, when a step of a controller is timed
OVER_TIME = ("q", "q_d", "lost", "E")  # fields
LYAPUNOV = ("q", "v", "v_d", "wanted_a", "s", "E", "theta", "alpha", "sigma", "lost")
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
    keep: Callable[["Request", Rows], Mapping[str, np.ndarray]]
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

        controller = self.variant.controls(ARM.mismatched(self.mismatch))
        simulate(environment, controller, self.duration, observe)
        recorder.flush()
        with np.errstate(all="ignore"):  # a diverged arm may hold anything
            kept = self.keep(self, blocks[0])
        return {**kept, "diverged_at": environment.physics.diverged_at()}


def noisy_arms(noise: npt.ArrayLike, seeds: Sequence[int]) -> dict[str, Any]:
    """What `octarm.load` takes for arms under noise of some strengths, shape (n,), and seeds."""
    ratio = np.asarray(noise)[:, None]
    acts = [BandLimitedNoise(ratio=ratio, correlation_time=TIME)] if ratio.any() else []
    keys = [np.random.SeedSequence(SEED, spawn_key=(i,)) for i in seeds]
    return {"batch": len(ratio), "disturbances": acts, "seed": keys}


def requests(variants: Mapping[str, Variant], effort: Effort) -> Iterator[Request]:
    """Those of figures 1 and 2 in both readings, the long ones, those of the Lyapunov functions."""
    for label, reference in product(effort.labels, effort.readings):
        seeds = effort.seeds if label in CONTROLLERS else min(effort.seeds, FEWER)
        place = variants[label], reference, effort.duration
        yield Request(name_of(label, reference), *place, OVER_TIME, kept, seeds=seeds)
    for label, name in LONG.items() if effort.long else ():
        yield Request(
            name, variants[label], BENDS, effort.long, OVER_TIME, kept, mismatches=(WRONG,),
            seeds=effort.seeds, quiet=False, stride=STRIDE, engine=effort.engine,
        )  # fmt: skip
    for label, reference, rate in product(effort.lyapunov, effort.readings, effort.rates):
        if reference == BENDS or rate == RATE:
            name = f"lyapunov-{name_of(label, reference)}-{rate:g}-Hz"
            place = variants[label], reference, effort.duration
            yield Request(name, *place, LYAPUNOV, counts, rate=rate)


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
    moved: np.ndarray  # by noise, rms of all instants that count, shape (n, 2N) [m], [rad]

    def of(self, mismatch: float, noise: float) -> np.ndarray:
        """The coordinates of some of the arms, shape (T, k, 2N)."""
        return self.q[:, (self.mismatch == mismatch) & (self.noise == noise)]


def kept(request: Request, rows: Rows) -> Arrays:
    """The fields of `Series`, less `diverged_at`.

    What moves an arm is the noise, against the one without it and with the same model, at every
    control instant of the steady regime. The noise is held for 10 ms: instants that are 10 ms apart
    would all see it at the same age.
    """
    few = {name: values[:: STRIDE // request.stride] for name, values in rows.items()}
    lost, moved = few["lost"][..., None], np.empty(0)
    if request.quiet:
        steady = rows["q"][round(SETTLED * request.rate) :]
        apart = len(request.mismatches), 1 + request.seeds, steady.shape[-1]
        groups = steady.reshape(len(steady), *apart)
        squares = np.sum(np.square(groups - groups[:, :, :1]), axis=0)
        moved = np.sqrt(squares / max(len(steady), 1)).reshape(rows["q"].shape[1:])
    return {
        "t": EVERY * np.arange(len(lost)), "q_d": few["q_d"][:, 0], "moved": moved,
        "q": np.where(lost, np.nan, few["q"]),
        "E": np.where(lost, np.nan, few["E"]) if "E" in few else np.empty(0),
        "mismatch": request.mismatch, "noise": request.noise,
    }  # fmt: skip


def record(request: Request, model: float, out: Path) -> None:
    """Has `octarm run` write the folder of one arm without noise; OctarmError if it does not."""
    variant, folder = request.variant, out / f"{request.name}-{100 * model:+.0f}"
    if (folder / "run.rrd").is_file() and (folder / "run.npz").is_file():
        return
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


class Descent(NamedTuple):
    """How V went on one arm."""

    label: str  # of the variant
    reference: str  # name
    rate: float  # of control [Hz]
    mismatch: float  # of the nominal model [1]
    covered: bool  # whether K_j >= |F_j| at all times; E_max >= eps for the adaptive law
    outside: int  # periods that begin outside the boundary layer: |s_j| > phi_j for a j
    grown_outside: int  # of them, those over which V grew
    late: int  # those outside that begin in the steady regime, where start-up is over
    inside: int  # periods that begin within it
    grown_inside: int  # of them, those over which V grew
    start: float  # V at the start [J]
    bound: float  # largest 1/2 s^T D s in the steady regime [J]
    diverged: bool  # whether the arm left its limits


def outcomes(request: Request, arrays: Mapping[str, np.ndarray]) -> list[Descent]:
    """What `counts` gave, arm by arm."""
    place = request.variant.label, request.reference, request.rate
    arms = zip(*(arrays[name].tolist() for name in Descent._fields[len(place) :]), strict=True)
    return [Descent(*place, *arm) for arm in arms]


def counts(request: Request, rows: Rows) -> dict[str, np.ndarray]:
    """The fields of `Descent` that differ from arm to arm, each of shape (n,)."""
    gains, s = request.variant.gains, rows["s"]
    kinetic, v = kinetic_energy(ARM, rows["q"], s), rows["v"]
    a_r = rows["wanted_a"] - np.asarray(gains["lambda"]) * (v - rows["v_d"])
    motion = rows["q"], v, a_r, v - s
    # The model error (D^ - D) q_r'' + .. + G^ - G, shape (T, n, 2N) [N], [N m].
    nominal = ARM.mismatched(request.mismatch)
    F = inverse_dynamics(nominal, *motion) - inverse_dynamics(ARM, *motion)
    learnt, covered = 0.0, np.all(_largest(F) <= np.asarray(gains.get("K", 0.0)), axis=-1)
    if "E" in rows:
        learnt, covered = _learnt(gains, rows, F)
    V = kinetic + learnt
    grown = V[1:] > V[:-1]
    outside = np.any(np.abs(s[:-1]) > np.asarray(gains.get("phi", 0.0)), axis=-1)
    steady = round(SETTLED * request.rate)
    return {
        "mismatch": request.mismatch, "covered": covered,
        "outside": np.sum(outside, axis=0), "grown_outside": np.sum(outside & grown, axis=0),
        "late": np.sum(outside[steady:], axis=0),
        "inside": np.sum(~outside, axis=0), "grown_inside": np.sum(~outside & grown, axis=0),
        "start": V[0], "bound": np.max(kinetic[steady:], axis=0, initial=0.0),
        "diverged": rows["lost"][-1],
    }  # fmt: skip


def _learnt(gains: Mapping[str, Any], rows: Rows, F: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """V of eq (80) beyond the first term, shape (T, n) [J]; whether E_max covers eps, (n,)."""
    theta, alpha, sigma, E = (rows[name] for name in ("theta", "alpha", "sigma", "E"))
    alpha0, sigma0, scale = (np.asarray(gains[name]) for name in ("alpha0", "sigma0", "scale"))
    z = (rows["s"] / scale)[..., None]
    phi = np.exp(-np.square(sigma * (z - alpha)))
    by_alpha, by_sigma = 2.0 * sigma**2 * (z - alpha) * phi, -2.0 * sigma * (z - alpha) ** 2 * phi
    moved = (alpha - alpha0) * by_alpha + (sigma - sigma0) * by_sigma
    needed = _largest(F + np.sum(moved * theta, axis=-1))
    rules = sum(
        np.sum(np.square(x), axis=-1) / np.maximum(np.asarray(gains[eta]), 1e-300)
        for x, eta in ((theta, "eta2"), (alpha - alpha0, "eta3"), (sigma - sigma0, "eta4"))
    )
    energy = np.square(needed - E) / np.asarray(gains["eta1"]) + rules
    return 0.5 * np.sum(energy, axis=-1), np.all(needed <= np.asarray(gains["E_max"]), axis=-1)


def _largest(x: np.ndarray) -> np.ndarray:
    """Over all instants, shape (T, n, 2N) to (n, 2N)."""
    return np.max(np.abs(x), axis=0)
