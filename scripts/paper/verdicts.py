"""All claims in the order of their letters."""

from __future__ import annotations

from paper import (
    chattering,
    computation,
    lyapunov,
    oscillation,
    overshoot,
    premises,
    uncertainty,
)
from paper.claims import Claim
from paper.evidence import Evidence


def claims(evidence: Evidence) -> list[Claim]:
    """(a) to (g)."""
    return [
        overshoot.claim(evidence),
        oscillation.claim(evidence),
        chattering.claim(evidence),
        premises.claim(evidence),
        lyapunov.claim(evidence),
        uncertainty.claim(evidence),
        computation.claim(evidence),
    ]
