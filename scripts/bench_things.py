"""Do changes keep their ids, and do intervals hold the true volumes?    bench_things.py NIGHTS... [--json FILE]

Each of NIGHTS is the folder of `wbflow demo --nights` or `nights_of_scene.py`, after a run of its nights.  Their changes against
the first one are computed in the order of the nights, from the artifacts in the cache.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from bench_changes import night_of
from bench_files import write_rows

import wbflow
from wbflow.pipeline.stages import CHANGES
from wbflow_stages.changes import find_changes
from wbflow_stages.types import Change, Changes

KINDS = {"appeared": "new", "vanished": "vanished", "moved": "moved"}
"""Kinds of changes by those of the truth."""
NEAR_SHARE = 0.75
"""A change is a thing if their middles are nearer than this share of the thing's length: of some things little is seen."""
LARGE_M3 = 1.0
"""Things above this volume must be found."""


@dataclass
class Thing:
    """A true change, through the nights."""

    name: str
    volume: float
    ids: list[str] = field(default_factory=list)
    """Its id on each night on which it was found."""
    missed: int = 0
    """Nights on which it stood and was not found, after it was found once or not."""
    split: int = 0
    """Nights on which it had further ids."""


@dataclass(frozen=True)
class Interval:
    """A volume's interval and the truth, m³."""

    least: float
    most: float
    volume: float
    sigma: float
    truth: float

    @property
    def holds(self) -> bool:
        return self.least <= self.truth <= self.most

    @property
    def in_two_sigma(self) -> bool:
        return abs(self.volume - self.truth) <= 2 * self.sigma


@dataclass(frozen=True)
class Row:
    """Figures of a site."""

    site: str
    nights: int
    things: int
    switches: int
    """Nights on which a thing that stands has another id than on the last night on which it was found."""
    splits: int
    """Nights and things with more than one id."""
    false: float
    """Changes that are none, per night."""
    missed: int
    """Things above `LARGE_M3` that were never found."""
    holds: float
    """Share of the intervals of things that contain the truth."""
    site_holds: float
    """Share of those of the site's gained and lost volumes."""
    in_two_sigma: float
    """Share of all these volumes within two standard deviations."""
    width: float
    """Median width of the intervals of things, as a share of the truth."""
    still_sigma: float
    """Median standard deviation of gained and lost volumes on nights without changes, m³."""
    cpu_share: float
    """Share of a night's CPU time, median."""


def truth_of(folder: Path) -> dict[str, list[dict[str, Any]]]:
    """True changes against the first night, by date."""
    nights = json.loads((folder / "truth" / "nights.json").read_text())["nights"]
    return {night["date"]: night["changes"] for night in nights}


def nights_of(folder: Path) -> Iterator[tuple[str, Changes, float]]:
    """The changes of each night but the first: date, changes, and the share of the night's CPU time that they take."""
    site = wbflow.load_site(folder)
    by_date = {}
    for name in site.work_folder.run_ids():
        run = wbflow.open_run(site, name)
        if run.record.cloud is not None:
            by_date[str(run.record.date)] = run
    dates = sorted(by_date)
    first = night_of(by_date[dates[0]].folder)
    previous = None
    for date in dates[1:]:
        night = night_of(by_date[date].folder)
        begun = time.process_time()
        previous = find_changes(**night.arguments(), **first.arguments("reference_"), previous=previous)
        seconds = time.process_time() - begun
        others = [spent.cpu for stage, spent in by_date[date].record.seconds.stages.items() if stage != CHANGES]
        yield date, previous, seconds / (seconds + sum(others))


def is_thing(change: Change, true: Mapping[str, Any]) -> bool:
    """Is a change this true one?"""
    if change.kind != KINDS[true["kind"]]:
        return False
    place = true.get("to") or true["from"]
    distance = np.hypot(change.x - place["position"][0], change.y - place["position"][1])
    return bool(distance <= NEAR_SHARE * max(true["size"]))


def row_of(folder: Path) -> Row:
    """Compare all nights of a site with the truth."""
    truth = truth_of(folder)
    things: dict[tuple[str, int], Thing] = {}
    intervals: list[Interval] = []
    whole: list[Interval] = []
    still: list[float] = []
    shares = []
    switches = 0
    false = 0
    for date, found, share in nights_of(folder):
        shares.append(share)
        matched: set[str] = set()
        for true in truth[date]:
            thing = things.setdefault((true["name"], since(true)), Thing(true["name"], true["volume_m3"]))
            ids = [change.id for change in found.changes.values() if is_thing(change, true)]
            matched |= set(ids)
            if not ids:
                thing.missed += 1
                continue
            thing.split += len(ids) - 1
            own = thing.ids[-1] if thing.ids and thing.ids[-1] in ids else ids[0]
            if thing.ids and thing.ids[-1] != own:
                switches += 1
            thing.ids.append(own)
            change = found.changes[own]
            intervals.append(
                Interval(change.volume_least, change.volume_most, change.volume, change.volume_sigma, true["volume_m3"])
            )
            print(f"  {date} {own} {line_of(change)}  truth {true['name']} {true['volume_m3']:.1f}", flush=True)
        for change in found.changes.values():
            if change.id not in matched:
                false += 1
                print(f"  {date} {change.id} {line_of(change)}  false", flush=True)
        part = found.cut_fill
        if part is not None:
            gained, lost = true_volumes(truth[date])
            whole.append(Interval(part.gained_least, part.gained_most, part.gained, part.gained_sigma, gained))
            whole.append(Interval(part.lost_least, part.lost_most, part.lost, part.lost_sigma, lost))
            if not truth[date]:
                still += [part.gained_sigma, part.lost_sigma]
    return Row(
        site=folder.name,
        nights=len(shares),
        things=len(things),
        switches=switches,
        splits=sum(thing.split for thing in things.values()),
        false=false / max(1, len(shares)),
        missed=sum(not thing.ids and thing.volume > LARGE_M3 for thing in things.values()),
        holds=share_of([interval.holds for interval in intervals]),
        site_holds=share_of([interval.holds for interval in whole]),
        in_two_sigma=share_of([interval.in_two_sigma for interval in [*intervals, *whole]]),
        width=float(np.median([(i.most - i.least) / i.truth for i in intervals])) if intervals else float("nan"),
        still_sigma=float(np.median(still)) if still else float("nan"),
        cpu_share=float(np.median(shares)),
    )


def since(true: Mapping[str, Any]) -> int:
    """The first night of a true change: what comes back is another one."""
    if "to" in true:
        return int(true["to"]["nights"][0])
    return 1 + int(true["from"]["nights"][1])


def true_volumes(changes: Sequence[Mapping[str, Any]]) -> tuple[float, float]:
    """Volumes gained and lost by true changes."""
    gained = sum(true["volume_m3"] for true in changes if true["kind"] != "vanished")
    lost = sum(true["volume_m3"] for true in changes if true["kind"] != "appeared")
    return gained, lost


def line_of(change: Change) -> str:
    """A change in a few words."""
    seen = "" if change.seen else " unseen"
    size = f"{change.length:.1f} x {change.width:.1f} x {change.height:.1f}"
    volume = f"{change.volume:.1f} ± {change.volume_sigma:.1f} [{change.volume_least:.1f}, {change.volume_most:.1f}]"
    return f"{change.kind}{seen} {size} at {change.x:.1f}, {change.y:.1f}: {volume}"


def share_of(values: Sequence[bool]) -> float:
    """Share of True; nan without any value."""
    return float(np.mean(values)) if values else float("nan")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("nights", type=Path, nargs="+")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    rows = []
    for folder in arguments.nights:
        print(folder.name)
        rows.append(row_of(folder))
    print("site        nights things switches splits false/night missed  holds  site  2 sigma  width  still sigma  CPU")
    for row in rows:
        counts = f"{row.nights:6d} {row.things:6d} {row.switches:8d} {row.splits:6d} {row.false:11.2f} {row.missed:6d}"
        shares = f"{row.holds:6.0%} {row.site_holds:5.0%} {row.in_two_sigma:8.0%} {row.width:6.2f} {row.still_sigma:12.2f}"
        print(f"{row.site:11s} {counts} {shares} {row.cpu_share:4.1%}")
    if arguments.json:
        write_rows(rows, list(vars(rows[0])), arguments.json)


if __name__ == "__main__":
    main()
