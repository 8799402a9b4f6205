"""Figures that could not be measured."""

from __future__ import annotations

import math


def known_or_none(figure: float) -> float | None:
    """The figure, or None if it is nan or infinite: figures are written as JSON, which has neither."""
    return figure if math.isfinite(figure) else None
