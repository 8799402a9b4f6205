"""What does the engine itself cost?  Runs toy stages that take no time, and Snakemake on the same graph for comparison.

    scripts/bench_engine.py [--cameras 20 100 300 1000] [--snakemake PYTHON] [--json FILE]

For each number of cameras it measures a full run, a run with nothing to do, one after a capture has changed, and one after a run
was killed half way, in CPU seconds of the whole process tree and in wall-clock seconds.  wbflow uses the toy stages of its tests.
Snakemake gets a workflow with the same jobs and dependencies, where each job writes a file; `--snakemake` names a Python that has
Snakemake, so that it can be installed in its own environment.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from bench_files import write_rows

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]
from tests.helpers.toy_site import ToySite  # noqa: E402

KEYS = ("system", "cameras", "what", "tasks", "cpu_s", "wall_s")
ONE_JOB = ("--jobs", "1")


@dataclass(frozen=True)
class Row:
    """One measurement."""

    system: str
    cameras: int
    what: str
    """full, noop, change or resume."""
    tasks: int
    """All tasks of the graph, whether they ran or not."""
    cpu_s: float
    """CPU seconds of the process and of all that it started."""
    wall_s: float


@dataclass(frozen=True)
class Workflow:
    """A workflow that can be run."""

    system: str
    cameras: int
    command: Sequence[str]
    environment: dict[str, str]
    folder: Path
    capture: Path
    """The capture that is changed between runs."""
    count_finished: Callable[[], int]
    """Counts the finished tasks."""

    def run(self) -> tuple[float, float]:
        """Run it, and return CPU seconds and wall-clock seconds."""
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        with (self.folder / "words.txt").open("w") as words:
            done = subprocess.run(self.command, env=self.environment, cwd=self.folder, stdout=words, stderr=words, check=False)
        wall, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode:
            raise SystemExit(f"{' '.join(self.command)} ended with {done.returncode}; see {self.folder / 'words.txt'}")
        return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime, wall

    def kill_half_way(self, tasks: int) -> None:
        """Start it, and kill its process group when half of its tasks are done."""
        process = subprocess.Popen(
            self.command,
            env=self.environment,
            cwd=self.folder,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        while process.poll() is None and self.count_finished() < tasks / 2:
            time.sleep(0.05)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def toy_workflow(cameras: int, folder: Path) -> Workflow:
    """wbflow on a toy site."""
    site = ToySite(folder / "toy", [f"c{k:04d}" for k in range(cameras)])
    command = [sys.executable, "-m", "wbflow", "run", str(site.file), "-q", *ONE_JOB]
    return Workflow("wbflow", cameras, command, site.env(), folder, site.capture("c0001"), lambda: _receipts(site.work))


def _receipts(work: Path) -> int:
    """Number of finished tasks, counted by their receipts; JSON files directly in the cache folder are memos."""
    within = (names for folder, _, names in os.walk(work / "cache") if folder != str(work / "cache"))
    return sum(name.endswith(".json") for names in within for name in names)


def snakemake_workflow(cameras: int, pairs: Sequence[tuple[str, str]], python: str, folder: Path) -> Workflow:
    """Snakemake on the same graph: a rule for each stage, whose jobs write a hash of their inputs.

    Parameters
    ----------
    cameras : int
        Number of cameras.
    pairs : sequence of (str, str)
        The pairs that wbflow has chosen.
    python : str
        A Python that has Snakemake.
    folder : Path
        Working folder of the workflow.
    """
    names = [f"c{k:04d}" for k in range(cameras)]
    (folder / "captures").mkdir(parents=True)
    for name in names:
        (folder / "captures" / f"{name}.txt").write_text(f"a view from {name}")
    rules = "".join(_RULE.format(stage=stage, each=f"/{{{each}}}" if each else "", needs=needs) for stage, each, needs in _RULES)
    (folder / "Snakefile").write_text(f"CAMERAS = {names}\nPAIRS = {['--'.join(pair) for pair in pairs]}\n{_HEAD}{rules}")
    command = [python, "-m", "snakemake", "--cores", "1", "--quiet", "all", "--rerun-incomplete", "--nolock"]

    def count_finished() -> int:
        return sum(len(names) for _, _, names in os.walk(folder / "made"))

    return Workflow("snakemake", cameras, command, dict(os.environ), folder, folder / "captures" / "c0001.txt", count_finished)


_HEAD = """
SIDES = dict((p, p.split("--")) for p in PAIRS)
AROUND = dict((c, []) for c in CAMERAS)
for p in PAIRS:
    for c in SIDES[p]:
        AROUND[c].append(p)
def each(stage, names):
    return [f"made/{stage}/{name}" for name in names]
def sides(stage):
    return lambda w: each(stage, SIDES[w.pair])
wildcard_constraints: camera="c[0-9]+", pair="c[0-9]+--c[0-9]+"
rule all:
    input: "made/fuse"
"""
"""Start of the Snakefile, before the rules."""
_RULE = """rule {stage}:
    input: {needs}
    output: "made/{stage}{each}"
    shell: "cat {{input}} | sha256sum > {{output}}"
"""
"""A rule of the Snakefile.  `run:` instead of `shell:` would start a Python for each job, which takes most of a second."""
_RULES = (
    ("frames", "camera", '"captures/{camera}.txt"'),
    ("features", "camera", '"made/frames/{camera}"'),
    ("overlap", "", 'each("features", CAMERAS)'),
    ("pairs", "", '"made/overlap"'),
    ("matches", "pair", 'sides("features"), "made/pairs"'),
    ("geometry", "pair", 'sides("features"), "made/matches/{pair}"'),
    ("poses", "", 'each("geometry", PAIRS)'),
    ("rectify", "pair", '"made/poses", "made/geometry/{pair}"'),
    ("disparity", "pair", 'sides("frames"), "made/rectify/{pair}"'),
    ("depth", "camera", '"made/poses", lambda w: each("disparity", AROUND[w.camera])'),
    ("fuse", "", '"made/poses", each("frames", CAMERAS), each("depth", CAMERAS)'),
)
"""Stage, wildcard of its jobs ("" for a single job), and its inputs, as in the toy stages of the tests."""


def measure(subject: Workflow, fresh: Workflow, rows: list[Row], count: Callable[[], int], work: Path | None = None) -> None:
    """Measure a workflow and add its rows.

    Parameters
    ----------
    subject : Workflow
        Is run in full, with nothing to do, and after one capture has changed.
    fresh : Workflow
        The same workflow, not run yet: is killed half way, then run to its end.
    rows : list of Row
        The list that receives the new rows.
    count : callable
        Returns the number of tasks after the full run.
    work : Path, optional
        Work folder of wbflow; if given, prints the CPU time per task without that of the stages.
    """

    def add(what: str, of: Workflow, tasks: int) -> None:
        cpu, wall = of.run()
        rows.append(Row(of.system, of.cameras, what, tasks or count(), round(cpu, 3), round(wall, 3)))
        print(
            f"{of.system:10} {of.cameras:5} cameras  {what:7}{rows[-1].tasks:6} tasks {cpu:8.2f} CPU s {wall:8.2f} s", flush=True
        )

    add("full", subject, 0)
    tasks = rows[-1].tasks
    if work:
        own = 1000 * (rows[-1].cpu_s - _of_stages(work)) / tasks
        print(f"{subject.system:10} {subject.cameras:5} cameras  {own:.2f} ms per task, stages not counted")
    add("noop", subject, tasks)
    subject.capture.write_text("another view")
    add("change", subject, tasks)
    fresh.kill_half_way(tasks)
    add("resume", fresh, tasks)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cameras", type=int, nargs="+", default=[20, 100, 300, 1000])
    parser.add_argument("--snakemake", metavar="PYTHON", help="a Python that has Snakemake; without it only wbflow is measured")
    parser.add_argument("--most", type=int, default=300, help="largest number of cameras for Snakemake")
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # with it, both systems would compile their modules at each start
    rows: list[Row] = []
    # Remove nothing before the end: ext4 does not reuse inodes that were freed in the last five minutes, and each creation of a
    # file has to search past them.
    with tempfile.TemporaryDirectory() as name:
        print(f"creating a folder with two files takes {_file_system(Path(name)):.0f} us of CPU time here")
        for cameras in asked.cameras:
            folder = Path(name) / str(cameras)
            for part in ("full", "killed"):
                (folder / part).mkdir(parents=True)
            subject, fresh = toy_workflow(cameras, folder / "full"), toy_workflow(cameras, folder / "killed")
            work = folder / "full" / "toy" / ".wbflow" / "toy"
            measure(subject, fresh, rows, subject.count_finished, work)
            if asked.snakemake and cameras <= asked.most:
                folders = (folder / f"snakemake-{k}" for k in range(2))
                rival, again = (snakemake_workflow(cameras, _pairs(work), asked.snakemake, f) for f in folders)
                measure(rival, again, rows, rival.count_finished)
            if asked.json:
                write_rows(rows, KEYS, asked.json)
    for what, exponent in growth(rows):
        print(f"wbflow, {what}: CPU time grows with the number of tasks to the power of {exponent:.2f}")


def _file_system(folder: Path, many: int = 500) -> float:
    """Least cost of a task's files on this file system, in CPU microseconds: about 65, but ten times that right after any process
    has removed as many files from it (then wait five minutes)."""
    start = time.process_time()
    for number in range(many):
        (folder / f"probe-{number}").mkdir()
        for name in ("artifact", "receipt"):
            (folder / f"probe-{number}" / name).touch()
    return (time.process_time() - start) / many * 1e6


def growth(rows: Sequence[Row]) -> Iterator[tuple[str, float]]:
    """Exponent of the growth of wbflow's CPU seconds from the smallest to the largest number of tasks, for each kind of run."""
    for what in ("noop", "full", "change"):
        own = sorted((row.tasks, row.cpu_s) for row in rows if row.system == "wbflow" and row.what == what)
        if len(own) > 1 and own[0][0] < own[-1][0]:
            yield what, math.log(own[-1][1] / own[0][1]) / math.log(own[-1][0] / own[0][0])


def _of_stages(work: Path) -> float:
    """CPU seconds that the stages of the latest run used themselves."""
    record = json.loads((work / "runs" / "latest" / "run.json").read_bytes())
    return float(sum(row["cpu"] for row in record["seconds"]["stages"].values()))


def _pairs(work: Path) -> list[tuple[str, str]]:
    names = sorted(path.name for path in (work / "cache" / "matches").iterdir())
    return [(left, right) for left, _, right in (name.partition("--") for name in names)]


if __name__ == "__main__":
    main()
