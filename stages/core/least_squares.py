"""Nonlinear least squares over states that are not vectors: rotations, essential matrices, unit vectors."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from ..types import Float64s

State = TypeVar("State")
Equations = tuple[float, Float64s, Float64s]
"""Cost of a state, normal matrix (k, k) and gradient (k,) there."""


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
    """Minimise a cost from a starting state; returns the least cost found and its state.

    Parameters
    ----------
    state : where to start.
    equations : gives the cost of a state, and normal matrix N (k, k) and gradient g (k,) of the linear system N step = -g.
    moved : gives the state after a step (k,).
    steps : largest number of steps, accepted or not.
    damping, least_damping, most_damping : initial, smallest and largest damping, as shares of N's diagonal: a tenth after each
        step that lowers the cost, ten times as much after any other.  Ends if it would exceed the largest.
    floor : share of the diagonal's sum that is added to the damped diagonal, for directions that the equations leave open.
    tolerance, relative_tolerance : ends when a step lowers the cost by less than `tolerance` plus this share of the cost.

    References: Marquardt, SIAM Journal on Applied Mathematics, 1963.
    """
    cost, normal, gradient = equations(state)
    for _ in range(steps):
        # Marquardt's damping by the diagonal: the step does not depend on the units of the unknowns
        damped = normal + damping * np.diag(np.diag(normal) + floor * np.trace(normal))
        step = np.asarray(np.linalg.solve(damped, -gradient), dtype=np.float64)
        new_state = moved(state, step)
        new_cost, new_normal, new_gradient = equations(new_state)
        if not new_cost < cost:  # nan too: the step is taken back, and a shorter one tried
            damping *= 10
            if damping > most_damping:
                break
            continue
        decrease = cost - new_cost
        state = new_state
        cost = new_cost
        normal = new_normal
        gradient = new_gradient
        damping = max(damping / 10, least_damping)
        if decrease < tolerance + relative_tolerance * cost:
            break
    return cost, state
