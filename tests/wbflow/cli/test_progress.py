"""How long a run still takes, told by its events alone."""

from __future__ import annotations

import datetime
import heapq

import pytest

from wbflow.cli.display import Progress, duration
from wbflow.pipeline.stages import ROUGH_SECONDS
from wbflow.records.events import Event, PlannedEvent, Signal, StageOutlook, StartedEvent, TaskEvent
from wbflow.task import Task

START = datetime.datetime(2026, 11, 20, 3, 30, tzinfo=datetime.UTC)
COSTS = {"frames": (8, 2.0), "matches": (20, 1.5), "disparity": (20, 9.0), "refine": (8, 14.0), "fuse": (1, 25.0)}
"""Tasks of each stage, and seconds that each takes."""


def at(seconds: float) -> str:
    return (START + datetime.timedelta(seconds=seconds)).isoformat()


def night(
    workers: int,
    expected: dict[str, float],
    known: bool,
    costs: dict[str, tuple[int, float]] = COSTS,
    compiling: dict[str, tuple[float, float]] = {},  # noqa: B006
) -> list[tuple[float, Event | Signal]]:
    """The events of a night whose stages follow each other, with their times; a stage's tasks take from 0.7 to 1.3 of its costs.

    compiling: seconds that every worker's first task of a stage takes on top, as stated and in truth.
    """
    told: list[tuple[float, Event | Signal]] = []
    now, settled = 0.0, dict.fromkeys(costs, 0)

    def plan(moment: float) -> None:
        stated = {name: compiling.get(name, (0.0, 0.0))[0] for name in costs}
        rows = [StageOutlook(name, n, settled[name], expected[name], known, stated[name]) for name, (n, _) in costs.items()]
        told.append((moment, PlannedEvent(tuple(rows), workers, at(moment))))

    for name, (count, seconds) in costs.items():
        plan(now)
        free = [now + compiling.get(name, (0.0, 0.0))[1]] * workers
        for k in range(count):
            begin = heapq.heappop(free)
            end = begin + seconds * (0.7 + 0.6 * k / max(1, count - 1) if count > 1 else 1.0)
            heapq.heappush(free, end)
            begin = begin if k >= workers else now
            task = Task(name, (f"camera-{k}",))
            told.append((begin, StartedEvent(task, at(begin))))
            told.append((end, TaskEvent(task, "ran", at(end), fresh=True, cpu=end - begin)))
        now = max(free)
        settled[name] = count
    plan(now)
    return sorted(told, key=lambda pair: pair[0])


@pytest.mark.parametrize("workers", [1, 2, 8])
@pytest.mark.parametrize("slower", [0.6, 1.0, 1.8])
def test_from_a_third_of_the_run_on_the_time_left_is_right_within_30_percent_of_the_run(workers: int, slower: float) -> None:
    """Whether the machine is as quick as in earlier runs, or not."""
    told = night(workers, {name: seconds / slower for name, (_, seconds) in COSTS.items()}, known=True)
    end = told[-1][0]
    progress = Progress()
    looked = 0
    for moment, event in told:
        progress.add(event)
        if end / 3 <= moment < end:
            left = progress.seconds_left((START + datetime.timedelta(seconds=moment)).timestamp())
            assert left is not None
            assert abs(moment + left - end) < 0.3 * end
            looked += 1
    assert looked > 10


FIRST = {
    "frames": (6, 0.09, 0.2, 0.0),
    "features": (6, 0.17, 0.5, 1.8),
    "matches": (10, 0.27, 0.5, 37.2),
    "geometry": (10, 0.24, 0.5, 2.3),
    "poses": (1, 0.86, 0.5, 0.0),
    "scene": (1, 1.1, 5.0, 10.0),
    "rectify": (10, 0.013, 0.1, 7.5),
    "disparity": (10, 0.39, 0.65, 34.8),
    "depth": (6, 0.05, 0.12, 6.3),
    "refine": (6, 0.6, 0.77, 18.9),
    "fuse": (1, 1.0, 0.74, 9.7),
    "coverage": (1, 0.4, 0.54, 2.2),
}
"""A first run of the small yard on a busy machine, of each stage: tasks; seconds that each took, that it was roughly expected to
take, and that compiling its kernels took."""


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("compiled", [False, True])
def test_so_it_is_in_a_first_run_whether_its_kernels_are_compiled_already_or_not(workers: int, compiled: bool) -> None:
    costs = {name: (count, each) for name, (count, each, _, _) in FIRST.items()}
    rough = {name: expected for name, (_, _, expected, _) in FIRST.items()}
    stated = {name: sum(ROUGH_SECONDS[name][2:]) for name in FIRST}
    compiling = {name: (stated[name], 0.0 if compiled else FIRST[name][3]) for name in FIRST}
    told = night(workers, rough, False, costs, compiling)
    end = told[-1][0]
    progress = Progress()
    off = []
    for moment, event in told:
        progress.add(event)
        if end / 3 <= moment < end:
            left = progress.seconds_left((START + datetime.timedelta(seconds=moment)).timestamp())
            assert left is not None
            off.append(abs(moment + left - end) / end)
    assert len(off) > 10 and max(off) < 0.3


def test_a_first_run_learns_from_its_own_tasks() -> None:
    """On a machine ten times slower than the rough figures: once two stages are through, the rest is expected to be slow, too."""
    told = night(2, {name: seconds / 10 for name, (_, seconds) in COSTS.items()}, known=False)
    end = told[-1][0]
    progress = Progress()
    through = next(moment for moment, event in told if isinstance(event, StartedEvent) and event.task.stage == "disparity")
    for moment, event in told:
        if moment <= through:
            progress.add(event)
    left = progress.seconds_left((START + datetime.timedelta(seconds=through)).timestamp())
    assert left is not None
    assert 0.6 < left / (end - through) < 1.5


def test_the_longer_a_task_takes_the_longer_the_run_may_still_take() -> None:
    progress = Progress()
    progress.add(PlannedEvent((StageOutlook("matches", 3, 0, 2.0, False),), 1, at(0)))
    progress.add(StartedEvent(Task("matches", ("gate", "roof")), at(0)))
    left = [progress.seconds_left((START + datetime.timedelta(seconds=age)).timestamp()) for age in (0, 1, 60, 120)]
    assert left[:2] == [pytest.approx(6.0), pytest.approx(5.0)]
    assert left[2] and left[3] and 6 < left[2] < left[3]
    progress.add(TaskEvent(Task("matches", ("gate", "roof")), "ran", at(120), fresh=True))
    left_after = progress.seconds_left((START + datetime.timedelta(seconds=120)).timestamp())
    assert left_after == pytest.approx(4.0), "the first has compiled what the others find ready"


def test_nothing_is_said_before_it_is_known_what_there_is_to_do() -> None:
    progress = Progress()
    assert progress.seconds_left(0.0) is None
    progress.add(TaskEvent(Task("frames", ("gate",)), "cached", at(0)))
    assert progress.seconds_left(0.0) is None


def test_a_stage_is_told_of_once_when_it_and_those_before_it_have_ended() -> None:
    progress = Progress()
    ended = [stage.name for _, event in night(2, dict.fromkeys(COSTS, 1.0), True) for stage in progress.add(event)]
    assert ended == list(COSTS)
    assert progress.stages["matches"].counts() == "20 ran"
    assert progress.totals == (57, 57)


def test_what_comes_from_the_cache_is_counted_and_no_stage_is_told_of_for_it() -> None:
    progress = Progress()
    tasks = [Task("frames", (name,)) for name in ("gate", "roof")]
    for task in tasks:
        progress.add(TaskEvent(task, "cached", at(0)))
    assert progress.add(PlannedEvent((StageOutlook("frames", 2, 2, 1.0, True),), 2, at(0))) == []
    assert progress.totals == (2, 2)
    assert progress.seconds_left(0.0) == 0.0


@pytest.mark.parametrize(("seconds", "words"), [(4.4, "4 s"), (89, "89 s"), (200, "3 min"), (7900, "2 h 12 min")])
def test_spans_are_said_as_people_say_them(seconds: float, words: str) -> None:
    assert duration(seconds) == words


def test_what_is_compiled_once_is_not_expected_of_every_task() -> None:
    """Of a first run: each worker's first task of a stage takes a minute longer."""
    progress = Progress(workers=2)
    progress.add(PlannedEvent((StageOutlook("disparity", 10, 0, 3.0, False),), 2, at(0)))
    for k, (begin, end) in enumerate([(0, 63), (0, 64), (63, 66), (64, 67)]):
        task = Task("disparity", (f"camera-{k}", "roof"))
        progress.add(StartedEvent(task, at(begin)))
        progress.add(TaskEvent(task, "ran", at(end), fresh=True))
    left = progress.seconds_left((START + datetime.timedelta(seconds=67)).timestamp())
    assert left is not None
    assert 6 < left < 12
