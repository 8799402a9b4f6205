"""Tables of `bench_verdict.py`: leave-one-scene-out results, reliability of the probability, and random small sites."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from verdict_fit import TERMS, LabelledPair, LabelledSet, Weights, fit, is_usable
from verdict_scenes import SETS, labelled, scene_of, symmetry
from verdict_site import LEAST_SCORE, averaged_turn_deg, in_use, loop_statistics, site_accepts, solved_poses, solved_turn_deg

from wbflow_stages.sfm.loops import LoopStatistics
from wbflow_stages.twoview.pair_score import probability
from wbflow_stages.types import Float64s

MOST_WRONG, LEAST_KEPT = 0.01, 0.9
"""`--check` limits for each set: largest share of wrong pairs in the solved site, smallest share of usable pairs kept in it."""
MOST_BIN_ERROR, LEAST_BIN_PAIRS = 0.05, 30
"""`--check` limit for p: largest difference of its mean to the share of right pairs, in bins of at least `LEAST_BIN_PAIRS`."""
TURNED_DEG = 3.0
DRAWS, SITE_SIZES = 20, (2, 3, 4, 6)


@dataclass(frozen=True)
class Fitted:
    """The weights and statistics fitted on some scenes, to judge others."""

    weights: Weights
    statistics: LoopStatistics


@dataclass(frozen=True)
class Row:
    """Counts for one set; kept and accepted: by the pair's score; site_*: by the solved site."""

    name: str
    pairs: int
    usable: int
    kept: int
    wrong: int
    accepted: int
    wrong_accepted: int
    site_kept: int
    site_accepted: int
    site_wrong: int

    def meets_limits(self) -> bool:
        return self.site_wrong <= MOST_WRONG * self.site_accepted and self.site_kept >= LEAST_KEPT * self.usable


def leave_one_out(cache: Path, to_json: Path | None, plot: Path | None, check: bool) -> int:
    """Print all tables; returns 1 if `check` is given and a limit is exceeded, else 0."""
    all_of = {name: labelled(name, cache) for name in SETS}
    sets = {name: list(one.pairs) for name, one in all_of.items()}
    others = {scene: fitted({n: p for n, p in sets.items() if scene_of(n) != scene}) for scene in {scene_of(n) for n in sets}}
    rows, probabilities = [], []
    print("set               pairs usable  kept  wrong accepted(wrong)  site: kept accepted(wrong)")
    for name, pairs in sets.items():
        row = _row(name, all_of[name], others[scene_of(name)])
        rows.append(row)
        probabilities += [probability(s) for s in others[scene_of(name)].weights.scores(pairs)]
        print(
            f"{row.name:18}{row.pairs:5}{row.usable:7}{row.kept:6}{row.wrong:7}{row.accepted:9} ({row.wrong_accepted:2})"
            f"{row.site_kept:16}{row.site_accepted:9} ({row.site_wrong:2})", flush=True,
        )  # fmt: skip
    bins = reliability(np.array(probabilities), [pair for pairs in sets.values() for pair in pairs])
    print("\np         pairs  mean  right  (with copies of a building counted as right)")
    for b in bins:
        print(f"{b.begins:.1f} to {b.begins + 0.1:.1f}{b.pairs:6}{b.mean_probability:6.2f}{b.right:7.2f}{b.right_or_copy:7.2f}")
    print(f"\n{DRAWS} random sites of some cameras: with a camera turned by over {TURNED_DEG:g} degrees (of them: where each")
    print("camera is an exact copy of the true one, so that the images are those of a right site), and without any camera")
    turned = {name: small_sites(name, all_of[name], others[scene_of(name)]) for name in sets if name != "nothing"}
    _print_fit(fitted(sets))
    if to_json:
        to_json.write_text(json.dumps([vars(row) for row in rows], indent=1))
    if plot:
        draw(bins, plot)
    missed = [r for r in rows if not r.meets_limits()]
    exceeded = [f"{r.name}: {r.site_wrong} wrong of {r.site_accepted}, {r.site_kept} of {r.usable} kept" for r in missed]
    off = [b for b in bins if not b.meets_limits()]
    exceeded += [f"p from {b.begins:.1f}: mean {b.mean_probability:.2f}, right {b.right:.2f}" for b in off]
    exceeded += [f"{name}: {count} small sites with a turned camera" for name, count in turned.items() if count]
    if check:
        print("\nlimits exceeded:" if exceeded else "\nall limits are met", *exceeded, sep="\n  ")
    return int(check and bool(exceeded))


def fitted(sets: Mapping[str, list[LabelledPair]]) -> Fitted:
    """Fit weights and statistics on these sets."""
    weights = fit([pair for pairs in sets.values() for pair in pairs])
    return Fitted(weights, loop_statistics(sets))


def _print_fit(found: Fitted) -> None:
    print("\nfitted on all:", *(f"{t.name}: {w:.2f}" for t, w in zip(TERMS, found.weights.terms, strict=True)), sep="\n  ")
    print(f"  offset: {found.weights.offset:.2f}\n  {found.statistics}")


def _row(name: str, of: LabelledSet, by: Fitted) -> Row:
    pairs = list(of.pairs)
    scores = by.weights.scores(pairs)
    usable, wrong, accepted = np.array([p.usable for p in pairs]), np.array([p.wrong for p in pairs]), scores > 0
    poses = None if name == "nothing" else solved_poses(pairs, scores, by.statistics)
    kept, kept_wrong = in_use(pairs, poses, of.cameras)
    counts = (usable, usable & accepted, wrong, accepted, wrong & accepted, usable & kept, kept, kept_wrong)
    return Row(name, len(pairs), *(int(c.sum()) for c in counts))


def small_sites(name: str, of: LabelledSet, by: Fitted) -> int:
    """Print a row about random subsets of the cameras, and return how many of these sites end with a turned camera.

    Solving takes minutes, so a site is solved only if averaging the rotations of its accepted pairs already gives a turned
    camera.
    """
    rng = np.random.default_rng(0)
    turns = symmetry(name)
    cameras = sorted({camera for p in of.pairs for camera in (p.left, p.right)})
    total, words = 0, []
    for size in (s for s in SITE_SIZES if s <= len(cameras)):
        turned = copies = empty = 0
        for _ in range(DRAWS):
            chosen = set(rng.choice(cameras, size, replace=False).tolist())
            mine = [p for p in of.pairs if {p.left, p.right} <= chosen]
            scores = by.weights.scores(mine)
            kept = site_accepts(mine, scores, by.statistics)
            some = [p for p, yes in zip(mine, kept, strict=True) if yes]
            empty += not some
            if averaged_turn_deg(some, of.cameras) <= TURNED_DEG or (poses := solved_poses(mine, scores, by.statistics)) is None:
                continue
            if solved_turn_deg(poses, of.cameras, turns[:1]) > TURNED_DEG:
                turned += 1
                copies += solved_turn_deg(poses, of.cameras, turns) <= TURNED_DEG
        total += turned
        words.append(f"{size} cameras {turned:2} ({copies:2}) and {empty:2}")
    print(f"{name:18}" + "; ".join(words), flush=True)
    return total


@dataclass(frozen=True)
class Bin:
    """A tenth of p: its lower end, number of pairs, their mean p, share right, and share right if symmetric copies count."""

    begins: float
    pairs: int
    mean_probability: float
    right: float
    right_or_copy: float

    def meets_limits(self) -> bool:
        return self.pairs < LEAST_BIN_PAIRS or abs(self.mean_probability - self.right) <= MOST_BIN_ERROR


def reliability(probabilities: Float64s, pairs: list[LabelledPair]) -> list[Bin]:
    """The tenths of p that contain pairs; pairs with scores below `LEAST_SCORE` are left out."""
    tenth = np.minimum((probabilities * 10).astype(int), 9)
    right = np.array([[p.usable, is_usable(p.error_of_copy_deg)] for p in pairs])
    seen = probabilities >= probability(LEAST_SCORE)
    found = []
    for k in np.unique(tenth[seen]).tolist():
        mine = seen & (tenth == k)
        strict, copies = right[mine].mean(axis=0).tolist()
        found.append(Bin(k / 10, int(mine.sum()), float(probabilities[mine].mean()), strict, copies))
    return found


def draw(bins: list[Bin], file: Path, size: int = 480) -> None:
    """Plot the share of right pairs (up) against p (right); dots grow with the number of pairs; the grey band is the limit."""
    picture = np.full((size, size, 3), 255, np.uint8)

    def at(p: float, share: float) -> tuple[int, int]:
        return round(p * (size - 1)), round((1 - share) * (size - 1))

    band = [at(0, -MOST_BIN_ERROR), at(1, 1 - MOST_BIN_ERROR), at(1, 1 + MOST_BIN_ERROR), at(0, MOST_BIN_ERROR)]
    cv2.fillPoly(picture, [np.array(band, np.int32)], (220, 220, 220))
    for k in range(11):
        cv2.line(picture, at(k / 10, 0), at(k / 10, 0.015), (0, 0, 0))
        cv2.line(picture, at(0, k / 10), at(0.015, k / 10), (0, 0, 0))
    for each in bins:
        cv2.circle(picture, at(each.mean_probability, each.right), 3 + round(each.pairs**0.5), (160, 60, 0), -1, cv2.LINE_AA)
    cv2.imwrite(str(file), picture)
