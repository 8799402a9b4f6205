"""Comparisons: the figures of two runs from their run.json, what changed between two runs, and a run's cloud with a scan."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..cache.atomic import write_atomic
from ..cache.layout import WorkFolder
from ..cache.ply import ply_bytes
from ..errors import UsageError, WbflowError
from ..pipeline.meanings import titled
from ..pipeline.stages import CHANGES, DEPTH, FRAMES, POSES, REFINE
from ..pipeline.summaries import CutFill
from ..plugins import load
from ..records.record import CameraRecord, PairRecord, RunRecord
from ..records.run_folder import NoSuchRun, RunFolder, newest_runs
from ..task import Task
from .export import MissingExtra
from .finished_run import MissingResult, Run

NOISE = 0.05
"""Smaller relative differences are ignored: keypoints, inliers and points vary this much from night to night."""
NOISE_OF_SHARES = 0.03
"""Smaller absolute differences are ignored between figures that are shares, 0 to 1."""
NOISE_OF_TIME = 0.25
"""Smaller relative differences are ignored between times in seconds."""

Value = int | float | str | None


@dataclass(frozen=True)
class Row:
    """A figure or text of both runs."""

    what: str
    """Name of the figure, preceded by the name of its camera or pair, if it has one."""
    a: Value
    b: Value
    noise: float = NOISE
    """Figures count as equal up to this difference, as a share of the larger one."""

    @property
    def change(self) -> float | None:
        """Relative change from a to b; None for texts, and if a is 0."""
        if isinstance(self.a, int | float) and isinstance(self.b, int | float) and self.a:
            return self.b / self.a - 1
        return None

    @property
    def differs(self) -> bool:
        """Do the two runs differ here, by more than noise?"""
        a, b = self.a, self.b
        if not isinstance(a, int | float) or not isinstance(b, int | float):
            return a != b
        if isinstance(a, float) and 0 <= min(a, b) <= max(a, b) <= 1:
            return abs(a - b) > NOISE_OF_SHARES
        return abs(a - b) > self.noise * max(abs(a), abs(b))

    def __str__(self) -> str:
        change = f"{100 * self.change:+.0f} %" if self.change is not None and self.differs else ""
        return f"{self.what:32} {_formatted(self.a):>24}   {_formatted(self.b):24} {change}".rstrip()

    def to_json(self) -> dict[str, Any]:
        change = None if self.change is None else round(self.change, 4)
        return {"what": self.what, "a": self.a, "b": self.b, "change": change, "differs": self.differs}


def compare(a: RunRecord, b: RunRecord) -> list[Row]:
    """All figures that two runs share: first the night as a whole, then every camera and pair."""
    rows = [Row("run", a.run, b.run), Row("night", a.date, b.date), Row("verdict", _verdict(a), _verdict(b))]
    rows += [Row("points", *(r.cloud.points if r.cloud else 0 for r in (a, b)))]
    rows += [Row("cameras", sum(c.ok for c in a.cameras), sum(c.ok for c in b.cameras), 0.0)]
    rows += [Row("pairs of cameras", sum(p.ok for p in a.pairs), sum(p.ok for p in b.pairs), 0.0)]
    rows += _site_rows(a, b)
    rows += [Row("wall seconds", round(a.seconds.wall, 1), round(b.seconds.wall, 1), NOISE_OF_TIME)]
    rows += [Row("CPU seconds", round(a.seconds.cpu, 1), round(b.seconds.cpu, 1), NOISE_OF_TIME)]
    counts = vars(a.tasks), vars(b.tasks)
    rows += [Row(f"tasks {name}", counts[0][name], counts[1][name], noise=0.0) for name in counts[0]]
    for records_a, records_b in ((_by_name(a.cameras), _by_name(b.cameras)), (_by_name(a.pairs), _by_name(b.pairs))):
        for name in dict.fromkeys([*records_a, *records_b]):
            rows += _subject_rows(name, records_a.get(name), records_b.get(name))
    return rows


def differing(rows: list[Row]) -> list[Row]:
    """Return the rows that identify the runs, their verdicts, and the rows that differ."""
    return rows[:3] + [row for row in rows[3:] if row.differs]


def last_two(work: WorkFolder) -> tuple[RunFolder, RunFolder]:
    """The newest good run before the newest one, and the newest one.  Raises NoSuchRun if there is none."""
    newest = RunFolder.of(work)
    for folder, record in newest_runs(work, before=newest.id):
        if folder.is_good() and (record.verdict is None or record.verdict.good):
            return folder, newest
    raise NoSuchRun(f"there is no good run before {newest.id}", remedy="name two: wbflow compare SITE.yaml RUN_A RUN_B")


def _verdict(record: RunRecord) -> str:
    return record.verdict.level if record.verdict else f"exit {record.exit_code}"


def _by_name(records: tuple[CameraRecord, ...] | tuple[PairRecord, ...]) -> Mapping[str, CameraRecord | PairRecord]:
    return {record.id if isinstance(record, CameraRecord) else record.name: record for record in records}


def _site_rows(a: RunRecord, b: RunRecord) -> Iterator[Row]:
    for stage in (stage for stage in a.results if stage in b.results):
        figures_a, figures_b = vars(a.results[stage]), vars(b.results[stage])
        yield from (Row(f"{stage}: {titled(name)}", figures_a[name], figures_b[name]) for name in _common(figures_a, figures_b))
        volumes = a.results[stage].volumes, b.results[stage].volumes
        for zone, what in itertools.product((zone for zone in volumes[0] if zone in volumes[1]), ("gained", "lost")):
            yield Row(f"{stage}: {what}{f' in {zone}' if zone else ''}", *(getattr(by_zone[zone], what) for by_zone in volumes))


def _subject_rows(name: str, a: CameraRecord | PairRecord | None, b: CameraRecord | PairRecord | None) -> list[Row]:
    """The outcome of a camera or pair, and its figures if both runs used it."""
    rows = [Row(name, _outcome(a), _outcome(b))]
    if a and b and a.ok and b.ok:
        figures_a, figures_b = vars(a.figures), vars(b.figures)
        rows += [Row(f"{name} {figure}", figures_a[figure], figures_b[figure]) for figure in _common(figures_a, figures_b)]
    return rows


def _outcome(record: CameraRecord | PairRecord | None) -> str:
    if record is None:
        return "absent"
    if isinstance(record, CameraRecord) and record.health and not record.health.ok:
        return f"{record.health.state}: {record.health.text}"
    return "ok" if record.ok else f"{record.outcome}: {record.reason}"


def _common(figures_a: Mapping[str, Any], figures_b: Mapping[str, Any]) -> list[str]:
    """Return the names of numbers and texts that both have."""
    return [name for name in figures_a if _is_comparable(figures_a[name]) and _is_comparable(figures_b.get(name))]


def _is_comparable(value: object) -> bool:
    return isinstance(value, int | float | str) and not isinstance(value, bool)


def _formatted(value: Value) -> str:
    if isinstance(value, float):
        return f"{value:,.2f}"
    return f"{value:,}" if isinstance(value, int) else str(value)


def compare_with_scan(run: Run, scan: Path, out: Path) -> dict[str, Any]:
    """Write the deviations of a run's cloud from a scan into `out`; return the figures.

    Raises UsageError for a scan that cannot be read, or lies elsewhere, or covers less than half of the cloud; MissingExtra
    if packages that read such files are not installed; MissingResult if the run has no cloud.
    """
    if not scan.is_file():
        raise UsageError(f"{scan}: there is no such file", remedy="wbflow compare SITE.yaml SCAN.laz --out DIR")
    try:
        files, figures = load("wbflow_stages.exports.deviation:scan_files")(run.cloud_table(), run.result_of(POSES), scan)
    except ImportError as error:
        extra = "e57" if scan.suffix.lower() == ".e57" else "las"
        raise MissingExtra(f"{scan.suffix} needs {error.name}: pip install 'wbflow[{extra}]'") from None
    except ValueError as error:
        raise UsageError(f"{scan}: {error}", remedy="nothing was written") from None
    for name, content in files.items():
        write_atomic(out / name, content if isinstance(content, bytes) else ply_bytes(content))
    return {**figures, "run": run.id, "night": run.record.date}


def changes_between(reference: Run, tonight: Run) -> Any:
    """Return what changed (`wbflow_stages.types.Changes`), by the function and the parameters of the later run.

    Raises MissingResult if a run placed no cameras or the cache no longer holds its results; WbflowError if the later
    run did not look for changes, or the runs have nothing in common.
    """
    receipt = tonight.receipt(Task(CHANGES))
    if receipt is None:
        raise WbflowError(f"run {tonight.id} did not look for changes", remedy="its log.jsonl says why")
    preimage = receipt.preimage
    changes = load(preimage.function)(**_change_inputs(tonight), **_change_inputs(reference, "reference_"), **preimage.parameters)
    if not changes.compared:
        raise WbflowError(
            f"runs {reference.id} and {tonight.id} have nothing in common", remedy="their cameras are at different places"
        )
    return changes


def _change_inputs(run: Run, prefix: str = "") -> Mapping[str, Any]:
    poses = run.result_of(POSES)
    if poses is None:
        raise MissingResult(f"run {run.id} placed no cameras: {run.record.reason or 'the run was not meant to'}")
    by_camera = {"frames": FRAMES, "depths": DEPTH, "refined": REFINE}
    values = {"poses": poses, "cloud": run.cloud_table(), **{name: run.of_cameras(stage) for name, stage in by_camera.items()}}
    return {prefix + name: value for name, value in values.items()}


def data_of(changes: Any) -> dict[str, Any]:
    """Return changes in the form of changes.json."""
    data: dict[str, Any] = load("wbflow_stages.exports.ground:changes_data")(changes)
    return data


def lines_of(data: Mapping[str, Any]) -> Iterator[str]:
    """Yield the volumes and changes of changes.json as lines of text."""
    unit = "m" if data["unit"] == "m" else "units"
    parts = {"": data.get("cut_fill"), **data["zones"]}
    for zone, part in ((zone, CutFill.from_json(part)) for zone, part in parts.items() if part):
        volumes = f"gained {part.gained:.2f} ± {part.gained_sigma:.2f}, lost {part.lost:.2f} ± {part.lost_sigma:.2f} {unit}³"
        ground = f"{part.area:,.0f} {unit}² seen on both, {part.unseen:,.0f} not; level of detection {part.level:.3f} {unit}"
        yield f"{zone or 'whole site'}: {volumes}; {ground}"
    for change in data["changes"]:
        place = ", ".join(f"{value:.1f}" for value in change["position"])
        yield f"{change['kind']} at {place}: {change['volume']:.2f} ± {change['volume_sigma']:.2f} {unit}³"
