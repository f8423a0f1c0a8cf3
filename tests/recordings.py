"""Runs made of sines, and how to read a recording back."""

from __future__ import annotations

import dataclasses

import numpy as np
import rerun as rr

from octarm.arm.parameters import ArmParameters
from octarm.runs import folder as runs
from octarm.simulation.trajectory import Trajectory


def arm(modules):
    ones = np.ones(modules)
    return ArmParameters(
        mass=0.2 * ones,
        inertia=5e-4 * ones,
        width=0.08,
        stiffness=1000.0 * np.ones((2, modules)),
        damping=10.0 * np.ones((2, modules)),
        rest_length=0.12 * ones,
        gravity=9.81,
    )


def layer(modules=3):
    """Half width of the boundary layer [m/s], [rad/s]."""
    return np.repeat([0.05, 0.8], modules)


def part_of(run, start, stop):
    """Rows of a run as a run."""
    arrays = {name: array[start:stop] for name, array in run.arrays() if name not in run.signals}
    signals = {name: array[start:stop] for name, array in run.signals.items()}
    return dataclasses.replace(run, **arrays, signals=signals)


def described(modules=3, **more):
    gains = {"lambda_": 10.0, "phi": layer(modules).tolist()}
    return {
        "controller": {"name": "smc", "gains": gains},
        "parameters": arm(modules).to_dict(),
        "reference": {"name": "sine"},
        "seed": 3,
        "command": "octarm run",
        "status": "ok",
        **more,
    }


def write_run(folder, rows, description):
    """Writes `run.npz`, then `run.json`, with which the run is complete, into a folder."""
    rows.save(folder / runs.ARRAYS)
    runs.write_description(folder, description)


def swinging(modules=3, rows=2500, rate=1000.0, **signals):
    """A run made of sines, with noise in every digit so that rounding cannot hide."""
    t = np.arange(rows) / rate
    phase = t[:, None] + np.arange(modules)
    q_d = np.concatenate([0.12 + 0.01 * np.sin(7 * phase), 0.3 * np.sin(3 * phase)], axis=1)
    noise = np.random.default_rng(0).normal(size=(rows, 2 * modules))
    shown = {"s": 2.0 * noise, "switching": -3.0 * noise, "V": noise[:, :1] ** 2}
    return Trajectory(
        layer=layer(modules),
        t=t,
        q=q_d + 1e-3 * noise,
        q_d=q_d,
        disturbance=0.0 * noise,
        signals={**shown, **{k: np.asarray(v) for k, v in signals.items()}},
        digest="0123abcd",
        v=noise[::-1],
        v_d=noise,
        tau=np.roll(noise, 1, axis=0),
        force=noise,
    )


def chunks(path, entity):
    """The temporal record batches of an entity, in the order of time."""
    found = [c for c in rr.chunk.RrdReader(path).stream() if c.entity_path == entity]
    batches = [c.to_record_batch() for c in found if not c.is_static]
    return sorted(batches, key=lambda batch: batch.column("t")[0].value)


def column(path, entity, name):
    return np.concatenate([flat(batch.column(name)) for batch in chunks(path, entity)])


def flat(array):
    while hasattr(array, "flatten") and hasattr(array.type, "value_type"):
        array = array.flatten()
    return array.to_numpy(zero_copy_only=False)


def fields(path, entity, component=""):
    """The lists of an entity's structure by name, each of shape (rows, k)."""
    found: dict[str, list[np.ndarray]] = {}
    for batch in chunks(path, entity):
        table = batch.column(f"octarm:{component or entity.strip('/')}").flatten()
        for field in table.type:
            values = flat(table.field(field.name))
            found.setdefault(field.name, []).append(values.reshape(batch.num_rows, -1))
    return {name: np.concatenate(parts) for name, parts in found.items()}


def entities(path):
    return {chunk.entity_path for chunk in rr.chunk.RrdReader(path).stream()}


def static(path):
    chunks = rr.chunk.RrdReader(path).stream()
    return {c.entity_path: c.to_record_batch() for c in chunks if c.is_static}
