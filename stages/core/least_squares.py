"""Nonlinear least squares over states that are no vectors: rotations, essential matrices, unit vectors."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from ..types import Float64s

State = TypeVar("State")
Equations = tuple[float, Float64s, Float64s]


def levenberg_marquardt(
    state: State,
    equations: Callable[[State], Equations],
    moved: Callable[[State, Float64s], State],
    *,
    steps: int,
    damping: float,
    least_damping: float = 0.0,
    most_damping: float = 1e4,
    floor: float = 0.0,
    tolerance: float = 0.0,
    relative_tolerance: float = 0.0,
) -> tuple[float, State]:
    """The state of least cost that is found downhill from `state`, and its cost.

    Parameters
    ----------
    state : where to start.
    equations : cost of a state, normal matrix (k, k) and right side (k,) of the linear equations for a step from there.
    moved : a state after a step (k,).
    steps : ends after so many, taken or not.
    damping, least_damping, most_damping : of the normal matrix's diagonal, as a share of it: a tenth after each step that lowers
        the cost, ten times as much after each other.  Ends where it would be more than the most.
    floor : added to the diagonal that is damped, as a share of its sum: for directions of which the equations say nothing.
    tolerance, relative_tolerance : ends when a step lowers the cost by less than this, or than this share of it.

    References: Marquardt, SIAM Journal on Applied Mathematics, 1963.
    """
    cost, normal, right = equations(state)
    for _ in range(steps):
        damped = normal + damping * np.diag(np.diag(normal) + floor * np.trace(normal))
        ahead = moved(state, np.asarray(np.linalg.solve(damped, -right), dtype=np.float64))
        new_cost, new_normal, new_right = equations(ahead)
        if not new_cost < cost:
            damping *= 10
            if damping > most_damping:
                break
            continue
        gain = cost - new_cost
        state, cost, normal, right = ahead, new_cost, new_normal, new_right
        damping = max(damping / 10, least_damping)
        if gain < tolerance + relative_tolerance * cost:
            break
    return cost, state
