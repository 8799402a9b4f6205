"""The work of a worker: run the tasks of a chain one after the other, each from its inputs to its receipt.

A task that exceeds its time limit (see `runner.limits`) is ended by the worker process itself (see `progress_reporter`).
"""

from __future__ import annotations

import copy
import dataclasses
import datetime
import faulthandler
import functools
import os
import resource
import time
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..cache.artifact import bytes_and_facts, result_of
from ..cache.atomic import DISK_FULL_ERRORS
from ..cache.checksum import content_digest
from ..cache.memo import ChangedFile
from ..cache.receipt import Preimage, Receipt
from ..cache.store import Cache, Damage, DamagedArtifact, OnDemand
from ..cache.untrusted import read_untrusted
from ..pipeline.stages import CHECK_RESULT, REJECTED, RESULT_TYPES, SITE_TYPES
from ..plugins import load, make_importable
from ..site.capture_files import CaptureFile
from ..task import Task
from ..words import DISK_FULL_REMEDY, LONGEST_TRACE, printable
from .output import output_into
from .spec import Files, Input, Joined, Stored, Table, TaskSpec, Value
from .state import Cause, Outcome, State, cached_state


@dataclass(frozen=True)
class FinishedTask:
    """How a task ended in a worker.  It is retried if an input was damaged or has changed."""

    task: Task
    state: State
    damaged: Task | None = None
    """The task whose artifact has to be made again first."""
    changed: Path | None = None
    """A capture, mask or model that has changed since the task was planned."""
    warnings: tuple[str, ...] = ()
    """Problems that did not affect the result, as text."""
    damages: tuple[Damage, ...] = ()
    """Damage in the cache that was found meanwhile."""


NO_FILE = Path(os.devnull)
_OUR_PACKAGES = ("wbflow.", "wbflow_stages.")
"""Packages of the functions whose results are not checked."""


@contextmanager
def progress_reporter(path: Path, time_limits: Mapping[str, float] | None) -> Iterator[Callable[[int, str], None]]:
    """A function that writes `begun NUMBER` to a small file for each task: the run knows the task even if the worker is lost.

    It takes the number and the stage of a task.  `faulthandler` writes to the same file if the process crashes, or if a task
    exceeds its time limit: it then ends the process, even if Python hangs.  So does, for the run's log, whatever prints to stdout
    or stderr meanwhile.  time_limits: seconds by stage; None if the process also does other work, and must be neither ended nor
    silenced.
    """
    try:
        file = path.open("a")  # every writer appends: none overwrites what another one has written
    except OSError:  # a full disk; the tasks report it themselves
        file = NO_FILE.open("a")
    printed = ExitStack()
    if time_limits is not None:
        faulthandler.enable(file)
        printed.enter_context(output_into(path))

    def begin(number: int, stage: str) -> None:
        with suppress(OSError):
            # on a line of its own, whatever a library has left unfinished; no library prints the record separator \x1e
            file.write(f"\n\x1ebegun {number}\n")
            file.flush()
        if time_limits is not None:
            faulthandler.dump_traceback_later(time_limits[stage], exit=True, file=file)

    try:
        yield begin
    finally:
        if time_limits is not None:
            faulthandler.cancel_dump_traceback_later()
            faulthandler.disable()
        printed.close()
        with suppress(OSError):
            file.close()


@dataclass
class _ChainContext:
    """What the tasks of a chain share: the cache, their results, and the artifacts that they have read (none is read twice)."""

    cache: Cache
    clock: Callable[[], float] = time.process_time
    """CPU seconds: of the process, or of the thread if other threads run tasks, too."""
    receipts: dict[Task, Receipt] = field(default_factory=dict)
    results: dict[str, Any] = field(default_factory=dict)
    """Results by digest, not by task: tonight's and the reference's result of one task may both be needed."""


def run_chain(
    specs: list[TaskSpec], cache: Cache, progress: Path = NO_FILE, time_limits: Mapping[str, float] | None = None
) -> list[FinishedTask]:
    """Run the tasks of a chain until one leaves no artifact.  An exception in a task is not raised, but returned as its state.

    Parameters
    ----------
    specs, cache : list of TaskSpec, Cache
        The chain, and the cache for its results.
    progress : Path, optional
        The progress file (see `progress_reporter`).
    time_limits : mapping, optional
        Seconds by stage; None if this process is shared with other work.
    """
    make_importable(specs[0].folder)
    # in a process of its own, threads of a stage count too; in a shared one, the threads of other tasks must not
    clock = time.thread_time if time_limits is None else time.process_time
    context = _ChainContext(cache, clock)
    ended: list[FinishedTask] = []
    with progress_reporter(progress, time_limits) as begin:
        for number, spec in enumerate(specs):
            begin(number, spec.task.stage)
            done = _attempt(spec, context)
            ended.append(dataclasses.replace(done, damages=tuple(cache.damages())))
            if not done.state.usable or done.state.receipt is None:
                break
            context.receipts[spec.task] = done.state.receipt
    return ended


def run_chain_in_cluster(specs: list[TaskSpec], cache: Cache, progress: Path) -> list[FinishedTask]:
    """`run_chain` in a process of a cluster, which other runs may use too: it is silenced, but not ended after a time."""
    with output_into(progress):
        return run_chain(specs, cache, progress)


def arguments_of(spec: TaskSpec, cache: Cache) -> dict[str, Any]:
    """The arguments of a task's function, without its parameters.  Raises DamagedArtifact, ChangedFile, OSError."""
    context = _ChainContext(cache)
    return {name: _load(value, context) for name, value in spec.inputs.items()}


def _attempt(spec: TaskSpec, context: _ChainContext) -> FinishedTask:
    """Run one task.  This is the only broad `except`: whatever a stage raises, only its own task fails."""
    try:
        resolved = dataclasses.replace(spec, inputs={name: _resolve(value, context) for name, value in spec.inputs.items()})
        preimage = resolved.preimage()
        key = preimage.key()
        # inputs made earlier in this chain are known only now: their result may be that of another night
        receipt = None if spec.force else context.cache.by_key(spec.task, key)
        if receipt:
            return FinishedTask(spec.task, cached_state(receipt))
        return _execute(resolved, preimage, key, context)
    except DamagedArtifact as damage:
        return FinishedTask(spec.task, State("failed", damage.what), damaged=damage.task)
    except ChangedFile as change:
        return FinishedTask(spec.task, State("failed", change.what), changed=change.path)
    except BaseException as error:  # KeyboardInterrupt, too: signals go to the run, so a stage has raised it
        return FinishedTask(spec.task, _failure(spec, error))


def _failure(spec: TaskSpec, error: BaseException) -> State:
    """The state for an exception of a task, as text: it may be of any class, so the object itself is not sent to the run.

    An OSError, or a ValueError of a task that reads files from outside, is blamed on the input; others on the function.
    """
    message = printable("".join(traceback.format_exception_only(error)).strip())
    trace = printable("".join(traceback.format_exception(error)), LONGEST_TRACE)
    if isinstance(error, MemoryError):
        why = "ran out of memory: lower `resolution`, or run with fewer --jobs"
        return State("failed", why, Cause.OUT_OF_MEMORY, fresh=True)
    if isinstance(error, OSError) and error.errno in DISK_FULL_ERRORS:
        return State("failed", f"{error.strerror}; {DISK_FULL_REMEDY}", Cause.DISK_FULL, fresh=True)
    reads_files = any(isinstance(value, Files) for value in spec.inputs.values())
    refuses_input = isinstance(error, ValueError) and type(error).__name__ != "LinAlgError"  # a ValueError too, of NumPy
    if isinstance(error, OSError) or (reads_files and refuses_input):
        why = message.partition(": ")[2] or message  # without the name of the class
        return State("failed", why, Cause.BAD_INPUT, trace=trace, fresh=True)
    if isinstance(error, SystemExit):
        message = printable(f"it ended the program (sys.exit({error.code!r}))")
    why = f"the function of {spec.task.stage} failed: {message}; to run it alone: wbflow debug SITE.yaml '{spec.task}' --out DIR"
    return State("failed", why, Cause.FAULT, trace=trace, fresh=True)


def _execute(spec: TaskSpec, preimage: Preimage, key: str, context: _ChainContext) -> FinishedTask:
    """Load the inputs, call the function, write the artifact, then the receipt."""
    reset_peak()
    wall_start = time.perf_counter()
    cpu_start = context.clock()
    arguments = {name: _load(value, context) for name, value in spec.inputs.items()}
    result = load(spec.function)(**arguments, **spec.parameters)
    rejected_class: Any = load(REJECTED)
    if not spec.function.startswith(_OUR_PACKAGES):
        # of the site's own: a wrong result is named here, not where a later stage stumbles over it
        named_type = RESULT_TYPES.get(spec.task.stage)
        result_type: Any = load(named_type) | rejected_class if named_type else Any
        load(CHECK_RESULT)(result, spec.function, result_type)

    data = None
    product_files: dict[str, bytes] = {}
    warnings: list[str] = []
    outcome: Outcome = "ran"
    if isinstance(result, rejected_class):
        outcome = "rejected"
        facts = {"digest": "", "reason": printable(result.reason), "code": result.code, "figures": dict(result.figures)}
    else:
        data, facts = bytes_and_facts(result, spec.task.stage, key)
        product_files, warnings = _draw(spec, result, context)
    receipt = Receipt(
        str(spec.task),
        key,
        outcome,
        preimage,
        **facts,
        wall=time.perf_counter() - wall_start,
        cpu=context.clock() - cpu_start,
        peak_rss_mb=peak_bytes() / 2**20,
        finished=datetime.datetime.now(datetime.UTC).isoformat(),
        product_files={name: content_digest(product) for name, product in product_files.items()},
    )
    context.cache.write(receipt, data, product_files)
    context.results[receipt.digest] = result
    return FinishedTask(spec.task, State(outcome, receipt.reason, receipt.code, receipt, fresh=True), warnings=tuple(warnings))


def _draw(spec: TaskSpec, result: Any, context: _ChainContext) -> tuple[dict[str, bytes], list[str]]:
    """The product files of a result for the report, by name, and warnings for those that failed, which do not affect the result.

    Raises DamagedArtifact.
    """
    product_files = {}
    warnings = []
    for product in spec.product_files:
        try:
            inputs = {name: _load(_resolve(value, context), context) for name, value in product.inputs.items()}
            product_files[product.name] = bytes(load(product.function)(result, **inputs))
        except DamagedArtifact:
            raise  # the artifact is made again, then this task
        except Exception as error:
            warnings.append(printable(f"its {product.name} could not be drawn: {type(error).__name__}: {error}"))
    return product_files, warnings


def _resolve(value: Input, context: _ChainContext) -> Input:
    """Resolve an input that an earlier task of this chain has made: fill in its file and digests."""
    if not isinstance(value, Stored) or value.file:
        return value
    resolved = value.resolved(context.receipts[value.task])
    assert resolved  # the chain ends at a task that leaves no artifact
    return resolved


def _load(value: Input, context: _ChainContext, keep: bool = True) -> Any:
    """The argument for an input.  keep: keep artifacts that are read for the later tasks of the chain."""
    if value is None:
        return None
    if isinstance(value, Value):
        return from_plain(value)
    if isinstance(value, Table):
        return _from_table(value)
    if isinstance(value, Files):
        captures = [_load_capture(file) for file in value.files]
        return captures[0] if value.single else captures
    if isinstance(value, Joined):
        # by id of a camera, or by pair of ids
        items = {subject[0] if len(subject) == 1 else subject: item for subject, item in value.items.items()}
        return OnDemand(items, lambda item: _load(item, context, keep=False))  # all together may exceed the memory
    return _load_stored(value, context, keep)


def _load_stored(value: Stored, context: _ChainContext, keep: bool) -> Any:
    """The result of another task, or a part of it; `keep` as for `_load`."""
    known = context.results.get(value.file_digest)
    if known is not None:
        return value.part_of(known)
    if value.field and not value.task.subject:
        # a copy: what a stage changes in its part must not reach the tasks of other chains
        return copy.deepcopy(value.part_of(_read_site_wide(context.cache, value.task, value.file, value.file_digest)))
    result = _read(context.cache, value.task, value.file, value.file_digest)
    if keep:
        context.results[value.file_digest] = result
    return value.part_of(result)


def _read(cache: Cache, task: Task, file: str, digest: str) -> Any:
    """An artifact from the cache.  Raises DamagedArtifact."""
    return result_of(cache.read(task, cache.work.task(task) / file, digest), task.stage)


_read_site_wide = functools.lru_cache(4)(_read)
"""Each chain needs its own part of a site-wide artifact: with many cameras, reading it anew would cost more than all the rest."""


def from_plain(value: Value) -> Any:
    """The dataclass of plain values; lists of numbers become arrays of float64."""
    import numpy as np

    fields = {}
    for name, plain in value.plain.items():
        fields[name] = np.asarray(plain, dtype=np.float64) if isinstance(plain, list) else plain
    return load(value.kind)(**fields)


def _from_table(table: Table) -> Any:
    """The dataclass of a table, with its columns as arrays of int32 or float64."""
    import numpy as np

    fields = dict(table.plain)
    for name, column in table.columns.items():
        values = np.array(column)
        width = table.widths.get(name)
        fields[name] = values if width is None else values.reshape(-1, width)
    return load(table.kind)(**fields)


def _load_capture(file: CaptureFile) -> Any:
    """The content of a capture.  Raises ChangedFile if it is no longer what the plan was made with."""
    import numpy as np

    data = read_untrusted(file.path)
    if content_digest(data) != file.digest:  # else the result would be stored under the key of another content
        raise ChangedFile(file.path)
    return load(SITE_TYPES["captures"])(name=file.name, data=np.frombuffer(data, dtype=np.uint8))


def reset_peak() -> None:
    """Reset the peak memory of this process."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")


def peak_bytes() -> int:
    """Return the peak of this process's private memory since `reset_peak`, bytes; if /proc does not provide it, the peak since
    its start, including shared memory."""
    with suppress(OSError, ValueError, KeyError):
        kb: dict[str, int] = {}
        for line in Path("/proc/self/status").read_text().splitlines():
            name, *words = line.split()
            if name in {"VmHWM:", "RssFile:", "RssShmem:"}:
                kb[name] = int(words[0])
        # the peak counts shared pages, too: files of libraries, and memory that processes share
        return (kb["VmHWM:"] - kb["RssFile:"] - kb["RssShmem:"]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
