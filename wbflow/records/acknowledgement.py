"""An entry of the file of acknowledgements beside a site file."""

from __future__ import annotations

from dataclasses import dataclass

from ..json_dataclass import JsonDataclass


@dataclass(frozen=True)
class Acknowledgement(JsonDataclass):
    """A finding or change that somebody has acknowledged."""

    finding: str
    """Code and subject of a finding ("camera-lost crane-2"), or kind and position of a change ("change new at 9.2,15.3,1.3")."""
    by: str
    on: str
    """ISO 8601 date."""
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
