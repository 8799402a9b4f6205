#!/usr/bin/env python3
"""Are right pairs accepted and wrong ones rejected?  Each scene is judged by a score that was fitted on the other scenes.

Without --sets, the pairs of photographed and rendered scenes are labelled by the truth (`verdict_scenes`).  The tables give, for
each scene, usable pairs kept and wrong pairs accepted, by the pair's score alone and by the solved site; the reliability of the
probability p in ten bins; random small sites that end with a wrongly turned camera; and the weights of a fit on all scenes.

With --sets, pairs are matched anew and judged by the current weights.  Three sets have no right pair: the first five views of
fountain with entry (the other views show entry's facade), the demo's walls with entry, and mirrored images.

    scripts/bench_verdict.py --plot reliability.png --check
    scripts/bench_verdict.py --sets fountain-768 walls sites
    scripts/bench_verdict.py --cache DIR       keeps renderings and pairs in DIR (default: in the temporary folder)
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import asdict, dataclass, replace
from itertools import combinations, product
from pathlib import Path
from time import process_time

import numpy as np
from pairs_with_truth import TrueView, correct, on_one_thread, photographed, pose_error_deg, rendered, walls
from verdict_table import leave_one_out

from wbflow_stages.core.rotations import angle_between_deg
from wbflow_stages.geometry import estimate_geometry
from wbflow_stages.matches import match
from wbflow_stages.sfm.loops import LEAST_SCORE_UNCONFIRMED, check_loops
from wbflow_stages.twoview.robust import pose_of_fundamental
from wbflow_stages.types import Frame, Geometry, Matches, Pair

SETS = (
    "fountain-768", "entry-768", "fountain-1536", "entry-1536", "yard", "walls", "nothing", "nothing-walls", "mirrored",
    "fountain-768-noK", "entry-768-noK", "walls-noK", "sites",
)  # fmt: skip
MAX_ROTATION_DEG, MAX_TRANSLATION_DEG, MIN_CORRECT = 5.0, 10.0, 0.35


@dataclass(frozen=True)
class Judged:
    """A pair with its geometry, and whether the geometry is right."""

    pair: Pair
    geometry: Geometry
    right: bool


@dataclass(frozen=True)
class Result:
    """Counts for one set of pairs; kept and accepted: by the pair's score alone; site_*: after the site's `check_loops`."""

    name: str
    pairs: int
    right: int
    right_kept: int
    wrong: int
    wrong_accepted: int
    wrong_alone: int
    site_kept: int
    site_accepted: int
    cpu_s: float


def judge(left: TrueView, right: TrueView, known: bool, related: bool) -> Judged | None:
    """Match a pair and label it; None if matching or geometry reject it."""
    f, g = (left.features, right.features) if known else (left.without_lens(), right.without_lens())
    matches = match(f, g)
    if not isinstance(matches, Matches):
        return None
    geometry = estimate_geometry(matches, f, g)
    if not isinstance(geometry, Geometry):
        return None
    return Judged((left.name, right.name), geometry, related and is_right(left, right, geometry))


def is_right(left: TrueView, right: TrueView, geometry: Geometry) -> bool:
    R, t = geometry.cam2_R_cam1, geometry.cam2_t_cam1
    if R is None:  # without K: decompose F with the true intrinsics
        pose = pose_of_fundamental(geometry.F, geometry.x1, geometry.x2, left.features.view, right.features.view)
        R, t = pose if pose is not None else (None, None)
    rotation, translation = pose_error_deg(left.camera, right.camera, R, t)
    # without K, the F of a nearly flat facade determines the pose poorly even if its matches are right: judge those by depth
    posed = geometry.cam2_R_cam1 is not None
    if (rotation > MAX_ROTATION_DEG and (posed or left.depth is None)) or (translation > MAX_TRANSLATION_DEG and posed):
        return False
    good, judged = correct(left, right, geometry.x1, geometry.x2)
    return good >= MIN_CORRECT * judged


def mirrored(view: TrueView) -> TrueView:
    frame = view.frame
    flipped = Frame(np.ascontiguousarray(frame.image[:, ::-1]), np.ascontiguousarray(frame.mask[:, ::-1]), frame.view)
    return replace(view, name=f"{view.name}-mirrored", frame=flipped)


def pairs_of(name: str, cache: Path) -> tuple[list[tuple[TrueView, TrueView]], bool]:
    """The pairs of a set, and whether any of them can be right (show the same scene)."""
    scene = name.split("-")[0]
    if name == "nothing":
        some = photographed("fountain", 768, list("01234"))
        return list(product(some.values(), photographed("entry", 768).values())), False
    if name == "nothing-walls":
        return list(product(list(photographed("entry", 768).values())[::3], list(walls(cache).values())[::2])), False
    if name == "mirrored":
        views = list(photographed("entry", 768).values())[::2] + list(walls(cache).values())[::4]
        return [(a, mirrored(b)) for a, b in combinations(views, 2) if a.scene == b.scene], False
    if scene == "walls":
        return list(combinations(walls(cache).values(), 2)), True
    if scene == "yard":
        return list(combinations(rendered("day", cache).values(), 2)), True
    return list(combinations(photographed(scene, int(name.split("-")[1])).values(), 2)), True


def measure(name: str, cache: Path) -> tuple[Result, list[Judged]]:
    pairs, related = pairs_of(name, cache)
    for view in {id(v): v for pair in pairs for v in pair}.values():
        _ = view.features
    start = process_time()
    found = [judge(a, b, not name.endswith("noK"), related) for a, b in pairs]
    seconds = (process_time() - start) / max(len(pairs), 1)
    judged = [j for j in found if j is not None]
    checks = check_loops({j.pair: j.geometry for j in judged}) if related else {}
    accepted = {pair for pair, check in checks.items() if check.rejected is None}
    right, wrong = [j for j in judged if j.right], [j for j in judged if not j.right]
    result = Result(
        name, len(pairs), len(right), sum(j.geometry.score > 0 for j in right), len(wrong),
        sum(j.geometry.score > 0 for j in wrong), sum(j.geometry.score > LEAST_SCORE_UNCONFIRMED for j in wrong),
        sum(j.pair in accepted for j in right), sum(j.pair in accepted for j in wrong), seconds,
    )  # fmt: skip
    return result, judged


def line(r: Result) -> str:
    return (
        f"{r.name:18}{r.pairs:6}{r.right:7}{r.right_kept:6}{r.wrong:7}{r.wrong_accepted:9}{r.wrong_alone:7}"
        f"{r.site_kept:11}{r.site_accepted:9}{r.cpu_s:9.2f}"
    )


HEAD = "set                pairs  right  kept  wrong accepted  alone site: kept accepted cpu/pair"


def small_sites(name: str, judged: list[Judged], views: dict[str, TrueView], draws: int = 100) -> None:
    """Print, for random subsets of the cameras, how many sites end with a turned camera and how many right pairs are lost."""
    rng = np.random.default_rng(0)
    geometries, right = {j.pair: j.geometry for j in judged}, {j.pair for j in judged if j.right}
    for size in (3, 5, 8):
        turned, lost, usable, sites = 0, 0, 0, 0
        for _ in range(draws):
            if size > len(views):
                break
            chosen = set(rng.choice(list(views), size, replace=False).tolist())
            mine = {pair: g for pair, g in geometries.items() if set(pair) <= chosen}
            accepted = {pair for pair, check in check_loops(mine).items() if check.rejected is None}
            sites += 1
            turned += worst_turn_deg(accepted, geometries, views) > MAX_ROTATION_DEG
            usable += len(right & set(mine))
            lost += len((right & set(mine)) - accepted)
        print(f"{name}, {size} cameras: {turned} of {sites} sites with a turned camera; {lost} of {usable} usable pairs lost")


def worst_turn_deg(accepted: set[Pair], geometries: dict[Pair, Geometry], views: dict[str, TrueView]) -> float:
    """The largest rotation error of an accepted pair: any accepted pair may determine a camera's rotation."""
    errors = [0.0]
    for a, b in accepted:
        R = geometries[a, b].cam2_R_cam1
        if R is not None:
            true_R = views[b].camera.R @ views[a].camera.R.T
            errors.append(angle_between_deg(true_R, R))
    return max(errors)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="+", choices=list(SETS), help="only measure these, with the current weights")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()) / "wbflow-bench")
    parser.add_argument("--json", type=Path, help="write the rows as JSON objects")
    parser.add_argument("--plot", type=Path, help="draw the reliability of the probability into this PNG")
    parser.add_argument("--check", action="store_true", help="exit 1 unless all limits are met on every scene")
    given = parser.parse_args()
    on_one_thread()
    if not given.sets:
        return leave_one_out(given.cache, given.json, given.plot, given.check)
    print(HEAD)
    results: list[Result] = []
    known: dict[str, tuple[Result, list[Judged]]] = {}
    for name in given.sets:
        if name == "sites":
            for scene, views in (("yard", rendered("day", given.cache)), ("walls", walls(given.cache))):
                judged = known[scene][1] if scene in known else measure(scene, given.cache)[1]
                small_sites(scene, judged, views)
            continue
        result, _ = known[name] = measure(name, given.cache)
        results.append(result)
        print(line(result), flush=True)
    if given.json:
        given.json.write_text(json.dumps([asdict(r) for r in results], indent=1))
    return 0


if __name__ == "__main__":
    sys.exit(main())
