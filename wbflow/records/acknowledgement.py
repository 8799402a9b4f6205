"""An entry of the file of acknowledgements beside a site file."""

from __future__ import annotations

from dataclasses import dataclass

from ..json_dataclass import JsonDataclass


@dataclass(frozen=True)
class Acknowledgement(JsonDataclass):
    """A finding or change that somebody has acknowledged."""

    finding: str
    """Code and subject of a finding ("camera-lost crane-2"), or the id of a change ("C17")."""
    by: str
    on: str
    """ISO 8601 date."""
    what: str = ""
    """A change as it was then: "new 2.0 x 1.4 x 2.6 m at 11.3, 15.0"."""
    until: str = ""
    """The last night to which it applies; "" for all nights."""
    note: str = ""

    def holds(self, night: str) -> bool:
        """Does it apply to a night?"""
        return not self.until or night <= self.until

    @property
    def words(self) -> str:
        """Who acknowledged it, until when, and why."""
        text = f"acknowledged by {self.by} on {self.on}"
        if self.until:
            text += f", until {self.until}"
        if self.note:
            text += f": {self.note}"
        return text
