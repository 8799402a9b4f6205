"""What stays on disk."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Keep:
    """What stays; None: all of it."""

    runs: int | None = None
    """Artifacts that so many of the newest runs use."""
    nights: int | None = None
    """Artifacts that runs of so many of the newest nights use."""
    bytes: int | None = None
    """So much of the cache: the artifacts of older runs go first, those of the newest and of the last good one never."""
    clouds: int | None = None
    """Published clouds of so many of the newest nights."""
    reports: int | None = None
    """Reports and logs of so many of the newest nights."""

    @property
    def everything(self) -> bool:
        """Is nothing ever removed?"""
        return self == Keep()
