"""Where somebody watches: stages with how far they are, the time that is left, what is at work; findings above, as they come."""

from __future__ import annotations

import datetime
import sys
import threading
import time
from typing import TYPE_CHECKING

from ..errors import printable
from ..records.events import ArrivalsEvent, Event, PlannedEvent, Signal
from .inplace import InPlace
from .progress import Progress, StageProgress, in_words
from .spoken import Words
from .words import LONGEST_WORDS, say

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.table import Table

TIMES_A_SECOND = 4
MOST_RUNNING = 6
"""So many of the tasks at work are named."""


class Display:
    """Draws them; a context manager, at whose end the terminal is as it was.

    The table is only drawn once there is something to do: a run that finds everything in the cache does without rich.
    """

    def __init__(self, words: Words) -> None:
        self._words = words
        self._progress = Progress()
        self._lock = threading.RLock()
        self._begun = self._spoke = time.monotonic()
        self._place = InPlace()
        self._console: Console | None = None
        self._over = threading.Event()
        self._clock = threading.Thread(target=self._redraw, daemon=True)

    def __enter__(self) -> Display:
        self._place.say(f"{self._words.site}: looking for what is to be done ...")
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        if self._console:
            self._clock.join()
        self._place.end()

    def hear(self, event: Event | Signal) -> None:
        """Say what there is to say of an event, and draw how things stand."""
        with self._lock:
            self._progress.add(event)
            for line, fault in self._words.of(event):
                self._above(line, fault)
            if isinstance(event, ArrivalsEvent):
                self._arrived(event)
            elif self._console is None and isinstance(event, PlannedEvent):
                self._begin()

    def _arrived(self, event: ArrivalsEvent) -> None:
        """Say how far looking at captures is, now and then: it takes a while where there are many that are new."""
        now = time.monotonic()
        if now - self._spoke >= 1 / TIMES_A_SECOND:
            left = in_words((now - self._begun) * (event.of - event.cameras) / event.cameras)
            self._place.say(f"{self._words.site}: captures of {event.cameras}/{event.of} cameras read; the plan in about {left}")
            self._spoke = now

    def _begin(self) -> None:
        from rich.console import Console

        self._console = Console(stderr=True, highlight=False)
        self._draw(self._console)
        self._clock.start()

    def _redraw(self) -> None:
        while self._console and not self._over.wait(1 / TIMES_A_SECOND):
            self._draw(self._console)

    def _draw(self, console: Console, above: str | None = None) -> None:
        with self._lock:
            with console.capture() as drawn:
                console.print(self._drawn(console))
            self._place.draw(drawn.get().splitlines()[-console.size.height :], above)

    def _above(self, line: str, fault: bool) -> None:
        """Say a line above what is drawn."""
        if self._console is None:
            self._place.end()
            say(line, err=fault)
        elif fault or sys.stdout.isatty():
            self._draw(self._console, printable(line, LONGEST_WORDS))
        else:
            say(line)

    def _drawn(self, console: Console) -> RenderableType:
        from rich.console import Group
        from rich.text import Text

        now = time.time()
        lines: list[RenderableType] = [self._table(console.size.height - MOST_RUNNING - 3)]
        lines += [
            Text(f"  {task}  {in_words(max(0.0, now - since))}", style="dim", no_wrap=True, overflow="ellipsis")
            for task, since in list(self._progress.running.items())[:MOST_RUNNING]
        ]
        return Group(*lines, Text(outlook_line(self._progress, now), style="bold", no_wrap=True, overflow="ellipsis"))

    def _table(self, room: int) -> Table:
        from rich.progress_bar import ProgressBar
        from rich.table import Table

        table = Table.grid(padding=(0, 2, 0, 0))
        table.add_column(min_width=10, no_wrap=True)
        table.add_column(width=24)
        table.add_column(justify="right", no_wrap=True)
        table.add_column(no_wrap=True, overflow="ellipsis", style="dim")
        for stage in shown_stages(list(self._progress.stages.values()), max(3, room)):
            bar = ProgressBar(total=max(1, stage.tasks), completed=stage.done, width=24)
            table.add_row(stage.name, bar, f"{stage.done}/{stage.tasks}", stage.counts())
        return table


def shown_stages(stages: list[StageProgress], room: int) -> list[StageProgress]:
    """The stages that are drawn on a low terminal: from the last that has ended on."""
    if len(stages) <= room:
        return stages
    first = next((i for i, stage in enumerate(stages) if stage.left), len(stages))
    start = max(0, min(first - 1, len(stages) - room))
    return stages[start : start + room]


def outlook_line(progress: Progress, now: float) -> str:
    """The last line: all tasks, and until when.  now: seconds since 1970."""
    left = progress.seconds_left(now)
    done, tasks = progress.totals
    if left is None:
        return "looking for what is to be done"
    if done >= tasks:
        return f"{done} of {tasks} tasks; putting the run together"
    until = datetime.datetime.fromtimestamp(now + left)
    return f"{done} of {tasks} tasks; ETA {until:%H:%M}, about {in_words(left)} left"
