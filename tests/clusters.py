"""Dask clusters of one process, a scheduler with workers in threads, which can be killed whole."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Generator
from pathlib import Path

ROOT = Path(__file__).parent.parent
_CLUSTER = (
    "import sys, distributed\n"
    "cluster = distributed.LocalCluster(n_workers=int(sys.argv[1]), threads_per_worker=1,\n"
    "    processes=False, dashboard_address=None, host='127.0.0.1', protocol='tcp')\n"
    "print(cluster.scheduler_address, flush=True)\n"
    "sys.stdin.read()\n"
)


@contextlib.contextmanager
def dask_process(workers: int) -> Generator[tuple[str, subprocess.Popen[str]]]:
    """The address of a scheduler with so many workers, and its process."""
    process = subprocess.Popen(
        [sys.executable, "-c", _CLUSTER, str(workers)], cwd=ROOT, text=True,
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    with process:
        try:
            assert process.stdout is not None
            yield process.stdout.readline().strip(), process
        finally:
            process.kill()
