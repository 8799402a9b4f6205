"""Two nights side by side, from their run.json."""

from __future__ import annotations

from dataclasses import dataclass

from ..store.record import CameraRecord, PairRecord, RunRecord


@dataclass(frozen=True)
class Row:
    """A figure in both runs."""

    what: str
    """Its name."""
    a: str
    b: str

    @property
    def changed(self) -> bool:
        """Do the two runs differ here?"""
        return self.a != self.b


def compare(a: RunRecord, b: RunRecord) -> list[Row]:
    """The figures of two runs: first the night as a whole, then every camera and pair that differs."""
    rows = [Row("run", a.run, b.run), Row("date", a.date, b.date), Row("exit code", str(a.exit_code), str(b.exit_code))]
    rows += [Row("points", *(f"{r.cloud.points if r.cloud else 0:,}" for r in (a, b)))]
    rows += [Row("wall seconds", f"{a.seconds.wall:.1f}", f"{b.seconds.wall:.1f}")]
    rows += [Row("CPU seconds", f"{a.seconds.cpu:.1f}", f"{b.seconds.cpu:.1f}")]
    counts = a.tasks.to_json(), b.tasks.to_json()
    rows += [Row(f"tasks {name}", *(str(count[name]) for count in counts)) for name in counts[0]]
    ours = {camera.id: _words(camera) for camera in a.cameras} | {pair.name: _words(pair) for pair in a.pairs}
    theirs = {camera.id: _words(camera) for camera in b.cameras} | {pair.name: _words(pair) for pair in b.pairs}
    both = [Row(name, ours.get(name, "absent"), theirs.get(name, "absent")) for name in dict.fromkeys([*ours, *theirs])]
    return rows + [row for row in both if row.changed]


def _words(record: CameraRecord | PairRecord) -> str:
    if not record.ok:
        return f"{record.outcome}: {record.reason}"
    figures = (f"{name} {value:.2f}" if isinstance(value, float) else f"{value} {name}" for name, value in _shown(record))
    return ", ".join(["ok", *figures])


def _shown(record: CameraRecord | PairRecord) -> list[tuple[str, int | float]]:
    """Counts, and shares of one: what differs by little from night to night says nothing."""
    shown = ("keypoints", "inliers", "density")
    return [(name, value) for name in shown if (value := record.figures.get(name)) is not None]
