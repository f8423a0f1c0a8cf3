"""Every quotation of the paper stands in the paper.

The paper's text is not part of the project. Where a file of it is at hand, named by the environment
variable OCTARM_PAPER, every quotation is looked for in it. Everywhere, each quotation must be one
of those that were found there, whose hashes stand here: a changed word is a failure until it has
been compared with the text again.

A list of hashes of all that the text holds would need no text at all, but a text can be put
together again from such a list, word by word.
"""

import os
import re
from pathlib import Path

import pytest
from paper.claims import words
from quotations import fingerprint, is_in, words_of

ROOT = Path(__file__).resolve().parent.parent
TEXT = os.environ.get("OCTARM_PAPER", "")
# Files in which typographic quotation marks enclose words of the paper.
QUOTING = (ROOT / "scripts" / "paper" / "words.toml", ROOT / "README.md")
FOUND = {
    "cfa65bb9ec398b990ab2e6b1ed114bf51620eca0458e387c8813d9f1e83f85fd",
    "f5f2bf1e58b7aa446308aea82f23b2468410c5449ccecae5be257e189e560953",
    "f427c9185e7f94d3fa26278af09647b0e7c49f77e9f3af603b4efc6284102c67",
    "b48c7e8f2876debc6b1b353356072f40f43dfcca3377e0b066c3ce7d2fa12382",
    "ec303aa2e61382f1fb781fffe22796576b40c40321ceeeb14902fd9f7c05b2ad",
    "28b3295345290b86af2a17101f9144faf7660343cbe1de7b26e238993a0b5d2a",
    "5f9825d68b256f7cd934aee3f228176faecc90bd2de1d4e01f09995d0abe8216",
    "3c48243afade686c98f6b1859724359b99dc840cae19343ebb5e629e9f3e3895",
}


def quotations() -> list[str]:
    """Those of the claims, and all else in typographic quotation marks."""
    quotes = [claim["quote"] for claim in words()["claims"].values() if claim["place"]]
    for file in QUOTING:
        quotes += re.findall("“([^”{]*)”", file.read_text(encoding="utf-8"))
    return list(dict.fromkeys(" ".join(words_of(quote)) for quote in quotes))


@pytest.mark.parametrize("quotation", quotations())
def test_a_quotation_is_one_that_was_found_in_the_paper(quotation: str):
    assert fingerprint(quotation) in FOUND, "look for it in the paper with OCTARM_PAPER=FILE"


@pytest.mark.skipif(not TEXT, reason="OCTARM_PAPER names no file with the text of the paper")
@pytest.mark.parametrize("quotation", quotations())
def test_a_quotation_stands_in_the_paper(quotation: str):
    assert is_in(quotation, Path(TEXT).read_text(encoding="utf-8"))


SAMPLE = "A method works well. It is slow, and costs much; it is\nthe arm’s best."


@pytest.mark.parametrize(
    ("quotation", "there"),
    [
        ("It is slow, and costs much", True),
        ("A method works [...] costs much; it is the arm's best", True),
        ("costs much [...] A method works", False),  # another order
        ("A method works [...] works well", False),  # the pieces overlap
        ("A method costs much", False),  # pieces without an ellipsis
        ("It was slow", False),
        ("method work", False),  # part of a word
        ("It is slow; and costs", False),  # other punctuation within
        ("[...]", False),
    ],
)
def test_word_for_word(quotation: str, there: bool):
    assert is_in(quotation, SAMPLE) is there
