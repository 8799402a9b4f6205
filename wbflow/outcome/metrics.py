"""A run in the text format of Prometheus, for whatever watches many sites."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from ..records.record import RunRecord, moment

Labels = dict[str, str]
Rows = list[tuple[Labels, float]]


def metrics(record: RunRecord) -> str:
    """Gauges of a run, one line each (https://prometheus.io/docs/instrumenting/exposition_formats)."""
    verdict, usual = record.verdict, record.usual
    findings = Counter(finding.kind for finding in verdict.findings) if verdict else Counter[str]()
    levels: Rows = [({"level": level}, _is(verdict and verdict.level == level)) for level in ("good", "degraded", "failed")]
    compared: Rows = [({"of": of}, value) for of, value in usual.figures.items()] if usual else []
    rows: list[tuple[str, str, Rows]] = [
        ("verdict", "1 for the level that the night came to.", levels),
        ("findings", "What is to be looked at, by kind.", [({"kind": kind}, count) for kind, count in findings.items()]),
        ("exit_code", "How the run ended.", [({}, int(record.exit_code))]),
        ("finished_timestamp_seconds", "When the run ended.", [({}, moment(record.finished).timestamp())]),
        ("night_timestamp_seconds", "The night of the captures.", [({}, moment(f"{record.date}T00:00:00Z").timestamp())]),
        ("points", "Points of the main cloud.", [({}, record.cloud.points if record.cloud else 0)]),
        ("usual", "What the last good nights gave.", compared),
        ("camera_ok", "1 for a camera that did its part and is as it should be.", _cameras(record)),
        ("camera_nights_down", "For how many nights it has not been.", _nights_down(record)),
        ("camera_pairs", "Pairs of cameras by outcome.", _counted("outcome", (pair.outcome for pair in record.pairs))),
        ("tasks", "Tasks by outcome.", [({"outcome": name}, count) for name, count in record.tasks.to_json().items()]),
        ("wall_seconds", "How long the run took.", [({}, round(record.seconds.wall, 2))]),
        ("cpu_seconds", "CPU time that it took.", [({}, round(record.seconds.cpu, 2))]),
        ("stage_cpu_seconds", "CPU time by stage.", [({"stage": n}, round(s.cpu, 2)) for n, s in record.seconds.stages.items()]),
        ("peak_rss_megabytes", "Memory of the largest worker.", [({}, record.peak_rss_mb)]),
    ]
    lines = []
    for name, told, values in rows:
        lines += [f"# HELP wbflow_{name} {told}", f"# TYPE wbflow_{name} gauge"]
        lines += [f"wbflow_{name}{{{_labels({'site': record.site, **labels})}}} {value:.12g}" for labels, value in values]
    return "\n".join(lines) + "\n"


def _cameras(record: RunRecord) -> Rows:
    return [({"camera": camera.id}, _is(camera.ok and camera.down is None)) for camera in record.cameras]


def _nights_down(record: RunRecord) -> Rows:
    return [({"camera": camera.id}, camera.down.nights if camera.down else 0) for camera in record.cameras]


def _counted(label: str, values: Iterable[str]) -> Rows:
    return [({label: value}, count) for value, count in Counter(values).items()]


def _labels(labels: Labels) -> str:
    return ",".join(f'{name}="{_escaped(value)}"' for name, value in labels.items())


def _escaped(value: str) -> str:
    return value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")


def _is(value: object) -> int:
    return int(bool(value))
