"""Pinning: makes a run the reference that later nights are compared with."""

from __future__ import annotations

from collections.abc import Iterable

from ..cache.layout import WorkFolder
from ..cache.receipt import Receipt
from ..cache.store import Cache
from ..errors import ExitCode, WbflowError
from ..pipeline.stages import STAGES
from ..records.record import RunRecord
from ..records.reference import PinnedArtifact, Reference
from ..records.run_folder import RunFolder, newest_runs
from ..task import Task
from .folder import write_reference


class CannotPin(WbflowError, ValueError):
    """A run cannot become the reference."""

    exit_code = ExitCode.USAGE


def pin(cache: Cache, run: RunFolder, automatic: bool = False) -> Reference:
    """Make a run the reference of its work folder.  The caller holds the lock.  automatic: without a request by the user.

    Raises CannotPin if the run has made no cloud, or the cache no longer holds its results; OSError.
    """
    record = run.record()
    if record.cloud is None:
        reason = record.reason or "the run was not meant to"
        raise CannotPin(f"run {run.id} made no cloud: {reason}", remedy="pin a run that did: wbflow history SITE.yaml")
    stored_stages = {stage.name for stage in STAGES if stage.reuse.stored}
    receipts = []
    # all or nothing: a reference that lacks some results would make later nights differ
    for task, event in run.tasks().items():
        if task.stage not in stored_stages or event.key is None:
            continue
        receipt = cache.by_key(task, event.key)
        if receipt is None:
            remedy = f"run its night again (wbflow run SITE.yaml --date {record.date}), and pin that run"
            raise CannotPin(f"the cache no longer holds '{task}' of run {run.id}", remedy=remedy)
        receipts.append(receipt)
    solved = run.cameras()
    # unsolved cameras are part of it, too: the site of a later night is compared with all of them
    cameras = {camera.id: dict(solved.get(camera.id, {})) for camera in record.cameras}
    reference = Reference(run.id, record.date, cameras, pinned_artifacts(receipts), automatic)
    write_reference(cache, reference, receipts)
    return reference


def pinned_artifacts(receipts: Iterable[Receipt]) -> dict[Task, PinnedArtifact]:
    """The entries of the reference for results, by task."""
    pinned = [PinnedArtifact(r.preimage.task, r.key, r.outcome, r.digest) for r in receipts]
    return {artifact.task: artifact for artifact in pinned}


def good_run(work: WorkFolder, name: str | None = None) -> RunFolder:
    """The run to pin: the named one, else the newest good one.  Raises CannotPin, NoSuchRun."""
    if name is not None:
        return RunFolder.of(work, name)
    for folder, record in newest_runs(work):
        if fit_to_pin(record):
            return folder
    remedy = "name one that is good enough: wbflow pin SITE.yaml RUN; wbflow history SITE.yaml lists them"
    raise CannotPin(f"{work.root} has no good run yet", remedy=remedy)


def fit_to_pin(record: RunRecord) -> bool:
    """Is a run good enough to be pinned without being named?"""
    # a night is good, too, if what was wrong has been acknowledged; but later nights should not be compared with that
    acknowledged = record.verdict.acknowledged if record.verdict else ()
    return record.exit_code == ExitCode.GOOD and record.cloud is not None and not acknowledged
