"""Levenberg-Marquardt never increases the cost, and reaches the minimum of curved valleys."""

from __future__ import annotations

import numpy as np
import pytest

from wbflow_stages.core.least_squares import Equations, levenberg_marquardt


def rosenbrock(x: np.ndarray) -> Equations:
    """The valley 100 (y - x^2)^2 + (1 - x)^2 as normal equations."""
    r = np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])
    J = np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])
    return float(r @ r), J.T @ J, J.T @ r


def step(x: np.ndarray, by: np.ndarray) -> np.ndarray:
    return np.asarray(x + by)


@pytest.mark.parametrize("start", [(-1.2, 1.0), (3.0, -4.0), (0.0, 0.0)])
def test_the_minimum_of_a_curved_valley_is_found(start: tuple[float, float]) -> None:
    cost, x = levenberg_marquardt(np.array(start), rosenbrock, step, steps=200, damping=1e-3, relative_tolerance=1e-12)
    assert x == pytest.approx([1, 1], abs=1e-6) and cost < 1e-12


def test_more_steps_never_increase_the_cost() -> None:
    costs = [
        levenberg_marquardt(np.array([-1.2, 1.0]), rosenbrock, step, steps=steps, damping=1e-3)[0] for steps in range(0, 30, 3)
    ]
    assert costs == sorted(costs, reverse=True) and costs[0] == pytest.approx(24.2)


def test_a_start_that_no_step_improves_is_returned_unchanged() -> None:
    def worse(x: np.ndarray, by: np.ndarray) -> np.ndarray:
        return np.asarray(x + 10 * np.sign(by) + 5)

    start = np.array([0.9, 0.8])
    cost, x = levenberg_marquardt(start, rosenbrock, worse, steps=20, damping=1.0)
    assert np.array_equal(x, start) and cost == rosenbrock(start)[0]


def test_a_direction_that_the_equations_do_not_determine_stays_unchanged() -> None:
    def flat(x: np.ndarray) -> Equations:
        return float(x[0] ** 2), np.diag([1.0, 0.0]), np.array([x[0], 0.0])

    _, x = levenberg_marquardt(np.array([3.0, 7.0]), flat, step, steps=20, damping=1e-4, floor=1e-12)
    assert x == pytest.approx([0, 7], abs=1e-6)
