"""The engine's unit of work: a stage applied to one subject."""

from __future__ import annotations

from typing import NamedTuple

Subject = tuple[str, ...]
"""What a task works on: () for the site, (camera,) or (left, right).  If a camera is too wide for one pinhole camera, it is split
into views, and each view counts as a camera here; texts for people name the camera (`camera_of`)."""

_VIEW_SEPARATOR = "@"
"""Separates a camera's id, which cannot contain it, from the number of one of its views."""


def view_name(camera: str, number: int) -> str:
    """The name, as a subject, of one view of a camera that has several: gate@1 is the first view of gate."""
    return f"{camera}{_VIEW_SEPARATOR}{number}"


def camera_of(view: str) -> str:
    """The id of a view's camera; most cameras have a single view, which has the camera's id."""
    return view.partition(_VIEW_SEPARATOR)[0]


class Task(NamedTuple):
    """A stage applied to one subject.  (A tuple, since a plan looks up hundreds of thousands of tasks in dictionaries.)"""

    stage: str
    subject: Subject = ()

    def __str__(self) -> str:
        return f"{self.stage} {'--'.join(self.subject)}".strip()


def names_of(task: Task) -> set[str]:
    """The names that select a task in options: its stage, the task itself, and for views the task of their cameras."""
    return {task.stage, str(task), str(Task(task.stage, tuple(map(camera_of, task.subject))))}


def component_name(number: int) -> str:
    """The name, as a subject, of a component of cameras other than the main one (number 0): component-2 for number 1."""
    return f"component-{number + 1}"
