"""Beyond one machine: the same night on a Dask cluster gives the same bytes."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.helpers.toy_site import HELPERS, ToySite
from wbflow.cache.layout import WorkFolder
from wbflow.cache.store import Cache
from wbflow.errors import UsageError, WbflowError
from wbflow.runner import elsewhere
from wbflow.runner.captures import CaptureFile
from wbflow.runner.mounts import Mount, moved
from wbflow.runner.spec import Files, Joined, Stored, TaskSpec
from wbflow.task import Task

distributed = pytest.importorskip("distributed", reason="the extra wbflow[dask] is not installed")


def test_three_worker_processes_of_a_cluster_make_the_same_cloud_though_one_is_killed(
    toy: ToySite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    toy.run()
    cloud = toy.cloud
    shutil.rmtree(toy.work)
    for name, value in toy.env().items():
        monkeypatch.setenv(name, value)
    toy.fault("once", "matches")
    (tmp_path / "mounted").symlink_to(toy.folder)
    roots = f"{toy.folder}={tmp_path / 'mounted'}"
    with distributed.LocalCluster(n_workers=3, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        result = toy.wbflow("run", "--backend", "dask", "--scheduler", cluster.scheduler_address, "--worker-root", roots)
    assert result.returncode == 0, result.stderr
    assert not (toy.folder / "faults" / "once").exists()  # somebody was killed
    assert toy.cloud == cloud


def test_a_cluster_without_workers_and_one_that_is_not_there_are_told_apart(tmp_path: Path) -> None:
    cache = Cache(WorkFolder(tmp_path))
    with distributed.LocalCluster(n_workers=0, processes=True, dashboard_address=None) as cluster:
        with pytest.raises(WbflowError, match="has no workers"):
            elsewhere.Cluster(cluster.scheduler_address, cache)
        address = cluster.scheduler_address
    with pytest.raises(WbflowError, match=f"no Dask scheduler answers at {address}"):
        elsewhere.Cluster(address, cache)


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
        self.given: list[tuple[list[TaskSpec], Cache]] = []

    def wait_for_workers(self, count: int, timeout: float) -> None: ...

    def nthreads(self) -> dict[str, int]:
        return {"old": 1, "new": 1}

    def submit(self, function: Any, lane: Any, cache: Cache, *rest: Any, pure: bool, workers: list[str] | None) -> Any:
        self.asked.append(workers)
        self.given.append((lane, cache))
        told = elsewhere._Refused("old", "its matcher is not what the run has") if workers is None else ["done"]
        return _Future("finished", lambda: told)


def test_workers_are_told_of_folders_as_they_call_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    client = _Client()
    monkeypatch.setattr(distributed, "Client", lambda *positional, **named: client)
    captures = (CaptureFile("gate.png", tmp_path / "gate.png", "d1g35t"), CaptureFile("roof.png", Path("/other/roof.png"), ""))
    files = Files("Capture", captures)
    here = Stored(Task("frames", ("gate",)), file="frame.wbf")
    spec = TaskSpec(
        Task("poses", ()),
        "toy_stages:solve",
        "code",
        {"folder": "as it is"},
        {"files": files, "frames": Joined({("gate",): here})},
    )
    cluster = elsewhere.Cluster("tcp://somewhere", Cache(WorkFolder(tmp_path / "work")), [Mount.parse(f"{tmp_path}=/mnt/site")])
    cluster.submit([[spec]])
    (theirs,), cache = client.given[0]
    assert cache.work.root == Path("/mnt/site/work")
    assert str(theirs).replace("/mnt/site", str(tmp_path)) == str(spec) != str(theirs)
    assert moved(theirs, [Mount.parse(f"{tmp_path}=/mnt/site").back]) == spec
    with pytest.raises(UsageError, match="write HERE=THERE"):
        Mount.parse("/srv")


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
