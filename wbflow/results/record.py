"""What is written of a run: run.json (its form is a contract), made from the states of a plan."""

from __future__ import annotations

import datetime
from collections import Counter
from dataclasses import dataclass, field
from typing import Any

from .. import __version__
from ..night.plan import Plan
from ..night.state import State
from ..task import Task
from .publish import cloud_file

STAMP = "%Y-%m-%dT%H:%M:%SZ"


@dataclass
class Measures:
    """Costs of a run, summed as tasks finish.  stages: wall and CPU seconds and number of tasks that ran, by stage."""

    started: datetime.datetime
    wall: float = 0.0
    cpu: float = 0.0
    peak_rss_mb: float = 0.0
    stages: dict[str, dict[str, float]] = field(default_factory=dict)

    def add(self, stage: str, wall: float, cpu: float, peak_rss_mb: float) -> None:
        """Count a task that ran."""
        row = self.stages.setdefault(stage, {"wall": 0.0, "cpu": 0.0, "tasks": 0})
        row["wall"] += wall
        row["cpu"] += cpu
        row["tasks"] += 1
        self.cpu += cpu
        self.peak_rss_mb = max(self.peak_rss_mb, peak_rss_mb)


def run_record(run: str, plan: Plan, measures: Measures, finished: datetime.datetime, interrupted: bool) -> dict[str, Any]:
    """run.json of a run."""
    counts = dict.fromkeys(("cached", "ran", "rejected", "failed", "skipped"), 0)
    for state in plan.states.values():
        counts[state.outcome] += 1
    pairs = [_pair(plan, pair) for pair in _pairs(plan)]
    cameras = [_with_fruitless_pairs(_camera(plan, camera.id), pairs) for camera in plan.site.cameras]
    fuse = plan.states.get(Task("fuse", ()))
    return {
        "run": run,
        "site": plan.site.name,
        "version": __version__,
        "date": plan.night,
        "started": measures.started.strftime(STAMP),
        "finished": finished.strftime(STAMP),
        "exit_code": 130 if interrupted else exit_code(plan, cameras),
        "tasks": counts,
        "seconds": {
            "wall": round(measures.wall, 2),
            "cpu": round(measures.cpu, 2),
            "stages": {name: {k: round(v, 2) for k, v in row.items()} for name, row in measures.stages.items()},
        },
        "peak_rss_mb": round(measures.peak_rss_mb),
        "cameras": cameras,
        "pairs": pairs,
        "cloud": _cloud(plan, Task("fuse", ())),
        "other_clouds": [c for task in plan.states if task.stage == "fuse" and task.subject and (c := _cloud(plan, task))],
        "poses": _poses(plan),
        "reason": fuse.reason if fuse and not fuse.usable else None,
    }


def exit_code(plan: Plan, cameras: list[dict[str, Any]]) -> int:
    """0 complete, 1 no cloud, 3 something failed."""
    fuse = plan.states.get(Task("fuse", ()))
    if any(stage.name == "fuse" for stage in plan.stages()) and not (fuse and fuse.usable):
        return 1
    lost = any(state.outcome == "failed" for state in plan.states.values()) or any(c["outcome"] != "ok" for c in cameras)
    return 3 if lost else 0


def _cloud(plan: Plan, task: Task) -> dict[str, Any] | None:
    state = plan.states.get(task)
    if state is None or not state.usable:
        return None
    figures = _figures(state)
    return {"path": cloud_file(task), "points": figures["points_count"], "bounds": figures["bounds"]}


def _poses(plan: Plan) -> dict[str, Any] | None:
    """How the cameras came to stand where they do, without the cameras themselves (those are in cameras.json) and what is said
    of each camera and pair elsewhere."""
    state = plan.states.get(Task("poses", ()))
    if state is None or not state.usable:
        return None
    return {name: _rounded(value) for name, value in _figures(state).items() if name not in {"verdicts", "checks"}}


def _camera(plan: Plan, camera: str) -> dict[str, Any]:
    states = [plan.states.get(Task(stage, (camera,))) for stage in ("frames", "features")]
    record: dict[str, Any] = {"id": camera, "outcome": "ok", "keypoints": None, "reason": None, "notes": [], "pose": None}
    for state in filter(None, states):
        if not state.usable:
            return record | {"outcome": state.outcome, "reason": state.reason}
        record["notes"] = [*record["notes"], *_figures(state).get("notes", [])]
        record["keypoints"] = _figures(state).get("xy_count", record["keypoints"])
    poses = plan.states.get(Task("poses", ()))
    solved = _figures(poses) if poses else {}
    record["pose"] = _rounded(solved.get("checks", {}).get(camera))
    if camera in solved.get("suspects", {}):
        record["notes"] = [*record["notes"], solved["suspects"][camera]]
    if camera in solved.get("unsolved", {}):
        return record | {"outcome": "unsolved", "reason": solved["unsolved"][camera]}
    return record


def _with_fruitless_pairs(camera: dict[str, Any], pairs: list[dict[str, Any]]) -> dict[str, Any]:
    """A camera none of whose pairs came to anything has been turned or moved, or sees something else: its notes say so."""
    tried = [pair for pair in pairs if camera["id"] in (pair["left"], pair["right"]) and pair["outcome"] != "skipped"]
    if camera["outcome"] != "ok" or not tried or any(pair["outcome"] == "ok" for pair in tried):
        return camera
    reason = Counter(str(pair["reason"]) for pair in tried).most_common(1)[0][0]
    note = f"none of its {len(tried)} pairs could be used: {reason}; has it been moved?"
    return camera | {"notes": [*camera["notes"], note]}


def _pairs(plan: Plan) -> list[tuple[str, str]]:
    state = plan.states.get(Task("pairs", ()))
    return [tuple(pair) for pair in _figures(state).get("pairs", [])] if state and state.usable else []


def _pair(plan: Plan, pair: tuple[str, str]) -> dict[str, Any]:
    record: dict[str, Any] = {"left": pair[0], "right": pair[1], "outcome": "ok"}
    record |= dict.fromkeys(("matches", "inliers", "angle_deg", "epipolar_px", "poses_px", "vertical_px", "density", "reason"))
    names = {
        "matches": {"x1_count": "matches"},
        "geometry": {
            "x1_count": "inliers",
            "angle_deg": "angle_deg",
            "epipolar_px": "epipolar_px",
            "good_probability": "probability",
        },
        "rectify": {"angle_deg": "angle_deg", "vertical_px": "vertical_px", "method": "method"},
        "disparity": {"density": "density"},
    }
    for stage, fields in names.items():
        state = plan.states.get(Task(stage, pair))
        if state is None:
            continue
        figures = _figures(state)
        record |= {ours: _rounded(figures[theirs]) for theirs, ours in fields.items() if theirs in figures}
        if not state.usable and record["outcome"] == "ok":
            record |= {"outcome": state.outcome, "reason": state.reason, "stage": stage}
            record["inliers"] = figures.get("inliers", record["inliers"])
    poses = plan.states.get(Task("poses", ()))
    verdict = _figures(poses).get("verdicts", {}).get("--".join(pair), {}) if poses else {}
    return record | {"poses_px": _rounded(verdict.get("adjusted_px"))}


def _figures(state: State) -> dict[str, Any]:
    return state.receipt.figures if state.receipt else {}


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    return round(value, 4) if isinstance(value, float) else value
