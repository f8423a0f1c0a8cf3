"""The one recorder: named fields of control instants, copied into blocks of rows."""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np

from octarm.arrays import stacked
from octarm.errors import OctarmError, quoted
from octarm.interfaces import WITHIN, Instant, Rows
from octarm.interrupts import held_interrupts
from octarm.simulation.trajectory import Ending

# Of a coordinate array. A few instants at a time are faster than one by one: the physics between
# two of them leaves the processor's caches cold.
NUMBERS_A_BLOCK = 50_000


class Recorder:
    """Copies fields of every `stride`-th instant, and hands each full block of rows on.

    The rows of one block of a batch are contiguous along the arms. Their memory is used again for
    the next block, so whoever keeps rows copies them. An interrupt waits until a block has been
    handed on.

    Attributes:
        count: number of rows so far, those included that were handed on.
        layer: half width of the boundary layer that the first command says, shape (..., 2N) [m/s],
            [rad/s]; None if it says none. It is known before the first block.
    """

    def __init__(
        self,
        hand_on: Callable[[Rows], object],
        *,
        rows: int | None = None,
        fields: Collection[str] | None = None,
        stride: int = 1,
    ) -> None:
        """A recorder for `simulate`, empty.

        Args:
            hand_on: called with each block of rows, see `octarm.interfaces.Rows`.
            rows: number of rows of a block; as many as suit the processor's caches if None.
            fields: names of those that are recorded, of which a controller need not have all; all
                that there are if None.
            stride: records the instants 0, stride, 2 stride and so on.
        """
        self._hand_on, self._rows, self._fields, self._stride = hand_on, rows, fields, stride
        self._columns: dict[str, np.ndarray] = {}
        self._instants = self._used = self._size = self.count = 0
        self.layer: np.ndarray | None = None

    def __call__(self, instant: Instant) -> None:
        """Takes a control instant; a row that is interrupted does not count."""
        due = self._instants % self._stride == 0
        self._instants += 1
        if not due:
            return
        row = self.row(instant)
        if not self._columns:
            numbers = instant.q.size * (1 if instant.within is None else len(instant.within.q))
            self._size = size = self._rows or max(1, NUMBERS_A_BLOCK // numbers)
            self._columns = {name: _column(name, np.asarray(x), size) for name, x in row.items()}
            layer = instant.command.layer
            self.layer = None if layer is None else np.broadcast_to(layer, instant.q.shape)
        place = self._used
        name = ""
        try:
            for name, column in self._columns.items():
                column[place] = row[name]
        except (KeyError, TypeError, ValueError):
            kind = quoted(row.get(name, "absent"))
            raise OctarmError(
                f"the controller's signal {quoted(name)} is {kind} at t = {instant.measurement.t:g}"
                " s; it must be there at every instant and keep its shape"
            ) from None
        self._used, self.count = place + 1, self.count + 1
        if self._used == self._size:
            self.flush()

    def flush(self) -> None:
        """Hands on the rows that have not been handed on yet, if there are any."""
        if not self._used:
            return
        with held_interrupts():
            rows = {name: column[: self._used] for name, column in self._columns.items()}
            self._used = 0
            self._hand_on(rows)

    def row(self, instant: Instant) -> dict[str, np.ndarray]:
        """The recorded fields of one instant, each of shape (...).

        Raises OctarmError if a signal has the name of another field.
        """
        batched = instant.q.ndim > 1  # a reference may be the same for all arms
        q_d, v_d = instant.reference.q, instant.reference.v
        row = {
            "t": np.asarray(instant.measurement.t),
            "q": instant.q,
            "v": instant.v,
            "q_d": np.atleast_2d(q_d) if batched else q_d,
            "v_d": np.atleast_2d(v_d) if batched else v_d,
            "tau": instant.tau,
            "force": instant.command.force,
            "disturbance": instant.disturbance,
        }
        if instant.plant_q is not None and instant.plant_tip is not None:
            row |= {"plant_q": instant.plant_q, "plant_tip": instant.plant_tip}
        if (within := instant.within) is not None:
            row["received"] = within.received
            if len(within.q) > 1:
                row["q_steps"], q_d = within.q, within.q_d
                row["q_d_steps"] = q_d[:, None] if q_d.ndim < within.q.ndim else q_d
                if within.plant_tip is not None:
                    row["plant_tip_steps"] = within.plant_tip
        signals, fields = instant.command.signals, self._fields
        if not (signals.keys().isdisjoint(row) and signals.keys().isdisjoint(Ending._fields)):
            for name, signal in signals.items():
                self.add_field(row, name, signal)  # which refuses one of them
        row.update(signals)
        return row if fields is None else {k: x for k, x in row.items() if k in fields}

    @staticmethod
    def add_field(row: dict[str, np.ndarray], name: str, value: np.ndarray) -> None:
        """Adds a field, shape (...), to a row.

        Raises OctarmError if the record has one of this name.
        """
        if name in row or name in Ending._fields:
            raise OctarmError(
                f"a signal cannot be called {quoted(name)}: the record has that field"
            )
        row[name] = value


def _column(name: str, row: np.ndarray, count: int) -> np.ndarray:
    """Memory for a field of so many instants, shape (count, ...)."""
    if name not in WITHIN:
        return stacked(row, count)
    return stacked(row[0], count * len(row)).reshape(count, *row.shape)
