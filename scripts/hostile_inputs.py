#!/usr/bin/env python3
"""Try hostile site files, calibrations and captures: each must be refused by name, or used.

    python scripts/hostile_inputs.py                      # everything: hand-written files, 5,000 fuzzed ones, captures
    python scripts/hostile_inputs.py --fuzz 200 --seed 3  # fewer fuzzed ones
    python scripts/hostile_inputs.py --no-captures        # only what is loaded in this process: seconds

Faults are a traceback, "wbflow itself failed", an exception that is not a WbflowError, a file that takes longer than a minute, a
bad file that is used although it must be refused, and a refusal that does not name the place or cannot be shown on a screen.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from hostile_captures import GOOD, Hostile, capture_cases, write_site
from hostile_files import Case, calibration_cases, fuzzed, site_cases, write_base

from wbflow.errors import ExitCode, WbflowError
from wbflow.runner.options import Options
from wbflow.runner.plan import Plan
from wbflow.runner.tonight import read_night
from wbflow.site.load import load_site

SECONDS = 60.0
"""Time limit for one file, in seconds, on an idle machine."""
WORKER_MB = 1500.0


@dataclass(frozen=True)
class Fault:
    """A wrong reaction to a hostile input."""

    kind: str
    name: str
    what: str
    column: str = "wrong exit"
    """The column of the fault campaign's table in which it counts."""

    def __str__(self) -> str:
        return f"{self.kind:12} {self.name:48} {self.what[:300]!r}"


def time_limit() -> float:
    """The time limit in wall-clock seconds: `SECONDS`, scaled by the machine's present load."""
    return SECONDS * max(1.0, os.getloadavg()[0] / (os.cpu_count() or 1))


class TooSlow(BaseException):
    """A file exceeded its time limit.  A BaseException, so that no `except Exception` swallows it."""


@contextlib.contextmanager
def within(seconds: float) -> Iterator[None]:
    """Raise TooSlow inside the block after this many seconds."""

    def stop(signum: int, frame: object) -> None:
        raise TooSlow

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def load(file: Path) -> str:
    """An empty string if a site file is accepted, else the message of its refusal.  Any other exception is a fault."""
    try:
        with within(time_limit()):
            own_work = b'"work"' in file.read_bytes()
            site = load_site(file, None if own_work else file.parent / "work")  # all cases share its functions memo
            Plan(read_night(site, Options())).refresh()
            site.bindings.reader.save()
    except WbflowError as error:
        if error.exit_code is not ExitCode.USAGE:
            raise AssertionError(f"exit code {int(error.exit_code)}: {error}") from None
        return str(error)
    return ""


def try_files(kind: str, cases: Iterator[Case], counts: Counter[str]) -> Iterator[Fault]:
    """Load each case in this process."""
    with tempfile.TemporaryDirectory() as folder:
        base = Path(folder)
        write_base(base)
        load(base / "site.yaml")  # fills the functions memo for all cases
        for case in cases:
            write_base(base)
            for name, data in case.files.items():
                (base / name).write_bytes(data)
            counts[f"{kind} tried"] += 1
            try:
                message = load(base / "site.yaml")
            except (Exception, TooSlow) as error:
                column = "hang" if isinstance(error, TooSlow) else "traceback"
                yield Fault(kind, case.name, f"{type(error).__name__}: {error}", column)
                continue
            counts[f"{kind} {'refused' if message else 'used'}"] += 1
            if case.refused and not message:
                yield Fault(kind, case.name, "is used")
            elif message and not re.search(r"\.(yaml|json|txt|py)(:\d+){1,2}: |cannot be read|must hold|not JSON that", message):
                yield Fault(kind, case.name, f"no place: {message}")
            elif "\x1b" in message or len(message) > 20_000:
                yield Fault(kind, case.name, "the message cannot be shown on a screen")


def try_captures(cases: list[Hostile], counts: Counter[str]) -> Iterator[Fault]:
    """Run a site with a camera for each case and two good ones, through the command line."""
    with tempfile.TemporaryDirectory() as folder:
        site = write_site(Path(folder), cases)
        command = [sys.executable, "-m", "wbflow", "run", str(site), "--until", "frames", "--json", "--jobs", "2"]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, errors="replace", timeout=len(cases) * time_limit() / 3, check=False
            )
        except subprocess.TimeoutExpired:
            yield Fault("captures", "all", "still running", "hang")
            return
        if "Traceback" in done.stderr or "itself failed" in done.stderr or "\x1b" in done.stderr + done.stdout:
            yield Fault("captures", "all", done.stderr[-300:], "traceback")
        try:
            record = json.loads(done.stdout)
        except ValueError:
            yield Fault("captures", "all", f"exit {done.returncode}: {done.stderr[-300:]}")
            return
        counts["captures MB"] = round(record["peak_rss_mb"])
        if record["peak_rss_mb"] > WORKER_MB:
            yield Fault("captures", "all", f"a worker held {record['peak_rss_mb']:.0f} MB", "memory")
        slow = [line for line in record["cameras"] if "took longer" in str(line["reason"])]
        yield from (Fault("captures", camera["id"], str(camera["reason"]), "hang") for camera in slow)
        yield from _judge(record, cases, counts)


def _judge(record: dict[str, object], cases: list[Hostile], counts: Counter[str]) -> Iterator[Fault]:
    cameras = {camera["id"]: camera for camera in record["cameras"]}  # type: ignore[attr-defined]
    if record["exit_code"] not in {1, 3}:
        yield Fault("captures", "all", f"exit code {record['exit_code']}")
    for name in GOOD:
        if cameras[name]["outcome"] != "ok":
            yield Fault("captures", name, str(cameras[name]["reason"]))
    for case in cases:
        camera = cameras[case.name]
        counts["captures tried"] += 1
        counts[f"captures {'refused' if camera['outcome'] == 'failed' else 'used'}"] += 1
        if case.refused and camera["outcome"] != "failed":
            yield Fault("captures", case.name, f"is {camera['outcome']}")
        elif case.refused and case.reason not in str(camera["reason"]):
            yield Fault("captures", case.name, f"{case.reason!r} is not in the reason: {camera['reason']}")


def try_loops() -> Iterator[Fault]:
    """Two symbolic links to their own folder, and `**` in the pattern: the captures must be found nevertheless."""
    with tempfile.TemporaryDirectory() as folder:
        site = write_site(Path(folder), [])
        captures = Path(folder) / "captures"
        for name in ("again", "and-again"):
            (captures / name).symlink_to(".")
        site.write_text(site.read_text().replace("{camera}.*", "**/{camera}.*"))
        command = [sys.executable, "-m", "wbflow", "status", str(site)]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=time_limit(), check=False)
        except subprocess.TimeoutExpired:
            yield Fault("captures", "two links to . and **", "still running", "hang")
            return
        if done.returncode:
            yield Fault("captures", "two links to . and **", done.stderr)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fuzz", type=int, default=5000, metavar="N", help="number of fuzzed site files and calibrations")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--no-captures", action="store_true")
    asked = parser.parse_args()
    counts: Counter[str] = Counter()
    faults = list(try_files("site", site_cases(), counts))
    faults += try_files("calibration", calibration_cases(), counts)
    faults += try_files("fuzzed", fuzzed(asked.fuzz, asked.seed), counts)
    if not asked.no_captures and shutil.which("mkfifo"):
        faults += try_captures(capture_cases(), counts)
        faults += try_loops()
    for kind in ("site", "calibration", "fuzzed", "captures"):
        figures = {what: counts[f"{kind} {what}"] for what in ("tried", "refused", "used")}
        wrong = sum(fault.kind == kind for fault in faults)
        print(f"{kind:12} {figures['tried']:6} tried {figures['refused']:6} refused {figures['used']:6} used {wrong:4} faults")
    print(f"peak memory of a worker that read the captures: {counts['captures MB']} MB")
    for fault in faults:
        print(fault)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
