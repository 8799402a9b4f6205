"""Beyond one machine: the same night on a Dask cluster gives the same bytes."""

from __future__ import annotations

import shutil

import pytest

from tests.helpers.toy_site import ToySite

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
