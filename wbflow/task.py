"""The unit of work that everything in the engine speaks of: a stage applied to one subject."""

from __future__ import annotations

from typing import NamedTuple

Subject = tuple[str, ...]
"""What a task works on: () for the site, (camera,) or (left, right).  Of a camera that is too wide for one pinhole each view
counts as a camera; what a person sees of it is said of the camera (`camera_of`)."""

_VIEW = "@"
"""Between a camera's id, in which it cannot be, and the number of one of its views."""


def view_name(camera: str, number: int) -> str:
    """What a view of a camera is called that has several, as a subject: gate@1 is the first of gate."""
    return f"{camera}{_VIEW}{number}"


def camera_of(view: str) -> str:
    """The id of the camera that a view is of; most cameras have one view, which is called as they are."""
    return view.partition(_VIEW)[0]


class Task(NamedTuple):
    """A stage applied to one subject.  (A plan asks for tasks by the hundred thousand: tuples are found quickest.)"""

    stage: str
    subject: Subject = ()

    def __str__(self) -> str:
        return f"{self.stage} {'--'.join(self.subject)}".strip()


def names_of(task: Task) -> set[str]:
    """What people may call a task: its stage, itself, and of a view the same of its camera."""
    return {task.stage, str(task), str(Task(task.stage, tuple(map(camera_of, task.subject))))}


def component_name(number: int) -> str:
    """What a component of cameras other than the main one is called, as a subject: component-2 is the second."""
    return f"component-{number + 1}"
