"""Figures that a test expects to have been measured."""

from __future__ import annotations


def measured(figure: float | None) -> float:
    """The figure, which must not be None."""
    assert figure is not None
    return figure
