"""Where no terminal is: one line with its time for each stage that ends, each finding, and now and then that work goes on."""

from __future__ import annotations

import datetime
import threading
import time

from ..records.events import Event, Signal
from .progress import Progress, in_words
from .spoken import Words
from .words import say

HEARTBEAT_SECONDS = 300.0
"""Never silent for longer."""


class Lines:
    """Says them; a context manager, at whose end it falls silent."""

    def __init__(self, words: Words, heartbeat: float = HEARTBEAT_SECONDS) -> None:
        self._words = words
        self._progress = Progress()
        self._heartbeat = heartbeat
        self._spoke = time.monotonic()
        self._over = threading.Event()
        self._lock = threading.Lock()
        self._clock = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self) -> Lines:
        self._clock.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._clock.join()

    def hear(self, event: Event | Signal) -> None:
        """Say what there is to say of an event."""
        with self._lock:
            ended = self._progress.add(event)
            for line, fault in self._words.of(event):
                self._say(line, fault)
            for stage in ended:
                self._say(f"{stage.name}: {stage.done} of {stage.tasks} done: {stage.counts()}; {stage.cpu:.1f} CPU s")

    def _say(self, line: str, fault: bool = False) -> None:
        say(f"{datetime.datetime.now():%Y-%m-%dT%H:%M:%S} {line}", err=fault)
        self._spoke = time.monotonic()

    def _beat(self) -> None:
        while not self._over.wait(max(0.0, self._spoke + self._heartbeat - time.monotonic())):
            with self._lock:
                if time.monotonic() - self._spoke >= self._heartbeat:
                    self._say(where_it_is(self._progress, time.time()))


def where_it_is(progress: Progress, now: float) -> str:
    """How far a run is, in one line.  now: seconds since 1970."""
    left = progress.seconds_left(now)
    if left is None:
        return "looking for what is to be done"
    done, tasks = progress.totals
    head = f"{done} of {tasks} tasks done, about {in_words(left)} left"
    running = ", ".join(f"{task} ({in_words(now - since)})" for task, since in progress.running.items())
    return f"{head}; at work: {running}" if running else head
