"""Pooling: what many nights have measured from the same poses becomes the surface of the reference."""

from __future__ import annotations

import dataclasses
import datetime
import importlib
from collections.abc import Mapping
from typing import Any

from ..graph.functions import FunctionReader
from ..graph.pipeline import STAGES, stage_with
from ..graph.rows import FromStage, Role, Stage, Which
from ..store import artifact
from ..store.cache import Cache, DamagedArtifact, Preimage, Receipt
from ..store.events import TaskEvent
from ..store.layout import WorkFolder
from ..store.reference import PinnedArtifact, Reference, write_reference
from ..store.run_folder import NoSuchRun, RunFolder
from ..task import Task, camera_of
from .pin import CannotPin

MOST_NIGHTS = 30
"""So many nights are pooled at most, the newest."""
FEWEST_NIGHTS = 3


def pool(work: WorkFolder, reference: Reference, reader: FunctionReader) -> dict[Task, int]:
    """Put what all its nights have measured in the place of what the reference's own night has; returns how many, by task.

    The caller holds the lock.

    Parameters
    ----------
    work : WorkFolder
        Whose reference.
    reference : Reference
        To be improved.
    reader : FunctionReader
        Knows the functions that pool.

    Raises
    ------
    CannotPin
        Too few nights were compared with the reference.
    OSError
        The disk is full, or there is no right to write.
    """
    cache = Cache(work)
    nights = _nights(work, reference)
    made: dict[Task, tuple[Receipt, int]] = {}
    for stage in STAGES:
        for camera in reference.placed if stage.pooled and stage.scope == "camera" else ():
            task = Task(stage.name, (camera,))
            receipts = _alike(cache, reference, stage, task, nights)
            if len(receipts) >= FEWEST_NIGHTS and (receipt := _pooled(cache, stage, task, receipts, reader)):
                made[task] = receipt, len(receipts)
    if not made:
        remedy = "a few more nights, and again: wbflow history SITE.yaml lists them"
        raise CannotPin(f"fewer than {FEWEST_NIGHTS} nights have measured the same from where the cameras stand", remedy=remedy)
    new = {task: PinnedArtifact(task, receipt.key, receipt.outcome, receipt.digest) for task, (receipt, _) in made.items()}
    better = dataclasses.replace(reference, artifacts={**reference.artifacts, **new})
    kept = [cache.by_key(task, pinned.key) for task, pinned in better.artifacts.items()]
    write_reference(cache, better, [receipt for receipt in kept if receipt])
    reader.save()
    return {task: count for task, (_, count) in made.items()}


def _nights(work: WorkFolder, reference: Reference) -> dict[str, dict[Task, str]]:
    """Keys of what the newest run of each night made of cameras that stood where they did, by date and task."""
    found: dict[str, dict[Task, str]] = {}
    for run in work.run_ids():
        try:
            folder = RunFolder.of(work, run)
            record = folder.record()
            if reference.run not in {run, record.reference}:
                continue
            still = {camera.id for camera in record.cameras if camera.health is None or camera.health.ok}
            events = folder.events()
        except NoSuchRun:  # one night less
            continue
        of_cameras = [event for event in events if isinstance(event, TaskEvent) and len(event.task.subject) == 1]
        made = [event for event in of_cameras if event.usable and camera_of(event.task.subject[0]) in still]
        found[record.date] = {event.task: event.key for event in made if event.key}
    return dict(sorted(found.items())[-MOST_NIGHTS:])


def _alike(
    cache: Cache, reference: Reference, stage: Stage, task: Task, nights: Mapping[str, Mapping[Task, str]]
) -> dict[str, Receipt]:
    """A task's receipts by night, as far as they go back to the pose of the reference."""
    world = stage_with(Role.WORLD).name
    same = [
        n for n, need in stage.needs.items() if isinstance(need, FromStage) and (need.stage, need.which) == (world, Which.SAME)
    ]
    pinned = reference.artifacts.get(task)
    base = cache.by_key(task, pinned.key) if pinned else None
    found = {date: cache.by_key(task, keys[task]) for date, keys in nights.items() if task in keys}
    return {
        date: receipt
        for date, receipt in found.items()
        if receipt and base and all(receipt.preimage.inputs.get(n) == base.preimage.inputs.get(n) for n in same)
    }


def _pooled(cache: Cache, stage: Stage, task: Task, receipts: Mapping[str, Receipt], reader: FunctionReader) -> Receipt | None:
    """The pooled result, kept in the cache; None where a night's is damaged."""
    function = reader.read(stage.pooled)
    any_one = next(iter(receipts.values()))
    own = {name: digest for name, digest in any_one.preimage.inputs.items() if name in stage.needs}
    inputs = {**own, **{f"night {date}": receipt.digest for date, receipt in receipts.items()}}
    preimage = Preimage(task.stage, task.subject, function.dotted, function.code, {}, inputs)
    key = preimage.key()
    if known := cache.by_key(task, key):
        return known
    try:
        result = _function(function.dotted)({date: cache.load(task, receipt) for date, receipt in receipts.items()})
    except DamagedArtifact:
        return None
    data = artifact.encode(result)
    now = datetime.datetime.now(datetime.UTC).isoformat()
    facts: dict[str, Any] = {"parts": artifact.parts(result), "figures": artifact.figures(result), "finished": now}
    file, digest = f"{key}{stage.suffix}", artifact.digest(data)
    receipt = Receipt(str(task), key, "ran", preimage, digest, file=file, bytes=len(data), **facts)
    cache.write(receipt, data)
    return receipt


def _function(dotted: str) -> Any:
    module, _, name = dotted.partition(":")
    return getattr(importlib.import_module(module), name)
