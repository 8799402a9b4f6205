"""The run's report: one HTML file with its pictures inside, readable anywhere, without a network."""

from __future__ import annotations

import base64
import json
from html import escape
from pathlib import Path
from typing import Any

from ...store.cache import Cache
from .graph import pair_graph_svg

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

EXITS = {
    0: "Complete: every camera and pair did its part.",
    1: "No cloud could be made.",
    3: "A cloud was made, but something failed.",
    130: "Interrupted; everything finished is kept.",
}


def build_report(work: Path, folder: Path) -> str:
    """HTML of the run in `folder` (its run.json and log.jsonl), with pictures from the cache of the work folder.

    Raises
    ------
    OSError, ValueError
        The run's files are missing or unreadable.
    """
    record = json.loads((folder / "run.json").read_text())
    events = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    pictures = _pictures(Cache(work / "cache"), events)
    body = [
        _head(record),
        _faults(record, events),
        _cloud(record, pictures),
        _graph(record, folder),
        _cameras(record, pictures),
        _pairs(record, pictures),
        _timings(record),
    ]
    title = escape(f"{record['site']} {record['date']}")
    head = (
        f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{title}</title><style>{STYLE}</style>'
    )
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{"".join(body)}</body></html>'


def _pictures(cache: Cache, events: list[dict[str, Any]]) -> dict[str, str]:
    """Pictures as data URLs, by task name."""
    found = {}
    for event in events:
        if event.get("event") != "task" or not event.get("key"):
            continue
        path = cache.folder(event["stage"], tuple(event["subject"])) / f"{event['key']}.jpg"
        if path.is_file():
            found[event["task"]] = "data:image/jpeg;base64," + base64.b64encode(path.read_bytes()).decode()
    return found


def _head(record: dict[str, Any]) -> str:
    code = record["exit_code"]
    words = EXITS.get(code, f"Exit code {code}.")
    good = sum(p["outcome"] == "ok" for p in record["pairs"])
    cameras = sum(c["outcome"] == "ok" for c in record["cameras"])
    facts = [f"{cameras} of {len(record['cameras'])} cameras", f"{good} of {len(record['pairs'])} pairs"]
    if record["cloud"]:
        facts.append(f"{record['cloud']['points']:,} points")
    facts.append(f"{record['seconds']['wall']:.0f} s")
    tasks = ", ".join(f"{count} {name}" for name, count in record["tasks"].items() if count)
    return (
        f"<h1>{escape(record['site'])}, night of {escape(record['date'])}</h1>"
        f'<p class="muted">run {record["run"]}, wbflow {escape(record["version"])}; tasks: {tasks}</p>'
        f'<p class="verdict{"" if code == 0 else " bad"}">{words} {", ".join(facts)}.</p>'
    )


def _faults(record: dict[str, Any], events: list[dict[str, Any]]) -> str:
    """Whatever failed, and why: what an operator has to act on comes first."""
    failed = [e for e in events if e.get("outcome") == "failed"]
    rows = "".join(
        f'<li><b>{escape(e["task"])}</b>: <span class="reason">{escape(e["reason"] or "")}</span></li>' for e in failed
    )
    if record.get("reason"):
        rows += f'<li><b>cloud</b>: <span class="reason">{escape(record["reason"])}</span></li>'
    moved = (record.get("poses") or {}).get("suspects", {})
    warnings = "".join(
        f'<li><b>{escape(name)}</b>: <span class="reason">{escape(why)}</span></li>' for name, why in moved.items()
    )
    return (f"<h2>What failed</h2><ul>{rows}</ul>" if rows else "") + (
        f"<h2>What has changed</h2><ul>{warnings}</ul>" if warnings else ""
    )


def _cloud(record: dict[str, Any], pictures: dict[str, str]) -> str:
    if not record["cloud"]:
        return ""
    low, high = record["cloud"]["bounds"]
    size = " x ".join(f"{b - a:.1f}" for a, b in zip(low, high, strict=True))
    picture = f'<p><img class="wide" src="{pictures["fuse"]}" alt="the cloud"></p>' if "fuse" in pictures else ""
    poses = record.get("poses") or {}
    unit = "m" if poses.get("metric", True) else "units (nothing says how long a metre is)"
    words = f"<p><a href='cloud.ply'>cloud.ply</a>: {record['cloud']['points']:,} points, {size} {unit}</p>"
    others = "".join(
        f"<li><a href='{c['path']}'>{c['path']}</a>: {c['points']:,} points</li>" for c in record.get("other_clouds", [])
    )
    if others:
        joins = "".join(f"<li>{escape(join)}</li>" for join in poses.get("joins", ()))
        words += f"<p>The pairs do not connect all cameras; the others have clouds of their own:</p><ul>{others}{joins}</ul>"
    notes = "".join(f"<li>{escape(note)}</li>" for note in poses.get("notes", ()))
    return f"<h2>The cloud</h2>{picture}{words}<ul>{notes}</ul>"


def _graph(record: dict[str, Any], folder: Path) -> str:
    centres = {}
    if (folder / "cameras.json").is_file():
        cameras = json.loads((folder / "cameras.json").read_text())
        centres = {name: (entry["C"][0], entry["C"][1]) for name, entry in cameras.items() if entry.get("C")}
    words = "<p class='muted'>Line width: how densely a pair was matched; dashed: not used (reason on hover).</p>"
    return f"<h2>Pair graph</h2>{pair_graph_svg(record, centres)}{words}"


def _cameras(record: dict[str, Any], pictures: dict[str, str]) -> str:
    cards = []
    for camera in record["cameras"]:
        bad = camera["outcome"] != "ok"
        picture = pictures.get(f"frames {camera['id']}")
        image = f'<img src="{picture}" alt="{escape(camera["id"])}">' if picture else ""
        notes = "; ".join(camera.get("notes") or [])
        words = f'<span class="reason">{escape(str(camera["reason"]))}</span>' if bad else f"{camera['keypoints']} keypoints"
        note = f"<br><span class='muted'>{escape(notes)}</span>" if notes else ""
        cards.append(f'<div class="card{" bad" if bad else ""}">{image}<b>{escape(camera["id"])}</b> {words}{note}</div>')
    return f'<h2>Cameras</h2><div class="cards">{"".join(cards)}</div>'


def _pairs(record: dict[str, Any], pictures: dict[str, str]) -> str:
    columns = ("matches", "inliers", "angle_deg", "epipolar_px", "poses_px", "vertical_px", "density")
    names = ("matches", "inliers", "angle °", "epipolar px", "by the poses px", "vertical px", "density")
    head = "<th>pair</th>" + "".join(f"<th>{n}</th>" for n in names) + '<th class="words">outcome</th>'
    rows, cards = [], []
    for pair in record["pairs"]:
        name = f"{pair['left']}--{pair['right']}"
        cells = "".join(f"<td>{_number(pair.get(c))}</td>" for c in columns)
        words = (
            "ok" if pair["outcome"] == "ok" else f'<span class="reason">{pair["outcome"]}</span>: {escape(str(pair["reason"]))}'
        )
        rows.append(f'<tr><td>{escape(name)}</td>{cells}<td class="words">{words}</td></tr>')
        shown = [pictures[task] for task in (f"geometry {name}", f"disparity {name}") if task in pictures]
        if shown:
            images = "".join(f'<img src="{picture}" alt="{escape(name)}">' for picture in shown)
            cards.append(f'<div class="card">{images}<b>{escape(name)}</b></div>')
    return f'<h2>Pairs</h2><table><tr>{head}</tr>{"".join(rows)}</table><div class="cards">{"".join(cards)}</div>'


def _timings(record: dict[str, Any]) -> str:
    rows = "".join(
        f"<tr><td>{escape(stage)}</td><td>{row['tasks']:.0f}</td><td>{row['wall']:.1f}</td><td>{row['cpu']:.1f}</td></tr>"
        for stage, row in record["seconds"]["stages"].items()
    )
    total = (
        f"wall {record['seconds']['wall']:.1f} s, CPU {record['seconds']['cpu']:.1f} s, peak {record['peak_rss_mb']} MB a worker"
    )
    table = f"<table><tr><th>stage</th><th>tasks</th><th>wall s</th><th>CPU s</th></tr>{rows}</table>" if rows else ""
    return f"<h2>Timings</h2><p>{total}</p>{table}"


def _number(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.2f}" if isinstance(value, float) else f"{value:,}"
