"""Digests of all that runs leave behind, to compare two versions of the code.

    golden.py record FILE [--only NAME ...]     runs the scenes and writes the digests of their results
    golden.py compare BEFORE AFTER              prints every difference; exit code 1 if there is one

Scenes use only the command line, so any version can be recorded: set PYTHONPATH to the version to record.  Digests are comparable
only on one machine with one set of libraries.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("WBFLOW_DATA", ROOT.parent / "shared" / "data"))
VARYING_ENTRIES = {
    "signed",
    "run",
    "started",
    "finished",
    "seconds",
    "peak_rss_mb",
    "version",
    "usual",
    "settings",
    "reference",
    "later",
}
"""Entries of run.json that differ from run to run, and are not compared."""

FOUNTAIN = """
site: fountain
captures: {root: %s/fountain/images, pattern: "{camera}.jpg"}
calibration: %s/fountain/cameras.json
cameras: ["0001", "0004", "0007", "0010"]
resolution: 768
"""
WRONG = """
site: wrong
captures: {root: ., pattern: "{camera}.jpg"}
cameras:
  - {id: gate, intrinsics: {fx: 900}}
  - {id: roof, pose: {position: [0, 0, 0], rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}}
  - gate
stages: {matches: {macther: spectral}, disparity: {matcher: nothing}}
resolutoin: 640
"""


def wbflow(*arguments: str | Path) -> tuple[int, str, str]:
    """Exit code, stdout and stderr of a command."""
    command = [sys.executable, "-m", "wbflow", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


def sha256(path: Path) -> str:
    """The first 24 hex digits of a file's SHA-256."""
    return hashlib.sha256(path.read_bytes()).hexdigest()[:24]


def run_of(site: Path, *arguments: str) -> dict[str, Any]:
    """Run a site: its plan, exit code and record, and the digests of its products and artifacts."""
    planned = wbflow("status", site, *arguments, "--json")
    plan = json.loads(planned[1]) if planned[0] == 0 else {}
    code, output, _ = wbflow("run", site, *arguments, "--json")
    record = json.loads(output) if output.strip() else {}
    work = next((site.parent / ".wbflow").glob("*/cache")).parent
    folder = (work / "runs" / "latest").resolve()
    artifacts = {
        f"{file.relative_to(work / 'cache').parent}{file.suffix}": sha256(file)
        for suffix in ("wbf", "ply")
        for file in sorted((work / "cache").glob(f"*/*/*.{suffix}"), key=lambda file: file.stat().st_mtime_ns)
    }
    return {
        "exit": code,
        "plan": [[task["task"], task["state"]] for task in plan.get("tasks", [])],
        "products": {
            file.name: sha256(file) for file in [*sorted(folder.glob("*.ply")), folder / "cameras.json"] if file.is_file()
        },
        "artifacts": artifacts,
        "record": {key: value for key, value in record.items() if key not in VARYING_ENTRIES},
    }


def yard_small(folder: Path) -> dict[str, Any]:
    """Four cameras of 320x180, run twice: the second run has nothing to do."""
    wbflow("demo", folder, "--small")
    captures = {str(file.relative_to(folder)): sha256(file) for file in sorted(folder.rglob("*.jpg"))}
    return {"captures": captures, "first": run_of(folder / "site.yaml"), "second": run_of(folder / "site.yaml")}


def yard(folder: Path) -> dict[str, Any]:
    """Eight cameras at full size."""
    wbflow("demo", folder)
    captures = {str(file.relative_to(folder)): sha256(file) for file in sorted(folder.rglob("*.jpg"))}
    return {"captures": captures, "run": run_of(folder / "site.yaml")}


def fountain(folder: Path) -> dict[str, Any]:
    """Four photographs with stated poses, at resolution 768."""
    folder.mkdir()
    (folder / "site.yaml").write_text(FOUNTAIN % (DATA, DATA))
    return {"run": run_of(folder / "site.yaml")}


def nights(folder: Path) -> dict[str, Any]:
    """Three small nights with a reference."""
    wbflow("demo", folder, "--small", "--nights", "3")
    site = folder / "site.yaml"
    dates = sorted({part for file in folder.rglob("*.jpg") for part in file.parts if len(part) == 10 and part[4] == "-"})
    names = sorted({file.stem[:10] for file in folder.rglob("*.jpg")})
    return {date: run_of(site, "--date", date) for date in (dates or names)[:3]}


def broken(folder: Path) -> dict[str, Any]:
    """A site with one truncated and one missing capture."""
    wbflow("demo", folder, "--small")
    files = sorted(file for file in folder.rglob("*.jpg") if "truth" not in file.parts)
    files[0].write_bytes(files[0].read_bytes()[:1000])
    files[-1].unlink()
    return {"run": run_of(folder / "site.yaml")}


def wrong(folder: Path) -> dict[str, Any]:
    """A site file with mistakes: the messages about them."""
    folder.mkdir()
    (folder / "site.yaml").write_text(WRONG)
    code, _, errors = wbflow("run", folder)
    return {"exit": code, "said": errors.replace(str(folder), "").splitlines()}


SCENES: dict[str, Callable[[Path], dict[str, Any]]] = {
    scene.__name__: scene for scene in (yard_small, nights, broken, wrong, fountain, yard)
}


def differences(before: Any, after: Any, path: str = "") -> Iterator[str]:
    """Paths of the entries that differ, with both values."""
    if isinstance(before, dict) and isinstance(after, dict):
        for key in sorted({*before, *after}, key=str):
            yield from differences(before.get(key, "(nothing)"), after.get(key, "(nothing)"), f"{path}/{key}")
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for number, (one, other) in enumerate(zip(before, after, strict=True)):
            yield from differences(one, other, f"{path}/{number}")
    elif before != after:
        yield f"{path}: {str(before)[:120]} -> {str(after)[:120]}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    record = commands.add_parser("record")
    record.add_argument("file", type=Path)
    record.add_argument("--only", nargs="*", choices=[*SCENES], default=[*SCENES])
    compare = commands.add_parser("compare")
    compare.add_argument("before", type=Path)
    compare.add_argument("after", type=Path)
    arguments = parser.parse_args()
    if arguments.command == "record":
        found = {}
        for name in arguments.only:
            folder = Path(tempfile.mkdtemp()) / "site"
            found[name] = SCENES[name](folder)
            shutil.rmtree(folder.parent)
            print(name, {key: value.get("exit") for key, value in found[name].items() if isinstance(value, dict)}, flush=True)
        arguments.file.write_text(json.dumps(found, indent=1, sort_keys=True))
        return
    before, after = (json.loads(file.read_text()) for file in (arguments.before, arguments.after))
    found_differences = [line for name in after for line in differences(before.get(name), after[name], name)]
    print("\n".join(found_differences) or f"{len(after)} scenes: no difference")
    sys.exit(bool(found_differences))


if __name__ == "__main__":
    main()
