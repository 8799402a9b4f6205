"""Two nights side by side, from their run.json."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Row:
    """what: a figure's name; a, b: its value in the two runs; changed: do they differ?"""

    what: str
    a: str
    b: str

    @property
    def changed(self) -> bool:
        """Do the two runs differ here?"""
        return self.a != self.b


def read_run(path: Path) -> dict[str, Any]:
    """run.json of a run's folder (or the file itself).

    Raises
    ------
    ValueError
        There is none, or it cannot be read.
    """
    file = path / "run.json" if path.is_dir() else path
    try:
        record = json.loads(file.read_text())
        if not isinstance(record, dict) or "run" not in record:
            raise ValueError("not a run.json")
        return record
    except (OSError, ValueError) as error:
        raise ValueError(f"{path} is not the folder of a run: {error}") from None


def compare(a: dict[str, Any], b: dict[str, Any]) -> list[Row]:
    """The figures of two runs: first the night as a whole, then every camera and pair that differs."""
    rows = [Row("run", a["run"], b["run"]), Row("date", a["date"], b["date"])]
    rows += [Row("exit code", str(a["exit_code"]), str(b["exit_code"]))]
    rows += [Row("points", *(f"{(r['cloud'] or {}).get('points', 0):,}" for r in (a, b)))]
    rows += [Row("wall seconds", f"{a['seconds']['wall']:.1f}", f"{b['seconds']['wall']:.1f}")]
    rows += [Row("CPU seconds", f"{a['seconds']['cpu']:.1f}", f"{b['seconds']['cpu']:.1f}")]
    rows += [Row(f"tasks {name}", str(a["tasks"][name]), str(b["tasks"][name])) for name in a["tasks"]]
    for kind, name in (("cameras", lambda r: r["id"]), ("pairs", lambda r: f"{r['left']}--{r['right']}")):
        ours, theirs = ({name(r): _words(r) for r in run[kind]} for run in (a, b))
        both = [Row(key, ours.get(key, "absent"), theirs.get(key, "absent")) for key in dict.fromkeys([*ours, *theirs])]
        rows += [row for row in both if row.changed]
    return rows


def _words(record: dict[str, Any]) -> str:
    if record["outcome"] != "ok":
        return f"{record['outcome']}: {record['reason']}"
    if "keypoints" in record:
        return f"ok, {record['keypoints']} keypoints"
    density = f", density {record['density']:.2f}" if record["density"] is not None else ""
    return f"ok, {record['inliers']} inliers{density}"
