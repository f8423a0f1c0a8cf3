"""What `octarm doctor` does."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

from octarm.checks import doctor as machine
from octarm.checks.doctor import Finding, State
from octarm.errors import ExitCode

_WIDTH = 80


def doctor() -> int:
    """`octarm doctor`: what the machine has, and what to install; 1 when runs do not work."""
    parts = {
        "versions": machine.versions(),
        "processor": machine.processor(),
        "commands, tried out": machine.work(),
        "folders": machine.folders(),
    }
    found = [finding for title, findings in parts.items() for finding in _say(title, findings)]
    remedies = [f for f in found if f.remedy]
    if remedies:
        print("\nto do:")
    for finding in remedies:
        print(f"  {finding.name}: {finding.remedy}")
    works = all(finding.state is not State.BROKEN for finding in found)
    slow = [f.name for f in found if f.state is State.SLOW and f.remedy]
    verdict = "works here" if works else "does not work here"
    if works and "octarm run" in slow:
        works, verdict = False, "was too slow here to tell whether it works"
    print(f"\noctarm run {verdict}")
    return ExitCode.FINE if works else ExitCode.CHECK_FAILED


def _say(title: str, findings: Iterable[Finding]) -> list[Finding]:
    """Prints findings as they come in."""
    print(f"{title}:", flush=True)
    found: list[Finding] = []
    for finding in findings:
        head = f"  {finding.state.value:<8} {finding.name:<16} "
        text = textwrap.fill(finding.text, _WIDTH, initial_indent=head, subsequent_indent=" " * 28)
        print(text, flush=True)
        found.append(finding)
    return found
