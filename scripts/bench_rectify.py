#!/usr/bin/env python3
"""Compare rectification methods on fountain pairs with laser truth: Tables 4-1 to 4-3 of Hao (2011), and more.

Columns: mean and 95th percentile of the row difference of true correspondences; sqrt of (4-6), the difference between the two
nets of matches, and the same over the nets' size; disparity range; anisotropy; share kept of the frame that loses more; share of
visible pixels with a dense disparity missing or off by over 2 px; CPU milliseconds.  "original" is the pair as photographed;
"fusiello" is "calibrated" without its robust affine.  F, and the relative pose of these two, come from the project's own matches.

The dense matcher is `sgbm` unless --dense names another one.  Its windows are upright squares in both images, so it profits from
congruent images.  `patchmatch` slants its windows itself and depends little on the method.

    scripts/bench_rectify.py --pairs 5-4 5-9 --methods hartley congruent
    scripts/bench_rectify.py --pairs all --dense none            is every pair rectified rightly or rejected rightly?
    scripts/bench_rectify.py --json rows.json --plot tables.svg
    scripts/bench_rectify.py --dense patchmatch                  with another dense matcher
    scripts/bench_rectify.py --check            exit code 1 if a figure misses its limit
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
from bench_files import Panel, draw, exit_status, write_rows
from pairs_with_truth import on_one_thread
from rectified_pairs import SWEEP, TruePair, dense_errors, row_errors, true_pairs

from wbflow_stages.disparity import MATCHERS, match_dense
from wbflow_stages.rectification.placement import place
from wbflow_stages.rectification.planar import fusiello, net_edges
from wbflow_stages.rectification.warping import to_rectified
from wbflow_stages.rectify import rectify
from wbflow_stages.types import Camera, Disparity, Float64s, Rectification, Rejected

WIDE = "5-2 5-1 5-8 5-9"
"""Pairs of the sweep at angles of 34 degrees and more."""

METHODS = ("original", "hartley", "hao2011", "congruent", "calibrated", "fusiello", "polar")


@dataclass(frozen=True)
class Row:
    """One pair, one method; nan where something does not apply."""

    pair: str
    method: str
    used: str
    vertical_mean_px: float
    vertical_p95_px: float
    sqrt_d: float
    sqrt_d_normalised: float
    disparity_range_px: float
    anisotropy: float
    kept: float
    bad_or_missing: float
    cpu_ms: float


NAN = float("nan")
JSON_KEYS = [
    "pair",
    "method",
    "vertical_mean_px",
    "vertical_p95_px",
    "sqrt_d",
    "disparity_range_px",
    "anisotropy",
    "bad_or_missing",
    "cpu_ms",
]


def net_difference(y1: Float64s, y2: Float64s) -> tuple[float, float]:
    """sqrt of (4-6) in x over the Delaunay net of y2 (n, 2), and its ratio to the root sum of squares of the net's edges in x."""
    edges = net_edges(y2)
    e1, e2 = (y[edges[:, 0], 0] - y[edges[:, 1], 0] for y in (y1, y2))
    total = float(np.sum((e1 - e2) ** 2))
    return total**0.5, (total / float(np.sum(e2**2))) ** 0.5


def own_cameras(pair: TruePair) -> tuple[Camera | None, Camera | None]:
    """The first camera at the origin, the second at the pose from the matches; None, None if a lens or the pose is unknown."""
    g = pair.geometry
    if g.view1.K is None or g.view2.K is None or g.cam2_R_cam1 is None or g.cam2_t_cam1 is None:
        return None, None
    centre = -g.cam2_R_cam1.T @ g.cam2_t_cam1
    return (
        Camera(g.view1.K, np.eye(3), np.zeros(3), g.view1.width, g.view1.height),
        Camera(g.view2.K, g.cam2_R_cam1, centre, g.view2.width, g.view2.height),
    )


def only_turned(pair: TruePair, left: Camera, right: Camera) -> Rectification:
    """Textbook calibrated rectification: rotates both cameras; only crop and disparity range are fitted to the matches."""
    g = pair.geometry
    sizes = (left.width, left.height), (right.width, right.height)
    H1, H2, size1, size2 = place(*fusiello(left, right), g.x1, g.x2, *sizes)
    bare = Rectification("fusiello", "", H1, H2, size1, size2, 0, 0, 0, 0, float("nan"))
    d = to_rectified(bare, 1, g.x1)[:, 0] - to_rectified(bare, 2, g.x2)[:, 0]
    low, high = np.percentile(d, [0.5, 99.5])
    margin = 0.1 * (high - low) + 0.01 * left.width
    return replace(bare, disparity_min_px=float(np.floor(low - margin)), disparity_max_px=float(np.ceil(high + margin)))


def rectified(pair: TruePair, method: str, cameras: str) -> tuple[Rectification | Rejected, float]:
    """The rectification of a pair by one method, and its CPU milliseconds."""
    left, right = (pair.left.camera, pair.right.camera) if cameras == "true" else own_cameras(pair)
    needed = method in ("calibrated", "fusiello")
    if needed and (left is None or right is None):
        return Rejected("no relative pose"), 0.0
    start = process_time()
    if method == "fusiello":
        assert left is not None and right is not None
        found: Rectification | Rejected = only_turned(pair, left, right)
    else:
        given = (left, right) if needed or cameras == "true" else (None, None)
        found = rectify(pair.geometry, *given, method=method, fallback=method == "congruent")
    return found, 1000 * (process_time() - start)


def measure(pair: TruePair, method: str, matcher: str, cameras: str) -> Row:
    g = pair.geometry
    if method == "original":
        errors = np.abs(pair.x1[:, 1] - pair.x2[:, 1])
        return Row(
            pair.name, method, "", float(errors.mean()), float(np.percentile(errors, 95)), *net_difference(g.x1, g.x2),
            float(np.ptp(g.x1[:, 0] - g.x2[:, 0])), 1.0, 1.0, NAN, 0.0,
        )  # fmt: skip
    found, ms = rectified(pair, method, cameras)
    if not isinstance(found, Rectification):
        return Row(pair.name, method, f"rejected: {found.reason}", NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN, ms)
    errors = row_errors(found, pair)
    bad = NAN
    if matcher != "none":
        dense = match_dense(pair.left.frame, pair.right.frame, found, matcher=matcher)
        bad = 1 - float(np.mean(dense_errors(found, dense, pair) <= 2)) if isinstance(dense, Disparity) else 1.0
    net = net_difference(to_rectified(found, 1, g.x1), to_rectified(found, 2, g.x2))
    return Row(
        pair.name, method, found.method, float(errors.mean()), float(np.percentile(errors, 95)), *net,
        found.disparity_max_px - found.disparity_min_px, found.anisotropy, min(found.kept1, found.kept2), bad, ms,
    )  # fmt: skip


HEAD = "pair  method      mean px 95 % px   sqrt d over net  range aniso  kept    bad     ms"


def line(r: Row) -> str:
    return (
        f"{r.pair:6}{r.method:11}{r.vertical_mean_px:8.3f}{r.vertical_p95_px:8.3f}{r.sqrt_d:9.0f}{r.sqrt_d_normalised:9.3f}"
        f"{r.disparity_range_px:7.0f}{r.anisotropy:6.2f}{r.kept:6.2f}{r.bad_or_missing:7.3f}{r.cpu_ms:7.1f}"
        f"  {r.used if r.used != r.method else ''}"
    )


def check(rows: list[Row]) -> list[str]:
    """Faults against the limits of the default method on the sweep, with F from the matches."""
    by = {(r.pair, r.method): r for r in rows}
    promised = []
    for pair in SWEEP.split():
        row, hartley = by[pair, "congruent"], by[pair, "hartley"]
        promised += [
            (pair, "mean row error", row.vertical_mean_px, 0.08),
            (pair, "95 % row error", row.vertical_p95_px, 0.26),
            (pair, "disparity range over Hartley's", row.disparity_range_px / hartley.disparity_range_px, 1.15),
            (pair, "anisotropy", row.anisotropy, 2.0),
            (pair, "bad or missing above Hartley's", row.bad_or_missing - hartley.bad_or_missing, 0.01),
        ]
    wide = [by[pair, "congruent"].bad_or_missing - by[pair, "hartley"].bad_or_missing for pair in WIDE.split()]
    widest = by["5-9", "congruent"].bad_or_missing - by["5-9", "fusiello"].bad_or_missing
    promised += [(WIDE, "bad or missing above Hartley's on average", float(np.mean(wide)), -0.01)]
    promised += [("5-9", "bad or missing above that of only turned cameras", widest, -0.10)]
    return [f"{pairs}: {what} {value:.4f}, {limit} allowed" for pairs, what, value, limit in promised if value > limit]


def plot(rows: list[Row], file: Path) -> None:
    """Plot columns against the pairs; except for sqrt_d, "original" is left out, because its errors would dwarf the others."""
    pairs = list(dict.fromkeys(r.pair for r in rows))
    methods = list(dict.fromkeys(r.method for r in rows))
    fields = ("sqrt_d", "sqrt_d_normalised", "disparity_range_px", "vertical_p95_px", "anisotropy", "kept", "bad_or_missing")
    panels = []
    for field in fields:
        asked = [m for m in methods if field in ("sqrt_d", "sqrt_d_normalised") or m != "original"]
        curves = {m: [(float(pairs.index(r.pair)), getattr(r, field)) for r in rows if r.method == m] for m in asked}
        panels.append(Panel(field, "pair", curves, pairs))
    draw(panels, file)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", nargs="+", default=SWEEP.split(), help="such as 5-4, or all")
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=METHODS)
    parser.add_argument("--width", type=int, default=768)
    parser.add_argument("--dense", default="sgbm", choices=[*MATCHERS, "none"], help="the dense matcher for the pairs")
    parser.add_argument("--cameras", choices=("own", "true"), default="own", help="F and poses: from the matches, or true")
    parser.add_argument("--json", type=Path, help="write the rows as JSON objects")
    parser.add_argument("--plot", type=Path, help="draw the tables as curves into this SVG file")
    parser.add_argument("--check", action="store_true")
    given = parser.parse_args()
    on_one_thread()
    names = [f"{a}-{b}" for a in range(11) for b in range(a + 1, 11)] if given.pairs == ["all"] else given.pairs
    if given.check:
        names, given.methods = SWEEP.split(), ["hartley", "congruent", "fusiello"]
    rows: list[Row] = []
    pairs = true_pairs(names, given.width)
    first = [measure(pair, method, "none", given.cameras).cpu_ms for pair in pairs[:1] for method in given.methods]
    print(f"first calls, which compile code or read it from disk and are not counted: {sum(first):.0f} ms")
    print(HEAD)
    for pair in pairs:
        for method in given.methods:
            rows.append(measure(pair, method, given.dense, given.cameras))
            print(line(rows[-1]), flush=True)
    for method in given.methods:
        ms = [r.cpu_ms for r in rows if r.method == method and not r.used.startswith("rejected")]
        if ms and method != "original":
            print(f"{method}: {np.mean(ms):.1f} ms a pair on average, median {np.median(ms):.1f}")
    if given.json:
        write_rows(rows, JSON_KEYS, given.json)
    if given.plot:
        plot(rows, given.plot)
    return exit_status(check(rows) if given.check else [])


if __name__ == "__main__":
    sys.exit(main())
