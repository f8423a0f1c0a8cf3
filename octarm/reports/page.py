"""The page of a sweep's report: one HTML file that needs nothing beside itself."""

from __future__ import annotations

import importlib.resources
import json
import re
import string
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

from octarm.reports.checks import Finding
from octarm.reports.figures import Picture
from octarm.reports.findings import Report
from octarm.reports.panels import GROUND, INK, LINE
from octarm.reports.tables import Tables, details, escaped

_PIXELS = 1.5  # of a point of a figure: four panels fill the page


class Source(NamedTuple):
    """Where a report comes from.

    Attributes:
        name: of the sweep.
        spec: its TOML text.
        commands: that make the sweep and the report again.
        files: beside the page.
    """

    name: str
    spec: str
    commands: Sequence[str]
    files: Sequence[str]


def page(
    report: Report, found: Iterable[Finding], pictures: Iterable[Picture], source: Source
) -> str:
    """The page as text; the same for the same numbers."""
    template = importlib.resources.files("octarm.reports").joinpath("page.html")
    draw = Tables(report)
    return string.Template(template.read_text(encoding="utf-8")).substitute(
        title=escaped(f"Sweep report: {source.name}"),
        lead=escaped(_lead(report)),
        findings=_findings(found),
        glance=draw.glance(),
        figures="\n".join(map(_figure, pictures)),
        tables=draw.tables(source.files),
        meanings=draw.meanings(),
        run=_run(report, source.spec),
        reproduce=_reproduce(report, source),
    )


def inline_svg(svg: str, prefix: str, label: str) -> str:
    """A figure to stand in a page: with its colours and font, and names of its own."""
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>", "", body, flags=re.DOTALL)
    box = re.search(r'viewBox="0 0 ([\d.]+) [\d.]+"', body)
    assert box is not None
    size = f'{box[0]} style="max-width: {_PIXELS * float(box[1]):.0f}px"'
    head = f'<svg {size} role="img" aria-label="{escaped(label)}">'
    body = re.sub(r"<svg[^>]*>", lambda _: head, body, count=1)
    body = re.sub(r'\bid="', f'id="{prefix}-', body)
    body = body.replace("xlink:href=", "href=").replace('href="#', f'href="#{prefix}-')
    body = body.replace("url(#", f"url(#{prefix}-")
    body = re.sub(r"'DejaVu Sans'[^;\"]*", "var(--font)", body)
    body = body.replace(f"fill: {GROUND}", "fill: none").replace(GROUND, "var(--ground)")
    body = body.replace(INK, "var(--ink)").replace(LINE, "var(--line)")
    return re.sub(r"\n\s*", "\n", body).strip()


def _figure(picture: Picture) -> str:
    svg = inline_svg(picture.svg, picture.name.replace(".", "-"), picture.caption)
    caption = f"<figcaption>{escaped(picture.caption)}</figcaption>"
    return f"<figure>\n{svg}\n{caption}\n</figure>"


def _lead(report: Report) -> str:
    episodes, spec = report.episodes, report.episodes.manifest["spec"]
    axes = [_several(len(a.labels), f"value of {a.name}") for a in episodes.axes if not a.drawn]
    drawn = [axis.name for axis in episodes.axes if axis.drawn]
    grid = [_several(len(episodes.controllers), "controller"), *axes]
    grid.append(_several(spec["episodes"], "seed"))
    parts = [f"{len(episodes.seed)} episodes of {spec['duration']:g} s: {' × '.join(grid)}"]
    parts += [f"{', '.join(drawn)} drawn for each seed"] if drawn else []
    parts.append("every controller meets the same random numbers")
    return "; ".join(parts) + "."


def _several(count: int, what: str) -> str:
    noun, space, rest = what.partition(" ")
    return f"{count} {noun}{'' if count == 1 else 's'}{space}{rest}"


def _findings(found: Iterable[Finding]) -> str:
    items = [
        f'<li class="warning"><b>Warning.</b> {escaped(finding.text)}</li>'
        if finding.warning
        else f"<li>{escaped(finding.text)}</li>"
        for finding in found
    ]
    return '<ul class="findings">\n' + "\n".join(items) + "\n</ul>" if items else ""


def _run(report: Report, spec: str) -> str:
    manifest = report.episodes.manifest
    starts = manifest["starts"]
    versions = _listed(starts[0]["versions"])
    hosts = [json.dumps(_machine(start["host"])) for start in starts]
    machines = "; ".join(_words(json.loads(host)) for host in dict.fromkeys(hosts))
    gains = "\n".join(f"{name}: {json.dumps(own)}" for name, own in manifest["gains"].items())
    return "\n".join(
        [
            f"<pre>{escaped(spec.strip())}</pre>",
            f"<p>Versions: {escaped(versions)}.</p>",
            f"<p>Computed on: {escaped(machines)}.</p>",
            details("Gains for the nominal model without mismatch", f"<pre>{escaped(gains)}</pre>"),
        ]
    )


def _machine(host: Mapping[str, Any]) -> dict[str, Any]:
    return {key: host[key] for key in ("cpu", "machine", "cores") if key in host}


def _words(facts: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{value} cores" if key == "cores" else str(value) for key, value in facts.items()
    )


def _listed(versions: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in versions.items())


def _reproduce(report: Report, source: Source) -> str:
    commands = "\n".join(source.commands)
    text = (
        "The first command makes the table again; with the same versions on the same kind of "
        "machine bit for bit. The second makes this page and what lies beside it."
    )
    identity = f"The spec's hash is {report.episodes.manifest['spec_hash']}."
    return f"<pre>{escaped(commands)}</pre>\n<p>{escaped(text)} {escaped(identity)}</p>"
