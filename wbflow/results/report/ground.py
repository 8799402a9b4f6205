"""The parts of the report that show what site-wide stages say of the ground."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from ...graph.pipeline import STAGES
from ...store.record import Figures, RunRecord
from ...task import Task
from ..beside import shown


def sections(record: RunRecord, pictures: Mapping[Task, str]) -> str:
    """Picture, figures and files of each stage that run.json tells of."""
    told = (
        (stage.name, stage.title, record.later.get(stage.name)) for stage in STAGES if stage.scope == "site" and stage.reports
    )
    return "".join(_section(title, figures, pictures.get(Task(name))) for name, title, figures in told if figures)


def _section(title: str, figures: Figures, picture: str | None) -> str:
    image = f'<p><img class="wide" src="{picture}" alt="{escape(title)}"></p>' if picture else ""
    rows = "".join(f"<tr><td>{escape(name)}</td><td>{escape(value)}</td></tr>" for name, value in shown(figures))
    listed = "".join(_list(value) for value in figures.values() if isinstance(value, Mapping))
    links = ", ".join(f"<a href='{escape(name)}'>{escape(name)}</a>" for name in figures.get("files") or ())
    reason = f'<p class="reason">{escape(str(figures["reason"]))}</p>' if figures.get("reason") else ""
    return f"<h2>{escape(title)}</h2>{reason}{image}<table>{rows}</table>{listed}<p>{links}</p>"


def _list(entries: Mapping[str, Any]) -> str:
    """A table of things that each have figures; "" for figures of one thing."""
    things = {name: entry for name, entry in entries.items() if isinstance(entry, Mapping)}
    if not things:
        return ""
    columns = list(dict.fromkeys(name for entry in things.values() for name in entry))
    head = "".join(f"<th>{escape(name.replace('_', ' '))}</th>" for name in ("", *columns))
    rows = (f"<td>{escape(name)}</td>" + "".join(_cell(entry.get(c)) for c in columns) for name, entry in things.items())
    return f"<table><tr>{head}</tr>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"


def _cell(value: Any) -> str:
    return f"<td>{value:.2f}</td>" if isinstance(value, float) else f"<td>{escape(str(value or ''))}</td>"
