#!/usr/bin/env python3
"""Fits the coefficients of `stages/fusion/posterior.py`, or measures how reliable its probabilities are.

    scripts/fit_posterior.py FOLDER ... [--keep NAME ...]

Each FOLDER is a rendered site with its truth (`wbflow demo`, `scripts/render_scene.py`) after a run.  The depths of its newest
good run are compared with `truth/depth/`.  `_OWN` is fitted on both refined and pair depths, `_OTHERS` and `_AROUND` on the
likelier depth of each pixel; those named by --keep are not fitted.  At the end, the share of right depths in ten bins of their
probability, and the area under the ROC curve, are printed for each folder.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import wbflow
from wbflow_stages.core.cameras import backproject, project
from wbflow_stages.core.residual_distortion import undistorted_frames
from wbflow_stages.fusion import posterior as P
from wbflow_stages.fusion.planning import nearest_views, subsample
from wbflow_stages.fusion.surface_support import surface_support
from wbflow_stages.fusion.visibility import TrustedDepth, cross_check, probability
from wbflow_stages.types import Bools, Camera, DepthMap, Float32s, Float64s

RIGHT_PX = 2.0
"""A depth is right if its point lies within this many pixel widths of the true surface."""

MOST_SAMPLES = 12_000
"""Largest number of pixels sampled from each view."""

RIDGE_PENALTY = 2e-5
"""Ridge penalty on the coefficients, which keeps them finite."""


@dataclass
class View:
    """A view's depths, the evidence about them, and which of them are right."""

    depth: DepthMap
    known: Bools
    right: Bools
    judged: Bools
    """Where a depth exists and its true value is known."""
    evidence: list[Float32s]
    logit: Float32s


class Scene:
    """The views of a run, each with its refined depth and the depth from its pairs."""

    def __init__(self, folder: Path) -> None:
        run = wbflow.open_run(folder, "latest-good")
        found: dict[str, dict[str, Any]] = {"frames": {}, "depth": {}, "refine": {}}
        for task in run.tasks:
            if task.stage in found:
                found[task.stage][task.subject[0]] = run.artifact(task)
        posed = run.artifact("poses").cameras
        self.cameras = {name: camera for name, camera in posed.items() if name in {**found["depth"], **found["refine"]}}
        frames = undistorted_frames(found["frames"], self.cameras)
        self.frames = {name: frames[name] for name in self.cameras}
        self.truth = folder / "truth"
        sources = [source for source in (found["refine"], found["depth"]) if source]
        self.kinds = [{name: self._view(name, source[name]) for name in self.cameras if name in source} for source in sources]
        small = {name: subsample(frames[name], next(k[name] for k in self.kinds if name in k).depth) for name in self.cameras}
        self.near = {name: nearest_views(name, self.cameras, small, 16) for name in self.cameras}

    def _view(self, name: str, depth: DepthMap) -> View:
        camera, mask = self.cameras[name], self.frames[name].mask
        known, off = mask & np.isfinite(depth.depth), off_truth(self.truth, name, camera, depth)
        right = off <= RIGHT_PX * depth.depth / camera.K[0, 0]
        evidence = P.own_evidence(depth, mask)
        return View(depth, known, right, known & np.isfinite(off), evidence, np.zeros(0, np.float32))

    def views(self) -> Iterator[View]:
        return (view for kind in self.kinds for view in kind.values())

    def apply(self, coefficients: Float64s) -> None:
        """Set each view's log-odds from its current evidence."""
        for view in self.views():
            view.logit = P._logit(coefficients, view.evidence, view.known)

    def compare_views(self) -> None:
        """Keeps the likelier depth of each pixel, as fusion does, and gathers the evidence of the other views."""
        found = {name: [kind[name] for kind in self.kinds if name in kind] for name in self.cameras}
        trusted = {
            name: P.merge_likelier([TrustedDepth(self.frames[name], v.depth, v.logit) for v in views])
            for name, views in found.items()
        }
        kept = {name: self._view(name, view.depth) for name, view in trusted.items()}
        for name, view in kept.items():
            view.logit = trusted[name].own_logit
            check = cross_check(name, self.near[name], self.cameras, trusted.__getitem__)
            view.evidence = [view.logit, *P.evidence_of_others(check)]
            view.known &= check.pairs > 0  # depths without pairs never enter a cloud
            view.judged &= view.known
        self.kinds = [kept]

    def measure_support(self) -> None:
        for name, view in self.kinds[0].items():
            around = surface_support(view.depth, view.known, probability(view.logit))
            view.evidence = [view.logit, around, P.noisiness(self.frames[name])]


def off_truth(truth: Path, name: str, camera: Camera, depth: DepthMap) -> Float64s:
    """(h, w) distance of each point from the true surface at its pixel or a neighbouring one; nan where the truth is unknown."""
    entry = json.loads((truth / "cameras.json").read_text())[name]
    z = np.load(truth / "depth" / f"{name}.npz")["depth"].astype(np.float64)
    z[z <= 0] = np.nan
    h, w = z.shape
    K, R, C = (np.array(entry[key], dtype=np.float64) for key in ("K", "R", "C"))
    y, x = np.nonzero(np.isfinite(depth.depth))
    X = backproject(camera, np.column_stack([x, y]).astype(np.float64), depth.depth[y, x].astype(np.float64))
    at, there = project(Camera(K, R, C, w, h), X)
    i, j = np.rint(at).astype(int).T
    inside = (there > 0) & (i > 0) & (j > 0) & (i < w - 1) & (j < h - 1)
    i, j = i.clip(1, w - 2), j.clip(1, h - 2)
    slope_y, slope_x = np.gradient(1 / z)
    nearest = np.full(len(X), np.inf)
    for dj, di in np.ndindex(3, 3):
        row, column = j + dj - 1, i + di - 1
        plane = np.column_stack([slope_x[row, column], slope_y[row, column], 1 / z[row, column]])
        plane[:, 2] -= plane[:, 0] * column + plane[:, 1] * row
        normal = plane @ K
        away = np.abs(z[row, column] - there)
        across = np.abs(((X - C) @ R.T * normal).sum(axis=1) - 1) / np.linalg.norm(normal, axis=1)
        nearest = np.fmin(nearest, np.where(across < away, across, away))
    off = np.full(depth.depth.shape, np.nan)
    off[y, x] = np.where(inside & np.isfinite(nearest), nearest, np.nan)
    return off


def samples(scenes: list[Scene]) -> tuple[Float64s, Float64s, Float64s, Float64s]:
    """Evidence (with a leading column of ones), labels (1: right), weights and log-odds of sampled pixels of each view."""
    rng = np.random.default_rng(0)
    parts = [part for scene in scenes for part in _parts(scene, rng)]
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))  # type: ignore[return-value]


def _parts(scene: Scene, rng: np.random.Generator) -> Iterator[tuple[Any, ...]]:
    views = list(scene.views())
    for view in views:
        at = np.flatnonzero(view.judged)
        at = rng.choice(at, min(len(at), MOST_SAMPLES), replace=False)
        rows = np.column_stack([np.ones(len(at)), *(values.ravel()[at] for values in view.evidence)])
        logit = view.logit.ravel()[at] if len(view.logit) else np.zeros(len(at))
        yield rows, view.right.ravel()[at].astype(float), np.full(len(at), 1 / max(len(at), 1) / len(views)), logit


def fitted(scenes: list[Scene]) -> Float64s:
    """Coefficients of a logistic regression, by iteratively reweighted least squares."""
    X, right, weight, _ = samples(scenes)
    weight, b = weight / weight.sum(), np.zeros(X.shape[1])
    for _ in range(40):
        p = 1 / (1 + np.exp(-X @ b))
        H = (X * (weight * p * (1 - p))[:, None]).T @ X + RIDGE_PENALTY * np.eye(len(b))
        b -= np.linalg.solve(H, X.T @ (weight * (p - right)) + RIDGE_PENALTY * b)
    return b.round(2)


def reliability(scenes: list[Scene]) -> str:
    """Share of right depths, and in brackets of all depths, in ten bins of the probability; area under the ROC curve."""
    _, right, weight, logit = samples(scenes)
    p, weight = 1 / (1 + np.exp(-logit)), weight / weight.sum()
    order = np.argsort(p)
    wrong = np.cumsum((weight * (1 - right))[order])
    area = float(((weight * right)[order] * wrong).sum() / ((weight * right).sum() * wrong[-1]))
    cells = []
    for k in range(10):
        some = (p >= k / 10) & (p < (k + 1) / 10 if k < 9 else p <= 1)
        cells.append(f"{np.average(right[some], weights=weight[some]):.2f} ({weight[some].sum():.2f})" if some.any() else "-")
    return f"right {(weight * right).sum():.3f}  area {area:.4f}  bins {'  '.join(cells)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--keep", nargs="*", default=[], metavar="NAME")
    given = parser.parse_args()
    scenes = [Scene(folder) for folder in given.folders]
    steps = {"_OWN": lambda scene: None, "_OTHERS": Scene.compare_views, "_AROUND": Scene.measure_support}
    for name, step in steps.items():
        for scene in scenes:
            step(scene)
        coefficients = getattr(P, name) if name in given.keep else fitted(scenes)
        for scene in scenes:
            scene.apply(coefficients)
        print(f"{name} = np.array({coefficients.tolist()})")
    for folder, scene in zip(given.folders, scenes, strict=True):
        print(f"{folder.name}: {reliability([scene])}")


if __name__ == "__main__":
    main()
