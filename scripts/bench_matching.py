#!/usr/bin/env python3
"""Compare matchers on photographed pairs with truth: fountain (laser depth) and entry (known cameras).

Rows: kdtree, kdtree-root, mutual, hao2011-dominance, structural (plain views), structural-tilt (adds views compressed in x),
aliked and sift-aliked (structural on learned keypoints, and on both kinds); each as matched, and (+F) after the guided round.
Columns: matches, correct ones and precision at 3 px (at width 1536); mean symmetric epipolar distance of F on true
correspondences, with K unknown; ok if that is below 0.2 % of the width; rotation and translation error with K known; CPU seconds
without keypoints.

The rival is Lowe's matching (ratio 0.8, randomised kd-trees of FLANN, 200 checks), in two rows.  `kdtree` is what OpenCV offers
on the same photographs: all keypoints and descriptors of its SIFT with default settings.  `kdtree-root` is the harder rival: it
matches the keypoints and RootSIFT descriptors of the other rows, so any gain over it comes from matching alone.

`lightglue` is DISK with LightGlue; it is left out with a message unless a package with its weights is installed (see
lightglue_rival.py).  `onnx` runs the model that --onnx names, with the matcher `onnx`.  Both bring their own keypoints, so their
rows (+F) have the same geometry without a guided round.  `aliked` takes the file that `wbflow models get aliked-n32` downloads,
or the one that --aliked names (COLMAP's, or what aliked_onnx.py writes), and is left out without it.

    scripts/bench_matching.py --scenes fountain --pairs 5-4 5-9
    scripts/bench_matching.py --matchers kdtree structural lightglue
    scripts/bench_matching.py --json rows.json --plot rates.svg
    scripts/bench_matching.py --check          a small set with thresholds, for CI
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from statistics import mean
from time import process_time
from typing import Any

import lightglue_rival
import numpy as np
from bench_files import exit_status
from pairs_with_truth import TrueView, axes_angle_deg, correct, on_one_thread, photographed, pose_error_deg, true_correspondences

from wbflow.site.published_models import PUBLISHED_MODELS
from wbflow_stages.contracts.reasons import usable
from wbflow_stages.core.epipolar import symmetric_epipolar_distance
from wbflow_stages.features import detect
from wbflow_stages.geometry import estimate_geometry
from wbflow_stages.matches import match
from wbflow_stages.types import Capture, Features, Geometry, Matches, Rejected

PLAIN_SIFT = "kdtree"
"""The row that matches OpenCV's own features."""
MATCHERS: dict[str, dict[str, Any]] = {
    "kdtree": {"matcher": "kdtree"},
    "kdtree-root": {"matcher": "kdtree"},
    "mutual": {"matcher": "mutual"},
    "hao2011-dominance": {"matcher": "hao2011-dominance"},
    "structural": {"tilt": "never"},
    "structural-tilt": {"tilt": "always"},
    "lightglue": {"matcher": "lightglue"},
    "onnx": {"matcher": "onnx"},
    "aliked": {},
    "sift-aliked": {},
}
LEARNED = {"aliked": "onnx", "sift-aliked": "sift+onnx"}
"""The detector of each row with learned keypoints."""
SWEEP = {
    "fountain": "5-4 5-3 5-2 5-1 5-0 5-6 5-7 5-8 5-9 5-10 0-4 2-7 3-9 2-9 1-9 0-9 0-10",
    "entry": "0-1 0-2 0-3 0-5 0-7 0-9 4-9 2-7",
}
CHECKED = ["kdtree", "kdtree-root", "structural", "structural-tilt"]
CHECK = {"fountain": "5-4 5-1 5-9 2-9"}
USABLE_SHARE = 0.002


@dataclass(frozen=True)
class Row:
    """One pair, one matcher.  Errors of a missing pose are 180 degrees, the error of a missing F is infinite."""

    scene: str
    pair: str
    angle_deg: float
    matcher: str
    matches: float
    correct: float
    precision: float
    f_error_px: float
    usable: float
    rotation_deg: float
    translation_deg: float
    cpu_s: float


@dataclass(frozen=True)
class Keypoints:
    """The keypoints of views; learned ones are searched once a view."""

    model: Capture | None
    """The file of ALIKED."""
    _found: dict[tuple[str, str, int, str], Features] = field(default_factory=dict)

    def of(self, view: TrueView, row: str) -> Features:
        """The keypoints of a view for a row."""
        if row == PLAIN_SIFT:
            return view.plain_sift
        if row not in LEARNED:
            return view.features
        key = (view.scene, view.name, view.camera.width, row)
        if key not in self._found:
            self._found[key] = usable(detect(view.frame, model=self.model, detector=LEARNED[row]))
        return self._found[key]


def measure(left: TrueView, right: TrueView, name: str, seed: int, keypoints: Keypoints) -> tuple[Row, Row]:
    """The row as matched, and the row after the guided round."""
    f = keypoints.of(left, name)
    g = keypoints.of(right, name)
    if name == "lightglue":
        lightglue_rival.prepare(left)
        lightglue_rival.prepare(right)
    start = process_time()
    options: dict[str, Any] = {"seed": seed} if MATCHERS[name].get("matcher") == "kdtree" else {}
    if name == "onnx":
        options = {"left_frame": left.frame, "right_frame": right.frame}
    matches = lightglue_rival.match_lightglue(left, right) if name == "lightglue" else match(f, g, **options, **MATCHERS[name])
    seconds = process_time() - start
    return judge(left, right, f, g, name, matches, False, seed, seconds), judge(
        left, right, f, g, name, matches, True, seed, seconds
    )


def judge(
    left: TrueView, right: TrueView, f: Features, g: Features, name: str, matches: Matches | Rejected, guided: bool, seed: int,
    seconds: float,
) -> Row:  # fmt: skip
    """One row; seconds: CPU seconds of the matching, to which the +F row adds those of the geometry."""
    geometry = posed = None
    if isinstance(matches, Matches):
        start = process_time()
        geometry = estimate_geometry(without_lenses(matches), lensless(f), lensless(g), guided=guided, seed=seed)
        seconds += process_time() - start if guided else 0
        posed = estimate_geometry(matches, f, g, guided=guided, seed=seed)
    found = geometry if isinstance(geometry, Geometry) else None
    points = found if guided else matches
    n = good = judged = 0
    if isinstance(points, Matches | Geometry):
        n, (good, judged) = len(points.x1), correct(left, right, points.x1, points.x2)
    error = float("inf")
    if found is not None:
        error = float(symmetric_epipolar_distance(found.F, *true_correspondences(left, right)).mean())
    pose = (posed.cam2_R_cam1, posed.cam2_t_cam1) if isinstance(posed, Geometry) else (None, None)
    rotation, translation = pose_error_deg(left.camera, right.camera, *pose)
    return Row(
        left.scene, f"{left.name}-{right.name}", round(axes_angle_deg(left.camera, right.camera), 1),
        name + ("+F" if guided else ""),
        n, good, good / max(judged, 1), error, float(error < USABLE_SHARE * left.camera.width),
        rotation, translation, seconds,
    )  # fmt: skip


def lensless(features: Features) -> Features:
    return replace(features, view=replace(features.view, K=None))


def without_lenses(matches: Matches) -> Matches:
    """The same matches with unknown intrinsics."""
    return replace(matches, view1=replace(matches.view1, K=None), view2=replace(matches.view2, K=None))


def averaged(rows: list[Row]) -> Row:
    """The mean of a row over seeds."""
    first = asdict(rows[0])
    means: dict[str, Any] = {k: v if isinstance(v, str) else mean(asdict(row)[k] for row in rows) for k, v in first.items()}
    return Row(**means)


def bench(
    pairs: dict[str, list[tuple[str, str]]], width: int, seeds: int, names: list[str], keypoints: Keypoints
) -> Iterator[Row]:
    for scene, chosen in pairs.items():
        views = photographed(scene, width, sorted({name for pair in chosen for name in pair}))
        for a, b in chosen:
            for name in names:
                for rows in zip(*(measure(views[a], views[b], name, seed, keypoints) for seed in range(seeds)), strict=True):
                    yield averaged(list(rows))


def warm_up(width: int, names: list[str], keypoints: Keypoints) -> None:
    """Compile the kernels, so that no row includes the time."""
    views = photographed("fountain", min(width, 768), ["4", "5"])
    for name in names:
        measure(views["5"], views["4"], name, 0, keypoints)


def pairs_of(scene: str, asked: list[str]) -> list[tuple[str, str]]:
    if asked == ["all"]:
        count = {"fountain": 11, "entry": 10}[scene]
        return [(str(a), str(b)) for a in range(count) for b in range(a + 1, count)]
    chosen = asked or SWEEP[scene].split()
    return [(a, b) for a, b in (pair.split("-") for pair in chosen)]


HEAD = "scene    pair    deg matcher             matches correct  prec    F px ok     rot  trans   cpu"


def line(row: Row) -> str:
    return (
        f"{row.scene:9}{row.pair:6}{row.angle_deg:5.0f} {row.matcher:19}{row.matches:8.0f}{row.correct:8.0f}{row.precision:6.2f}"
        f"{row.f_error_px:8.2f} {'ok' if row.usable == 1 else '* '} {row.rotation_deg:7.3f} {row.translation_deg:7.3f}"
        f"{row.cpu_s:6.2f}"
    )


def plot(rows: list[Row], file: Path) -> None:
    """Figures 3-28 to 3-30 of Hao (2011) on these pairs, as SVG: matches, good matches, good rate; kd-tree against structural."""
    colours = {"kdtree": "#b0b0b0", "structural": "#3070b0", "structural-tilt+F": "#d07020"}
    order = sorted({(r.scene, r.angle_deg, r.pair) for r in rows})
    step, height, left = 46, 170, 60
    parts = []
    for panel, (column, title) in enumerate((("matches", "matches"), ("correct", "good matches"), ("precision", "good rate"))):
        base = 40 + (panel + 1) * (height + 24)
        found = {(r.scene, r.angle_deg, r.pair, r.matcher): float(getattr(r, column)) for r in rows if r.matcher in colours}
        top = max(found.values(), default=1.0) or 1.0
        parts.append(f'<text x="4" y="{base - height}">{title}</text>')
        parts.append(f'<text x="4" y="{base - height + 14}">{top:.4g}</text>')
        parts.append(f'<path d="M{left} {base}h{step * len(order)}" stroke="black"/>')
        for i, place in enumerate(order):
            for k, (name, colour) in enumerate(colours.items()):
                tall = height * found.get((*place, name), 0.0) / top
                x = left + i * step + 4 + 12 * k
                parts.append(f'<rect x="{x}" y="{base - tall:.1f}" width="11" height="{tall:.1f}" fill="{colour}"/>')
    for i, (scene, angle, pair) in enumerate(order):
        for row, text in enumerate((scene, pair, f"{angle:.0f}°")):
            parts.append(f'<text x="{left + i * step + 4}" y="{base + 14 + 12 * row}">{text}</text>')
    for k, (name, colour) in enumerate(colours.items()):
        parts.append(f'<text x="{left + 150 * k}" y="14" fill="{colour}" font-weight="bold">{name}</text>')
    size = f'width="{left + step * len(order) + 20}" height="{base + 50}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} font-family="sans-serif" font-size="10">'
    file.write_text(head + "".join(parts) + "</svg>")


def check(rows: list[Row]) -> list[str]:
    """Faults against limits a tenth below the measured figures: precision, and correct matches relative to the harder rival."""
    by = {(r.pair, r.matcher): r for r in rows}
    faults = []
    for pair, precision, gain in (("5-4", 0.94, 1.04), ("5-1", 0.90, 1.4), ("5-9", 0.84, 1.8), ("2-9", 0.70, 2.5)):
        plain, kd = by[pair, "structural"], by[pair, "kdtree-root"]
        if plain.precision < precision:
            faults.append(f"{pair}: precision {plain.precision:.3f} of structural, {precision} expected")
        if plain.correct < gain * kd.correct:
            faults.append(f"{pair}: {plain.correct:.0f} correct, {gain} times kd-tree's {kd.correct:.0f} expected")
        wide = by[pair, "structural-tilt+F"]
        if not wide.usable or wide.correct < plain.correct:
            faults.append(f"{pair}: structural-tilt+F has {wide.correct:.0f} correct and an error of {wide.f_error_px:.2f} px")
    return faults


def available(names: list[str], model: Path | None, aliked: Path) -> list[str]:
    """The matchers that can be measured here; prints why the others cannot."""
    absent = {"lightglue": lightglue_rival.why_absent(), "onnx": "" if model else "no --onnx MODEL"}
    if not aliked.is_file():
        absent.update(dict.fromkeys(LEARNED, f"there is no {aliked}"))
    for name in names:
        if absent.get(name):
            print(f"{name}: left out, {absent[name]}")
    if model:
        MATCHERS["onnx"]["model"] = Capture(model.name, np.fromfile(model, np.uint8))
    return [name for name in names if not absent.get(name)]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=["fountain", "entry"], choices=["fountain", "entry"])
    parser.add_argument("--pairs", nargs="+", default=[], help="such as 5-4, or all; default: a sweep of growing angles")
    parser.add_argument("--matchers", nargs="+", default=list(MATCHERS), choices=list(MATCHERS))
    parser.add_argument("--onnx", type=Path, metavar="MODEL", help="the model of the row onnx, see stages/README.md")
    parser.add_argument(
        "--aliked", type=Path, metavar="MODEL", default=PUBLISHED_MODELS["aliked-n32"].path, help="the model of the rows aliked"
    )
    parser.add_argument("--width", type=int, default=1536, help="working width, pixels")
    parser.add_argument("--seeds", type=int, default=3, help="random seeds to average over")
    parser.add_argument("--json", type=Path, help="write the rows as JSON objects")
    parser.add_argument("--plot", type=Path, help="write Hao's three figures on these pairs, as SVG")
    parser.add_argument("--check", action="store_true", help="test a few pairs against limits; exit code 1 if one is exceeded")
    given = parser.parse_args()
    on_one_thread()
    if given.check:
        pairs, given.seeds, given.matchers = {k: pairs_of(k, v.split()) for k, v in CHECK.items()}, 1, CHECKED
    else:
        pairs = {scene: pairs_of(scene, given.pairs) for scene in given.scenes}
    given.matchers = available(given.matchers, given.onnx, given.aliked)
    model = None
    if given.aliked.is_file():
        model = Capture(given.aliked.name, np.fromfile(given.aliked, np.uint8))
    keypoints = Keypoints(model)
    warm_up(given.width, given.matchers, keypoints)
    rows: list[Row] = []
    print(HEAD)
    for row in bench(pairs, given.width, given.seeds, given.matchers, keypoints):
        rows.append(row)
        print(line(row), flush=True)
    if given.json:
        given.json.write_text(json.dumps([asdict(row) for row in rows], indent=1))
    if given.plot:
        plot(rows, given.plot)
    return exit_status(check(rows) if given.check else [])


if __name__ == "__main__":
    sys.exit(main())
