"""Metrics of a run: gauges for Prometheus, by way of node_exporter's textfile collector."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping

from .changes import open_changes
from .findings import Verdict
from .record import RunRecord, moment

Rows = list[tuple[dict[str, str], float]]
"""Labels and values of a gauge."""


def metrics(record: RunRecord) -> str:
    """Gauges of a run, one line each (https://prometheus.io/docs/instrumenting/exposition_formats)."""
    lines = []
    for name, meaning, rows in _gauges(record):
        lines += [f"# HELP wbflow_{name} {meaning}", f"# TYPE wbflow_{name} gauge"]
        for labels, value in rows:
            text = _labels({"site": record.site, **labels})
            lines.append(f"wbflow_{name}{{{text}}} {value:.12g}")
    return "\n".join(lines) + "\n"


def _gauges(record: RunRecord) -> Iterator[tuple[str, str, Rows]]:
    """Yield name, meaning and rows of each gauge."""
    verdict = record.verdict or Verdict("good")
    levels = dict.fromkeys(("good", "degraded", "failed"), 0)
    if record.verdict:
        levels[verdict.level] = 1
    yield "verdict", "1 for the level of the night.", _by("level", levels)
    yield "findings", "Number of findings, by code.", _by("kind", Counter(finding.kind for finding in verdict.findings))
    yield "exit_code", "How the run ended.", [({}, int(record.exit_code))]
    yield "finished_timestamp_seconds", "When the run ended.", [({}, moment(record.finished).timestamp())]
    yield "night_timestamp_seconds", "The night of the captures.", [({}, moment(f"{record.date}T00:00:00Z").timestamp())]
    yield "points", "Points of the main cloud.", [({}, record.cloud.points if record.cloud else 0)]
    usual = record.usual.figures if record.usual else {}
    yield "usual", "Usual values: medians of the last good nights.", _by("of", usual)
    well = {camera.id: int(camera.ok and camera.down is None) for camera in record.cameras}
    yield "camera_ok", "1 for a camera that is in use and well.", _by("camera", well)
    nights = {camera.id: camera.down.nights if camera.down else 0 for camera in record.cameras}
    yield "camera_nights_down", "Nights for which the camera has been down.", _by("camera", nights)
    yield "camera_pairs", "Pairs of cameras by outcome.", _by("outcome", Counter(pair.outcome for pair in record.pairs))
    yield from _gauges_of_volumes(record)
    yield from _gauges_of_changes(record)
    yield "tasks", "Tasks by outcome.", _by("outcome", record.tasks.to_json())
    seconds = record.seconds
    yield "wall_seconds", "How long the run took.", [({}, round(seconds.wall, 2))]
    yield "cpu_seconds", "CPU time that it took.", [({}, round(seconds.cpu, 2))]
    cpu_of_stages = {name: round(stage.cpu, 2) for name, stage in seconds.stages.items()}
    yield "stage_cpu_seconds", "CPU time by stage.", _by("stage", cpu_of_stages)
    yield "peak_rss_megabytes", "Memory of the largest worker.", [({}, record.peak_rss_mb)]


def _by(label: str, values: Mapping[str, float]) -> Rows:
    """A row for each value, with its name as this label."""
    return [({label: name}, value) for name, value in values.items()]


def _gauges_of_volumes(record: RunRecord) -> Iterator[tuple[str, str, Rows]]:
    """Yield volumes, their standard deviations, and areas; without rows for a site without a metric scale."""
    volumes: Rows = []
    sigmas: Rows = []
    bounds: Rows = []
    areas: Rows = []
    if record.poses and record.poses.metric:
        for result in record.results.values():
            for zone, part in result.volumes.items():
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
