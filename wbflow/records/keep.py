"""Limits on what is kept of earlier runs."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Keep:
    """Limits on what is kept; None keeps everything of that kind."""

    runs: int | None = None
    """Number of newest runs whose artifacts are kept."""
    nights: int | None = None
    """Number of newest nights whose artifacts are kept; with both limits, a run must be within both."""
    bytes: int | None = None
    """Size limit of the cache, reference excluded: oldest runs lose their artifacts first, the newest and last good run never."""
    clouds: int | None = None
    """Number of newest nights whose published clouds are kept."""
    reports: int | None = None
    """Number of newest nights whose reports, with their logs, are kept."""

    @property
    def keeps_artifacts(self) -> bool:
        """Are all artifacts kept?"""
        return self.runs is self.nights is self.bytes is None
