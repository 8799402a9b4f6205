"""Structures: façades with recessed windows, containers with ribs, a lattice crane, stacks, posts."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from wbflow_stages.types import Float64s

from ..render.paint import Rng
from ..render.scene import UP, SceneBuilder, Vector, axes_of
from ..render.textures import container_roof, container_side, painted_steel


@dataclass(frozen=True)
class Opening:
    """A window or door of a façade: left, top, width, height in metres on the wall, seen from outside."""

    left: float
    top: float
    width: float
    height: float
    texture: int
    depth: float = 0.16


@dataclass(frozen=True)
class Box:
    """A container: position (metres), level (1: on top of another), heading (radians), length, paint and shipping line's name."""

    x: float
    y: float
    level: int
    yaw: float
    length: float
    colour: tuple[float, float, float]
    name: str


def facade(
    build: SceneBuilder, corner: Vector, right: Vector, size: tuple[float, float], wall: int, openings: list[Opening], sill: int
) -> None:
    """Add a wall with openings, seen from outside: top left `corner`, unit direction `right`, `size` = (width, height).

    The wall is cut along the edges of its openings; one texture continues across all its pieces."""
    # pieces between all edges of openings, so that none needs a hole
    corner = np.asarray(corner, np.float64)
    right = np.asarray(right, np.float64)
    inward = np.cross(right, -UP)
    xs = sorted({0.0, size[0], *(o.left for o in openings), *(o.left + o.width for o in openings)})
    ys = sorted({0.0, size[1], *(o.top for o in openings), *(o.top + o.height for o in openings)})
    for top, bottom in itertools.pairwise(ys):
        for left, end in itertools.pairwise(xs):
            if min(end - left, bottom - top) < 1e-6:  # edges of two openings that differ only by rounding
                continue
            # a piece of wall, unless its middle lies in an opening
            x = 0.5 * (left + end)
            y = 0.5 * (top + bottom)
            if not any(o.left < x < o.left + o.width and o.top < y < o.top + o.height for o in openings):
                build.quad(corner + left * right - top * UP, (end - left) * right, -(bottom - top) * UP, wall, (left, top))
    for o in openings:
        _recess(build, corner + o.left * right - o.top * UP, right, inward, o, wall, sill)


def _recess(build: SceneBuilder, corner: Float64s, right: Float64s, inward: Float64s, o: Opening, wall: int, sill: int) -> None:
    """Add the pane or door leaf, its four reveals, and a sill that sticks out."""
    deep = o.depth * inward
    across = o.width * right
    down = -o.height * UP
    build.quad(corner + deep, across, down, o.texture)
    build.quad(corner, deep, down, wall, (o.left, o.top))
    build.quad(corner + across + deep, -deep, down, wall, (o.left + o.width, o.top))
    build.quad(corner + deep + down, across, -deep, wall, (o.left, o.top + o.height))
    build.quad(corner, across, deep, wall, (o.left, o.top))
    # windows have a sill; doors lie deeper, and have none
    if o.depth < 0.2:
        middle = corner + 0.5 * across + down - 0.04 * inward
        yaw = float(np.arctan2(right[1], right[0]))
        build.box(middle - 0.08 * UP, (o.width + 0.24, 0.26, 0.08), sill, yaw=yaw)


def container(build: SceneBuilder, rng: Rng, texel_m: float, box: Box) -> None:
    """Add a shipping container: ribbed walls with a texture each, corner posts, door end with bars."""
    length, width, height = box.length, 2.44, 2.59
    ahead, side = axes_of(box.yaw)
    foot = np.array([box.x, box.y, 2.6 * box.level])
    serial = f"{box.name[:3]}U {rng.integers(100000, 999999)} {rng.integers(10)}"
    for sign in (-1, 1):
        # a long side
        right = -sign * ahead
        outward = sign * side
        paint = build.add_texture(container_side(rng, length, height, texel_m, box.colour, box.name, serial))
        corner = foot - right * length / 2 + outward * width / 2 + height * UP
        _ribs(build, corner, right, outward, (length, height), paint)
        # an end: closed, with the name, or the doors with their bars
        right = sign * side
        outward = sign * ahead
        name = box.name if sign > 0 else ""
        paint = build.add_texture(container_side(rng, width, height, texel_m, box.colour, name, serial))
        corner = foot - right * width / 2 + outward * length / 2 + height * UP
        if sign > 0:
            _ribs(build, corner, right, outward, (width, height), paint)
        else:
            build.quad(corner, right * width, -height * UP, paint)
            for at in (0.45, 0.95, 1.5, 2.0):
                bar = corner + at * right + 0.04 * outward
                build.beam(bar - 0.05 * UP, bar - (height - 0.05) * UP, 0.05, paint)
    roof = build.add_texture(container_roof(rng, length, width, texel_m, box.colour))
    build.quad(foot - ahead * length / 2 + side * width / 2 + height * UP, ahead * length, -side * width, roof)


_POST = 0.16
"""Width of a container's posts and rails, metres."""

_DEEP = 0.036
"""Depth of its corrugation, metres."""

_PROFILE = ((0.0, 0.0), (0.25, 0.0), (0.5, -_DEEP), (0.75, -_DEEP), (1.0, 0.0))
"""Profile of a rib: position along it, as a share of its pitch, and outward offset, metres."""


def _ribs(
    build: SceneBuilder, corner: Float64s, right: Float64s, outward: Float64s, size: tuple[float, float], texture: int
) -> None:
    """Add a corrugated wall of trapezoids of about 0.28 m between posts and rails; its texture ignores the corrugation."""
    length, height = size
    down = -(height - 2 * _POST) * UP
    # the two rails, then the two posts
    build.quad(corner, length * right, -_POST * UP, texture)
    build.quad(corner - (height - _POST) * UP, length * right, -_POST * UP, texture, (0.0, height - _POST))
    for at in (0.0, length - _POST):
        build.quad(corner + at * right - _POST * UP, _POST * right, down, texture, (at, _POST))
    inner = length - 2 * _POST
    count = max(int(inner / 0.28), 1)
    pitch = inner / count
    top = corner + _POST * right - _POST * UP
    for k in range(count):
        for (a, out_a), (b, out_b) in itertools.pairwise(_PROFILE):
            x = k * pitch + a * pitch
            step = (b - a) * pitch * right + (out_b - out_a) * outward
            place = top + x * right + out_a * outward
            build.quad(place, step, down, texture, (_POST + k * pitch + a * pitch, _POST), axis=right)


def crane(
    build: SceneBuilder, rng: Rng, foot: tuple[float, float], texel_m: float, *, height: float, reach: float, bearing: float
) -> None:
    """Add a slewing crane: lattice tower, cabin, lattice jib with a hook, counterweight."""
    yellow = build.add_texture(painted_steel(rng, 12.0, 3.0, texel_m, (0.58, 0.36, 0.02)))
    striped = build.add_texture(painted_steel(rng, 3.0, 2.0, texel_m, (0.62, 0.42, 0.03), stripes=True))
    base = np.array([*foot, 0.0])
    build.box(base, (3.0, 3.0, 1.0), striped)
    _lattice(build, base + 1.0 * UP, *axes_of(0.0), UP, 1.5, height - 1.0, yellow)
    ahead, aside = axes_of(bearing)
    build.box(base + height * UP, (2.4, 2.2, 2.1), yellow, yaw=bearing)
    build.box(base - 3.2 * ahead + height * UP, (2.2, 1.8, 1.2), striped, yaw=bearing)
    build.beam(base - 3.0 * ahead + (height + 0.2) * UP, base + (height + 0.2) * UP, 0.5, yellow)
    # the jib rises by 0.16 rad, 9 degrees
    rise = ahead * np.cos(0.16) + UP * np.sin(0.16)
    _lattice(build, base + 1.2 * ahead + (height + 0.6) * UP, aside, np.cross(rise, aside), rise, 0.9, reach, yellow)
    tip = base + ahead * (1.2 + reach * 0.97) + (height + 0.6 + reach * 0.16) * UP
    build.beam(tip, tip - (height * 0.45) * UP, 0.05, striped)
    build.box(tip - (height * 0.45 + 0.7) * UP, (0.4, 0.4, 0.7), striped)


def _lattice(
    build: SceneBuilder, start: Float64s, a: Float64s, b: Float64s, along: Float64s, width: float, length: float, texture: int
) -> None:
    """Add a square lattice girder: four chords and zigzag braces."""
    corners = [start + width / 2 * (i * a + j * b) for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    bays = max(round(length / width), 1)
    for k, corner in enumerate(corners):
        build.beam(corner, corner + length * along, 0.14, texture, offset=0.3 * k)
        neighbour = corners[(k + 1) % 4]
        for bay in range(bays):
            low = (bay / bays) * length * along
            high = ((bay + 1) / bays) * length * along
            one, other = (low, high) if bay % 2 else (high, low)
            build.beam(corner + one, neighbour + other, 0.08, texture, offset=0.7 * bay)
            build.beam(corner + low, neighbour + low, 0.07, texture, offset=0.5 * bay)


def crates(build: SceneBuilder, rng: Rng, place: tuple[float, float], textures: list[int], *, rows: int, levels: int) -> None:
    """Add a stack of crates of different sizes on pallets, set down by hand."""
    for k in range(rows):
        z = 0.0
        x = place[0] + 1.25 * k + rng.normal(0, 0.1)
        y = place[1] + rng.normal(0, 0.25)
        for _ in range(int(rng.integers(1, levels + 1))):
            size = (float(rng.uniform(0.8, 1.15)), float(rng.uniform(0.7, 1.1)), float(rng.uniform(0.45, 0.95)))
            yaw = float(rng.normal(0, 0.25))
            build.box((x, y, z), (1.2, 1.0, 0.14), textures[0], yaw=yaw, offset=float(rng.uniform(0, 2)))
            texture = textures[int(rng.integers(len(textures)))]
            build.box((x, y, z + 0.14), size, texture, yaw=yaw, offset=float(rng.uniform(0, 4)))
            z += 0.14 + size[2]


def barrels(build: SceneBuilder, rng: Rng, place: tuple[float, float], textures: list[int], *, count: int) -> None:
    """Add a loose group of oil drums."""
    for k in range(count):
        x = place[0] + 0.72 * (k % 4) + rng.normal(0, 0.06)
        y = place[1] + 0.72 * (k // 4) + rng.normal(0, 0.06)
        build.tube((x, y, 0.0), 0.29, 0.88, textures[int(rng.integers(len(textures)))])


def heap(
    build: SceneBuilder, rng: Rng, place: tuple[float, float], radius: float, height: float, texture: int, *, steps: int = 18
) -> None:
    """Add a heap of tipped gravel, rough at the scale of its facets."""
    side = np.linspace(-radius, radius, steps + 1)
    x, y = np.meshgrid(side, side)
    z = height * (1 - (np.hypot(x, y) / radius) ** 1.3) + 0.04 * rng.standard_normal(x.shape)
    grid = np.stack([x + place[0], y + place[1], z], axis=-1)
    for i, j in np.ndindex(steps, steps):
        (a, b), (d, c) = grid[i : i + 2, j : j + 2]
        at = (float(x[i, j]) + radius, float(y[i, j]) + radius)
        for corners in (np.array([a, b, c]), np.array([a, c, d])):
            if corners[:, 2].max() > 0:  # not wholly under the ground
                build.triangle(corners, (1, 0, 0), (0, 1, 0), texture, at)


def lamp_post(build: SceneBuilder, place: tuple[float, float], height: float, steel: int) -> None:
    """Add a post with an arm."""
    x, y = place
    build.tube((x, y, 0.0), 0.09, height, steel, sides=8)
    build.beam((x, y, height - 0.1), (x, y + 1.1, height), 0.09, steel)
