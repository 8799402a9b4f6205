"""Comparisons: the figures of two runs from their run.json, what changed between two runs, and a run's cloud with a scan."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from wbflow_stages.contracts.ground_figures import CutFill

from ..cache.atomic import write_atomic
from ..cache.layout import WorkFolder
from ..cache.ply import ply_bytes
from ..errors import UsageError, WbflowError
from ..json_dataclass import read_json
from ..pipeline.meanings import titled
from ..pipeline.stages import CHANGES, DEPTH, FRAMES, POSES, REFINE
from ..pipeline.summaries import RecordedChange, volume_words
from ..plugins import load
from ..records.finished_run import Run
from ..records.record import CameraRecord, PairRecord, RunRecord
from ..records.run_folder import NoSuchRun, RunFolder, newest_runs
from ..task import Task
from .export import MissingExtra

NOISE = 0.05
"""Smaller relative differences are ignored: keypoints, inliers and points vary this much from night to night."""
NOISE_OF_SHARES = 0.03
"""Smaller absolute differences are ignored between figures that are shares, 0 to 1."""
NOISE_OF_TIME = 0.25
"""Smaller relative differences are ignored between times in seconds."""

_WIDTH = 22
"""Width of the columns of both runs, so that a row fits into 80."""

Value = int | float | str | None


@dataclass(frozen=True)
class Row:
    """A figure or text of both runs."""

    what: str
    """Name of the figure, preceded by the name of its camera or pair, if it has one."""
    a: Value
    b: Value
    noise: float = field(default=NOISE, kw_only=True)
    """Figures count as equal up to this difference, as a share of the larger one."""
    technical: bool = field(default=False, kw_only=True)
    """Is it for those who know the stages, rather than what a user sees of a night?"""

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
        a, b = _formatted(self.a), _formatted(self.b)
        if max(len(a), len(b)) > _WIDTH:  # a text: one below the other
            return f"{self.what}\n  {a}\n  {b}"
        return f"{self.what:26} {a:>{_WIDTH}}  {b:{_WIDTH}} {change}".rstrip()

    def to_json(self) -> dict[str, Any]:
        change = None if self.change is None else round(self.change, 4)
        return {"what": self.what, "a": self.a, "b": self.b, "change": change, "differs": self.differs}


def compare(a: RunRecord, b: RunRecord) -> list[Row]:
    """All figures that two runs share: first the night as a whole, then every camera and pair."""
    both = a, b
    rows = [
        Row("run", a.run, b.run),
        Row("night", a.date, b.date),
        Row("verdict", *(record.verdict.level if record.verdict else f"exit {record.exit_code}" for record in both)),
        Row("points", *(record.cloud.points if record.cloud else 0 for record in both)),
        Row("cameras", *(sum(camera.ok for camera in record.cameras) for record in both), noise=0.0),
        Row("pairs of cameras", *(sum(pair.ok for pair in record.pairs) for record in both), noise=0.0),
        *_site_rows(a, b),
        Row("wall seconds", round(a.seconds.wall, 1), round(b.seconds.wall, 1), noise=NOISE_OF_TIME, technical=True),
        Row("CPU seconds", round(a.seconds.cpu, 1), round(b.seconds.cpu, 1), noise=NOISE_OF_TIME, technical=True),
    ]
    for name, count in vars(a.tasks).items():
        rows.append(Row(f"tasks {name}", count, vars(b.tasks)[name], noise=0.0, technical=True))
    for records_a, records_b in ((_by_name(a.cameras), _by_name(b.cameras)), (_by_name(a.pairs), _by_name(b.pairs))):
        for name in dict.fromkeys([*records_a, *records_b]):
            rows += _subject_rows(name, records_a.get(name), records_b.get(name))
    return rows


@dataclass(frozen=True)
class ChangedSince:
    """What changed between two nights, as both saw it since one reference."""

    came: tuple[RecordedChange, ...]
    """Changes that only the later night has."""
    gone: tuple[RecordedChange, ...]
    """Changes that only the earlier night has: all is as in the reference again."""
    grown: tuple[tuple[RecordedChange, RecordedChange], ...]
    """Changes whose volume differs for certain: on the earlier and on the later night."""
    same: tuple[str, ...]
    """Ids of the others."""

    def to_json(self) -> dict[str, Any]:
        return {
            "came": [change.to_json() for change in self.came],
            "gone": [change.to_json() for change in self.gone],
            "grown": [[before.to_json(), after.to_json()] for before, after in self.grown],
            "same": list(self.same),
        }


def changed_since(a: RunRecord, b: RunRecord) -> ChangedSince | None:
    """Return what changed between two nights; None if they have no reference in common."""
    if b.compared is None or b.reference not in {a.reference, a.run} or (a.compared is None and a.run != b.reference):
        return None
    before, after = a.changes, b.changes
    grown: list[tuple[RecordedChange, RecordedChange]] = []
    same: list[str] = []
    for name in before.keys() & after.keys():
        is_apart = after[name].volume_least > before[name].volume_most or after[name].volume_most < before[name].volume_least
        if is_apart:
            grown.append((before[name], after[name]))
        else:
            same.append(name)
    return ChangedSince(
        came=tuple(change for name, change in after.items() if name not in before),
        gone=tuple(change for name, change in before.items() if name not in after),
        grown=tuple(sorted(grown, key=lambda pair: _number_of(pair[0].id))),
        same=tuple(sorted(same, key=_number_of)),
    )


def _number_of(name: str) -> tuple[int, str]:
    """Return what sorts ids: C2 before C17."""
    return len(name), name


def changed_lines(a: RunRecord, b: RunRecord) -> Iterator[str]:
    """Yield what changed between two nights, as lines of text."""
    found = changed_since(a, b)
    if found is None:
        yield "what changed is unknown: both nights have no reference in common"
        return
    if not found.came and not found.gone and not found.grown:
        yield f"nothing changed between {a.date} and {b.date}"
    for change in found.came:
        yield f"{change.id} {change.words(b.unit)}; {change.volume_words(b.unit)}"
    for change in found.gone:
        yield f"{change.id} gone: {change.words(a.unit)}; {change.volume_words(a.unit)}"
    for before, after in found.grown:
        verb = "has grown" if after.volume_least > before.volume_most else "has shrunk"
        yield f"{after.id} {verb}: {before.volume_words(a.unit)}, now {after.volume_words(b.unit)}; {after.words(b.unit)}"
    if found.same:
        yield f"{', '.join(found.same)} as before"


def differing(rows: list[Row]) -> list[Row]:
    """Return the rows that identify the runs, their verdicts, and the rows that differ."""
    return rows[:3] + [row for row in rows[3:] if row.differs]


def last_two(work: WorkFolder) -> tuple[RunFolder, RunFolder]:
    """The newest good run before the newest one, and the newest one.  Raises NoSuchRun if there is none."""
    newest = RunFolder.of(work)
    for folder, record in newest_runs(work, before=newest.id):
        if folder.paths.cloud.is_file() and (record.verdict is None or record.verdict.good):
            return folder, newest
    raise NoSuchRun(f"there is no good run before {newest.id}", remedy="name two: wbflow compare SITE.yaml RUN_A RUN_B")


def _by_name(records: tuple[CameraRecord, ...] | tuple[PairRecord, ...]) -> Mapping[str, CameraRecord | PairRecord]:
    return {record.id if isinstance(record, CameraRecord) else record.name: record for record in records}


def _site_rows(a: RunRecord, b: RunRecord) -> Iterator[Row]:
    for stage in (stage for stage in a.results if stage in b.results):
        results = a.results[stage], b.results[stage]
        for name, values in _common_figures(*results).items():
            yield Row(f"{stage}: {titled(name)}", *values, technical=True)
        for zone in (zone for zone in results[0].volumes if zone in results[1].volumes):
            for what in ("gained", "lost"):
                where = f" in {zone}" if zone else ""
                volumes = (getattr(result.volumes[zone], what) for result in results)
                yield Row(f"{stage}: {what}{where}", *volumes, technical=True)


def _subject_rows(name: str, a: CameraRecord | PairRecord | None, b: CameraRecord | PairRecord | None) -> list[Row]:
    """The outcome of a camera or pair, and its figures if both runs used it."""
    is_pair = isinstance(a or b, PairRecord)
    rows = [Row(name, _outcome(a), _outcome(b), technical=is_pair)]
    if a and b and a.ok and b.ok:
        for figure, values in _common_figures(a.figures, b.figures).items():
            rows.append(Row(f"{name} {figure}", *values, technical=True))
    return rows


def _outcome(record: CameraRecord | PairRecord | None) -> str:
    if record is None:
        return "absent"
    if isinstance(record, CameraRecord) and record.health and not record.health.ok:
        return f"{record.health.state}: {record.health.text}"
    return "ok" if record.ok else f"{record.outcome}: {record.reason}"


def _common_figures(a: object, b: object) -> dict[str, tuple[Value, Value]]:
    """Return the numbers and texts that both summaries have, by name."""
    both = {name: (value, getattr(b, name, None)) for name, value in vars(a).items()}
    return {
        name: values
        for name, values in both.items()
        if all(isinstance(value, int | float | str) and not isinstance(value, bool) for value in values)
    }


def _formatted(value: Value) -> str:
    if isinstance(value, float):
        return f"{value:,.2f}"
    return f"{value:,}" if isinstance(value, int) else str(value)


def compare_with_scan(run: Run, scan: Path, out: Path) -> dict[str, Any]:
    """Write the deviations of a run's cloud from a scan into `out`; return the figures.

    Raises UsageError for a scan that cannot be read, or lies elsewhere, or covers less than half of the cloud; MissingExtra
    if packages that read such files are not installed; WbflowError if the run has no cloud.
    """
    if not scan.is_file():
        raise UsageError(f"{scan}: there is no such file", remedy="wbflow compare SITE.yaml SCAN.laz --out DIR")
    try:
        files, figures = load("wbflow_stages.exports.deviation:scan_files")(run.cloud_table(), run.load(Task(POSES)), scan)
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

    Raises WbflowError if a run placed no cameras, the cache no longer holds its results, the later run did not look for
    changes, or the runs have nothing in common.
    """
    receipt = tonight.receipt(Task(CHANGES))
    if receipt is None:
        raise WbflowError(f"run {tonight.id} did not look for changes", remedy="its log.jsonl says why")
    inputs = _change_inputs(tonight) | {f"reference_{name}": value for name, value in _change_inputs(reference).items()}
    changes = load(receipt.preimage.function)(**inputs, **receipt.preimage.parameters)
    if not changes.compared:
        raise WbflowError(
            f"runs {reference.id} and {tonight.id} have nothing in common", remedy="their cameras are at different places"
        )
    return changes


def _change_inputs(run: Run) -> dict[str, Any]:
    poses = run.load(Task(POSES))
    if poses is None:
        raise WbflowError(f"run {run.id} placed no cameras: {run.record.reason or 'the run was not meant to'}")
    by_camera = {"frames": FRAMES, "depths": DEPTH, "refined": REFINE}
    return {"poses": poses, "cloud": run.cloud_table(), **{name: run.of_cameras(stage) for name, stage in by_camera.items()}}


def data_of(changes: Any) -> dict[str, Any]:
    """Return changes in the form of changes.json."""
    data: dict[str, Any] = load("wbflow_stages.exports.ground:changes_data")(changes)
    return data


def lines_of(data: Mapping[str, Any]) -> Iterator[str]:
    """Yield the volumes and changes of changes.json as lines of text."""
    unit = "m" if data["unit"] == "m" else "units"
    parts = {"": data.get("cut_fill"), **data["zones"]}
    for zone, part in ((zone, read_json(CutFill, part)) for zone, part in parts.items() if part):
        gained = volume_words((part.gained_least, part.gained_most), (part.gained, part.gained_sigma), unit)
        lost = volume_words((part.lost_least, part.lost_most), (part.lost, part.lost_sigma), unit)
        volumes = f"gained {gained}, lost {lost}"
        ground = f"{part.area:,.0f} {unit}² seen on both, {part.unseen:,.0f} not; level of detection {part.level:.3f} {unit}"
        yield f"{zone or 'whole site'}: {volumes}; {ground}"
    for change in data["changes"]:
        place = ", ".join(f"{value:.1f}" for value in change["position"])
        interval = (change["volume_least"], change["volume_most"])
        yield f"{change['kind']} at {place}: {volume_words(interval, (change['volume'], change['volume_sigma']), unit)}"
