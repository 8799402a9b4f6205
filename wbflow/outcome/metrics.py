"""Metrics of a run: gauges for Prometheus, by way of node_exporter's textfile collector."""

from __future__ import annotations

from collections import Counter

from ..records.record import RunRecord, moment

Labels = dict[str, str]
Rows = list[tuple[Labels, float]]


def metrics(record: RunRecord) -> str:
    """Gauges of a run, one line each (https://prometheus.io/docs/instrumenting/exposition_formats)."""
    verdict, usual = record.verdict, record.usual
    findings = Counter(finding.kind for finding in verdict.findings) if verdict else Counter[str]()
    levels: Rows = [
        ({"level": level}, int(verdict is not None and verdict.level == level)) for level in ("good", "degraded", "failed")
    ]
    usual_rows: Rows = [({"of": name}, value) for name, value in usual.figures.items()] if usual else []
    cameras = [({"camera": c.id}, int(c.ok and c.down is None), c.down.nights if c.down else 0) for c in record.cameras]
    pairs: Rows = [({"outcome": outcome}, count) for outcome, count in Counter(pair.outcome for pair in record.pairs).items()]
    volumes, sigmas, areas = _volumes(record)
    rows: list[tuple[str, str, Rows]] = [
        ("verdict", "1 for the level of the night.", levels),
        ("findings", "Number of findings, by code.", [({"kind": kind}, count) for kind, count in findings.items()]),
        ("exit_code", "How the run ended.", [({}, int(record.exit_code))]),
        ("finished_timestamp_seconds", "When the run ended.", [({}, moment(record.finished).timestamp())]),
        ("night_timestamp_seconds", "The night of the captures.", [({}, moment(f"{record.date}T00:00:00Z").timestamp())]),
        ("points", "Points of the main cloud.", [({}, record.cloud.points if record.cloud else 0)]),
        ("usual", "Usual values: medians of the last good nights.", usual_rows),
        ("camera_ok", "1 for a camera that is in use and well.", [(labels, ok) for labels, ok, _ in cameras]),
        ("camera_nights_down", "Nights for which the camera has been down.", [(labels, nights) for labels, _, nights in cameras]),
        ("camera_pairs", "Pairs of cameras by outcome.", pairs),
        ("volume_cubic_metres", "Volumes gained and lost since the reference, by zone (none: the whole site).", volumes),
        ("volume_sigma_cubic_metres", "Standard deviation of the volumes.", sigmas),
        ("compared_square_metres", "Ground that was seen on both nights, and that was not.", areas),
        ("tasks", "Tasks by outcome.", [({"outcome": name}, count) for name, count in record.tasks.to_json().items()]),
        ("wall_seconds", "How long the run took.", [({}, round(record.seconds.wall, 2))]),
        ("cpu_seconds", "CPU time that it took.", [({}, round(record.seconds.cpu, 2))]),
        ("stage_cpu_seconds", "CPU time by stage.", [({"stage": n}, round(s.cpu, 2)) for n, s in record.seconds.stages.items()]),
        ("peak_rss_megabytes", "Memory of the largest worker.", [({}, record.peak_rss_mb)]),
    ]
    lines = []
    for name, meaning, values in rows:
        lines += [f"# HELP wbflow_{name} {meaning}", f"# TYPE wbflow_{name} gauge"]
        lines += [f"wbflow_{name}{{{_labels({'site': record.site, **labels})}}} {value:.12g}" for labels, value in values]
    return "\n".join(lines) + "\n"


def _volumes(record: RunRecord) -> tuple[Rows, Rows, Rows]:
    """Return volumes, their standard deviations, and areas; nothing for a site without a metric scale."""
    volumes, sigmas, areas = Rows(), Rows(), Rows()
    results = record.results.values() if record.poses and record.poses.metric else ()
    for zone, part in ((zone, part) for result in results for zone, part in result.volumes.items()):
        labels = {"zone": zone} if zone else {}
        volumes += [({**labels, "change": "gained"}, part.gained), ({**labels, "change": "lost"}, part.lost)]
        sigmas += [({**labels, "change": "gained"}, part.gained_sigma), ({**labels, "change": "lost"}, part.lost_sigma)]
        areas += [({**labels, "seen": "yes"}, part.area), ({**labels, "seen": "no"}, part.unseen)]
    return volumes, sigmas, areas


_ESCAPES = str.maketrans({"\\": "\\\\", '"': '\\"', "\n": "\\n"})


def _labels(labels: Labels) -> str:
    return ",".join(f'{name}="{value.translate(_ESCAPES)}"' for name, value in labels.items())
