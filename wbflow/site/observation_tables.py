"""The tables of observations and of their survey that a site file names, as `observations` reads them."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from pathlib import Path

from wbflow_stages.contracts import stated

ObservationRows = stated.Observations["array[int]", "array[float]"]
SurveyRows = stated.ThingSurvey["array[int]", "array[float]"]


@dataclass(frozen=True)
class ObservationTable:
    """An observations file."""

    path: Path
    rows: ObservationRows
    """With all cameras of the site, in its order."""
    line: array[int]
    """Line of each row in the file."""

    def point(self, row: int) -> tuple[float, float]:
        """x and y of a row."""
        return self.rows.xy[2 * row], self.rows.xy[2 * row + 1]


@dataclass(frozen=True)
class SurveyTable:
    """A survey file."""

    path: Path
    rows: SurveyRows
    line: array[int]
    """Line of each position in the file; empty if there are only lengths."""
    geodetic: bool = False
    """Are the positions latitude and longitude in degrees, and height in metres?"""

    @property
    def first_geodetic(self) -> tuple[float, float, float] | None:
        """Latitude, longitude and height of the first position; None if it has no such positions."""
        if not self.geodetic:
            return None
        latitude, longitude, height = self.rows.position[:3]
        return latitude, longitude, height
