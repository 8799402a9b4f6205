"""`wbflow pin --refine`: pool what many nights measured from the same poses into results of the reference.

For cameras, depth maps are pooled; for pairs with too few matches in the reference's own night, the matches.  A later night uses
such a pair's pooled result only while its cameras have not moved; else it matches the pair anew (see `reference.resolve`).
"""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Mapping

from ..cache.artifact import bytes_and_facts
from ..cache.layout import WorkFolder
from ..cache.store import Cache, DamagedArtifact, Preimage, Receipt
from ..pipeline.functions import FunctionReader
from ..pipeline.stages import POSES, STAGES, Stage
from ..plugins import load
from ..records.reference_folder import PinnedArtifact, Reference, write_reference
from ..records.run_folder import NoSuchRun, newest_runs
from ..runner.planner import Plan
from ..runner.state import Impossible, Waiting, cached_state
from ..runner.worker import run_chain
from ..site.models import Site
from ..task import Subject, Task, camera_of
from .create import CannotPin

MOST_NIGHTS = 30
"""Largest number of nights to pool; the newest are used."""

FEWEST_NIGHTS = 3


def aggregate_nights(work: WorkFolder, reference: Reference, site: Site) -> dict[Task, int]:
    """Replace results of the reference's own night by results pooled from many nights; returns the number of nights by task.

    The caller holds the lock.  Raises CannotPin if too few nights were compared with the reference; OSError.
    """
    cache = Cache(work)
    nights = _keys_by_night(work, reference)
    pooled: dict[Task, tuple[Receipt, int]] = {}
    reference_plan = _reference_plan(cache, reference, site)
    for stage in (stage for stage in STAGES if stage.reuse.aggregate):
        for subject in _rejected_pairs(cache, reference, stage) if stage.scope == "pair" else [(c,) for c in reference.placed]:
            task = Task(stage.name, subject)
            receipts = _comparable_receipts(cache, reference, stage, task, nights)
            if len(receipts) < FEWEST_NIGHTS or not (receipt := _pool(cache, stage, task, receipts, site.reader)):
                continue
            derived = _derived_results(receipt, stage, reference_plan) if stage.scope == "pair" else []
            if derived is not None:
                pooled |= {result.preimage.task: (result, len(receipts)) for result in (receipt, *derived)}
    if not pooled:
        remedy = "a few more nights, and again: wbflow history SITE.yaml lists them"
        raise CannotPin(
            f"fewer than {FEWEST_NIGHTS} nights have measured the same from the cameras' present places", remedy=remedy
        )
    results = {task: PinnedArtifact(task, receipt.key, receipt.outcome, receipt.digest) for task, (receipt, _) in pooled.items()}
    updated = dataclasses.replace(reference, artifacts={**reference.artifacts, **results})
    all_receipts = [cache.by_key(task, pinned.key) for task, pinned in updated.artifacts.items()]
    write_reference(cache, updated, [receipt for receipt in all_receipts if receipt])
    site.reader.save()
    return {task: count for task, (_, count) in pooled.items()}


def _keys_by_night(work: WorkFolder, reference: Reference) -> dict[str, dict[Task, str]]:
    """Cache keys of the newest run of each night, by date and task, for cameras that had not moved."""
    nights: dict[str, dict[Task, str]] = {}
    for folder, record in newest_runs(work):
        if reference.run not in {folder.id, record.reference} or record.date in nights:
            continue
        unmoved = {camera.id for camera in record.cameras if camera.health is None or camera.health.ok}
        try:
            tasks = folder.tasks()
        except NoSuchRun:  # do without this night
            continue
        keys = {task: event.key for task, event in tasks.items() if event.usable and event.key and task.subject}
        nights[record.date] = {task: key for task, key in keys.items() if set(map(camera_of, task.subject)) <= unmoved}
        if folder.id == reference.run or len(nights) == MOST_NIGHTS:
            break
    return dict(sorted(nights.items()))


def _rejected_pairs(cache: Cache, reference: Reference, stage: Stage) -> list[Subject]:
    """The pairs that the reference's own night rejected with one of the codes `too_little`."""
    names = {stage.name, *(dependent.name for dependent in _dependents(stage))}
    rejected = [pinned for task, pinned in reference.artifacts.items() if pinned.outcome == "rejected" and task.stage in names]
    codes = {pinned.task.subject: receipt.code for pinned in rejected if (receipt := cache.by_key(pinned.task, pinned.key))}
    return [subject for subject, code in codes.items() if code in stage.reuse.too_little]


def _dependents(stage: Stage) -> list[Stage]:
    return [other for other in STAGES if other.scope == "pair" and stage.name in other.needed()]


def _reference_plan(cache: Cache, reference: Reference, site: Site) -> Plan:
    """A plan of the reference's night in which all stored results are committed."""
    plan = Plan(site, {}, reference.date, cache)
    for task, pinned in reference.artifacts.items():
        if receipt := cache.by_key(task, pinned.key):
            plan.commit(task, cached_state(receipt))
    return plan


def _derived_results(aggregated: Receipt, stage: Stage, plan: Plan) -> list[Receipt] | None:
    """Run the pair stages that need a pooled result, with other inputs of the reference's night; None if one yields nothing."""
    pair = aggregated.preimage.task.subject
    plan.commit(aggregated.preimage.task, cached_state(aggregated))
    try:
        ended = [done for other in _dependents(stage) for done in run_chain([plan.spec_of(Task(other.name, pair))], plan.cache)]
    except (Waiting, Impossible):
        return None
    receipts = [done.state.receipt for done in ended if done.state.receipt and done.state.receipt.outcome == "ran"]
    return receipts if len(receipts) == len(ended) else None


def _comparable_receipts(
    cache: Cache, reference: Reference, stage: Stage, task: Task, nights: Mapping[str, Mapping[Task, str]]
) -> dict[str, Receipt]:
    """A task's receipts by night, if they rest on the poses of the reference; a result that nights share counts once."""
    pose_inputs = [n for n, source in stage.inputs.items() if (source.kind, source.name, source.of) == ("stage", POSES, "own")]
    pinned = reference.artifacts.get(task)
    pinned_receipt = cache.by_key(task, pinned.key) if pinned else None
    date_of_key = {keys[task]: date for date, keys in nights.items() if task in keys}
    receipts = {date: cache.by_key(task, key) for key, date in date_of_key.items()}
    return {
        date: receipt
        for date, receipt in receipts.items()
        if receipt
        and pinned_receipt
        and receipt.preimage.function != stage.reuse.aggregate
        and all(receipt.preimage.inputs.get(n) == pinned_receipt.preimage.inputs.get(n) for n in pose_inputs)
    }


def _pool(cache: Cache, stage: Stage, task: Task, receipts: Mapping[str, Receipt], reader: FunctionReader) -> Receipt | None:
    """Pool the results of nights, and store the result in the cache; None if one of them is damaged."""
    function = reader.read(stage.reuse.aggregate)
    first = next(iter(receipts.values()))
    stage_inputs = {name: digest for name, digest in first.preimage.inputs.items() if name in stage.inputs}
    inputs = {**stage_inputs, **{f"night {date}": receipt.digest for date, receipt in receipts.items()}}
    preimage = Preimage(task.stage, task.subject, function.dotted, function.code, first.preimage.parameters, inputs)
    key = preimage.key()
    if existing := cache.by_key(task, key):
        return existing
    try:
        result = load(function.dotted)({date: cache.load(task, receipt) for date, receipt in receipts.items()})
    except DamagedArtifact:
        return None
    data, facts = bytes_and_facts(result, stage.name, key)
    receipt = Receipt(str(task), key, "ran", preimage, **facts, finished=datetime.datetime.now(datetime.UTC).isoformat())
    cache.write(receipt, data)
    return receipt
