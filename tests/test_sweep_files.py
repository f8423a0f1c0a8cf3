"""The file of a shard comes back as it was written, or not at all."""

import itertools
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from octarm.sweeps.shard_file import labels_of, read_shard, write_shard

LABELS = {"spec": "3f", "first": 8, "host": {"cpu": "x", "cores": 2}}


def rows() -> pa.Table:
    """Numbers, words, lists and what is missing, as in the table of a sweep."""
    marks = pa.array(np.arange(6, dtype=np.uint64))
    return pa.table(
        {
            "episode": pa.array([8, 9, 10], pa.int64()),
            "controller": ["pd", "smc", "smc"],
            "effort": pa.array([0.0, None, 2.5e-3], pa.float64()),
            "marks": pa.FixedSizeListArray.from_arrays(marks, 2),
        }
    )


@pytest.fixture
def file(tmp_path) -> Path:
    write_shard(tmp_path / "00001.parquet", rows(), LABELS)
    return tmp_path / "00001.parquet"


def test_rows_and_labels_come_back(file):
    table = read_shard(file)
    assert table.equals(rows())
    assert labels_of(table) == LABELS
    assert read_shard(file, ["effort"]).equals(rows().select(["effort"]))
    assert pq.read_table(file).equals(rows())  # it is a Parquet file like any other
    with pytest.raises(ValueError, match="no column 'effrot'"):
        read_shard(file, ["effrot"])


def test_a_bit_that_is_flipped_is_noticed_wherever_it_is_and_whatever_is_read(file):
    content = file.read_bytes()
    damaged = bytearray(content)
    for place in range(len(content)):
        bit = 1 << place % 8
        damaged[place] ^= bit
        file.write_bytes(damaged)
        damaged[place] ^= bit
        with pytest.raises(ValueError, match=r"00001\.parquet is damaged"):
            read_shard(file, ["effort"] if place % 2 else None)


def test_any_piece_that_is_lost_or_added_is_noticed(file):
    content = file.read_bytes()
    cuts = itertools.chain(range(0, len(content), 50), range(len(content) - 100, len(content)))
    for broken in (*(content[:cut] for cut in cuts), content[1:], content + b"\n", content * 2):
        file.write_bytes(broken)
        with pytest.raises(ValueError, match="is damaged"):
            read_shard(file)


def test_a_file_by_another_hand_is_not_taken(tmp_path):
    pq.write_table(rows(), tmp_path / "other.parquet")
    with pytest.raises(ValueError, match="is damaged: it does not have the digest"):
        read_shard(tmp_path / "other.parquet")
