"""The run's report: one HTML file with its pictures inside, readable anywhere, without a network."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping
from html import escape
from typing import Any

from ...config.site import Measure
from ...graph.pipeline import STAGES, stage_with
from ...graph.rows import Role
from ...store.events import Event, TaskEvent, WarningEvent
from ...store.layout import WorkFolder
from ...store.record import RunRecord
from ...store.run_folder import RunFolder
from ...task import Subject, Task
from ..record import reported
from .graph import pair_graph_svg
from .ground import sections

STYLE = """
:root { color-scheme: light dark; --good: #2a7d46; --bad: #c0392b; --line: #8886; --soft: #8882; }
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 70rem; padding: 0 1rem; }
h1 { font-size: 1.5rem; margin-bottom: 0; } h2 { font-size: 1.15rem; margin-top: 2.2rem; }
.verdict { font-size: 1.15rem; border-left: 5px solid var(--good); padding: .4rem .8rem; background: var(--soft); }
.verdict.bad { border-color: var(--bad); }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: .25rem .6rem; border-bottom: 1px solid var(--line); vertical-align: top; }
th:first-child, td:first-child, td.words, th.words { text-align: left; }
.cards { display: grid; grid-template-columns: repeat(auto-fill, minmax(20rem, 1fr)); gap: 1rem; }
.card { border: 1px solid var(--line); border-radius: 6px; padding: .6rem; } .card img { width: 100%; border-radius: 4px; }
.card.bad { border-color: var(--bad); } .reason { color: var(--bad); } .muted { opacity: .7; } img.wide { max-width: 100%; }
.graph { max-width: 40rem; } .graph text { font-size: 13px; fill: currentColor; }
.graph line.good { stroke: var(--good); } .graph line.bad { stroke: var(--bad); stroke-dasharray: 4 4; }
.graph circle.good { fill: var(--good); } .graph circle.bad { fill: var(--bad); }
"""

LEVELS = {
    "good": "Good: nothing to look at.",
    "degraded": "Degraded: a cloud was made, but look at what is said here.",
    "failed": "Failed.",
}

UNITS = {"deg": "°", "px": "px"}
"""How units at the end of a figure's name are shown."""

Pictures = Mapping[Task, str]
"""Pictures as data URLs, by task."""


def rebuild_report(work: WorkFolder, folder: RunFolder) -> str:
    """The report of a finished run.  Raises NoSuchRun for a folder that cannot be read."""
    return build_report(work, folder.record(), folder.events(), folder.cameras())


def build_report(work: WorkFolder, record: RunRecord, events: Iterable[Event], cameras: Mapping[str, Any]) -> str:
    """HTML of a run.

    Parameters
    ----------
    work : WorkFolder
        Whose cache holds the pictures.
    record : RunRecord
        The run in figures.
    events : iterable of Event
        What happened.
    cameras : mapping
        The cameras that the cloud rests on by id, in the form of a calibration.
    """
    events = list(events)
    pictures = _pictures(work, events)
    body = [
        _head(record),
        _warnings(events),
        _cloud(record, pictures),
        sections(record, pictures),
        _graph(record, cameras),
        _cameras(record, pictures),
        _pairs(record, pictures),
        _timings(record),
    ]
    title = escape(f"{record.site} {record.date}")
    head = (
        f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{title}</title><style>{STYLE}</style>'
    )
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{"".join(body)}</body></html>'


def _pictures(work: WorkFolder, events: Iterable[Event]) -> Pictures:
    found = {}
    for event in events:
        if isinstance(event, TaskEvent) and event.key:
            path = work.picture(event.task, event.key)
            if path.is_file():
                found[event.task] = "data:image/jpeg;base64," + base64.b64encode(path.read_bytes()).decode()
    return found


def _of_subject(pictures: Pictures, subject: Subject) -> list[str]:
    """Pictures of a camera or pair in the order of the pipeline."""
    return [picture for stage in STAGES if (picture := pictures.get(Task(stage.name, subject)))]


def _head(record: RunRecord) -> str:
    words = LEVELS[record.verdict.level] if record.verdict else f"Exit code {record.exit_code}."
    good = sum(pair.ok for pair in record.pairs)
    cameras = sum(camera.ok for camera in record.cameras)
    usual = round(record.usual.figures.get(Measure.PAIRS, 0)) if record.usual else 0
    facts = [f"{cameras} of {len(record.cameras)} cameras", f"{good} of {max(len(record.pairs), usual)} pairs"]
    if record.cloud:
        facts.append(f"{record.cloud.points:,} points")
    facts.append(f"{record.seconds.wall:.0f} s")
    tasks = ", ".join(f"{count} {name}" for name, count in record.tasks.to_json().items() if count)
    return (
        f"<h1>{escape(record.site)}, night of {escape(record.date)}</h1>"
        f'<p class="muted">run {record.run}, wbflow {escape(record.version)}; tasks: {tasks}</p>'
        f'<div class="verdict{" bad" if record.exit_code else ""}">{words} {", ".join(facts)}.{_findings(record)}</div>'
    )


def _findings(record: RunRecord) -> str:
    """What an operator has to look at, and what to do about it."""
    items = []
    for finding in record.verdict.findings if record.verdict else ():
        subject = f"<b>{escape('--'.join(finding.subject))}</b>: " if finding.subject else ""
        remedy = f'<br><span class="muted">{escape(finding.remedy)}</span>' if finding.remedy else ""
        items.append(f'<li class="finding">{subject}{escape(finding.text)}{remedy}</li>')
    return f"<ul>{''.join(items)}</ul>" if items else ""


def _warnings(events: Iterable[Event]) -> str:
    """What went wrong and was survived."""
    survived = [
        (str(e.task or "run"), f"{e.what}{'; ' if e.remedy else ''}{e.remedy}") for e in events if isinstance(e, WarningEvent)
    ]
    return _told("Warnings", survived)


def _told(title: str, rows: Iterable[tuple[str, str]]) -> str:
    items = "".join(f'<li><b>{escape(name)}</b>: <span class="reason">{escape(why)}</span></li>' for name, why in rows)
    return f"<h2>{title}</h2><ul>{items}</ul>" if items else ""


def _cloud(record: RunRecord, pictures: Pictures) -> str:
    cloud, poses = record.cloud, record.poses
    if not cloud:
        return ""
    size = " x ".join(f"{b - a:.1f}" for a, b in zip(*cloud.bounds, strict=True))
    shown = pictures.get(Task(stage_with(Role.PRODUCT).name))
    picture = f'<p><img class="wide" src="{shown}" alt="the cloud"></p>' if shown else ""
    unit = "m" if not poses or poses.metric else "units (nothing says how long a metre is)"
    words = f"<p><a href='{cloud.path}'>{cloud.path}</a>: {cloud.points:,} points, {size} {unit}</p>"
    others = "".join(f"<li><a href='{c.path}'>{c.path}</a>: {c.points:,} points</li>" for c in record.other_clouds)
    if others:
        joins = "".join(f"<li>{escape(join)}</li>" for join in (poses.joins if poses else ()))
        words += f"<p>The pairs do not connect all cameras; the others have clouds of their own:</p><ul>{others}{joins}</ul>"
    notes = "".join(f"<li>{escape(note)}</li>" for note in (poses.notes if poses else ()))
    return f"<h2>The cloud</h2>{picture}{words}<ul>{notes}</ul>"


def _graph(record: RunRecord, cameras: Mapping[str, Any]) -> str:
    centres = {name: (entry["C"][0], entry["C"][1]) for name, entry in cameras.items() if entry.get("C")}
    words = "<p class='muted'>Line width: how densely a pair was matched; dashed: not used (reason on hover).</p>"
    return f"<h2>Pair graph</h2>{pair_graph_svg(record, centres)}{words}"


def _cameras(record: RunRecord, pictures: Pictures) -> str:
    cards = []
    for camera in record.cameras:
        shown = _of_subject(pictures, (camera.id,))[:1]
        image = "".join(f'<img src="{picture}" alt="{escape(camera.id)}">' for picture in shown)
        notes = "; ".join(camera.notes)
        counts = ", ".join(f"{value:,} {name}" for name, value in camera.figures.items() if isinstance(value, int))
        words = counts if camera.ok else f'<span class="reason">{escape(str(camera.reason))}</span>'
        note = f"<br><span class='muted'>{escape(notes)}</span>" if notes else ""
        kind = "card" if camera.ok else "card bad"
        cards.append(f'<div class="{kind}">{image}<b>{escape(camera.id)}</b> {words}{note}</div>')
    return f'<h2>Cameras</h2><div class="cards">{"".join(cards)}</div>'


def _pairs(record: RunRecord, pictures: Pictures) -> str:
    columns = reported("pair")
    head = "<th>pair</th>" + "".join(f"<th>{_title(c)}</th>" for c in columns) + '<th class="words">outcome</th>'
    rows, cards = [], []
    for pair in record.pairs:
        cells = "".join(f"<td>{_number(pair.figures.get(c))}</td>" for c in columns)
        words = "ok" if pair.ok else f'<span class="reason">{pair.outcome}</span>: {escape(str(pair.reason))}'
        rows.append(f'<tr><td>{escape(pair.name)}</td>{cells}<td class="words">{words}</td></tr>')
        images = "".join(
            f'<img src="{picture}" alt="{escape(pair.name)}">' for picture in _of_subject(pictures, (pair.left, pair.right))
        )
        if images:
            cards.append(f'<div class="card">{images}<b>{escape(pair.name)}</b></div>')
    return f'<h2>Pairs</h2><table><tr>{head}</tr>{"".join(rows)}</table><div class="cards">{"".join(cards)}</div>'


def _title(figure: str) -> str:
    """The name of a figure with its unit, as people write it."""
    name, _, unit = figure.rpartition("_")
    return f"{name} {UNITS[unit]}" if unit in UNITS else figure


def _timings(record: RunRecord) -> str:
    seconds = record.seconds
    rows = "".join(
        f"<tr><td>{escape(stage)}</td><td>{row.tasks:.0f}</td><td>{row.wall:.1f}</td><td>{row.cpu:.1f}</td></tr>"
        for stage, row in seconds.stages.items()
    )
    total = f"wall {seconds.wall:.1f} s, CPU {seconds.cpu:.1f} s, peak {record.peak_rss_mb} MB a worker"
    table = f"<table><tr><th>stage</th><th>tasks</th><th>wall s</th><th>CPU s</th></tr>{rows}</table>" if rows else ""
    return f"<h2>Timings</h2><p>{total}</p>{table}"


def _number(value: Any) -> str:
    if value is None:
        return ""
    return escape(value) if isinstance(value, str) else f"{value:.2f}" if isinstance(value, float) else f"{value:,}"
