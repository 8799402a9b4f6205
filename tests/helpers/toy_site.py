"""A toy site whose stages take no time, for tests of the engine."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

HELPERS = Path(__file__).resolve().parent
STAGES = {
    "frames": "clean_frame",
    "features": "detect",
    "overlap": "estimate_overlap",
    "matches": "match",
    "geometry": "estimate_geometry",
    "poses": "solve_poses",
    "rectify": "rectify",
    "disparity": "match_dense",
    "depth": "view_depth",
    "fuse": "fuse",
}


@dataclass
class ToySite:
    """A site in a folder: captures `<camera>.txt`, and site.yaml, which sets the `parameters` of each stage."""

    folder: Path
    cameras: list[str]
    parameters: dict[str, dict[str, Any]] = field(default_factory=dict)
    environment: dict[str, str] = field(default_factory=dict)
    keys: dict[str, Any] = field(default_factory=dict)
    """Additional keys of the site file."""
    watched: bool = False
    """Whether its cameras are compared with the reference (stage health)."""
    compares: bool = False
    """Whether it looks for what has changed (stage changes)."""
    dated: bool = False
    """Whether captures are named `<camera>-<date>.txt`."""
    backend: str = "processes"
    """Where `run` executes tasks.  Threads start at once; they suffice if a test is about results instead of workers."""

    def __post_init__(self) -> None:
        (self.folder / "captures").mkdir(parents=True)
        (self.folder / "faults").mkdir()
        for camera in self.cameras:
            self.capture(camera).write_text(f"a view from {camera}")
        self.write()

    @property
    def file(self) -> Path:
        return self.folder / "site.yaml"

    @property
    def work(self) -> Path:
        return self.folder / ".wbflow" / "toy"

    @property
    def cloud(self) -> bytes:
        return (self.work / "runs" / "latest-good" / "cloud.ply").read_bytes()

    def capture(self, camera: str, date: str = "2026-11-01") -> Path:
        return self.folder / "captures" / (f"{camera}-{date}.txt" if self.dated else f"{camera}.txt")

    def night(self, date: str, **states: str) -> None:
        """Write the captures of one more night of a dated site; states: of cameras that are not `ok`, by name."""
        for camera in self.cameras:
            self.capture(camera, date).write_text(f"{states.get(camera, 'ok')}: {camera} on {date}")

    def things(self, date: str, things: str = "") -> None:
        """Write the captures of a night of a dated site; things: what differs from the reference, as in "van 5, stack -3"."""
        self.night(date)
        first = self.capture(self.cameras[0], date)
        first.write_text(f"{first.read_text()}{f'; {things}' if things else ''}")

    def fault(self, name: str, text: str) -> None:
        (self.folder / "faults" / name).write_text(text)

    def write(self) -> None:
        stages: dict[str, Any] = {
            stage: {"use": f"toy_stages:{name}", **self.parameters.get(stage, {})} for stage, name in STAGES.items()
        }
        stages["shared"] = False
        if "observations" in self.keys:
            stages["observed"] = {"use": "toy_stages:solve_observations", **self.parameters.get("observed", {})}
        stages["scene"] = stages["refine"] = stages["coverage"] = stages["calibration"] = False
        stages["changes"] = {"use": "toy_stages:find_changes"} if self.compares else False
        stages["health"] = {"use": "toy_stages:examine"} if self.watched else False
        site = {
            "site": "toy",
            "captures": {"root": "captures", "pattern": "{camera}-{date}.txt" if self.dated else "{camera}.txt"},
            "cameras": self.cameras,
            "stages": stages,
            **self.keys,
        }
        self.file.write_text(json.dumps(site, indent=1))  # JSON is YAML

    def command(self, *arguments: str) -> list[str]:
        return [sys.executable, "-m", "wbflow", *arguments]

    def env(self) -> dict[str, str]:
        path = os.pathsep.join([str(HELPERS), os.environ.get("PYTHONPATH", "")])
        return {**os.environ, "PYTHONPATH": path, "TOY_FAULTS": str(self.folder / "faults"), **self.environment}

    def wbflow(self, command: str, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run a wbflow command on the site in a process of its own."""
        full = self.command(command, str(self.file), *arguments)
        return subprocess.run(full, env=self.env(), capture_output=True, text=True, timeout=120, check=False)

    def run(self, *arguments: str, code: int | None = 0) -> dict[str, Any]:
        """Run `wbflow run --json` in this process, which is fast; check the exit code and return the record."""
        from click.testing import CliRunner

        from wbflow.cli.main import main

        jobs = [] if "--jobs" in arguments else ["--jobs", "1"]
        command = ["run", str(self.file), "--json", "--backend", self.backend, *jobs, *arguments]
        result = CliRunner().invoke(main, command, env=self.env())
        assert code in {None, result.exit_code}, result.output
        record: dict[str, Any] = json.loads(result.stdout)
        return record

    def ran(self, *outcomes: str) -> set[str]:
        """The tasks that the newest run executed, with one of these outcomes (default: those that are cached)."""
        newest = max(p for p in (self.work / "runs").iterdir() if not p.is_symlink())
        events = [json.loads(line) for line in (newest / "log.jsonl").read_text().splitlines()]
        return {event["task"] for event in events if event.get("outcome") in (outcomes or ("ran", "rejected")) and event["fresh"]}
