"""What happens inside a worker process: a lane of tasks is done one after the other, each from its inputs to its receipt."""

from __future__ import annotations

import dataclasses
import datetime
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..cache import artifact
from ..cache.atomic import Prepared
from ..cache.codec import result_bytes, result_of
from ..cache.digests import ChangedFile
from ..cache.pictures import Drawing, write_drawing
from ..cache.plugins import load, offer
from ..cache.room import FULL, REMEDY
from ..cache.shown import Shown
from ..cache.store import Cache, Damage, DamagedArtifact, Preimage, Receipt
from ..cache.untrusted import read_outside
from ..errors import LONGEST_TRACE, printable
from ..pipeline.stages import REJECTED, stage_named
from ..task import Task
from . import machine
from .spec import Absent, Files, Input, Joined, Stored, TaskSpec, Value
from .state import Cause


@dataclass(frozen=True)
class Done:
    """How a task ended in a worker."""

    task: Task
    outcome: str
    """ran, cached (someone had done it), rejected, failed, damaged: an input's bytes were wrong, or changed: a file from outside
    is another one than when the task was planned."""
    receipt: Receipt | None = None
    reason: str | None = None
    code: str | None = None
    """The reason as one word."""
    trace: str | None = None
    damaged: Task | None = None
    """What has to be made again before this."""
    changed: Path | None = None
    """The file that has changed."""
    warnings: tuple[str, ...] = ()
    """What went wrong without costing the result, in words."""
    damages: tuple[Damage, ...] = ()
    """What was found damaged on the way."""


@dataclass
class Kept:
    """What a worker keeps from lane to lane: artifacts of the whole site of which lanes need parts, read and checked once."""

    opened: dict[str, artifact.Opened] = field(default_factory=dict)
    """By digest, the one that was asked for last at the end."""

    def of(self, digest: str, read: Callable[[], bytes]) -> artifact.Opened:
        """An artifact; `read` gives its bytes."""
        found = self.opened.pop(digest, None) or artifact.Opened(read())
        self.opened[digest] = found
        while len(self.opened) > MOST_KEPT:
            del self.opened[next(iter(self.opened))]
        return found


QUICK_SECONDS = 0.25
"""By the clock: results of tasks that take no longer are made to last once for the lane, not each."""
MOST_KEPT = 4
"""So many artifacts of the whole site are kept from lane to lane."""


@dataclass
class Unsettled:
    """Results that are written, and whose receipts are not in their places yet: they are made to last all at once."""

    cache: Cache
    receipts: dict[Task, Prepared] = field(default_factory=dict)

    def settle(self) -> list[Done]:
        """Put all receipts into their places.  What cannot be kept is not there, and has to be made again."""
        tasks, receipts = list(self.receipts), list(self.receipts.values())
        self.receipts = {}
        try:
            if receipts:
                self.cache.settle(receipts)
        except OSError as error:
            return [unkept(task, error) for task in tasks]
        return []

    def drop(self) -> None:
        """They are not wanted any more."""
        for prepared in self.receipts.values():
            prepared.drop()


@dataclass
class _Lane:
    """Results of the lane so far and what its tasks have read: nothing is read, or read back, twice."""

    cache: Cache
    kept: Kept
    unsettled: Unsettled
    receipts: dict[Task, Receipt] = field(default_factory=dict)
    results: dict[str, Any] = field(default_factory=dict)
    """By the digest of the artifact: a task's result of tonight and the reference's may both be needed."""
    clock: Callable[[], float] = time.process_time
    """CPU seconds."""

    def keep(self, receipt: Receipt, data: bytes | bytearray | None) -> None:
        """Keep a result: what took its time at once, what was quick with the rest of what was."""
        if receipt.wall > QUICK_SECONDS:
            self.cache.write(receipt, data)
        else:
            self.unsettled.receipts[receipt.preimage.task] = self.cache.prepare(receipt, data)


def do_lane(
    specs: list[TaskSpec],
    cache: Cache,
    receipts: Mapping[Task, Receipt],
    kept: Kept,
    unsettled: Unsettled,
    clock: Callable[[], float] = time.process_time,
) -> Iterator[Done]:
    """Do the tasks of a lane in order, until one leaves nothing that the next could use.  Never raises for a task's sake.

    What was quick is done when the caller has settled it.

    Parameters
    ----------
    specs : list of TaskSpec
        The lane.
    cache : Cache
        Where results go.
    receipts : mapping of Task to Receipt
        Of earlier tasks of the lane, where it goes on after a worker was lost.
    kept : Kept
        What the worker keeps from lane to lane.
    unsettled : Unsettled
        Takes the results that were quick.
    clock : callable
        CPU seconds: of the process, or of the thread where others work beside it.
    """
    offer(specs[0].folder)
    lane = _Lane(cache, kept, unsettled, dict(receipts), clock=clock)
    for spec in specs:
        done = _attempt(spec, lane)
        if damages := cache.damages():
            done = dataclasses.replace(done, damages=tuple(damages))
        yield done
        if done.receipt is None or done.outcome == "rejected":
            return
        lane.receipts[spec.task] = done.receipt


def unkept(task: Task, error: OSError) -> Done:
    """A result whose receipt could not be kept: it is not there."""
    why = f"the result of '{task}' could not be kept: {error.strerror or error}"
    return Done(task, "damaged", reason=printable(why), damaged=task)


def run_lane(specs: list[TaskSpec], cache: Cache) -> list[Done]:
    """The same, all at once, in one of several threads."""
    unsettled = Unsettled(cache)
    done = list(do_lane(specs, cache, {}, Kept(), unsettled, time.thread_time))
    return done + unsettled.settle()


def arguments_of(spec: TaskSpec, cache: Cache) -> dict[str, Any]:
    """What a task's function is handed, besides its parameters.  Raises DamagedArtifact, ChangedFile, OSError."""
    lane = _Lane(cache, Kept(), Unsettled(cache))
    return {name: _load(value, lane) for name, value in spec.inputs.items()}


def _attempt(spec: TaskSpec, lane: _Lane) -> Done:
    """The one broad `except`: whatever a stage does wrong costs that task only."""
    try:
        if spec.redraw:
            return _redraw(spec, spec.redraw, lane)
        inputs = {name: _resolve(value, lane) for name, value in spec.inputs.items()}
        resolved = spec if inputs == spec.inputs else dataclasses.replace(spec, inputs=inputs)
        preimage = resolved.preimage()
        key = preimage.key()
        if not spec.force and (receipt := lane.cache.find(preimage, key)):
            outcome = "rejected" if receipt.outcome == "rejected" else "cached"
            return Done(spec.task, outcome, receipt, receipt.reason, receipt.code)
        return _do(resolved, preimage, key, lane)
    except DamagedArtifact as damage:
        return Done(spec.task, "damaged", reason=damage.what, damaged=damage.task)
    except ChangedFile as change:
        return Done(spec.task, "changed", reason=change.what, changed=change.path)
    except MemoryError:
        why = "ran out of memory: lower `resolution`, or run with fewer --jobs"
        return Done(spec.task, "failed", reason=why, code=Cause.OUT_OF_MEMORY)
    except SystemExit as error:
        why = f"its function ended the program (sys.exit({error.code!r}))"
        return Done(spec.task, "failed", reason=printable(why), code=Cause.FAULT, trace=_trace())
    except Exception as error:
        words = printable(error) or type(error).__name__
        foreseen = isinstance(error, ValueError | OSError)
        why, code = (words, Cause.BAD_INPUT) if foreseen else (f"{type(error).__name__}: {words}", Cause.FAULT)
        if isinstance(error, OSError) and error.errno in FULL:
            return Done(spec.task, "failed", reason=f"{error.strerror}; {REMEDY}", code=Cause.DISK_FULL)
        return Done(spec.task, "failed", reason=why, code=code, trace=_trace())


def _trace() -> str:
    return printable(traceback.format_exc(), LONGEST_TRACE)


def _do(spec: TaskSpec, preimage: Preimage, key: str, lane: _Lane) -> Done:
    machine.count_from_here()
    wall, cpu = time.perf_counter(), lane.clock()
    arguments = {name: _load(value, lane) for name, value in spec.inputs.items()}
    result = load(spec.function)(**arguments, **spec.parameters)
    nothing: Any = load(REJECTED)
    rejected = isinstance(result, nothing)
    data = None if rejected else result_bytes(result, spec.table)
    warnings = () if rejected else _draw(spec, key, result, lane, arguments)
    if not rejected:
        _show(spec, key, result, lane)
    receipt = Receipt(
        task=str(spec.task),
        key=key,
        outcome="rejected" if rejected else "ran",
        preimage=preimage,
        digest="" if data is None else artifact.digest(data),
        parts={} if data is None else artifact.parts(result),
        file=None if data is None else f"{key}{spec.suffix}",
        bytes=len(data or b""),
        reason=printable(result.reason) if rejected else None,
        code=_code(result) if rejected else None,
        figures=dict(result.figures) if rejected else _figures(spec, result),
        wall=time.perf_counter() - wall,
        cpu=lane.clock() - cpu,
        peak_rss_mb=machine.most_held() / 2**20,
        finished=datetime.datetime.now(datetime.UTC).isoformat(),
    )
    lane.keep(receipt, data)
    lane.results[receipt.digest] = result
    return Done(spec.task, receipt.outcome, receipt, receipt.reason, receipt.code, warnings=warnings)


def _code(rejection: Any) -> str | None:
    """The reason as one word, where a function gives one."""
    code = getattr(rejection, "code", None)
    return None if code is None else str(code)


def _figures(spec: TaskSpec, result: Any) -> dict[str, Any]:
    found = artifact.figures(result)
    return found | load(spec.table.figures)(result) if spec.table else found


def _redraw(spec: TaskSpec, receipt: Receipt, lane: _Lane) -> Done:
    """Draw the picture of a result that is in the cache."""
    data = lane.cache.read(spec.task, lane.cache.path(receipt), receipt.digest)
    result = result_of(data, spec.table)
    warnings = _draw(spec, receipt.key, result, lane, {})
    return Done(spec.task, "cached", receipt, receipt.reason, warnings=warnings)


def _draw(spec: TaskSpec, key: str, result: Any, lane: _Lane, loaded: Mapping[str, Any]) -> tuple[str, ...]:
    """Draw a result and keep the picture; returns what went wrong, in words: without its picture the task has succeeded all the
    same.

    loaded: the task's inputs, as far as they are in memory.
    """
    if spec.picture is None:
        return ()
    inputs = {name: _resolve(value, lane) for name, value in spec.picture.inputs.items()}
    digest = dataclasses.replace(spec.picture, inputs=inputs).digest(key)
    try:
        own = {name for name in loaded if spec.inputs.get(name) == inputs.get(name)}
        asked = {name: loaded[name] if name in own else _load(value, lane) for name, value in inputs.items()}
        picture = bytes(load(spec.picture.function)(**{spec.picture.result: result}, **asked))
    except DamagedArtifact as damage:
        return (f"its picture has to wait: {damage.what}",)  # and is drawn by the next run, when that is made again
    except Exception as error:
        failure = printable(f"its picture could not be drawn: {type(error).__name__}: {error}")
        write_drawing(lane.cache.work, spec.task, key, Drawing(digest, failure), None)
        return (failure,)
    write_drawing(lane.cache.work, spec.task, key, Drawing(digest), picture)
    return ()


def _show(spec: TaskSpec, key: str, result: Any, lane: _Lane) -> None:
    """Make and keep a result's points for the report, while it is in memory.  What cannot be made is tried again there."""
    if spec.view is None:
        return
    with suppress(Exception):
        Shown(lane.cache.work, spec.task, key, spec.view.code).keep(bytes(load(spec.view.function)(result)))


def _resolve(value: Input, lane: _Lane) -> Input:
    """Give inputs made earlier in this lane their place in the cache."""
    if isinstance(value, Stored) and not value.file:
        return value.resolved(lane.receipts[value.task])
    return value


class _OnDemand(Mapping[Any, Any]):
    """A mapping whose values are read when they are asked for, so that a night is never in memory at once."""

    def __init__(self, items: dict[Any, Any], load: Callable[[Any], Any]) -> None:
        self._items = items
        self._load = load

    def __getitem__(self, key: Any) -> Any:
        return self._load(self._items[key])

    def __contains__(self, key: object) -> bool:
        return key in self._items  # without reading it

    def __iter__(self) -> Iterator[Any]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)


def _load(value: Input, lane: _Lane, keep: bool = True) -> Any:
    if isinstance(value, Absent):
        return None
    if isinstance(value, Joined):
        items = {subject[0] if len(subject) == 1 else subject: item for subject, item in value.items.items()}
        return _OnDemand(items, lambda item: _load(item, lane, keep=False))
    if isinstance(value, Value):
        return _from_plain(value)
    if isinstance(value, Files):
        captures = [_capture(value.kind, file) for file in value.files]
        return captures[0] if value.single else captures
    result = lane.results.get(value.file_digest)
    if result is None and value.part and not value.task.subject:
        opened = lane.kept.of(value.file_digest, lambda: _bytes_of(value, lane))
        return opened.part(value.part.field, value.part.entry)
    if result is None:
        result = result_of(_bytes_of(value, lane), stage_named(value.task.stage).table)
        if keep:
            lane.results[value.file_digest] = result
    return value.part.of(result) if value.part else result


def _bytes_of(value: Stored, lane: _Lane) -> bytes:
    name = lane.cache.work.artifact_name(value.task, value.file)
    return lane.cache.read(value.task, name, value.file_digest)


def _from_plain(value: Value) -> Any:
    import numpy as np

    fields = {name: np.asarray(v, dtype=np.float64) if isinstance(v, list) else v for name, v in value.plain.items()}
    return load(value.kind)(**fields)


def _capture(kind: str, file: Any) -> Any:
    import numpy as np

    data = read_outside(file.path)
    if artifact.digest(data) != file.digest:  # else what is made of it would be kept as made of something else
        raise ChangedFile(file.path)
    return load(kind)(name=file.name, data=np.frombuffer(data, dtype=np.uint8))
