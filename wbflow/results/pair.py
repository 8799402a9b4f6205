"""Two photographs and nothing else: the same stages and cache as a site's, the results as files that other programs read."""

from __future__ import annotations

import importlib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..config.load import Site, load_site
from ..night.run import Listener, Options, run
from ..store import artifact
from ..store.atomic import write_atomic
from ..store.cache import Cache
from ..task import Task

PAIR = ("left", "right")


@dataclass(frozen=True)
class PairResult:
    """record: run.json; files: what was written; failure: why there is no disparity, if there is none."""

    record: dict[str, Any]
    files: tuple[Path, ...]
    failure: str | None


def pair_site(left: Path, right: Path, out: Path, resolution: int | None) -> Site:
    """A site of the two photographs, written to out/site.yaml (from where it can be taken further)."""
    out.mkdir(parents=True, exist_ok=True)
    cameras = [{"id": name, "images": [str(path.resolve())]} for name, path in zip(PAIR, (left, right), strict=True)]
    description = {
        "site": "pair",
        "captures": {"root": ".", "pattern": "{camera}"},
        "cameras": cameras,
        "resolution": resolution,
        "pairs": {"min_angle": 0.0, "max_angle": 180.0, "include": [list(PAIR)]},
        "stages": {"poses": False},
        "work": "work",
    }
    write_atomic(out / "site.yaml", json.dumps(description, indent=1).encode())
    return load_site(out)


def match_pair(site: Site, out: Path, jobs: int, listen: Listener) -> PairResult:
    """Run the pair's stages and write their results into `out`.  Raises Locked."""
    finished = run(site, Options(jobs=jobs, until="disparity"), listen)
    cache = Cache(site.work / "cache")
    events = [json.loads(line) for line in (finished.folder / "log.jsonl").read_text().splitlines()]
    found = {event["task"]: event for event in events}
    failure = next((f"{e['task']} {e['outcome']}: {e['reason']}" for e in events if e["outcome"] in {"failed", "rejected"}), None)

    def load(stage: str, subject: tuple[str, ...]) -> Any:
        task = Task(stage, subject)
        event = found.get(str(task))
        if event is None or event["outcome"] not in {"ran", "cached"}:
            return None
        receipt = cache.by_key(stage, subject, event["key"])
        if receipt is None:
            return None
        return artifact.decode(cache.read(str(task), cache.path(receipt), receipt.digest))

    frames = [load("frames", (name,)) for name in PAIR]
    steps = {stage: load(stage, PAIR) for stage in ("matches", "geometry", "rectify", "disparity")}
    files = _files(frames, steps, finished.record)
    for name, data in files.items():
        write_atomic(out / name, data)
    return PairResult(finished.record, tuple(out / name for name in files), failure)


def _files(frames: list[Any], steps: dict[str, Any], record: dict[str, Any]) -> dict[str, bytes]:
    if None in frames or steps["matches"] is None:
        return {}
    vision = importlib.import_module("wbflow_stages.io.pairfiles")
    files: dict[str, bytes] = vision.matching_files(steps["matches"], steps["geometry"], *frames)
    summary = dict(record["pairs"][0])
    if steps["rectify"] is not None:
        rectification = steps["rectify"]
        files |= vision.rectified_files(rectification, *frames)
        told = ("method", "reason", "H1", "H2", "disparity_min_px", "disparity_max_px")
        summary |= {f"rectification_{name}": _plain(getattr(rectification, name)) for name in told}
    if steps["disparity"] is not None:
        disparity, offset = vision.disparity_files(steps["disparity"], steps["rectify"], *frames)
        files |= disparity
        summary |= {"png_offset_px": offset, "png_steps_per_px": vision.PNG_STEPS}
    return files | {"pair.json": json.dumps(summary, indent=1).encode()}


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    return None if isinstance(value, float) and not math.isfinite(value) else value
