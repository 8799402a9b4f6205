"""A night on which nothing has changed since the last whole one: it is published once more, and not planned.

Exactly what a plan would find is known without one: the same tasks, all of them cached, the same products and the same verdict.
The run has its own record, log and figures of time; cloud, maps and report are those of the run before.
"""

from __future__ import annotations

import datetime
import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from itertools import takewhile
from typing import TYPE_CHECKING, Any

from ..graph.installed import installed_code
from ..store.artifact import digest
from ..store.cache import Cache
from ..store.events import TaskEvent, WarningEvent, event_from_json, now
from ..store.findings import STORE_BEHIND
from ..store.layout import WorkFolder
from ..store.record import SAME_AS, Seconds, TaskCounts, stamp
from ..store.reference import BadReference, Reference, read_reference
from ..store.run_folder import UnfinishedRun, log_of, record_of, text_of
from ..store.share import share_product
from ..store.signed import sign
from ..store.unchanged import Unchanged, keep, products_of, recall, show_again, stamps_of
from .artifacts import FinishedRun, LoggedTasks
from .metrics import metrics

if TYPE_CHECKING:
    from ..config.site import Site
    from ..night.arrivals import Arrivals
    from ..night.journal import Costs, Journal
    from ..night.night import Night
    from ..night.plan import Plan

_RUN, _STARTED, _FINISHED, _AT = "<this run>", "<its start>", "<its end>", "<now>"
_WALL, _CPU = -1234567.89, -9876543.21
_SETTLED = {"cached", "ran", "rejected", "skipped"}


@dataclass(frozen=True)
class Basis:
    """All that a night rests on besides files of the work folder, at its beginning."""

    code: str
    """Digest of the stamps of all that may be run."""
    site: str

    @staticmethod
    def of(site: Site) -> Basis:
        """The basis of what a site does now."""
        told = [getattr(site, field.name) for field in fields(site) if field.name not in {"document", "reader", "notify"}]
        told.append(site.file.resolve())
        return Basis(installed_code(), digest(repr(told).encode(errors="surrogateescape")))

    def with_captures(self, date: str, captures: Mapping[str, Any], named: Mapping[str, Any], *said: object) -> str:
        """The same with what has arrived, as one digest."""
        files = [(camera, [(f.name, str(f.path), f.digest, f.fault) for f in found]) for camera, found in captures.items()]
        others = [(name, f.name, f.digest, f.fault) for name, f in named.items()]
        told = [self.code, self.site, date, files, others, [repr(words) for words in said]]
        return digest(json.dumps(told).encode())


def again(there: Arrivals, basis: Basis, run: str, costs: Costs, work: WorkFolder, journal: Journal) -> FinishedRun | None:
    """Publish the last whole night once more; None where anything may have changed since.

    Parameters
    ----------
    there : Arrivals
        What has arrived.
    basis : Basis
        Of the site as it is now.
    run : str
        Id of the new run.
    costs : Costs
        What it has cost so far.
    work : WorkFolder
        The caller holds its lock.
    journal : Journal
        Is told again of what that night was warned of.

    Raises
    ------
    OSError
        The disk is full, or there is no right to write.
    """
    night = recall(work, basis.with_captures(str(there.date), there.captures, there.named, there.stale, there.notes))
    if night is None or night.run != next(iter(work.newest_runs()), None) or not night.holds(work):
        return None
    unfinished, before = UnfinishedRun(work, run), work.run(night.run).folder
    if not all(share_product(unfinished.paths.folder / name, before / name) for name in night.products):
        return None
    seconds, end = costs.seconds(own_process=True), _now()
    text = night.record
    for token, value in ((_RUN, run), (_STARTED, stamp(costs.started)), (_FINISHED, stamp(end))):
        text = text.replace(token, value, 1)
    for number, spent in ((_WALL, seconds.wall), (_CPU, seconds.cpu)):
        text = text.replace(str(number), str(round(spent, 2)), 1)
    data = sign(text.encode())
    record = record_of(data)
    log = night.log.replace(_AT, now())
    folder = unfinished.tell(log.encode(), data, metrics(record), record.verdict)
    _warn_again(log, journal)
    show_again(work, run)
    there.digests.save()
    there.seen.save()
    return FinishedRun(work, folder, record, LoggedTasks(folder), Cache(work))


def _warn_again(log: str, journal: Journal) -> None:
    """Tell of the warnings that stand at the head of a log, but for those that have been told."""
    said = {event.what for event in journal.standing}
    for line in takewhile(lambda line: line.startswith('{"event": "warning"'), log.splitlines()):
        warning = event_from_json(json.loads(line))
        if isinstance(warning, WarningEvent) and warning.what not in said:
            journal.warn(warning.what, task=warning.task, remedy=warning.remedy, standing=True)


def remember(finished: FinishedRun, night: Night, basis: Basis, journal: Journal) -> None:
    """Remember a whole night on which nothing went wrong, for the next one.  The caller holds the lock.

    Parameters
    ----------
    finished : FinishedRun
        What came of it.
    night : Night
        Its plan is settled.
    basis : Basis
        What it rested on at its beginning.
    journal : Journal
        All that happened.

    Raises
    ------
    OSError
        The disk is full, or there is no right to write.
    """
    plan, record, work = night.plan, finished.record, finished.work
    tasks = [event for event in journal.events if isinstance(event, TaskEvent)]
    warned = len(tasks) + len(journal.standing) < len(journal.events)
    open_ends = plan.ready or plan.waiting or plan.busy or plan.undrawn or warned
    behind = record.verdict and any(finding.kind == STORE_BEHIND for finding in record.verdict.findings)
    if open_ends or record.cloud is None or record.repaired or behind or any(event.outcome not in _SETTLED for event in tasks):
        return
    if not night.site.reader.as_read():
        return
    try:
        reference = read_reference(work)
    except BadReference:
        return
    files = [*_of_tasks(plan), *_of_reference(plan, reference), *night.site.reader.files()]
    stamps, newest = stamps_of(files)
    if not plan.cache.untouched():
        return
    cached = [_cached(event) for event in tasks]
    counts = TaskCounts(**Counter[str](event.outcome for event in cached))
    used = reference.run if reference and night.site.pin != "none" else None
    told = replace(record, run=_RUN, started=_STARTED, finished=_FINISHED, seconds=Seconds(_WALL, _CPU), peak_rss_mb=0)
    told = replace(told, tasks=counts, reference=used, later={**record.later, SAME_AS: record.run})
    rests_on = basis.with_captures(plan.night, night.captures, plan.named, plan.stale, night.notes)
    products = products_of(work, record.run, [*record.files, finished.folder.paths.report.name])
    warnings = [replace(event, at=_AT) for event in journal.standing]
    texts = log_of([*warnings, *cached]).decode(), text_of(told)
    keep(work, Unchanged(record.run, rests_on, stamps, products, tuple(files), *texts), newest)


def _cached(event: TaskEvent) -> TaskEvent:
    """How a task ends that is found in the cache."""
    outcome = "cached" if event.outcome == "ran" else event.outcome
    return replace(event, outcome=outcome, at=_AT, fresh=False, cpu=None, trace=None)


def _of_tasks(plan: Plan) -> Iterator[str]:
    """The files of all tasks of a night."""
    from ..graph.pipeline import STAGES  # here: a night on which nothing has changed has no use for the table

    drawn = {stage.name for stage in STAGES if stage.picture}
    for task, state in plan.states.items():
        if (receipt := state.receipt) is None:
            continue
        if not task.subject:  # few, and with all that is published of them
            yield from map(str, plan.cache.work.of_key(task, receipt.key))
            continue
        name = plan.cache.work.receipt_name(task, receipt.key)
        yield name
        if receipt.file:
            yield f"{name[: name.rindex('/')]}/{receipt.file}"
            if task.stage in drawn:
                yield plan.cache.work.drawing_name(task, receipt.key)
                yield plan.cache.work.picture_name(task, receipt.key)


def _of_reference(plan: Plan, reference: Reference | None) -> Iterator[str]:
    """The files of the reference; that there is none, too."""
    work = plan.cache.work
    yield from (str(work.reference_record), str(work.reference_twin))
    for task, pinned in reference.artifacts.items() if reference else ():
        state = plan.states.get(task)
        yield from plan.cache.copies(task, pinned.key, state.receipt if state else None)


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.UTC)
