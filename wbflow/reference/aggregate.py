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
    nights = _nights(work, reference)
    made: dict[Task, tuple[Receipt, int]] = {}
    then = _reference_s_night(cache, reference, site)
    for stage in (stage for stage in STAGES if stage.reuse.aggregate):
        for subject in _poor(cache, reference, stage) if stage.scope == "pair" else [(camera,) for camera in reference.placed]:
            task = Task(stage.name, subject)
            receipts = _alike(cache, reference, stage, task, nights)
            if len(receipts) < FEWEST_NIGHTS or not (receipt := _aggregate(cache, stage, task, receipts, site.reader)):
                continue
            more = _made_of(receipt, stage, then) if stage.scope == "pair" else []
            if more is not None:
                made |= {one.preimage.task: (one, len(receipts)) for one in (receipt, *more)}
    if not made:
        remedy = "a few more nights, and again: wbflow history SITE.yaml lists them"
        raise CannotPin(
            f"fewer than {FEWEST_NIGHTS} nights have measured the same from the cameras' present places", remedy=remedy
        )
    new = {task: PinnedArtifact(task, receipt.key, receipt.outcome, receipt.digest) for task, (receipt, _) in made.items()}
    better = dataclasses.replace(reference, artifacts={**reference.artifacts, **new})
    kept = [cache.by_key(task, pinned.key) for task, pinned in better.artifacts.items()]
    write_reference(cache, better, [receipt for receipt in kept if receipt])
    site.reader.save()
    return {task: count for task, (_, count) in made.items()}


def _nights(work: WorkFolder, reference: Reference) -> dict[str, dict[Task, str]]:
    """Cache keys of the newest run of each night, by date and task, for cameras that had not moved."""
    found: dict[str, dict[Task, str]] = {}
    for folder, record in newest_runs(work):
        if reference.run not in {folder.id, record.reference} or record.date in found:
            continue
        still = {camera.id for camera in record.cameras if camera.health is None or camera.health.ok}
        try:
            tasks = folder.tasks()
        except NoSuchRun:  # do without this night
            continue
        used = {task: event.key for task, event in tasks.items() if event.usable and event.key and task.subject}
        found[record.date] = {task: key for task, key in used.items() if set(map(camera_of, task.subject)) <= still}
        if folder.id == reference.run or len(found) == MOST_NIGHTS:
            break
    return dict(sorted(found.items()))


def _poor(cache: Cache, reference: Reference, stage: Stage) -> list[Subject]:
    """The pairs that the reference's own night rejected with one of the codes `too_little`."""
    of_pairs = {stage.name, *(other.name for other in _resting_on(stage))}
    rejected = [pinned for task, pinned in reference.artifacts.items() if pinned.outcome == "rejected" and task.stage in of_pairs]
    codes = {pinned.task.subject: receipt.code for pinned in rejected if (receipt := cache.by_key(pinned.task, pinned.key))}
    return [subject for subject, code in codes.items() if code in stage.reuse.too_little]


def _resting_on(stage: Stage) -> list[Stage]:
    return [other for other in STAGES if other.scope == "pair" and stage.name in other.needed()]


def _reference_s_night(cache: Cache, reference: Reference, site: Site) -> Plan:
    """A plan of the reference's night in which all stored results are committed."""
    plan = Plan(site, {}, reference.date, cache)
    for task, pinned in reference.artifacts.items():
        if receipt := cache.by_key(task, pinned.key):
            plan.commit(task, cached_state(receipt))
    return plan


def _made_of(aggregated: Receipt, stage: Stage, then: Plan) -> list[Receipt] | None:
    """Run the pair stages that need a pooled result, with other inputs of the reference's night; None if one yields nothing."""
    pair = aggregated.preimage.task.subject
    then.commit(aggregated.preimage.task, cached_state(aggregated))
    try:
        done = [done for other in _resting_on(stage) for done in run_chain([then.spec_of(Task(other.name, pair))], then.cache)]
    except (Waiting, Impossible):
        return None
    made = [one.state.receipt for one in done if one.state.receipt and one.state.receipt.outcome == "ran"]
    return made if len(made) == len(done) else None


def _alike(
    cache: Cache, reference: Reference, stage: Stage, task: Task, nights: Mapping[str, Mapping[Task, str]]
) -> dict[str, Receipt]:
    """A task's receipts by night, if they rest on the poses of the reference; a result that nights share counts once."""
    same = [n for n, source in stage.inputs.items() if (source.kind, source.name, source.of) == ("stage", POSES, "own")]
    pinned = reference.artifacts.get(task)
    base = cache.by_key(task, pinned.key) if pinned else None
    own = {keys[task]: date for date, keys in nights.items() if task in keys}
    found = {date: cache.by_key(task, key) for key, date in own.items()}
    return {
        date: receipt
        for date, receipt in found.items()
        if receipt
        and base
        and receipt.preimage.function != stage.reuse.aggregate
        and all(receipt.preimage.inputs.get(n) == base.preimage.inputs.get(n) for n in same)
    }


def _aggregate(cache: Cache, stage: Stage, task: Task, receipts: Mapping[str, Receipt], reader: FunctionReader) -> Receipt | None:
    """Pool the results of nights, and store the result in the cache; None if one of them is damaged."""
    function = reader.read(stage.reuse.aggregate)
    any_one = next(iter(receipts.values()))
    own = {name: digest for name, digest in any_one.preimage.inputs.items() if name in stage.inputs}
    inputs = {**own, **{f"night {date}": receipt.digest for date, receipt in receipts.items()}}
    preimage = Preimage(task.stage, task.subject, function.dotted, function.code, any_one.preimage.parameters, inputs)
    key = preimage.key()
    if known := cache.by_key(task, key):
        return known
    try:
        result = load(function.dotted)({date: cache.load(task, receipt) for date, receipt in receipts.items()})
    except DamagedArtifact:
        return None
    data, facts = bytes_and_facts(result, stage.name, key)
    receipt = Receipt(str(task), key, "ran", preimage, **facts, finished=datetime.datetime.now(datetime.UTC).isoformat())
    cache.write(receipt, data)
    return receipt
