"""How a site is, at a glance: its last night, its cameras, what has changed, the disk, and its next run."""

from __future__ import annotations

from dataclasses import dataclass

from ..cache.atomic import free_bytes
from ..cache.layout import WorkFolder
from ..cache.lock import holder_of
from ..records.changes import change_words, open_changes
from ..records.killed_runs import KilledRun, killed_runs
from ..records.record import CameraRecord, RunRecord
from ..records.run_folder import NoSuchRun, RunFolder
from ..runner.disk import night_bytes
from ..runner.night import Night
from ..words import DISK_FULL_REMEDY, format_size
from .schedule import next_run


@dataclass(frozen=True)
class Overview:
    """The state of a site, in five lines."""

    level: str
    """Level of the last night's verdict; "" if no night has one."""
    night: str
    """The last night, its verdict, and the first finding."""
    cameras: str
    """How many cameras were in use, and since when the others are not."""
    changes: str
    """The changes that nobody has acknowledged."""
    disk: str
    """Free space, and how much a night takes."""
    next_run: str
    """When the next run begins, or what there is to do."""


def overview(night: Night) -> Overview:
    """Return the state of the site whose next night this is."""
    site = night.site
    work = night.cache.work
    try:
        record = RunFolder.of(work).record()
    except NoSuchRun:
        record = None
    level = ""
    words = "none has been worked on yet"
    if record:
        words = record.date
        if record.verdict:
            level = record.verdict.level
            words += f" {level}"
            if record.verdict.findings:
                words += f": {record.verdict.findings[0]}"
    return Overview(
        level=level,
        night=words,
        cameras=_cameras(record) if record else _captures(night),
        changes=_changes(record),
        disk=_disk(night),
        next_run=_what_is_next(work, next_run(site)),
    )


def _captures(night: Night) -> str:
    """Return how many cameras have captures of the night, for a site that has never run."""
    with_captures = sum(bool(files) for files in night.files.captures.values())
    return f"{with_captures} of {len(night.site.cameras)} have captures of {night.date}"


def _cameras(record: RunRecord) -> str:
    """Return how many cameras were in use on the last night, and which were not."""
    left_out = [camera for camera in record.cameras if not camera.ok]
    used = len(record.cameras) - len(left_out)
    words = f"{used} of {len(record.cameras)} in use"
    if left_out:
        words += f"; left out: {', '.join(map(_since, left_out))}"
    return words


def _since(camera: CameraRecord) -> str:
    """Return the id of a camera that is left out and, if that has lasted, since when."""
    if camera.down is None or camera.down.nights == 1:
        return camera.id
    return f"{camera.id} ({camera.down.words()})"


def _changes(record: RunRecord | None) -> str:
    """Return how many changes nobody has acknowledged, and which."""
    if record is None or record.compared is None:
        return "not known: the last night was not compared with a reference"
    unacknowledged = open_changes(record)
    if unacknowledged:
        return f"{len(unacknowledged)} that nobody has acknowledged: {change_words(record)}"
    return f"{len(record.changes)}, all acknowledged" if record.changes else "none"


def _disk(night: Night) -> str:
    free = free_bytes(night.cache.work.root)
    needed = night_bytes(night)
    words = f"{format_size(free)} free; a night takes about {format_size(needed)}"
    if free < needed:
        words += f": {DISK_FULL_REMEDY}"
    return words


def _what_is_next(work: WorkFolder, planned: str) -> str:
    """Return what happens next.  planned: when the next run begins, if that is known."""
    holder = holder_of(work.lock)
    if holder:
        return f"at work now: {holder}"
    killed = _killed_last(work)
    if killed:
        words = f"wbflow run SITE.yaml  continues the last one, {killed.words}"
        return f"{words}; then {planned}" if planned else words
    return planned or "not planned: wbflow init SITE.yaml --systemd  writes a timer; or add a line with crontab -e"


def _killed_last(work: WorkFolder) -> KilledRun | None:
    """Return the last run if it was killed."""
    killed = killed_runs(work)
    published = work.run_ids()
    if not killed or (published and killed[-1].run < published[-1]):
        return None
    return killed[-1]
