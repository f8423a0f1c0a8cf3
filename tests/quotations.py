"""Whether a quotation stands in a text word for word."""

import hashlib
import re
import unicodedata

ELLIPSIS = "[...]"


def words_of(text: str) -> list[str]:
    """The words of a text with their punctuation, however quotes, spaces and lines are set."""
    plain = unicodedata.normalize("NFKC", text).translate(str.maketrans("‘’“”", "''\"\""))
    return re.sub(r"\s+", " ", plain).split()


def is_in(quotation: str, text: str) -> bool:
    """Whether all pieces between ellipses stand in the text, word for word and in their order."""
    words, begin = words_of(text), 0
    for piece in map(words_of, quotation.split(ELLIPSIS)):
        if not piece:
            return False
        places = (i for i in range(begin, len(words)) if _begins(words[i : i + len(piece)], piece))
        place = next(places, None)
        if place is None:
            return False
        begin = place + len(piece)
    return True


def _begins(words: list[str], piece: list[str]) -> bool:
    """Whether they are the words; the quotation may leave out punctuation at its end."""
    return words[:-1] == piece[:-1] and words[-1].rstrip(".,;") == piece[-1].rstrip(".,;")


def fingerprint(quotation: str) -> str:
    """SHA-256 of the words."""
    return hashlib.sha256(" ".join(words_of(quotation)).encode()).hexdigest()
