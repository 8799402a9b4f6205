#!/usr/bin/env python3
"""Compare dense matchers on Middlebury's four pairs and on fountain pairs of growing baseline.

Fountain pairs are rectified by the project, with F from its own matches.  Columns: density, the share of pixels with known truth
that have a value; share of these values off by more than 1, 2, 4 px; share of all these pixels bad (2 px) or missing; median
error; CPU seconds per million pixels, both views.  The matchers are the project's, OpenCV's, and graph cuts.

    scripts/bench_dense.py --scenes middlebury --matchers sgbm patchmatch
    scripts/bench_dense.py --json rows.json --plot curves.svg        draw quality against baseline as curves
    scripts/bench_dense.py --noise 0 100 --plot curves.svg           add Hao's noise test (2011): Gaussian, of these variances
    scripts/bench_dense.py --matchers census-sgm sift-sgm daisy-sgm  dense descriptors as data cost, which Hao (2011)
                                                                     left to future work (slow; DAISY needs scikit-image)
    scripts/bench_dense.py --check                                   exit code 1 if a figure misses its limit
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import cv2
import numpy as np
from bench_files import Panel, draw, exit_status, write_rows
from graphcut import match_graphcut
from pairs_with_truth import DATA, read_rgb
from rectified_pairs import SWEEP, dense_errors, true_pairs

from wbflow_stages import disparity
from wbflow_stages.rectification.warping import disparity_px
from wbflow_stages.rectify import rectify
from wbflow_stages.stereo.census import semi_global
from wbflow_stages.stereo.matcher import DenseMatches, RectifiedPair, mirrored
from wbflow_stages.types import Disparity, Float32s, Float64s, Frame, Rectification, Uint8s, View

MIDDLEBURY = {
    # left, right, true disparity, its grey levels per pixel, largest disparity in pixels
    "tsukuba": ("im3.png", "im4.png", "disp3.pgm", 16, 16),
    "venus": ("im2.png", "im6.png", "disp2.pgm", 8, 20),
    "teddy": ("im2.png", "im6.png", "disp2.png", 4, 60),
    "cones": ("im2.png", "im6.png", "disp2.png", 4, 60),
}


def opencv(matcher: cv2.StereoMatcher, pair: RectifiedPair) -> DenseMatches:
    """Run one of OpenCV's matchers on both views, as a plain script would."""
    views = []
    count = 16 * -(-(pair.disparity_max - pair.disparity_min + 1) // 16)
    for view in (pair, mirrored(pair)):
        grey = (np.clip(np.rint(image), 0, 255).astype(np.uint8) for image in (view.left, view.right))
        sides = max(0, pair.disparity_min + count), max(0, -pair.disparity_min)
        left, right = (cv2.copyMakeBorder(image, 0, 0, sides[0], sides[1], cv2.BORDER_REPLICATE) for image in grey)
        matcher.setMinDisparity(pair.disparity_min)
        matcher.setNumDisparities(count)
        found = matcher.compute(left, right).astype(np.float32)[:, sides[0] : sides[0] + pair.left.shape[1]] / 16
        views.append(np.where(found < pair.disparity_min, np.float32(np.nan), found).astype(np.float32))
    ones = np.ones_like(views[0])
    return DenseMatches(views[0], np.ascontiguousarray(views[1][:, ::-1]), ones, ones)


def opencv_bm(pair: RectifiedPair) -> DenseMatches:
    return opencv(cv2.StereoBM.create(blockSize=15), pair)


def opencv_sgbm5(pair: RectifiedPair) -> DenseMatches:
    return opencv(cv2.StereoSGBM.create(blockSize=5, P1=200, P2=800, uniquenessRatio=5, mode=cv2.STEREO_SGBM_MODE_SGBM), pair)


SIFT_SIZE, DAISY_RADIUS, SCALE = 1.2, 4, 90.0
"""Diameter of SIFT keypoints in pixels (descriptors cover about eight times as much), radius of DAISY in pixels, and cost of a
descriptor distance of 1, in census bits."""


def sift_sgm(pair: RectifiedPair) -> DenseMatches:
    """Semi-global matching on distances of dense SIFT descriptors, which Hao (2011) left to future work."""
    return descriptor_sgm(pair, dense_sift(pair.left), dense_sift(pair.right))


def daisy_sgm(pair: RectifiedPair) -> DenseMatches:
    """Semi-global matching on distances of dense DAISY descriptors (Tola et al., PAMI 2010), from scikit-image."""
    return descriptor_sgm(pair, dense_daisy(pair.left), dense_daisy(pair.right))


def descriptor_sgm(pair: RectifiedPair, left: Float32s, right: Float32s) -> DenseMatches:
    """Semi-global matching on distances of descriptors; left, right: (h, w, n), of unit length."""
    height, width = pair.left.shape
    count = pair.disparity_max - pair.disparity_min + 1
    volume = np.full((height, width, count), 35, dtype=np.uint8)  # the census matcher's cost of invalid matches
    for k in range(count):
        d = pair.disparity_min + k
        at = slice(max(d, 0), min(width, width + d))
        partner = slice(at.start - d, at.stop - d)
        if at.start < at.stop:
            likeness = np.einsum("yxc,yxc->yx", left[:, at], right[:, partner])
            cost = np.minimum(SCALE * np.sqrt(np.maximum(2 - 2 * likeness, 0)), 62)
            volume[:, at, k] = np.where(pair.valid_right[:, partner], cost, 35)
    return semi_global(pair, volume)


def dense_sift(image: Float32s) -> Float32s:
    """(h, w, 128) RootSIFT of every pixel, upright."""
    height, width = image.shape
    y, x = np.mgrid[0:height, 0:width].reshape(2, -1).astype(np.float32)
    points = [cv2.KeyPoint(float(a), float(b), SIFT_SIZE, 0.0) for a, b in zip(x, y, strict=True)]
    kept, found = cv2.SIFT.create().compute(np.clip(np.rint(image), 0, 255).astype(np.uint8), points)
    assert len(kept) == len(points)
    return rooted(found.reshape(height, width, 128))


def dense_daisy(image: Float32s) -> Float32s:
    """(h, w, 104) DAISY descriptors of every pixel, upright, square roots as in RootSIFT."""
    try:
        from skimage.feature import daisy
    except ImportError:
        raise SystemExit("daisy-sgm needs scikit-image: pip install scikit-image") from None
    bordered = np.pad(image, DAISY_RADIUS, mode="edge")
    return rooted(daisy(bordered, step=1, radius=DAISY_RADIUS, rings=2, histograms=6, orientations=8))


def rooted(found: np.ndarray) -> Float32s:
    return np.asarray(np.sqrt(found / np.maximum(found.sum(axis=2, keepdims=True), 1e-6)), dtype=np.float32)


RIVALS = {
    "opencv-bm": opencv_bm,
    "opencv-sgbm5": opencv_sgbm5,
    "sift-sgm": sift_sgm,
    "daisy-sgm": daisy_sgm,
    "graphcut": match_graphcut,
}
disparity.MATCHERS.update({name: f"{function.__module__}:{function.__name__}" for name, function in RIVALS.items()})
DEFAULT = ("patchmatch", "sgbm", "census-sgm", "opencv-sgbm5", "opencv-bm", "graphcut")


@dataclass(frozen=True)
class Row:
    """One pair, one matcher; noise: variance, also part of `scene`; angle_deg: median between the rays, nan if unknown."""

    scene: str
    pair: str
    noise: float
    angle_deg: float
    matcher: str
    density: float
    bad1: float
    bad2: float
    bad4: float
    bad_or_missing: float
    median_px: float
    cpu_s_per_mpx: float


JSON_KEYS = ["scene", "pair", "matcher", "density", "bad2", "bad_or_missing", "median_px", "cpu_s_per_mpx"]


def row(scene: str, name: str, noise: float, angle: float, matcher: str, errors: Float64s, seconds: float, pixels: int) -> Row:
    kept = errors[~np.isnan(errors)]
    bad1, bad2, bad4 = (float(np.mean(kept > limit)) if len(kept) else 0.0 for limit in (1, 2, 4))
    missed = 1 - float(np.mean(errors <= 2))
    median = float(np.median(kept)) if len(kept) else float("nan")
    scene = f"{scene}+noise{noise:g}" if noise > 0 else scene
    density = len(kept) / max(len(errors), 1)
    return Row(scene, name, noise, angle, matcher, density, bad1, bad2, bad4, missed, median, seconds / pixels * 1e6)


def matched(left: Frame, right: Frame, rectification: Rectification, matcher: str) -> tuple[Disparity | None, float]:
    start = process_time()
    found = disparity.match_dense(left, right, rectification, matcher=matcher)
    return found if isinstance(found, Disparity) else None, process_time() - start


def noisy(frame: Frame, variance: float, seed: int) -> Frame:
    if variance <= 0:
        return frame
    noise = np.random.default_rng(seed).normal(0, variance**0.5, frame.image.shape)
    return replace(frame, image=np.clip(np.rint(frame.image + noise), 0, 255).astype(np.uint8))


def full_frame(pixels: Uint8s) -> Frame:
    """A frame without mask or lens."""
    height, width = pixels.shape[:2]
    return Frame(pixels, np.ones((height, width), dtype=bool), View(width, height))


def identity_rectification(size: tuple[int, int], widest: float) -> Rectification:
    """A rectification that leaves already rectified images unchanged."""
    return Rectification("hartley", "rectified already", np.eye(3), np.eye(3), size, size, 0.0, widest, 0.0, 0.0, float("nan"))


def middlebury(matchers: list[str], noise: float) -> Iterator[Row]:
    for name, (left_file, right_file, truth_file, scale, widest) in MIDDLEBURY.items():
        folder = DATA / "middlebury" / name
        stored = cv2.imread(str(folder / truth_file), cv2.IMREAD_GRAYSCALE)
        if stored is None:
            raise SystemExit(f"{folder / truth_file} is not there")
        truth = stored.astype(np.float32)
        known = truth > 0
        frames = []
        for seed, file in enumerate((left_file, right_file)):
            frames.append(noisy(full_frame(read_rgb(folder / file)), noise, seed))
        given = identity_rectification((truth.shape[1], truth.shape[0]), widest)
        for matcher in matchers:
            found, seconds = matched(frames[0], frames[1], given, matcher)
            values: Float32s = np.full(truth.shape, np.nan, np.float32) if found is None else disparity_px(found, 1)
            errors = np.abs(values - truth / scale)[known].astype(np.float64)
            yield row("middlebury", name, noise, float("nan"), matcher, errors, seconds, truth.size)


def fountain(matchers: list[str], names: list[str], width: int, noise: float) -> Iterator[Row]:
    for pair in true_pairs(names, width):
        found = rectify(pair.geometry, None, None)
        if not isinstance(found, Rectification):
            print(f"{pair.name} rejected: {found.reason}")
            continue
        frames = [noisy(view.frame, noise, seed) for seed, view in enumerate((pair.left, pair.right))]
        for matcher in matchers:
            dense, seconds = matched(frames[0], frames[1], found, matcher)
            errors = np.full(len(pair.x1), np.nan) if dense is None else dense_errors(found, dense, pair)
            yield row("fountain", pair.name, noise, found.angle_deg, matcher, errors, seconds, found.size1[0] * found.size1[1])


HEAD = "scene               pair     deg matcher      density   bad1   bad2   bad4    bad median cpu/Mpx"


def line(r: Row) -> str:
    return (
        f"{r.scene:20}{r.pair:8}{r.angle_deg:4.0f} {r.matcher:13}{r.density:7.3f}{r.bad1:7.3f}{r.bad2:7.3f}{r.bad4:7.3f}"
        f"{r.bad_or_missing:7.3f}{r.median_px:7.2f}{r.cpu_s_per_mpx:8.2f}"
    )


LIMITS = {
    # pair, matcher: largest bad2, largest bad or missing
    ("5-4", "patchmatch"): (0.013, 0.10), ("5-2", "patchmatch"): (0.028, 0.205), ("5-9", "patchmatch"): (0.045, 0.29),
    ("5-4", "sgbm"): (1.0, 0.105), ("5-2", "sgbm"): (1.0, 0.23), ("5-9", "sgbm"): (1.0, 0.36),
    ("tsukuba", "sgbm"): (0.028, 1.0), ("venus", "sgbm"): (0.009, 1.0),
    ("teddy", "sgbm"): (0.048, 1.0), ("cones", "sgbm"): (0.037, 1.0),
    ("teddy", "patchmatch"): (0.040, 1.0), ("cones", "patchmatch"): (0.030, 1.0),  # stricter than for sgbm
}  # fmt: skip


def check(rows: list[Row]) -> list[str]:
    faults = []
    for r in rows:
        bad2, missing = LIMITS.get((r.pair, r.matcher), (1.0, 1.0))
        if r.bad2 > bad2 or r.bad_or_missing > missing:
            faults.append(f"{r.pair} {r.matcher}: bad2 {r.bad2:.4f} ({bad2}), bad or missing {r.bad_or_missing:.3f} ({missing})")
    return faults


FIELDS = ("bad_or_missing", "bad2", "median_px")


def plot(rows: list[Row], file: Path) -> None:
    """Plot quality against the angle of the fountain pairs, one curve per matcher; with several noises also against noise."""
    matchers = list(dict.fromkeys(r.matcher for r in rows))
    noises = sorted({r.noise for r in rows})
    panels = []
    for noise in noises:
        for field in FIELDS:
            shown = [r for r in rows if r.noise == noise and np.isfinite(r.angle_deg)]
            curves = {m: sorted((r.angle_deg, getattr(r, field)) for r in shown if r.matcher == m) for m in matchers}
            panels.append(Panel(f"fountain, noise {noise:g}: {field}", "degrees between the rays", curves))
    for scene in dict.fromkeys(r.scene.split("+")[0] for r in rows) if len(noises) > 1 else ():
        for field in FIELDS:
            curves = {m: [(v, mean_of(rows, scene, m, v, field)) for v in noises] for m in matchers}
            panels.append(Panel(f"{scene}, mean of its pairs: {field}", "variance of the noise", curves))
    draw(panels, file)


def mean_of(rows: list[Row], scene: str, matcher: str, noise: float, field: str) -> float:
    values = [getattr(r, field) for r in rows if r.scene.startswith(scene) and r.matcher == matcher and r.noise == noise]
    return float(np.mean(values)) if values else float("nan")


def warm_up(matchers: list[str]) -> None:
    """Compile the kernels, so that no row includes the time."""
    image = np.random.default_rng(0).integers(0, 255, (64, 480, 3)).astype(np.uint8)
    for matcher in matchers:
        for widest in (8.0, 240.0):  # wide disparity ranges take another code path
            matched(full_frame(image), full_frame(image), identity_rectification((480, 64), widest), matcher)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", nargs="+", default=["middlebury", "fountain"], choices=["middlebury", "fountain"])
    parser.add_argument("--pairs", nargs="+", default=SWEEP.split(), help="fountain pairs such as 5-4")
    parser.add_argument("--matchers", nargs="+", default=list(DEFAULT), choices=sorted(disparity.MATCHERS))
    parser.add_argument("--width", type=int, default=768, help="width to which the fountain pictures are reduced, pixels")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0], help="variances of Gaussian noise added to both images")
    parser.add_argument("--json", type=Path, help="write the rows as JSON objects")
    parser.add_argument("--plot", type=Path, help="draw the errors as curves into this SVG file")
    parser.add_argument("--check", action="store_true")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    if given.check:
        given.matchers, given.pairs, given.noise = ["patchmatch", "sgbm"], ["5-4", "5-2", "5-9"], [0.0]
    warm_up(given.matchers)
    print(HEAD)
    rows = []
    for scene in given.scenes:
        for noise in given.noise:
            if scene == "middlebury":
                found = middlebury(given.matchers, noise)
            else:
                found = fountain(given.matchers, given.pairs, given.width, noise)
            for r in found:
                rows.append(r)
                print(line(r), flush=True)
    if given.json:
        write_rows(rows, JSON_KEYS, given.json)
    if given.plot:
        plot(rows, given.plot)
    return exit_status(check(rows) if given.check else [])


if __name__ == "__main__":
    sys.exit(main())
