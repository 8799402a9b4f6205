"""The report's charts of the last nights."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from tests.wbflow.verdict.test_rules import PAIRS, night, pair, without
from wbflow.report.charts import trends
from wbflow.report.data import ReportData


def test_a_night_with_fewer_pairs_shows_in_a_chart(tmp_path: Path) -> None:
    work = SimpleNamespace(run=lambda run: SimpleNamespace(folder=tmp_path, report=tmp_path / "report.html"))
    rejected = [pair(*names, "rejected") for names in PAIRS if "roof" in names]
    data = ReportData(
        cast(Any, SimpleNamespace(work=work)), night(pairs=[*without("roof"), *rejected]), (), {}, tmp_path, cast(Any, None)
    )
    vars(data)["earlier"] = [night("2026-11-19")]
    pairs = next(trend for trend in trends(data) if trend.title == "usable pairs")
    assert pairs.now == "3"
    assert [(dot.date, dot.words) for dot in pairs.chart.dots] == [("2026-11-19", "6"), ("2026-11-20", "3")]
    assert [words for _, words in pairs.chart.ticks] == ["3", "4", "5", "6"], "the axis has the values that the dots have"
    assert [words for _, words, _ in pairs.chart.dates] == ["19 Nov", "20 Nov"]
