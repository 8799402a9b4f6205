"""One task's inputs as ordinary files, its parameters, and a short script that runs it alone."""

from __future__ import annotations

import datetime
import json
import os
import shutil
from pathlib import Path
from typing import Any

from ..cache.artifact import result_bytes, result_of, suffix_of
from ..cache.checksum import content_digest
from ..cache.store import Cache
from ..errors import UsageError
from ..pipeline.stages import DENSE_PAIRS, FUSE, PAIRS, REJECTED, stage_named
from ..plugins import load, make_importable
from ..runner.executors import THREADS
from ..runner.options import Options
from ..runner.plan import Plan
from ..runner.spec import Input, Stored, TaskSpec
from ..runner.state import Impossible, Waiting
from ..runner.tonight import read_night
from ..runner.worker import arguments_of
from ..site.models import Site
from ..site.yaml_document import suggest
from ..task import Task

SCRIPT = "run.py"
"""Runs the task alone."""
TASK_FILE = "task.json"
"""Describes the task: stage, subject, function, parameters, where its inputs are, and its outcome in the cache."""
INPUTS = "inputs"
"""Folder of the task's inputs."""
_MOST_LISTED = 20
"""Most tasks that are listed for a name that is none."""

_SCRIPT = '''\
"""{task}, night of {night}, alone: what it is handed lies in inputs/, its parameters in task.json."""
from pathlib import Path

from wbflow.commands import debug

here = Path(__file__).resolve().parent
debug.set_up_as_worker(here)  # one thread, as in a run
from {module} import {name} as stage  # noqa: E402

result = stage(**debug.inputs(here), **debug.parameters(here))
print(result)
print(debug.keep(here, result))
'''


def write_task(site: Site, task: Task, out: Path, date: datetime.date | None = None) -> list[Path]:
    """Write a task's inputs and parameters as they are tonight, and a script that runs it; returns the files, the script first.

    Raises UsageError if there is no such task, or its inputs have not been made; DamagedArtifact.

    Parameters
    ----------
    site, task : Site, Task
        The site, and the task to write.
    out : Path
        The folder for the files; it is created if missing.
    date : date, optional
        The night; the newest with captures, if not given.
    """
    plan = Plan(read_night(site, Options(date)))
    plan.refresh()
    cache = plan.night.cache
    spec = _spec(plan, task)
    # 1. its inputs, as a worker would hand them over
    (out / INPUTS).mkdir(parents=True, exist_ok=True)
    make_importable(spec.folder)
    entries: dict[str, Any] = {}
    for name, value in arguments_of(spec, cache).items():
        entries[name] = _write_input(spec.inputs[name], value, out / INPUTS, name, cache)
    # 2. its description, with how it ended
    description: dict[str, Any] = {
        "stage": task.stage,
        "subject": list(task.subject),
        "night": str(plan.night.date),
        "function": spec.function,
        "parameters": spec.parameters,
        "inputs": entries,
        **_ended(plan, spec),
        "folder": str(spec.folder) if spec.folder else None,
    }
    # 3. the script
    module, _, name = spec.function.partition(":")
    (out / SCRIPT).write_text(_SCRIPT.format(task=task, night=plan.night.date, module=module, name=name))
    (out / TASK_FILE).write_text(json.dumps(description, indent=1))
    return [out / SCRIPT, out / TASK_FILE, *sorted((out / INPUTS).iterdir())]


def _ended(plan: Plan, spec: TaskSpec) -> dict[str, str | None]:
    """Return how a task has ended, as task.json has it; the digest is that of its artifact in the cache."""
    receipt = plan.night.cache.by_key(spec.task, spec.preimage().key())
    if receipt:
        digest = receipt.digest if receipt.file else None
        return {"outcome": receipt.outcome, "reason": receipt.reason, "digest": digest}
    state = plan.states.get(spec.task)
    if state is None:
        return {"outcome": "not run", "reason": None, "digest": None}
    outcome: str = state.outcome
    if state.receipt:
        outcome = "the night uses the reference's"
    return {"outcome": outcome, "reason": state.reason, "digest": None}


def _spec(plan: Plan, task: Task) -> TaskSpec:
    """Return the spec of a task, whether it has run or not.  Raises UsageError as `write_task` does."""
    known = [*plan.states, *plan.ready, *plan.waiting]
    stage = stage_named(task.stage)
    if stage.scope == "pair" and plan.subjects.pairs(stage.dense) is None:  # which pairs there are is not known yet
        needed = DENSE_PAIRS
        if plan.subjects.pairs() is None:
            needed = PAIRS
        raise _waiting_error(plan, task, Task(needed))
    if task not in known:
        stage_tasks = [str(other) for other in known if other.stage == task.stage]
        listed = ", ".join(stage_tasks[:_MOST_LISTED]) or f"there is none of the stage {task.stage}"
        remedy = suggest(str(task), stage_tasks, f"there are: {listed}")
        raise UsageError(f"the night of {plan.night.date} has no task '{task}'", remedy=remedy)
    try:
        return plan.spec_of(task)
    except Waiting as waiting:
        raise _waiting_error(plan, task, waiting.task or Task(PAIRS)) from None
    except Impossible as impossible:
        remedy = f"wbflow status {plan.night.site.file}  says what each task waits for"
        raise UsageError(f"'{task}' has nothing to work on: {impossible}", remedy=remedy) from None


def _waiting_error(plan: Plan, task: Task, needed: Task) -> UsageError:
    remedy = f"first: wbflow run {plan.night.site.file} --date {plan.night.date} --until {needed.stage}"
    return UsageError(f"'{task}' waits for '{needed}', which has not been made yet", remedy=remedy)


def _write_input(source: Input, value: Any, folder: Path, name: str, cache: Cache) -> Any:
    """Write an input, and return its entry in task.json; a cloud is copied, since the cache stores it as a PLY file."""
    if isinstance(source, Stored) and not source.field and source.file and source.task.stage == FUSE:
        file = f"{name}{suffix_of(FUSE)}"
        shutil.copyfile(cache.work.task(source.task) / source.file, folder / file)
        return {"cloud": file}
    return load("wbflow_stages.exports.plain:write")(value, folder, name)


def set_up_as_worker(folder: Path) -> None:
    """Allow one thread, and make modules beside the site file importable, as in a run; call this before other imports."""
    os.environ.update(dict.fromkeys(THREADS, "1"))
    module_folder = _description(folder)["folder"]
    if module_folder:
        make_importable(Path(module_folder))


def inputs(folder: Path) -> dict[str, Any]:
    """The arguments of the function that are inputs, by name."""
    return {name: _read_input(entry, folder / INPUTS) for name, entry in _description(folder)["inputs"].items()}


def parameters(folder: Path) -> dict[str, Any]:
    """The parameters of the function: change them in task.json, and run the script again."""
    values: dict[str, Any] = _description(folder)["parameters"]
    return values


def keep(folder: Path, result: Any) -> str:
    """Write the result beside the script, and return in words how it compares with the result in the cache."""
    task = _description(folder)
    outcome = task["outcome"]
    reason = task["reason"]
    rejected_type: Any = load(REJECTED)
    if isinstance(result, rejected_type):
        if outcome == "rejected" and reason == str(result.reason):
            return "rejected, as in the cache"
        return f"rejected, in the cache: {outcome}"
    data = result_bytes(result, task["stage"])
    file = folder / f"result{suffix_of(task['stage'])}"
    file.write_bytes(data)
    if task["digest"] is None:
        why = f"{outcome}, {reason}" if reason else outcome
        return f"{file} (the cache has none: {why})"
    if content_digest(data) == task["digest"]:
        return f"{file}: the same bytes as the cache has"
    return f"{file}: other bytes than the cache has"


def _read_input(entry: Any, folder: Path) -> Any:
    """Read what `_write_input` has written."""
    if isinstance(entry, dict) and "cloud" in entry:
        return result_of((folder / entry["cloud"]).read_bytes(), FUSE)
    return load("wbflow_stages.exports.plain:read")(entry, folder)


def _description(folder: Path) -> dict[str, Any]:
    description: dict[str, Any] = json.loads((folder / TASK_FILE).read_text())
    return description
