"""Rotations as people write them, turned into R (world axes to camera axes: x right, y down, z forward).  World: z up."""

from __future__ import annotations

import math

Vector = list[float]
Matrix = list[Vector]


def look_at(position: Vector, target: Vector) -> Matrix:
    """R of an upright camera that looks from `position` at `target`.

    Raises ValueError where the two points coincide, or the camera would look straight up or down (its roll would be undefined).
    """
    forward = _unit([t - p for t, p in zip(target, position, strict=True)])
    right = _cross(forward, [0.0, 0.0, 1.0])
    if math.hypot(*right) < 1e-6:
        raise ValueError("looks straight up or down, so which way is up in the image is unknown: give a rotation instead")
    right = _unit(right)
    return [right, _cross(forward, right), forward]


def yaw_pitch_roll(yaw_deg: float, pitch_deg: float, roll_deg: float) -> Matrix:
    """R from a heading: yaw 0 looks along +y, 90 along +x; pitch up is positive; roll turns the camera clockwise as it sees."""
    yaw, pitch, roll = (math.radians(v) for v in (yaw_deg, pitch_deg, roll_deg))
    forward = [math.sin(yaw) * math.cos(pitch), math.cos(yaw) * math.cos(pitch), math.sin(pitch)]
    level = [math.cos(yaw), -math.sin(yaw), 0.0]
    down = _cross(forward, level)
    right = [math.cos(roll) * a + math.sin(roll) * b for a, b in zip(level, down, strict=True)]
    return [right, _cross(forward, right), forward]


def rotation_fault(R: Matrix, tolerance: float = 1e-3) -> str:
    """What is wrong with a rotation matrix; "" where nothing is."""
    dots = [sum(a * b for a, b in zip(R[i], R[j], strict=True)) - (i == j) for i in range(3) for j in range(3)]
    if not max(map(abs, dots)) < tolerance:
        return "is not a rotation matrix (rows of unit length, at right angles)"
    if sum(a * b for a, b in zip(_cross(R[0], R[1]), R[2], strict=True)) < 0:
        return "is a mirror, not a rotation (its determinant is -1)"
    return ""


def centre(R: Matrix, t: Vector) -> Vector:
    """The centre of the camera x = R X + t."""
    return [-sum(R[j][i] * t[j] for j in range(3)) for i in range(3)]


def turned(R: Matrix, turn: Matrix) -> Matrix:
    """The product turn R."""
    columns = list(zip(*R, strict=True))
    return [[sum(a * b for a, b in zip(row, column, strict=True)) for column in columns] for row in turn]


def _cross(a: Vector, b: Vector) -> Vector:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _unit(v: Vector) -> Vector:
    length = math.hypot(*v)
    if length < 1e-9:
        raise ValueError("looks at its own position")
    return [x / length for x in v]
