"""What was tried with a pair that gave nothing: each step as far as it came, with the figures behind it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ..cache.store import Receipt
from ..outcome.beside import number
from ..pipeline.rows import Stage
from ..pipeline.stages import STAGES
from ..pipeline.summaries import meaning
from ..records.record import PairRecord
from ..task import Task
from .sources import Sources

_MOST = 8
"""Figures of a step."""


@dataclass(frozen=True)
class Step:
    """One stage of a pair."""

    stage: str
    outcome: str
    words: str


def tried(sources: Sources, pair: PairRecord) -> tuple[Step, ...]:
    """The steps of a pair that could not be used; of one that could, none."""
    return () if pair.ok else tuple(_steps(sources, (pair.left, pair.right)))


def _steps(sources: Sources, subject: tuple[str, str]) -> Iterator[Step]:
    cache = sources.cache
    for stage in (stage for stage in STAGES if stage.scope == "pair"):
        event = sources.tasks.get(Task(stage.name, subject))
        if event is None or event.outcome == "skipped":  # for what the step before says
            continue
        receipt = cache.by_key(event.task, event.key) if event.key else None
        told = list(_figures(stage, receipt)) if receipt else []
        outcome = "done" if event.usable else event.outcome
        yield Step(stage.name, outcome, "; ".join(filter(None, (*_method(stage, receipt), event.reason, ", ".join(told)))))


def _method(stage: Stage, receipt: Receipt | None) -> Iterator[str]:
    if stage.method and receipt and (name := receipt.preimage.parameters.get(stage.method.parameter)):
        yield f"by {name}"


def _figures(stage: Stage, receipt: Receipt) -> Iterator[str]:
    """Numbers of a receipt under the names that run.json has for them, these first."""
    names = {theirs: ours for ours, theirs in stage.reports.fields.items()} if stage.reports else {}
    figures: Mapping[str, Any] = receipt.figures
    numbers = {name: value for name, value in figures.items() if isinstance(value, int | float) and not isinstance(value, bool)}
    known = [name for name in names if name in numbers]
    others = [name for name in numbers if name not in names and not name.endswith("_count")]
    for name in [*known, *others][:_MOST]:
        value = numbers[name]
        if value == value:  # nan says nothing
            yield f"{meaning(names.get(name, name)).title} {number(value) if isinstance(value, float) else f'{value:,}'}"
