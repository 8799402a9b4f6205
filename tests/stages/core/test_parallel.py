"""Threads change how long a stage takes, and nothing else."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from wbflow_stages.core.parallel import THREADS, parallel_map


@pytest.mark.parametrize("threads", ["", "1", "2", "9", "many"])
def test_results_come_in_order_however_many_threads_there_are(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS, threads)
    assert list(parallel_map(lambda x: x * x, range(20))) == [x * x for x in range(20)]


def test_with_two_threads_two_are_at_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS, "2")
    met = threading.Barrier(2, timeout=30)  # a single thread would never pass it
    assert sorted(parallel_map(lambda _: met.wait(), range(4))) == [0, 0, 1, 1]


def test_nothing_is_made_far_ahead_of_who_takes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS, "2")
    asked = []

    def items() -> Iterator[int]:
        for x in range(100):
            asked.append(x)
            yield x

    made = parallel_map(lambda x: x, items())
    assert [next(made), next(made)] == [0, 1]
    assert len(asked) <= 4


def test_what_goes_wrong_in_a_thread_is_raised_in_its_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS, "2")
    made = parallel_map(lambda x: 1 // (2 - x), range(5))
    assert [next(made), next(made)] == [0, 1]
    with pytest.raises(ZeroDivisionError):
        next(made)
