"""One task without site, cache and engine: what the script that `wbflow debug` writes calls."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from ..cache import artifact
from ..cache.codec import result_bytes
from ..cache.plugins import load, offer
from ..cache.ply import columns_of
from ..pipeline.exports import FROM_PLAIN_FILES
from ..pipeline.stages import REJECTED, stage_named
from ..runner.executors import THREADS
from .artifacts import function

TASK_FILE = "task.json"
"""What the task is: stage, subject, function, parameters, where its inputs are, what came of it in the cache."""
INPUTS = "inputs"
"""The folder of its inputs."""


def as_a_worker(folder: Path) -> None:
    """Before anything else is imported: one thread, and modules beside the site file, as in a run."""
    os.environ.update(dict.fromkeys(THREADS, "1"))
    beside = _task(folder)["folder"]
    offer(Path(beside) if beside else None)


def inputs(folder: Path) -> dict[str, Any]:
    """What the function is handed, by argument name."""
    return {name: _input(node, folder / INPUTS) for name, node in _task(folder)["inputs"].items()}


def parameters(folder: Path) -> dict[str, Any]:
    """Its parameters: change them in task.json, and run the script again."""
    found: dict[str, Any] = _task(folder)["parameters"]
    return found


def keep(folder: Path, result: Any) -> str:
    """Write the result beside the script, and say how it compares with what the cache has."""
    task = _task(folder)
    told = task["outcome"], task["reason"]
    nothing: Any = function(REJECTED)
    if isinstance(result, nothing):
        same = told == ("rejected", str(result.reason))
        return f"rejected, {'as in the cache' if same else f'in the cache: {told[0]}'}"
    table = stage_named(task["stage"]).table
    data = result_bytes(result, table)
    file = folder / f"result{table.suffix if table else '.wbf'}"
    file.write_bytes(data)
    if task["digest"] is None:
        return f"{file} (the cache has none: {told[0]}{f', {told[1]}' if told[1] else ''})"
    same = artifact.digest(data) == task["digest"]
    return f"{file}: {'the same bytes as the cache has' if same else 'other bytes than the cache has'}"


def _input(node: Any, folder: Path) -> Any:
    if isinstance(node, dict) and "table" in node:
        return load(node["restore"])(columns_of((folder / node["table"]).read_bytes()))
    return function(FROM_PLAIN_FILES)(node, folder)


def _task(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / TASK_FILE).read_text())
    return found
