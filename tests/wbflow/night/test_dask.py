"""Beyond one machine: the same night on a Dask cluster gives the same bytes."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.helpers.toy_site import HELPERS, ToySite
from wbflow.night import elsewhere
from wbflow.night.spec import TaskSpec
from wbflow.store.cache import Cache
from wbflow.store.layout import WorkFolder
from wbflow.task import Task

distributed = pytest.importorskip("distributed", reason="the extra wbflow[dask] is not installed")


def test_two_worker_processes_of_a_cluster_make_the_same_cloud(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    toy.run()
    cloud = toy.cloud
    shutil.rmtree(toy.work)
    for name, value in toy.env().items():
        monkeypatch.setenv(name, value)
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        result = toy.wbflow("run", "--backend", "dask", "--scheduler", cluster.scheduler_address)
    assert result.returncode == 0, result.stderr
    assert toy.cloud == cloud


def test_a_worker_with_other_stage_code_is_refused_and_stores_nothing(
    toy: ToySite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = (HELPERS / "toy_stages.py").read_text()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "toy_stages.py").write_text(code.replace("matches.x1.sum()", "2 * matches.x1.sum()"))
    for name, value in toy.env().items():
        monkeypatch.setenv(name, value)
    monkeypatch.syspath_prepend(str(tmp_path / "other"))  # whence worker processes have it, too
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        refused = toy.wbflow("run", "--backend", "dask", "--scheduler", cluster.scheduler_address)
        assert refused.returncode == 1
        assert "no worker of the cluster runs the same code" in refused.stderr
        assert "toy_stages:clean_frame" in refused.stderr
        assert WorkFolder(toy.work).receipts() == []


@dataclass(frozen=True)
class _Future:
    status: str
    result: Any


class _Client:
    """Two workers of a cluster, of which the first has other code: what it is given, it does at once."""

    def __init__(self) -> None:
        self.asked: list[list[str] | None] = []

    def wait_for_workers(self, count: int, timeout: float) -> None: ...

    def nthreads(self) -> dict[str, int]:
        return {"old": 1, "new": 1}

    def submit(self, function: Any, lane: Any, *rest: Any, pure: bool, workers: list[str] | None) -> Any:
        self.asked.append(workers)
        told = elsewhere._Refused("old", "its matcher is not what the run has") if workers is None else ["done"]
        return _Future("finished", lambda: told)


def test_what_a_worker_was_refused_for_another_one_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    client = _Client()
    monkeypatch.setattr(distributed, "Client", lambda *positional, **named: client)
    monkeypatch.setattr(distributed, "wait", lambda futures, return_when: SimpleNamespace(done=futures))
    spec = TaskSpec(Task("matches", ("a", "b")), "toy_stages:match", "code", {}, {})
    cluster = elsewhere.Cluster("tcp://somewhere", Cache(WorkFolder(tmp_path)))
    cluster.submit([[spec]])
    assert list(cluster.reports()) == []
    done: list[object] = [report.done for report in cluster.reports()]
    assert done == ["done", None]
    assert client.asked == [None, ["new"]]
