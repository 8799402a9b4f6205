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
from ..cache.memo import Digests, EarlierCaptures
from ..cache.receipt import Preimage, Receipt
from ..cache.store import Cache, DamagedArtifact
from ..pipeline.stages import POSES, STAGES, Stage, stage_named
from ..plugins import load
from ..records.reference import Reference
from ..records.run_folder import NoSuchRun, newest_runs
from ..runner.night import Night, NightFiles
from ..runner.plan import Plan
from ..runner.state import Impossible, Waiting, cached_state
from ..runner.worker import run_chain
from ..site.models import Site
from ..task import Task, camera_of
from .create import CannotPin, pinned_artifacts
from .folder import write_reference

MOST_NIGHTS = 30
"""Largest number of nights to pool; the newest are used."""

FEWEST_NIGHTS = 3
"""Smallest number of nights to pool; with fewer, a task keeps the result of the reference's own night."""


def aggregate_nights(work: WorkFolder, reference: Reference, site: Site) -> dict[Task, int]:
    """Replace results of the reference's own night by results pooled from many nights; returns the number of nights by task.

    The caller holds the lock.  Raises CannotPin if too few nights were compared with the reference; OSError.
    """
    cache = Cache(work)
    nights = _keys_by_night(work, reference)
    plan = Plan(_night_of(reference, site, cache))
    # what the reference has is done: pooled results are derived from it
    for task, pinned in reference.artifacts.items():
        receipt = cache.by_key(task, pinned.key)
        if receipt:
            plan.commit(task, cached_state(receipt))

    results: dict[Task, Receipt] = {}
    counts: dict[Task, int] = {}
    for task in _tasks_to_pool(plan, reference):
        receipts = _comparable_receipts(plan, task, nights)
        for receipt in _pooled_and_derived(plan, task, receipts):
            results[receipt.preimage.task] = receipt
            counts[receipt.preimage.task] = len(receipts)
    if not results:
        what = f"fewer than {FEWEST_NIGHTS} nights have measured the same from the cameras' present places"
        raise CannotPin(what, remedy="a few more nights, and again: wbflow history SITE.yaml lists them")

    artifacts = {**reference.artifacts, **pinned_artifacts(results.values())}
    all_receipts = []
    for task, pinned in artifacts.items():
        receipt = cache.by_key(task, pinned.key)
        if receipt:
            all_receipts.append(receipt)
    write_reference(cache, dataclasses.replace(reference, artifacts=artifacts), all_receipts)
    site.bindings.reader.save()
    return counts


def _night_of(reference: Reference, site: Site, cache: Cache) -> Night:
    """The reference's own night, without its captures."""
    files = NightFiles({}, {}, Digests(cache.work.captures_memo), EarlierCaptures(cache.work.delivered_memo))
    return Night(site, datetime.date.fromisoformat(reference.date), site.active_stages(), cache, files)


def _keys_by_night(work: WorkFolder, reference: Reference) -> dict[str, dict[Task, str]]:
    """Cache keys of the newest run of each night, by date and task, for cameras that had not moved."""
    nights: dict[str, dict[Task, str]] = {}
    for folder, record in newest_runs(work):
        if reference.run not in {folder.id, record.reference} or record.date in nights:
            continue
        try:
            tasks = folder.tasks()
        except NoSuchRun:  # do without this night
            continue
        unmoved = {camera.id for camera in record.cameras if camera.health is None or camera.health.ok}
        keys: dict[Task, str] = {}
        for task, event in tasks.items():
            of_unmoved_cameras = all(camera_of(view) in unmoved for view in task.subject)
            if event.usable and event.key and task.subject and of_unmoved_cameras:
                keys[task] = event.key
        nights[record.date] = keys
        if folder.id == reference.run or len(nights) == MOST_NIGHTS:
            break
    return dict(sorted(nights.items()))


def _tasks_to_pool(plan: Plan, reference: Reference) -> list[Task]:
    """The tasks of placed cameras, and of pairs that the reference's own night rejected with one of the codes `too_little`."""
    tasks: dict[Task, None] = {}  # a set that keeps its order
    for stage in STAGES:
        if not stage.reuse.aggregate:
            continue
        if stage.scope == "camera":
            for camera in reference.placed:
                tasks[Task(stage.name, (camera,))] = None
            continue
        # a pair's matches can be too few already in `matches`, or only in a stage that needs them
        names = {stage.name, *_dependents(stage)}
        for task, state in plan.states.items():
            if task.stage in names and state.code in stage.reuse.too_little:
                tasks[Task(stage.name, task.subject)] = None
    return list(tasks)


def _dependents(stage: Stage) -> list[str]:
    """The pair stages that need the results of a stage."""
    return [other.name for other in STAGES if other.scope == "pair" and stage.name in other.needed()]


def _comparable_receipts(plan: Plan, task: Task, nights: Mapping[str, Mapping[Task, str]]) -> dict[str, Receipt]:
    """A task's receipts by night, if they rest on the poses of the reference; a result that nights share counts once."""
    stage = stage_named(task.stage)
    state = plan.states.get(task)
    if state is None or state.receipt is None:
        return {}
    reference_poses = _pose_digests(state.receipt, stage)
    # several nights with the same result have the same key: the last of them stands for all
    date_of_key = {keys[task]: date for date, keys in nights.items() if task in keys}
    comparable = {}
    for key, date in date_of_key.items():
        receipt = plan.night.cache.by_key(task, key)
        if receipt is None or receipt.preimage.function == stage.reuse.aggregate:
            continue
        if _pose_digests(receipt, stage) == reference_poses:
            comparable[date] = receipt
    return comparable


def _pose_digests(receipt: Receipt, stage: Stage) -> list[str | None]:
    """Digests of the inputs of a stage's result that are poses."""
    digests = []
    for name, source in stage.inputs.items():
        if (source.kind, source.name, source.of) == ("stage", POSES, "own"):
            digests.append(receipt.preimage.inputs.get(name))
    return digests


def _pooled_and_derived(plan: Plan, task: Task, receipts: Mapping[str, Receipt]) -> list[Receipt]:
    """Pool a task's results of nights, and run what needs the pooled result; [] if either yields nothing."""
    if len(receipts) < FEWEST_NIGHTS:
        return []
    pooled = _pool(plan, task, receipts)
    if pooled is None:
        return []
    derived = _derived_results(plan, pooled)
    if derived is None:
        return []
    return [pooled, *derived]


def _derived_results(plan: Plan, pooled: Receipt) -> list[Receipt] | None:
    """Run the pair stages that need a pooled result, with other inputs of the reference's night; None if one yields nothing."""
    task = pooled.preimage.task
    derived = []
    plan.commit(task, cached_state(pooled))
    for name in _dependents(stage_named(task.stage)):
        try:
            (done,) = run_chain([plan.spec_of(Task(name, task.subject))], plan.night.cache)
        except (Waiting, Impossible):
            return None
        if done.state.receipt is None or done.state.receipt.outcome != "ran":
            return None
        derived.append(done.state.receipt)
    return derived


def _pool(plan: Plan, task: Task, receipts: Mapping[str, Receipt]) -> Receipt | None:
    """Pool the results of nights, and store the result in the cache; None if one of them is damaged."""
    cache = plan.night.cache
    stage = stage_named(task.stage)
    function = stage.reuse.aggregate

    # the key of the pooled result: inputs and parameters of the first night's, and the digest of every night's result
    first = next(iter(receipts.values())).preimage
    inputs = {name: digest for name, digest in first.inputs.items() if name in stage.inputs}
    for date, receipt in receipts.items():
        inputs[f"night {date}"] = receipt.digest
    code = plan.night.site.bindings.reader.code(function)
    preimage = Preimage(task.stage, task.subject, function, code, first.parameters, inputs)
    key = preimage.key()
    existing = cache.by_key(task, key)
    if existing:
        return existing

    try:
        result = load(function)({date: cache.load(task, receipt) for date, receipt in receipts.items()})
    except DamagedArtifact:
        return None
    data, facts = bytes_and_facts(result, task.stage, key)
    receipt = Receipt(str(task), key, "ran", preimage, **facts, finished=datetime.datetime.now(datetime.UTC).isoformat())
    cache.write(receipt, data)
    return receipt
