"""The supervisor of tasks: worker processes that are kept warm, each task under a limit of time and memory.

What a task does to its process (it hangs, takes all memory, is killed, ends it) is that task's fault and costs it alone: what
its lane had finished before is kept, the rest of the night goes on.  A worker that was lost is forgiven once: what it was at is
done again, alone.  One that took too long is not: it has had its time.
"""

from __future__ import annotations

import datetime
import heapq
import itertools
import math
import select
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, field

from ..cache.sizes import in_words
from ..cache.store import Cache, Receipt
from ..errors import WbflowError
from ..task import Task
from . import machine
from .hand import LOOK_SECONDS, Hand
from .holding import Holding
from .limits import Limits
from .spec import TaskSpec
from .state import Cause
from .worker import Done, unkept

START_SECONDS = 120.0
"""A worker process that has not started in this time never will."""
HANDFUL_SECONDS = 0.25
"""Lanes that together take no longer are handed out at once: their results are made to last at once, too."""


@dataclass(frozen=True)
class Report:
    """What became of a task, or that its lane has come to an end."""

    lane: list[TaskSpec]
    done: Done | None
    """None: nothing more will come of the lane."""


@dataclass
class _Lane:
    """A lane on its way."""

    specs: list[TaskSpec]
    finished: int = 0
    receipts: dict[Task, Receipt] = field(default_factory=dict)
    """Of what it has finished."""
    losses: int = 0
    """Workers that the task now at work has lost."""

    @property
    def at_work(self) -> TaskSpec:
        return self.specs[min(self.finished, len(self.specs) - 1)]

    def goes_on(self, done: Done) -> bool:
        """Does a task follow the one that has just ended?"""
        return self.finished < len(self.specs) and done.receipt is not None and done.outcome != "rejected"

    def count(self, done: Done) -> None:
        self.finished, self.losses = self.finished + 1, 0
        if done.receipt:
            self.receipts[done.task] = done.receipt


@dataclass
class _Handful:
    """Lanes that a worker has in hand; it does one after the other."""

    lanes: list[_Lane]
    over: int = 0
    """So many have come to their end, and wait for the rest: what they have made lasts when all of it does."""

    @property
    def lane(self) -> _Lane:
        """The one at work."""
        return self.lanes[min(self.over, len(self.lanes) - 1)]

    @property
    def at_work(self) -> Task:
        return self.lane.at_work.task

    def count(self, done: Done) -> bool:
        """Count what has ended; is another task begun?"""
        lane = self.lane
        lane.count(done)
        self.over += not lane.goes_on(done)
        return self.over < len(self.lanes)


class Supervisor:
    """Does lanes in worker processes of its own; see `executor.Executor`."""

    def __init__(
        self,
        jobs: int,
        cache: Cache,
        limits: Limits,
        warn: Callable[[str, Task], None],
        begun: Callable[[Task], None] = lambda task: None,
    ) -> None:
        self._begun = begun
        self._jobs = jobs
        self._cache = cache
        self._limits = limits
        self._holding = Holding(limits)
        self._warn = warn
        self._queue: list[tuple[float, int, _Lane]] = []
        self._numbers = itertools.count()
        self._alone: list[_Lane] = []  # that have lost a worker, and wait until nothing else is at work
        self._idle: list[Hand] = []
        self._busy: dict[Hand, _Handful] = {}
        self._took: dict[str, float] = {}  # what the last task of each stage took tonight, seconds by the clock
        self._kills = machine.kills_for_memory()
        self._until = limits.until
        self._look = 0.0  # when memory is looked at next

    def submit(self, lanes: list[list[TaskSpec]]) -> None:
        """Lanes to be done, longest expected first, else in their order."""
        self._line_up(map(_Lane, lanes))

    def _line_up(self, lanes: Iterable[_Lane]) -> None:
        for lane in lanes:
            heapq.heappush(self._queue, (-self._expected(lane), next(self._numbers), lane))

    def reports(self) -> Iterator[Report]:
        """What becomes of tasks, as it happens; ends when lanes have ended and no other is queued behind them, and once when the
        time of the run is over."""
        ended = False
        while self._queue or (not ended and (self._busy or self._alone)):
            if self._until and datetime.datetime.now() >= self._until:
                self._until = None
                return
            self._assign()
            for report in self._listen():
                ended = ended or report.done is None
                yield report

    def close(self) -> None:
        """End all workers, whatever they are at."""
        for hand, handful in self._busy.items():
            for done in filter(None, hand.heard()[0]):  # what it had told, and nobody has read
                handful.count(done)
        for hand in [*self._idle, *self._busy]:
            hand.end()
        for handful in self._busy.values():
            list(self._kept(handful))
        self._idle, self._busy, self._queue, self._alone = [], {}, [], []

    def _expected(self, lane: _Lane) -> float:
        past = self._limits.past
        return sum(past.expected(spec.task.stage, str(spec.task)) for spec in lane.specs)

    def _assign(self) -> None:
        """Give work to who has none, and start workers for what is left."""
        first = bool(self._queue)
        alone = any(lane.losses for handful in self._busy.values() for lane in handful.lanes)
        room = 1 if not first else self._jobs if not alone else 0
        while (self._queue if first else self._alone) and len(self._busy) < room:
            if first and self._busy and not self._fits(self._queue[0][2]):
                return
            lanes = self._next_lanes() if first else [self._alone.pop(0)]
            hand = self._idle.pop() if self._idle else Hand(self._jobs)
            hand.give([(lane.specs[lane.finished :], lane.receipts) for lane in lanes], self._cache)
            self._busy[hand] = _Handful(lanes)
            self._begun(lanes[0].at_work.task)

    def _fits(self, lane: _Lane) -> bool:
        """Will it hold so little that it can be done beside those at work?"""
        begun = [[spec.task for each in handful.lanes for spec in each.specs] for handful in self._busy.values()]
        return self._holding.fits(begun, [spec.task for spec in lane.specs])

    def _next_lanes(self) -> list[_Lane]:
        """The next lane; where it is known to be quick, with others that are, but no more than each worker's share of them."""
        most = len(self._queue) // (2 * self._jobs)
        lanes, seconds = [heapq.heappop(self._queue)[2]], 0.0
        while len(lanes) < most:
            seconds += self._tonight(lanes[-1])
            if seconds + self._tonight(self._queue[0][2]) > HANDFUL_SECONDS:
                break
            lanes.append(heapq.heappop(self._queue)[2])
        return lanes

    def _tonight(self, lane: _Lane) -> float:
        """What a lane will take, by what the like took tonight, and by what it took before."""
        took = sum(self._took.get(spec.task.stage, math.inf) for spec in lane.specs)
        return max(took, self._expected(lane))

    def _listen(self) -> Iterator[Report]:
        self._wait()
        fullest = self._above_memory()
        for hand, handful in list(self._busy.items()):
            told, alive = hand.heard()
            for done in told:
                if not hand.ready:
                    hand.ready = True
                elif done is not None:
                    specs, another = handful.lane.specs, handful.count(done)
                    if done.receipt:
                        self._holding.learn(done.task.stage, done.receipt.peak_rss_mb)
                    self._took[done.task.stage] = done.receipt.wall if done.receipt else math.inf
                    yield Report(specs, done)
                    if another:
                        self._begun(handful.at_work)
                else:
                    self._idle.append(hand)
                    del self._busy[hand]
                    for lane in handful.lanes:
                        yield Report(lane.specs, None)
            if hand not in self._busy:
                continue
            if not alive:
                yield from self._lost(hand, *self._why(hand))
            elif hand is fullest:
                yield from self._lost(hand, *self._took_all(hand))
            elif not hand.ready and hand.age > START_SECONDS:
                self.close()
                raise WbflowError(f"a worker process has not started in {START_SECONDS:.0f} s", remedy="is the machine well?")
            elif hand.age > self._limits.seconds_for(handful.at_work):
                yield from self._too_slow(hand)

    def _wait(self) -> None:
        """Until one of those at work tells something, or it is time to look at them."""
        poll = select.poll()
        for hand in self._busy:
            poll.register(hand.pipe.fileno(), select.POLLIN)
        poll.poll(LOOK_SECONDS * 1000)

    def _above_memory(self) -> Hand | None:
        """Who has to go because all workers together hold too much: those without work at once, else the fullest."""
        if time.monotonic() < self._look:
            return None
        self._look = time.monotonic() + LOOK_SECONDS
        held = {hand: hand.holds() for hand in [*self._busy, *self._idle]}
        if not self._limits.memory or sum(held.values()) <= self._limits.memory:
            return None
        for hand in self._idle:
            hand.end()
            del held[hand]
        self._idle = []
        return max(held, key=lambda hand: held[hand]) if sum(held.values()) > self._limits.memory else None

    def _took_all(self, hand: Hand) -> tuple[str, Cause]:
        hand.end()
        limit = self._limits.memory
        together = f"all workers together more than the {in_words(limit)} that they may"
        why = f"ran out of memory: it held {in_words(hand.most)}, and {together}"
        return why, Cause.OUT_OF_MEMORY

    def _why(self, hand: Hand) -> tuple[str, Cause]:
        """Why a worker is not there any more."""
        how = hand.ended()
        kills, before = machine.kills_for_memory(), self._kills
        self._kills = kills
        if "SIGKILL" in how and kills > before:
            return f"{how} because the machine ran out of memory (it held {in_words(hand.most)})", Cause.OUT_OF_MEMORY
        if "SIGKILL" in how and self._limits.memory and hand.most > self._limits.memory / 2:
            return f"{how} (out of memory? it held {in_words(hand.most)})", Cause.WORKER_LOST
        return how, Cause.WORKER_LOST

    def _lost(self, hand: Hand, why: str, cause: Cause) -> Iterator[Report]:
        handful = self._busy.pop(hand)
        if not hand.ready:
            self.close()
            raise WbflowError(f"no worker process can be started: the first {why.partition(',')[0]}", remedy=_INSTALLED)
        lane = yield from self._left(handful)
        if lane is None:
            return
        task = lane.at_work.task
        lane.losses += 1
        if lane.losses == 1:
            self._warn(f"it {why}: it is done again, alone", task)
            self._alone.append(lane)
            return
        remedy = "lower `resolution`, or give it more with --memory" if cause is Cause.OUT_OF_MEMORY else "look at its function"
        yield from _failed(lane, f"{why}, twice; {remedy}", cause)

    def _left(self, handful: _Handful) -> Generator[Report, None, _Lane | None]:
        """Of lanes whose worker is gone: what was finished stays, what was not begun waits again; returns the one at work."""
        yield from self._kept(handful)
        for lane in handful.lanes[: handful.over]:
            yield Report(lane.specs, None)
        self._line_up(handful.lanes[handful.over + 1 :])
        return handful.lane if handful.over < len(handful.lanes) else None

    def _kept(self, handful: _Handful) -> Iterator[Report]:
        """What lanes had finished stays, though their worker is gone; what cannot be kept has to be made again."""
        for lane in handful.lanes:
            for task, receipt in lane.receipts.items():
                try:
                    self._cache.assure(receipt)
                except OSError as error:
                    yield Report(lane.specs, unkept(task, error))
            for spec in lane.specs:
                self._cache.tidy(spec.task)

    def _too_slow(self, hand: Hand) -> Iterator[Report]:
        handful = self._busy.pop(hand)
        hand.end()
        lane = yield from self._left(handful)
        if lane is None:
            return
        task = lane.at_work.task
        before = self._limits.past.stages.get(task.stage)
        usual = f" ({task.stage} takes {_time(before)} as a rule)" if before is not None else ""
        why = f"took longer than {_time(self._limits.seconds_for(task))}{usual} and was ended; --time-limit gives more"
        yield from _failed(lane, why, Cause.TOO_SLOW)


_INSTALLED = "the words above say why; is wbflow installed for this Python?"


def _failed(lane: _Lane, why: str, cause: Cause) -> Iterator[Report]:
    yield Report(lane.specs, Done(lane.at_work.task, "failed", reason=why, code=cause))
    yield Report(lane.specs, None)


def _time(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.3g} s"
    return f"{seconds / 60:.0f} minutes" if seconds < 7200 else f"{seconds / 3600:.3g} hours"
