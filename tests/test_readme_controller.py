"""The controller in the README keeps the contract that the shipped ones keep."""

import re
from pathlib import Path

import numpy as np
import pytest
import test_controller_contract as contract

from controllers import make_controller
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout

README = Path(__file__).resolve().parent.parent / "README.md"


@pytest.fixture
def feedforward(tmp_path: Path) -> str:
    """The file that the README's controller is in, outside the package, and its name there."""
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    (source,) = (block for block in blocks if "(Law)" in block)
    (tmp_path / "feedforward.py").write_text(source, encoding="utf-8")
    return f"{tmp_path}/feedforward.py:Feedforward"


def test_the_controller_in_the_readme_keeps_the_contract(feedforward: str):
    contract.test_an_arm_gets_the_same_bits_alone_and_in_any_batch(feedforward, {})
    contract.test_calls_are_deterministic_and_start_again_from_the_initial_state(feedforward, {})
    contract.test_gains_broadcast_along_the_batch(feedforward, {})
    contract.test_a_batch_may_share_one_reference(feedforward, {})
    for batch in ((), (3,), (2, 3)):
        contract.test_answers_are_finite_floats_of_constant_shape(feedforward, {}, batch)
        contract.test_no_two_things_share_memory(feedforward, {}, batch)
    for message in contract.WRONG:
        contract.test_a_wrong_shape_is_refused_in_one_sentence(feedforward, message)


def test_the_controller_in_the_readme_tracks(feedforward: str):
    run = rollout(load(), make_controller(feedforward, contract.P), 2.0)
    rms = np.sqrt(np.mean(run.error[run.t > 1.0, 3:5] ** 2, axis=0))
    assert run.status == "ok"
    assert np.all(rms < 0.02 * contract.AMPLITUDE)
