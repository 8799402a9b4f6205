"""What do many cameras cost?  Measures the pair graph, the plan, pairs without poses, and a rendered site of 8 and 64 cameras.

    scripts/bench_pipeline.py plan [--cameras 100 300 1000]       known poses: the pair graph and the plan alone
    scripts/bench_pipeline.py overlap [--cameras 100 300 1000]    no poses: the overlap of synthetic keypoints
    scripts/bench_pipeline.py growth [--width 640] [--until STAGE]  the yard with 8 and with 64 cameras, poses withheld
    scripts/bench_pipeline.py first --site DIR [--jobs 1 2]       a first run without compiled kernels, and a second with them

Prints CPU seconds of the whole process tree; `--json FILE` writes the rows.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from bench_files import write_rows

KEYS = ("system", "cameras", "what", "tasks", "cpu_s", "wall_s")


@dataclass(frozen=True)
class Row:
    """One measurement."""

    cameras: int
    what: str
    tasks: int
    cpu_s: float
    wall_s: float
    system: str = "wbflow"


def clean_frame(captures: Sequence[Any], lens: Any) -> Any:
    """Stage `frames` of the synthetic site of `plan`: every frame is black."""
    from wbflow_stages.types import Frame, View

    black = np.zeros((8, 8, 3), np.uint8)
    return Frame(black, np.ones((8, 8), bool), View(640, 480, lens.K))


def detect(frame: Any) -> Any:
    """Stage `features` of the synthetic site of `plan`: one keypoint per frame."""
    from wbflow_stages.types import Features

    one = np.ones(1, np.float32)
    return Features(np.zeros((1, 2)), np.eye(2)[None], np.eye(1, 128, dtype=np.float32), one, np.zeros(1, np.uint8), frame.view)


def plan(cameras: int) -> Iterator[Row]:
    """Measure a synthetic site: cameras on a grid of masts, eight metres apart, that look in random directions."""
    random = np.random.default_rng(0)
    side = int(np.ceil(np.sqrt(cameras)))
    rows = []
    for k in range(cameras):
        centre = np.array([k % side * 8.0, k // side * 8.0, 7.0]) + random.normal(0, 1, 3) * (1, 1, 0.3)
        bearing = random.uniform(0, 2 * np.pi)
        target = centre + 12 * np.array([np.cos(bearing), np.sin(bearing), 0]) - (0, 0, 6)
        pose = {"position": centre.tolist(), "look_at": target.tolist()}
        lens = {"fx": 560, "fy": 560, "cx": 319.5, "cy": 239.5, "width": 640, "height": 480}
        rows.append({"id": f"c{k:04d}", "intrinsics": lens, "pose": pose})
    off = dict.fromkeys(("health", "scene", "refine", "coverage", "changes"), False)
    stages = {"frames": {"use": "bench_pipeline:clean_frame"}, "features": {"use": "bench_pipeline:detect"}, **off}
    site = {"site": "plan", "captures": {"root": "captures", "pattern": "{camera}.txt"}, "cameras": rows, "stages": stages}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "captures").mkdir()
        for k in range(cameras):
            (folder / "captures" / f"c{k:04d}.txt").write_text(f"{k}")
        (folder / "site.yaml").write_text(json.dumps(site))
        _wbflow("run", folder / "site.yaml", "--until", "features")
        cpu, wall = _wbflow("run", folder / "site.yaml", "--until", "pairs")
        reported = json.loads((folder / ".wbflow" / "plan" / "runs" / "latest" / "run.json").read_bytes())
        for stage, seconds in reported["seconds"]["stages"].items():
            yield Row(cameras, stage, seconds["tasks"], seconds["cpu"], seconds["wall"])
        yield Row(cameras, "whole run, with report", 2, cpu, wall)
        cpu, wall = _wbflow("run", folder / "site.yaml", "--dry-run")
        yield Row(cameras, "plan", len(reported["pairs"]), cpu, wall)


def overlap(cameras: int) -> Iterator[Row]:
    """Measure synthetic views along a row of landmarks; each view shares landmarks with a dozen others."""
    from wbflow_stages.overlap import estimate_overlap
    from wbflow_stages.types import Features, View

    random, view = np.random.default_rng(0), View(1024, 768)
    world = random.normal(size=(800 + 120 * cameras, 128)).astype(np.float32)
    seen = {}
    for k in range(cameras):
        own = np.abs(world[120 * k : 120 * k + 800] + 0.3 * random.normal(size=(800, 128)).astype(np.float32))
        own /= np.linalg.norm(own, axis=1, keepdims=True)
        one = np.ones(800, np.float32)
        seen[f"c{k}"] = Features(np.zeros((800, 2)), np.tile(np.eye(2), (800, 1, 1)), own, one, one.astype(np.uint8) - 1, view)
    (found, cpu, wall) = _timed(lambda: estimate_overlap(dict.fromkeys(seen, view), {}, seen))
    yield Row(cameras, "overlap", len(found.pairs), cpu, wall)


def growth(width: int, until: str, memory: str) -> Iterator[Row]:
    """Measure the same yard with every eighth of its 64 cameras, and with all of them."""
    from many_cameras import render, write_site

    site = render(64, (width, width * 9 // 16))
    with tempfile.TemporaryDirectory() as name:
        for every in (8, 1):
            folder = Path(name) / str(every)
            withheld, posed = write_site(site, folder, every=every)
            cpu, wall = _wbflow("run", withheld, "--until", until, "--memory", memory)
            record = json.loads((folder / ".wbflow" / "withheld" / "runs" / "latest" / "run.json").read_bytes())
            yield Row(64 // every, f"until {until}", sum(record["tasks"].values()), cpu, wall)
            for stage, seconds in record["seconds"]["stages"].items():
                yield Row(64 // every, stage, seconds["tasks"], seconds["cpu"], seconds["wall"])
            _wbflow("run", posed, "--until", "pairs")
            known = json.loads((folder / ".wbflow" / "posed" / "runs" / "latest" / "run.json").read_bytes())
            right = {(p["left"], p["right"]) for p in known["pairs"]}
            for what, figure, without in (("matched", "matched", None), ("made dense", "dense", False)):
                chosen = {(p["left"], p["right"]) for p in record["pairs"] if p.get(figure) not in {None, without}}
                same = f"{len(chosen & right)} of the {len(right)} that are chosen from the true poses"
                print(f"{64 // every} cameras: {len(chosen)} pairs {what}, among them {same}")


def first(jobs: int, site: Path) -> Iterator[Row]:
    """Measure two full runs of a rendered site: the first without compiled kernels, the second with them."""
    from wbflow import load_site
    from wbflow.words import counted

    cameras = len(load_site(site).cameras)
    with tempfile.TemporaryDirectory() as name:
        for k, what in enumerate(("first", "second")):
            arguments = ("run", site, "--jobs", str(jobs), "--work", Path(name) / str(k))
            cpu, wall = _wbflow(*arguments, kernels=Path(name) / "kernels")
            yield Row(cameras, f"{what} run, {counted(jobs, 'job')}", 0, cpu, wall)


def _wbflow(command: str, *arguments: object, kernels: Path | None = None) -> tuple[float, float]:
    """CPU seconds of all processes, and wall-clock seconds, of a command; exit codes 1 and 3 are accepted."""
    words = [sys.executable, "-m", "wbflow", command, *map(str, arguments), "-q"]
    if command == "run" and "--jobs" not in arguments:
        words += ["--jobs", "1"]
    paths = [str(Path(__file__).resolve().parent), os.environ.get("PYTHONPATH", "")]
    own = {"PYTHONPATH": os.pathsep.join(paths)} | ({"NUMBA_CACHE_DIR": str(kernels)} if kernels else {})
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(words, env=os.environ | own, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, check=False)
    if done.returncode not in {0, 1, 3}:  # 1: a run without a cloud
        raise SystemExit(f"{' '.join(words)} ended with {done.returncode}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime, time.perf_counter() - start


def _timed(work: Callable[[], Any]) -> tuple[Any, float, float]:
    cpu, wall = time.process_time(), time.perf_counter()
    return work(), time.process_time() - cpu, time.perf_counter() - wall


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["plan", "overlap", "growth", "first"])
    parser.add_argument("--cameras", type=int, nargs="+", default=[100, 300, 1000])
    parser.add_argument("--width", type=int, default=640, help="width of the rendered pictures, in pixels")
    parser.add_argument("--until", default="fuse", help="the last stage of the rendered site")
    parser.add_argument("--memory", default="2GB", help="memory limit for runs of the rendered site")
    parser.add_argument("--jobs", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--site", type=Path, help="a rendered site, for `first`: wbflow demo DIR --small")
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    if asked.what == "first" and not asked.site:
        parser.error("first needs --site DIR, of wbflow demo DIR --small")
    rows: list[Row] = []
    made: dict[str, Callable[[], Iterable[Row]]] = {
        "plan": lambda: (row for count in asked.cameras for row in plan(count)),
        "overlap": lambda: (row for count in asked.cameras for row in overlap(count)),
        "growth": lambda: growth(asked.width, asked.until, asked.memory),
        "first": lambda: (row for jobs in asked.jobs for row in first(jobs, asked.site)),
    }
    for row in made[asked.what]():
        each = 1000 * row.cpu_s / max(row.cameras, 1)
        print(f"{row.cameras:5} cameras  {row.what:24}{row.tasks:7} {row.cpu_s:8.2f} CPU s {each:9.1f} ms a camera", flush=True)
        rows.append(row)
    if asked.json:
        write_rows(rows, KEYS, asked.json)


if __name__ == "__main__":
    main()
