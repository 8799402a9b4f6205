"""Threads change how long a stage takes, and nothing else."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from wbflow_stages.core.parallel import THREADS, parallel_map


@pytest.mark.parametrize("threads", ["", "1", "2", "9", "many"])
def test_results_come_in_order_whatever_the_number_of_threads(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS, threads)
    assert list(parallel_map(lambda x: x * x, range(20))) == [x * x for x in range(20)]


def test_two_threads_work_at_the_same_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS, "2")
    barrier = threading.Barrier(2, timeout=30)  # a single thread would never pass it
    assert sorted(parallel_map(lambda _: barrier.wait(), range(4))) == [0, 0, 1, 1]


def test_few_items_are_taken_ahead_of_the_consumer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS, "2")
    requested = []

    def items() -> Iterator[int]:
        for x in range(100):
            requested.append(x)
            yield x

    results = parallel_map(lambda x: x, items())
    assert [next(results), next(results)] == [0, 1]
    assert len(requested) <= 4


def test_an_error_in_a_thread_is_raised_in_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS, "2")
    results = parallel_map(lambda x: 1 // (2 - x), range(5))
    assert [next(results), next(results)] == [0, 1]
    with pytest.raises(ZeroDivisionError):
        next(results)
