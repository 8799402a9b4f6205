"""The unit of work that everything in the engine speaks of: a stage applied to one subject."""

from __future__ import annotations

from dataclasses import dataclass

Subject = tuple[str, ...]
"""What a task works on: () for the site, (camera,) or (left, right)."""


@dataclass(frozen=True)
class Task:
    """A stage applied to one subject."""

    stage: str
    subject: Subject = ()

    def __str__(self) -> str:
        return f"{self.stage} {'--'.join(self.subject)}".strip()


def component_name(number: int) -> str:
    """What a component of cameras other than the main one is called, as a subject: component-2 is the second."""
    return f"component-{number + 1}"
