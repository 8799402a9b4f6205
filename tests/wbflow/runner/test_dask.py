"""A night on a Dask cluster gives the same bytes as on one machine."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.toy_site import HELPERS, ToySite
from wbflow.cache.layout import WorkFolder
from wbflow.cache.store import Cache
from wbflow.errors import UsageError, WbflowError
from wbflow.runner.executors import Cluster, CodeMismatch, translate_paths
from wbflow.runner.options import worker_roots
from wbflow.runner.spec import Files, Input, Joined, Stored, TaskSpec
from wbflow.site.capture_files import CaptureFile
from wbflow.task import Task

distributed = pytest.importorskip("distributed", reason="the extra wbflow[dask] is not installed")


def test_a_cluster_makes_the_same_cloud_though_a_worker_is_killed(
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
    assert not (toy.folder / "faults" / "once").exists()  # a worker was killed
    assert toy.cloud == cloud


def test_a_cluster_without_workers_and_a_missing_one_give_different_errors() -> None:
    with distributed.LocalCluster(n_workers=0, processes=True, dashboard_address=None) as cluster:
        with pytest.raises(WbflowError, match="has no workers"):
            Cluster(cluster.scheduler_address)
        address = cluster.scheduler_address
    with pytest.raises(WbflowError, match=f"no Dask scheduler answers at {address}"):
        Cluster(address)


def test_a_worker_with_other_stage_code_is_refused_and_stores_nothing(
    toy: ToySite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = (HELPERS / "toy_stages.py").read_text()
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "toy_stages.py").write_text(code.replace("matches.x1.sum()", "2 * matches.x1.sum()"))
    for name, value in toy.env().items():
        monkeypatch.setenv(name, value)
    monkeypatch.syspath_prepend(str(tmp_path / "other"))  # worker processes inherit this path
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        refused = toy.wbflow("run", "--backend", "dask", "--scheduler", cluster.scheduler_address)
        assert refused.returncode == 1
        assert "no worker of the cluster runs the same code" in refused.stderr
        assert "toy_stages:clean_frame" in refused.stderr
        assert WorkFolder(toy.work).receipts() == []


class _Client:
    """A cluster with two workers; records which of them each call may be sent to."""

    def __init__(self) -> None:
        self.asked: list[list[str] | None] = []

    def wait_for_workers(self, count: int, timeout: float) -> None: ...

    def nthreads(self) -> dict[str, int]:
        return {"old": 1, "new": 1}

    def get_executor(self, pure: bool) -> _Client:
        return self

    def submit(self, function: Any, *args: Any, workers: list[str] | None) -> None:
        self.asked.append(workers)


def test_paths_are_translated_to_those_of_the_workers_and_back(tmp_path: Path) -> None:
    captures = (CaptureFile("gate.png", tmp_path / "gate.png", "d1g35t"), CaptureFile("roof.png", Path("/other/roof.png"), ""))
    files = Files(captures)
    here = Stored(Task("frames", ("gate",)), file="frame.wbf")
    inputs: dict[str, Input] = {"files": files, "frames": Joined({("gate",): here})}
    spec = TaskSpec(Task("poses", ()), "toy_stages:solve", "code", {"folder": "as it is"}, inputs)
    roots = worker_roots((f"{tmp_path}=/mnt/site",))
    theirs, cache = translate_paths((spec, Cache(WorkFolder(tmp_path / "work"))), roots)
    assert cache.work.root == Path("/mnt/site/work")
    assert str(theirs).replace("/mnt/site", str(tmp_path)) == str(spec) != str(theirs)
    assert translate_paths(theirs, {there: here for here, there in roots.items()}) == spec
    with pytest.raises(UsageError, match="write HERE=THERE"):
        worker_roots(("/srv",))


def test_a_refused_worker_is_given_no_more_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    client = _Client()
    monkeypatch.setattr(distributed, "Client", lambda *positional, **named: client)
    spec = TaskSpec(Task("matches", ("a", "b")), "toy_stages:match", "code", {}, {})
    cluster = Cluster("tcp://somewhere")
    cluster.submit(print, [spec])
    cluster.refuse(CodeMismatch("old", "matcher"))
    cluster.submit(print, [spec])
    assert client.asked == [None, ["new"]]
    cluster.refuse(CodeMismatch("new", "matcher"))
    with pytest.raises(WbflowError, match="no worker of the cluster runs the same code"):
        cluster.submit(print, [spec])
