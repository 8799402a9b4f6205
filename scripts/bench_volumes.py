"""Are the gained and lost volumes right, and their standard deviations?    bench_volumes.py NIGHTS [--json FILE]

NIGHTS is the folder of `wbflow demo --nights` after `wbflow run --since`.  Each night is compared with each later one; the true
volumes are those of the things that came and went between them.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench_files import write_rows

import wbflow
from wbflow.commands.compare import changes_between


@dataclass(frozen=True)
class Row:
    """Figures of a group of pairs of nights."""

    what: str
    nights: int
    within_two_sigma: float
    """Share of the gained and lost volumes within two standard deviations of the truth."""
    within_tenth: float
    """Share of the volumes within 10 % of the truth (within 0.1 m³ where the truth is zero)."""
    worst: float
    """Largest error as a share of the truth, or in m³ where the truth is zero."""


@dataclass(frozen=True)
class Volume:
    """The gained or the lost volume of one comparison, in m³."""

    found: float
    sigma: float
    truth: float

    @property
    def error(self) -> float:
        """Error as a share of the truth, or in m³ where the truth is zero."""
        return abs(self.found - self.truth) / (self.truth or 1.0)


def truth_of(folder: Path) -> dict[str, dict[str, float]]:
    """Changes of each night against the first, as volumes in m³ by name: negative for things that vanished."""
    nights = json.loads((folder / "truth" / "nights.json").read_text())["nights"]
    return {
        night["date"]: {c["name"]: c["volume_m3"] * (-1 if c["kind"] == "vanished" else 1) for c in night["changes"]}
        for night in nights
    }


def true_volumes(then: dict[str, float], tonight: dict[str, float]) -> tuple[float, float]:
    """Volumes gained and lost between two nights."""
    steps = [tonight.get(name, 0.0) - then.get(name, 0.0) for name in {**then, **tonight}]
    return sum(step for step in steps if step > 0), -sum(step for step in steps if step < 0)


def row_of(what: str, pairs: Sequence[tuple[Volume, Volume]]) -> Row:
    """Summarize the (gained, lost) volumes of some comparisons."""
    volumes = [volume for pair in pairs for volume in pair]
    two = sum(abs(v.found - v.truth) <= 2 * v.sigma for v in volumes) / max(1, len(volumes))
    tenth = sum(v.error <= 0.1 for v in volumes) / max(1, len(volumes))
    return Row(what, len(pairs), two, tenth, max((v.error for v in volumes), default=0.0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("nights", type=Path)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    site = wbflow.load_site(arguments.nights)
    runs = {run.record.date: run for run in (wbflow.open_run(site, name) for name in site.work_folder.run_ids())}
    truth = truth_of(arguments.nights)
    first, lost = min(runs), {date for date, run in runs.items() if not all(camera.ok for camera in run.record.cameras)}
    groups: dict[str, list[tuple[Volume, Volume]]] = {}
    for then, tonight in itertools.combinations(sorted(runs), 2):
        found = changes_between(runs[then], runs[tonight]).cut_fill
        gained, gone = true_volumes(truth[then], truth[tonight])
        pair = Volume(found.gained, found.gained_sigma, gained), Volume(found.lost, found.lost_sigma, gone)
        if not gained and not gone:
            what = "nothing changed"
        elif {then, tonight} & lost:
            what = "things came and went, against a night that lost cameras"
        else:
            what = f"things came and went, against {'the first' if then == first else 'any other'} night"
        groups.setdefault(what, []).append(pair)
        words = " ".join(f"{v.found:7.2f} ± {v.sigma:.2f} ({v.truth:.2f})" for v in pair)
        print(f"{then} {tonight}  {words}", flush=True)
    rows = [row_of(what, pairs) for what, pairs in sorted(groups.items())]
    for row in rows:
        shares = f"{row.within_two_sigma:.0%} in 2 sigma, {row.within_tenth:.0%} in 10 %"
        print(f"{row.what}: {row.nights} pairs; {shares}; worst {row.worst:.3f}")
    if arguments.json:
        write_rows(rows, list(vars(rows[0])), arguments.json)


if __name__ == "__main__":
    main()
