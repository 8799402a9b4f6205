"""Tables of `bench_verdict.py`: each scene left out of the fit in turn, reliability, and random small sites."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from verdict_fit import LabelledPair, fit, is_usable
from verdict_scenes import SETS, labelled, scene_of

from wbflow_stages.sfm.loops import check_loops
from wbflow_stages.twoview.pair_score import TERMS, pair_score, probability
from wbflow_stages.twoview.rivals import Rival
from wbflow_stages.types import Bools, Float64s, Geometry, View

MOST_WRONG, LEAST_KEPT = 0.01, 0.9
"""Promised of every scene: share of wrong pairs among the accepted, and of usable ones that are kept."""
RELIABLE, BIN_OF = 0.05, 30
"""Promised of p: so near to the share that is right, in bins with so many pairs."""
TURNED_DEG = 3.0
DRAWS, SITE_SIZES = 20, (2, 3, 4, 6)
LEAST_SCORE = -4.0
"""Pairs below do not reach the site (`estimate_geometry`)."""


@dataclass(frozen=True)
class Row:
    """One set: kept and accepted by the score of the pair, fitted on other scenes; site_*: after the site's check."""

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

    def holds(self) -> bool:
        return self.site_wrong <= MOST_WRONG * self.site_accepted and self.site_kept >= LEAST_KEPT * self.usable


def leave_one_out(cache: Path, to_json: Path | None, plot: Path | None, check: bool) -> int:
    """Print all tables; 1 if `check` is asked for and a promise is broken."""
    sets = {name: labelled(name, cache) for name in SETS}
    rows, every, scores = [], [], []
    print("set               pairs usable  kept  wrong accepted(wrong)  site: kept accepted(wrong)")
    for name, pairs in sets.items():
        others = [p for other, some in sets.items() if scene_of(other) != scene_of(name) for p in some]
        own = fit(others).scores(pairs)
        row = _row(name, pairs, own)
        rows.append(row)
        every += pairs
        scores.append(own)
        print(
            f"{row.name:18}{row.pairs:5}{row.usable:7}{row.kept:6}{row.wrong:7}{row.accepted:9} ({row.wrong_accepted:2})"
            f"{row.site_kept:16}{row.site_accepted:9} ({row.site_wrong:2})", flush=True,
        )  # fmt: skip
    said = np.array([probability(s) for s in np.concatenate(scores)])
    bins = reliability(said, every)
    print("\np         pairs  said  right  (with copies of a building counted as right)")
    for b in bins:
        print(f"{b.begins:.1f} to {b.begins + 0.1:.1f}{b.pairs:6}{b.said:6.2f}{b.right:7.2f}{b.right_or_copy:7.2f}")
    print(f"\n{DRAWS} random sites of some cameras: with a pair turned by over {TURNED_DEG:g} degrees, and without any pair")
    turned = {name: small_sites(name, pairs) for name, pairs in sets.items() if name != "nothing"}
    weights = fit(every)
    print("\nweights of a fit on all:", *(f"{t.name}: {w:.2f}" for t, w in zip(TERMS, weights.terms, strict=True)), sep="\n  ")
    print(f"  offset: {weights.offset:.2f}")
    if to_json:
        to_json.write_text(json.dumps([vars(row) for row in rows], indent=1))
    if plot:
        draw(bins, plot)
    missed = [r for r in rows if not r.holds()]
    broken = [f"{r.name}: {r.site_wrong} wrong of {r.site_accepted}, {r.site_kept} of {r.usable} kept" for r in missed]
    broken += [f"p from {b.begins:.1f}: said {b.said:.2f}, right {b.right:.2f}" for b in bins if not b.holds()]
    broken += [f"{name}: {count} small sites with a turned camera" for name, count in turned.items() if count]
    if check:
        print("\nbroken promises:" if broken else "\nall promises hold", *broken, sep="\n  ")
    return int(check and bool(broken))


def _row(name: str, pairs: list[LabelledPair], scores: Float64s) -> Row:
    usable, wrong = np.array([p.usable for p in pairs]), np.array([p.wrong for p in pairs])
    believed = np.zeros(len(pairs), bool) if name == "nothing" else site(pairs)
    accepted = scores > 0
    counts = (usable, usable & accepted, wrong, accepted, wrong & accepted, usable & believed, believed, wrong & believed)
    return Row(name, len(pairs), *(int(c.sum()) for c in counts))


def site(pairs: list[LabelledPair]) -> Bools:
    """(n,) which pairs of a site the site believes, by the weights of the product."""
    geometries = {(p.left, p.right): g for p in pairs if (g := _geometry(p)).score >= LEAST_SCORE}
    checks = check_loops(geometries)
    return np.array([(p.left, p.right) in checks and checks[p.left, p.right].rejected is None for p in pairs], bool)


def _geometry(pair: LabelledPair) -> Geometry:
    """What the check of a site looks at."""
    e, nothing, bare = pair.evidence, np.zeros((0, 2)), View(1, 1)
    score = pair_score(e, pair.contradicted)
    rival = e.rival or Rival(0, 0, float("nan"))
    return Geometry(
        F=np.eye(3), x1=nothing, x2=nothing, i1=None, i2=None, probability=np.zeros(0, np.float32), view1=bare, view2=bare,
        cam2_R_cam1=pair.R, cam2_t_cam1=pair.t, matches=e.inliers, inliers=e.inliers, model="E", epipolar_px=0.0,
        angle_deg=e.angle_deg, homography_share=0.0, score=score, good_probability=probability(score),
        distinct_cells=e.distinct_cells, rival_elsewhere=rival.elsewhere, rival_turned_deg=rival.turned_deg,
    )  # fmt: skip


def small_sites(name: str, pairs: list[LabelledPair]) -> int:
    """Random subsets of the cameras: how many sites end with a turned camera; any believed pair may be what one is hung on."""
    rng = np.random.default_rng(0)
    cameras = sorted({camera for p in pairs for camera in (p.left, p.right)})
    total, words = 0, []
    for size in (s for s in SITE_SIZES if s <= len(cameras)):
        turned = empty = 0
        for _ in range(DRAWS):
            chosen = set(rng.choice(cameras, size, replace=False).tolist())
            mine = [p for p in pairs if {p.left, p.right} <= chosen]
            believed = [p for p, yes in zip(mine, site(mine), strict=True) if yes]
            turned += any(p.error_deg[0] > TURNED_DEG for p in believed)
            empty += not believed
        total += turned
        words.append(f"{size} cameras {turned:2} and {empty:2}")
    print(f"{name:18}" + "; ".join(words))
    return total


@dataclass(frozen=True)
class Bin:
    """A tenth of p: where it begins, its pairs, their mean p, the share that is right, and that with copies counted as right."""

    begins: float
    pairs: int
    said: float
    right: float
    right_or_copy: float

    def holds(self) -> bool:
        return self.pairs < BIN_OF or abs(self.said - self.right) <= RELIABLE


def reliability(said: Float64s, pairs: list[LabelledPair]) -> list[Bin]:
    """The tenths of p that have pairs."""
    tenth = np.minimum((said * 10).astype(int), 9)
    right = np.array([[p.usable, is_usable(p.error_of_copy_deg)] for p in pairs])
    found = []
    for k in np.unique(tenth).tolist():
        mine = tenth == k
        strict, copies = right[mine].mean(axis=0).tolist()
        found.append(Bin(k / 10, int(mine.sum()), float(said[mine].mean()), strict, copies))
    return found


def draw(bins: list[Bin], file: Path, size: int = 480) -> None:
    """Share right (up) against p (right), the area of a dot as the number of pairs; grey: what is promised."""
    picture = np.full((size, size, 3), 255, np.uint8)

    def at(p: float, share: float) -> tuple[int, int]:
        return round(p * (size - 1)), round((1 - share) * (size - 1))

    band = [at(0, -RELIABLE), at(1, 1 - RELIABLE), at(1, 1 + RELIABLE), at(0, RELIABLE)]
    cv2.fillPoly(picture, [np.array(band, np.int32)], (220, 220, 220))
    for k in range(11):
        cv2.line(picture, at(k / 10, 0), at(k / 10, 0.015), (0, 0, 0))
        cv2.line(picture, at(0, k / 10), at(0.015, k / 10), (0, 0, 0))
    for each in bins:
        cv2.circle(picture, at(each.said, each.right), 3 + round(each.pairs**0.5), (160, 60, 0), -1, cv2.LINE_AA)
    cv2.imwrite(str(file), picture)
