"""Shapes that several of these scenes use: round bars, pipes, and flat cones."""

from __future__ import annotations

import itertools

import numpy as np

from wbflow_demo.render import Place
from wbflow_demo.render.scene import UP, SceneBuilder, Vector


def rod(build: SceneBuilder, start: Vector, end: Vector, radius: float, texture: int, *, sides: int = 10) -> None:
    """Add a round bar between two points; the texture's u runs around it, its v from start to end."""
    a = np.asarray(start, np.float64)
    along = np.asarray(end, np.float64) - a
    side = np.cross(along, UP if abs(along[2]) < 0.95 * np.linalg.norm(along) else (0, 1.0, 0))
    side /= np.linalg.norm(side)
    other = np.cross(along, side) / np.linalg.norm(along)
    turn = np.linspace(2 * np.pi, 0, sides + 1)[:, None]
    ring = a + radius * (np.cos(turn) * side + np.sin(turn) * other)
    for k, (p, q) in enumerate(itertools.pairwise(ring)):
        build.quad(p, q - p, along, texture, (float(k * np.linalg.norm(q - p)), 0.0))


def run_of_pipe(build: SceneBuilder, path: list[Place], radius: float, texture: int) -> None:
    """Add a pipe along a path of points, with a round knee at each bend."""
    for start, end in itertools.pairwise(path):
        rod(build, start, end, radius, texture)
    for knee in path[1:-1]:
        build.ball(knee, (1.15 * radius, 1.15 * radius, 1.15 * radius), texture, steps=5)


def cone(build: SceneBuilder, foot: Place, radius: float, rise: float, texture: int, *, sides: int = 14) -> None:
    """Add a conical roof; its texture is projected from above."""
    apex, turn = np.add(foot, (0.0, 0.0, rise)), np.linspace(0, 2 * np.pi, sides + 1)
    rim = foot + radius * np.column_stack([np.cos(turn), np.sin(turn), np.zeros(sides + 1)])
    for p, q in itertools.pairwise(rim):
        build.triangle(np.array([apex, p, q]), (1, 0, 0), (0, -1, 0), texture, (radius, radius))
