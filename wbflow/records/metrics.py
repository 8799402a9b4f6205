"""Metrics of a run: gauges for Prometheus, by way of node_exporter's textfile collector."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

from .changes import open_changes
from .record import RunRecord, moment

Rows = list[tuple[dict[str, str], float]]
"""Labels and values of a gauge."""


def metrics(record: RunRecord) -> str:
    """Gauges of a run, one line each (https://prometheus.io/docs/instrumenting/exposition_formats)."""
    lines = []
    for name, meaning, rows in _gauges(record):
        lines += [f"# HELP wbflow_{name} {meaning}", f"# TYPE wbflow_{name} gauge"]
        lines += [f"wbflow_{name}{{{_labels({'site': record.site, **labels})}}} {value:.12g}" for labels, value in rows]
    return "\n".join(lines) + "\n"


def _gauges(record: RunRecord) -> Iterator[tuple[str, str, Rows]]:
    """Yield name, meaning and rows of each gauge."""
    level = record.verdict.level if record.verdict else ""
    yield "verdict", "1 for the level of the night.", [({"level": n}, int(n == level)) for n in ("good", "degraded", "failed")]
    findings = Counter(finding.kind for finding in record.verdict.findings) if record.verdict else {}
    yield "findings", "Number of findings, by code.", [({"kind": kind}, count) for kind, count in findings.items()]
    yield "exit_code", "How the run ended.", [({}, int(record.exit_code))]
    yield "finished_timestamp_seconds", "When the run ended.", [({}, moment(record.finished).timestamp())]
    yield "night_timestamp_seconds", "The night of the captures.", [({}, moment(f"{record.date}T00:00:00Z").timestamp())]
    yield "points", "Points of the main cloud.", [({}, record.cloud.points if record.cloud else 0)]
    usual = record.usual.figures if record.usual else {}
    yield "usual", "Usual values: medians of the last good nights.", [({"of": name}, value) for name, value in usual.items()]
    well: Rows = [({"camera": camera.id}, int(camera.ok and camera.down is None)) for camera in record.cameras]
    yield "camera_ok", "1 for a camera that is in use and well.", well
    nights: Rows = [({"camera": camera.id}, camera.down.nights if camera.down else 0) for camera in record.cameras]
    yield "camera_nights_down", "Nights for which the camera has been down.", nights
    pairs = Counter(pair.outcome for pair in record.pairs)
    yield "camera_pairs", "Pairs of cameras by outcome.", [({"outcome": outcome}, count) for outcome, count in pairs.items()]
    yield from _gauges_of_volumes(record)
    yield from _gauges_of_changes(record)
    tasks = record.tasks.to_json()
    yield "tasks", "Tasks by outcome.", [({"outcome": outcome}, count) for outcome, count in tasks.items()]
    seconds = record.seconds
    yield "wall_seconds", "How long the run took.", [({}, round(seconds.wall, 2))]
    yield "cpu_seconds", "CPU time that it took.", [({}, round(seconds.cpu, 2))]
    yield "stage_cpu_seconds", "CPU time by stage.", [({"stage": n}, round(s.cpu, 2)) for n, s in seconds.stages.items()]
    yield "peak_rss_megabytes", "Memory of the largest worker.", [({}, record.peak_rss_mb)]


def _gauges_of_volumes(record: RunRecord) -> Iterator[tuple[str, str, Rows]]:
    """Yield volumes, their standard deviations, and areas; without rows for a site without a metric scale."""
    volumes, sigmas, bounds, areas = Rows(), Rows(), Rows(), Rows()
    results = record.results.values() if record.poses and record.poses.metric else ()
    for zone, part in ((zone, part) for result in results for zone, part in result.volumes.items()):
        labels = {"zone": zone} if zone else {}
        volumes += [({**labels, "change": "gained"}, part.gained), ({**labels, "change": "lost"}, part.lost)]
        sigmas += [({**labels, "change": "gained"}, part.gained_sigma), ({**labels, "change": "lost"}, part.lost_sigma)]
        for side in ("gained", "lost"):
            for bound in ("least", "most"):
                bounds.append(({**labels, "change": side, "bound": bound}, getattr(part, f"{side}_{bound}")))
        areas += [({**labels, "seen": "yes"}, part.area), ({**labels, "seen": "no"}, part.unseen)]
    yield "volume_cubic_metres", "Volumes gained and lost since the reference, by zone (none: the whole site).", volumes
    yield "volume_sigma_cubic_metres", "Standard deviation of the volumes.", sigmas
    yield "volume_bound_cubic_metres", "Intervals that hold the volumes.", bounds
    yield "compared_square_metres", "Ground that was seen on both nights, and that was not.", areas


def _gauges_of_changes(record: RunRecord) -> Iterator[tuple[str, str, Rows]]:
    """Yield the number of changes, and the interval that holds the volume of each."""
    counts, volumes = Rows(), Rows()
    if record.compared:
        changes = record.changes.values()
        unacknowledged = len(open_changes(record))
        counts.append(({"state": "open"}, unacknowledged))
        counts.append(({"state": "acknowledged"}, len(changes) - unacknowledged))
        counts.append(({"state": "new"}, sum(change.first == record.date for change in changes)))
        counts.append(({"state": "gone"}, len(record.compared.gone)))
    for change in record.changes.values() if record.unit else ():
        labels = {"id": change.id, "kind": change.kind, "zone": change.zone}
        volumes.append(({**labels, "bound": "least"}, change.volume_least))
        volumes.append(({**labels, "bound": "most"}, change.volume_most))
    yield "changes", "Changes since the reference: open and acknowledged ones; new and gone ones of this night.", counts
    yield "change_cubic_metres", "Interval that holds the volume of a change.", volumes


_ESCAPES = str.maketrans({"\\": "\\\\", '"': '\\"', "\n": "\\n"})


def _labels(labels: dict[str, str]) -> str:
    return ",".join(f'{name}="{value.translate(_ESCAPES)}"' for name, value in labels.items())
