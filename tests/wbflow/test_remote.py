"""Work folders kept in an object store: same results as on disk, from any machine, despite kills, damage and outages."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from tests.helpers.toy_site import ToySite
from wbflow import remote
from wbflow.cache.layout import WorkFolder
from wbflow.cli.main import main
from wbflow.errors import ExitCode
from wbflow.records.run_folder import refresh
from wbflow.remote import LOCK_NAME, ObjectStore, StoreError

pytest.importorskip("fsspec", reason="object stores need the extra: pip install 'wbflow[cloud]'")

TASKS = 25
"""Number of tasks in one night of the toy site with three cameras."""


@dataclass
class Mirrored(ToySite):
    """A toy site whose work folder is kept in an object store; `machine` selects the machine that it runs on."""

    caches: Path = Path()
    backend: str = field(default="threading")

    @property
    def url(self) -> str:
        return str(self.keys["work"])

    @property
    def work(self) -> Path:
        return WorkFolder.mirroring(self.url, "toy").root

    def machine(self, name: str) -> None:
        os.environ["WBFLOW_CACHE"] = str(self.caches / name)

    def invoke(self, *arguments: str) -> tuple[int, str]:
        """Exit code and output of a command that runs in this process."""
        command = [arguments[0], str(self.file), *arguments[1:]]
        more = ["--backend", self.backend, "--jobs", "1"] if arguments[0] == "run" else []
        result = CliRunner().invoke(main, [*command, *more], env=self.env())
        return result.exit_code, result.output


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("WBFLOW_CACHE", str(tmp_path / "caches" / "first"))
    monkeypatch.setattr(remote, "UPLOAD_SECONDS", 0.05)


@pytest.fixture
def made(toy: ToySite, tmp_path: Path) -> Callable[[str], Mirrored]:
    """Makes the toy site with its work folder at a given URL."""

    def make(url: str) -> Mirrored:
        shutil.rmtree(toy.folder)
        return Mirrored(toy.folder, toy.cameras[:3], keys={"work": url}, caches=tmp_path / "caches")

    return make


@pytest.fixture
def site(made: Callable[[str], Mirrored], tmp_path: Path) -> Mirrored:
    """A site whose store is another folder, for tests that need no S3 server."""
    return made(f"file://{tmp_path}/store")


@pytest.fixture(scope="module")
def s3(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The URL of a bucket on an S3 server that runs on this machine."""
    pytest.importorskip("s3fs", reason="object stores need the extra: pip install 'wbflow[cloud]'")
    server_of = pytest.importorskip("moto.server", reason="moto is not installed: pip install 'wbflow[test]'")
    server = server_of.ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
            patch.setenv(name, "of-nobody")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        import s3fs

        s3fs.S3FileSystem(skip_instance_cache=True).mkdir("nights")
        yield "s3://nights"
    server.stop()


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """The requests to S3, in order: method, and name or prefix of the object."""
    import s3fs

    asked: list[tuple[str, str]] = []
    real = s3fs.S3FileSystem._call_s3

    async def call(self: Any, method: str, *arguments: Any, **named: Any) -> Any:
        asked.append((method, str(named.get("Key") or named.get("Prefix") or "")))
        return await real(self, method, *arguments, **named)

    monkeypatch.setattr(s3fs.S3FileSystem, "_call_s3", call)
    return asked


def on_disk(site: Mirrored, tmp_path: Path) -> bytes:
    """The cloud that the same site produces in an ordinary work folder on disk."""
    assert site.invoke("run", "--work", str(tmp_path / "disk"))[0] == 0
    return (tmp_path / "disk" / "runs" / "latest" / "cloud.ply").read_bytes()


def receipts(url: str, scratch: Path) -> set[str]:
    """Names of the tasks whose receipts are in a store."""
    work = WorkFolder(scratch, url)
    refresh(work)
    return {json.loads(path.read_bytes())["task"] for path in work.receipts()}


def receipts_here(site: Mirrored) -> set[str]:
    return {json.loads(path.read_bytes())["task"] for path in WorkFolder(site.work).receipts()}


def claim(minutes: float) -> bytes:
    """The content of the store's lock (`LOCK_NAME`) as another machine wrote it `minutes` ago."""
    return json.dumps({"token": "t", "host": "crane-pc", "pid": 7, "seen": time.time() - 60 * minutes}).encode()


def test_another_machine_continues_a_killed_night_from_the_store(
    made: Callable[[str], Mirrored], s3: str, tmp_path: Path
) -> None:
    site = made(f"{s3}/killed")
    expected = on_disk(site, tmp_path)
    site.fault("slow", "0.1")
    quick = "import wbflow.remote as r; r.UPLOAD_SECONDS = 0.2"
    command = [
        sys.executable,
        "-c",
        f"{quick}; import wbflow.cli.main as m; m.main()",
        "run",
        str(site.file),
        "--jobs",
        "1",
        "-q",
    ]
    process = subprocess.Popen(command, env=site.env(), start_new_session=True)
    store = ObjectStore(site.url)
    for _ in range(600):
        with contextlib.suppress(StoreError):
            if sum(name.endswith(".json") for name in store.listing()) >= 6:
                break
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    there = receipts(site.url, tmp_path / "scratch")
    assert 2 < len(there) < TASKS
    site.fault("slow", "0")
    site.machine("second")  # the first machine is lost, together with its folder
    assert site.invoke("run")[0] == ExitCode.LOCKED
    store.write(LOCK_NAME, claim(minutes=61))
    record = site.run()
    assert record["tasks"] == {"cached": len(there), "ran": TASKS - len(there), "rejected": 0, "failed": 0, "skipped": 0}
    assert not site.ran() & there
    assert site.cloud == expected


def test_a_night_with_nothing_to_do_transfers_no_artifact(
    made: Callable[[str], Mirrored], s3: str, requests: list[tuple[str, str]]
) -> None:
    site = made(f"{s3}/again")
    site.run()
    assert Counter(method for method, _ in requests)["put_object"] > TASKS
    requests.clear()
    record = site.run()
    assert record["tasks"]["cached"] == TASKS
    assert not [name for method, name in requests if method == "get_object" and "/cache/" in name]
    assert not [name for method, name in requests if method == "put_object" and "/cache/" in name]


def test_two_machines_can_take_turns_with_one_store(site: Mirrored) -> None:
    first = site.run()
    site.machine("second")
    site.capture("gate").write_text("another view from gate")
    second = site.run()
    assert second["tasks"]["ran"] + second["tasks"]["cached"] == TASKS and second["tasks"]["cached"] > 4
    assert json.loads((site.work / "reference" / "reference.json").read_bytes())["run"] == first["run"]
    cloud = site.cloud
    site.machine("first")
    third = site.run()
    assert third["tasks"]["ran"] == 0 and site.cloud == cloud
    shown = [line.split()[0] for line in site.invoke("history")[1].splitlines()[1:]]
    assert {first["run"], second["run"], third["run"]} <= set(shown) | {p.name for p in (site.work / "runs").iterdir()}
    assert (site.work / "runs" / "latest").readlink().name == third["run"]
    assert ObjectStore(site.url).read("runs/latest") == third["run"].encode()


def test_objects_lost_or_damaged_in_the_store_are_made_again_and_reported(site: Mirrored, tmp_path: Path) -> None:
    site.run()
    cloud = site.cloud
    objects = sorted((tmp_path / "store" / "cache").rglob("*.wbf"))
    cut, changed = (next(path for path in objects if stage in path.parts) for stage in ("geometry", "features"))
    cut.write_bytes(cut.read_bytes()[:-100])
    changed.write_bytes(bytes(len(changed.read_bytes())))
    (tmp_path / "store" / "cache" / "matches").rename(tmp_path / "lost")
    site.machine("second")
    record = site.run("--force", "matches", "--force", "geometry", "--force", "poses", "--force", "rectify")
    assert record["exit_code"] == ExitCode.GOOD and site.cloud == cloud
    assert any(changed.name in text and "made again" in text for text in record["repaired"])
    assert not receipts(site.url, tmp_path / "scratch") ^ receipts_here(site)
    site.machine("third")
    again = site.run("--force", "matches", "--force", "fuse")
    assert not any("made again" in text for text in again["repaired"]) and site.cloud == cloud


def test_a_store_that_has_lost_everything_is_filled_again(site: Mirrored, tmp_path: Path) -> None:
    site.run()
    cloud = site.cloud
    shutil.rmtree(tmp_path / "store")
    assert site.run()["tasks"]["cached"] == TASKS
    site.machine("second")
    assert site.run()["tasks"]["cached"] == TASKS and site.cloud == cloud


def test_an_unreachable_store_is_reported_before_any_work_is_done(made: Callable[[str], Mirrored], s3: str) -> None:
    site = made("s3://no-such-bucket/toy")
    assert "only what is on this machine" in site.invoke("status")[1]
    code, words = site.invoke("run")
    assert code == ExitCode.FAILED
    assert "s3://no-such-bucket/toy" in words and "AWS_ENDPOINT_URL" in words
    assert not (site.work / "runs").exists()


def test_a_missing_extra_is_named_with_what_to_install(site: Mirrored, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    code, words = site.invoke("run")
    assert code == ExitCode.USAGE and "pip install 'wbflow[cloud]'" in words


def test_a_night_during_an_outage_of_the_store_is_uploaded_later(site: Mirrored, monkeypatch: pytest.MonkeyPatch) -> None:
    def away(*asked: object) -> None:
        raise StoreError(f"{site.url} does not answer")

    with monkeypatch.context() as gone:
        gone.setattr(ObjectStore, "put", away)
        record = site.run(code=ExitCode.DEGRADED)
    (finding,) = record["verdict"]["findings"]
    assert finding["kind"] == "store-behind" and site.url in finding["text"]
    cloud = site.cloud
    site.run()
    site.machine("second")
    assert site.run()["tasks"]["cached"] == TASKS
    assert site.cloud == cloud
    assert (site.work / "runs" / record["run"] / "run.json").is_file()


def test_two_machines_do_not_write_at_once(site: Mirrored, monkeypatch: pytest.MonkeyPatch) -> None:
    site.run("--until", "frames")
    store = ObjectStore(site.url)
    store.write(LOCK_NAME, claim(minutes=59))
    code, words = site.invoke("run")
    assert code == ExitCode.LOCKED and "crane-pc" in words and site.url in words and "--wait" in words
    assert json.loads(store.read(LOCK_NAME) or b"")["token"] == "t"
    store.write(LOCK_NAME, claim(minutes=61))
    assert site.run()["exit_code"] == ExitCode.GOOD
    assert store.read(LOCK_NAME) is None


def test_a_waiting_run_starts_once_the_store_is_free(site: Mirrored, monkeypatch: pytest.MonkeyPatch) -> None:
    store = ObjectStore(site.url)
    store.write(LOCK_NAME, claim(minutes=1))
    monkeypatch.setattr("wbflow.remote.time.sleep", lambda seconds: store.remove([LOCK_NAME]))
    assert site.invoke("run", "--wait")[0] == ExitCode.GOOD


def test_the_lock_of_a_killed_run_on_this_machine_is_taken_over_at_once(site: Mirrored) -> None:
    site.run("--until", "frames")
    killed = remote.Mirror(WorkFolder(site.work, site.url))
    killed.hold(wait=False)
    assert site.run()["exit_code"] == ExitCode.GOOD


def test_an_object_can_be_created_only_once(s3: str, tmp_path: Path) -> None:
    for url in (f"{s3}/one", f"file://{tmp_path}/one"):
        store = ObjectStore(url)
        assert store.write("held", b"mine", new=True) and not store.write("held", b"yours", new=True)
        assert store.read("held") == b"mine" and store.read("nobody") is None


def test_a_run_whose_lock_was_taken_over_stops_uploading(site: Mirrored, monkeypatch: pytest.MonkeyPatch) -> None:
    store = ObjectStore(site.url)

    def listen(event: object) -> None:
        store.write(LOCK_NAME, claim(minutes=0))

    import wbflow

    with monkeypatch.context() as patch:
        for name, value in site.env().items():
            patch.setenv(name, value)
        run = wbflow.run(site.file, backend="threading", jobs=1, listen=listen)
    assert run.record.exit_code == ExitCode.DEGRADED and run.record.verdict
    assert "taken over" in run.record.verdict.findings[0].text
    assert json.loads(store.read(LOCK_NAME) or b"")["token"] == "t"


def test_clean_removes_artifacts_from_the_store_and_manual_deletion_does_not(site: Mirrored, tmp_path: Path) -> None:
    site.run()
    before = set((tmp_path / "store").rglob("*.wbf"))
    shutil.rmtree(site.work / "cache" / "matches")
    site.capture("gate").write_text("another view from gate")
    site.run()
    assert before <= set((tmp_path / "store").rglob("*.wbf"))
    assert site.invoke("pin", "--drop")[0] == 0
    assert site.invoke("clean", "--keep", "1")[0] == 0
    assert not before <= set((tmp_path / "store").rglob("*.wbf"))
    site.machine("second")
    assert site.run()["tasks"]["cached"] == TASKS


def test_captures_are_fetched_from_a_store_only_once(site: Mirrored, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site.run("--work", str(tmp_path / "disk"))
    cloud = (tmp_path / "disk" / "runs" / "latest" / "cloud.ply").read_bytes()
    delivered = tmp_path / "delivered"
    (site.folder / "captures").rename(delivered)
    site.keys = {"work": str(tmp_path / "work"), "captures": {"root": f"file://{delivered}", "pattern": "{camera}.txt"}}
    site.write()
    fetched: list[str] = []
    fetch = ObjectStore.fetch

    def noted(store: ObjectStore, names: Sequence[str], root: Path) -> None:
        fetched.extend(names)
        fetch(store, names, root)

    monkeypatch.setattr(ObjectStore, "fetch", noted)
    record = site.run()
    assert record["tasks"]["ran"] == TASKS and sorted(fetched) == sorted(f"{camera}.txt" for camera in site.cameras)
    assert (tmp_path / "work" / "runs" / "latest" / "cloud.ply").read_bytes() == cloud
    fetched.clear()
    assert site.run()["tasks"]["cached"] == TASKS and fetched == []
    (delivered / "gate.txt").write_text("another view from gate, somewhat later")
    (delivered / "mast-1.txt").unlink()
    (delivered / "roof.txt").write_bytes(
        next(WorkFolder.mirroring(f"file://{delivered}", "captures").root.glob("gate.txt")).read_bytes()
    )
    record = site.run(code=ExitCode.DEGRADED)
    assert sorted(fetched) == ["gate.txt", "roof.txt"]
    assert [camera["id"] for camera in record["cameras"] if camera["outcome"] != "ok"] == ["mast-1"]


def test_only_captures_of_the_night_are_fetched(site: Mirrored, tmp_path: Path) -> None:
    site.dated = True
    for date in ("2026-11-01", "2026-11-02"):
        site.night(date)
    delivered = tmp_path / "delivered"
    (site.folder / "captures").rename(delivered)
    site.keys = {"captures": {"root": f"file://{delivered}", "pattern": "{camera}-{date}.txt"}}
    site.write()
    assert site.run("--work", str(tmp_path / "work"), "--date", "2026-11-01")["date"] == "2026-11-01"
    here = WorkFolder.mirroring(f"file://{delivered}", "captures").root
    sizes = {path.name: path.stat().st_size for path in here.glob("*.txt")}
    assert len(sizes) == len(list(delivered.iterdir()))
    assert all(bool(size) == ("2026-11-01" in name) for name, size in sizes.items())


def test_odd_object_names_in_a_bucket_do_not_prevent_fetching_captures(s3: str, tmp_path: Path) -> None:
    store, root = ObjectStore(f"{s3}/delivered"), tmp_path / "here"
    for name, data in {"yard/": b"", "yard/gate.txt": b"a view", "yard/gate.txt/odd": b"?", "../out": b"?"}.items():
        store.write(name, data)
    remote.list_captures(root, store.url)
    remote.fetch_captures(root, store.url, [root / "yard" / "gate.txt"])
    assert (root / "yard" / "gate.txt").read_bytes() == b"a view"
    assert not (tmp_path / "out").exists()
