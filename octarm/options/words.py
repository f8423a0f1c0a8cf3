"""The words that are known for a kind of value."""

from __future__ import annotations

SHELLS = ("bash", "zsh", "fish")


def known_words(value: str) -> list[str]:
    """The words that a kind of value can be, such as CONTROLLER; none when there is no list."""
    match value:
        case "CONTROLLER":
            from controllers import CONTROLLERS

            return list(CONTROLLERS)
        case "REFERENCE":
            from octarm.references import REFERENCES

            return list(REFERENCES)
        case "DISTURBANCE":
            from octarm.disturbances.spelling import DISTURBANCES

            return list(DISTURBANCES)
        case "ACTUATION":
            from octarm.arm.actuation import ACTUATIONS

            return list(ACTUATIONS)
        case "SHELL":
            return list(SHELLS)
        case _:
            return []
