"""Where somebody watches: stages with how far they are, the time that is left, what is at work; findings above, as they come."""

from __future__ import annotations

import datetime
import sys
import threading
import time
from typing import TYPE_CHECKING

from ..errors import printable
from ..store.events import Event, PlannedEvent, Signal
from .progress import Progress, StageProgress, in_words
from .spoken import Words
from .words import echo, say

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.live import Live
    from rich.table import Table

TIMES_A_SECOND = 4
MOST_RUNNING = 6
"""So many of the tasks at work are named."""
_WIPE = "\r\x1b[K"


class Display:
    """Draws them; a context manager, at whose end the terminal is as it was.

    The table is only drawn once there is something to do: a run that finds everything in the cache does without rich.
    """

    def __init__(self, words: Words) -> None:
        self._words = words
        self._progress = Progress()
        self._lock = threading.RLock()
        self._live: Live | None = None

    def __enter__(self) -> Display:
        echo(f"{printable(self._words.site)}: looking for what is to be done ...", nl=False, err=True)
        return self

    def __exit__(self, *error: object) -> None:
        if self._live:
            self._live.stop()
        else:
            echo(_WIPE, nl=False, err=True)

    def hear(self, event: Event | Signal) -> None:
        """Say what there is to say of an event, and draw how things stand."""
        with self._lock:
            self._progress.add(event)
            said = self._words.of(event)
        for line, fault in said:
            self._above(line, fault)
        if self._live is None and isinstance(event, PlannedEvent):
            self._begin()

    def _begin(self) -> None:
        from rich.console import Console
        from rich.live import Live

        echo(_WIPE, nl=False, err=True)
        console = Console(stderr=True, highlight=False)
        self._live = Live(
            console=console,
            get_renderable=lambda: self._drawn(console),
            refresh_per_second=TIMES_A_SECOND,
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self._live.start(refresh=True)

    def _above(self, line: str, fault: bool) -> None:
        """Say a line above the table."""
        if self._live is None:
            echo(_WIPE, nl=False, err=True)
            say(line, err=fault)
        elif fault or sys.stdout.isatty():
            from rich.text import Text

            self._live.console.print(Text(printable(line)), soft_wrap=True)
        else:
            say(line)

    def _drawn(self, console: Console) -> RenderableType:
        from rich.console import Group
        from rich.text import Text

        with self._lock:
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
