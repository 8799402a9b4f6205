"""Work folders whose truth lies in an object store: as on disk, from any machine, whatever is killed, damaged or out of reach."""

from __future__ import annotations

import contextlib
import datetime
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from tests.helpers.toy_site import ToySite
from wbflow.cache.layout import WorkFolder
from wbflow.cli.main import main
from wbflow.errors import ExitCode
from wbflow.remote import courier, lease, mirror
from wbflow.remote.objects import Objects, StoreError
from wbflow.remote.standin import stand_in

pytest.importorskip("fsspec", reason="object stores need the extra: pip install 'wbflow[cloud]'")

TASKS = 25
"""Of a night of the toy's."""
SMALL = 600
"""Of the toy's files the larger ones have objects of their own so."""


@dataclass
class Mirrored(ToySite):
    """A toy site whose work lies in a store; `machine` says on which machine it is run."""

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

    def told(self, *arguments: str) -> tuple[int, str]:
        """Exit code and words of a command in this process."""
        command = [arguments[0], str(self.file), *arguments[1:]]
        more = ["--backend", self.backend, "--jobs", "1"] if arguments[0] == "run" else []
        result = CliRunner().invoke(main, [*command, *more], env=self.env())
        return result.exit_code, result.output


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("WBFLOW_CACHE", str(tmp_path / "caches" / "first"))
    monkeypatch.setattr(mirror, "SMALL", SMALL)
    monkeypatch.setattr(courier, "EVERY_SECONDS", 0.05)


@pytest.fixture
def made(toy: ToySite, tmp_path: Path) -> Callable[[str], Mirrored]:
    """The same toy site with its work at a URL."""

    def make(url: str) -> Mirrored:
        shutil.rmtree(toy.folder)
        return Mirrored(toy.folder, toy.cameras[:3], keys={"work": url}, caches=tmp_path / "caches")

    return make


@pytest.fixture
def site(made: Callable[[str], Mirrored], tmp_path: Path) -> Mirrored:
    """A site whose store is another folder: for all that does not ask for an S3 of its own."""
    return made(f"file://{tmp_path}/store")


@pytest.fixture(scope="module")
def s3(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """The URL of a bucket on a server of this machine."""
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
    """What S3 is asked, and of which object."""
    import s3fs

    asked: list[tuple[str, str]] = []
    real = s3fs.S3FileSystem._call_s3

    async def call(self: Any, method: str, *arguments: Any, **named: Any) -> Any:
        asked.append((method, str(named.get("Key") or named.get("Prefix") or "")))
        return await real(self, method, *arguments, **named)

    monkeypatch.setattr(s3fs.S3FileSystem, "_call_s3", call)
    return asked


def on_disk(site: Mirrored, tmp_path: Path) -> bytes:
    """The cloud that the same site makes in an ordinary work folder."""
    assert site.told("run", "--work", str(tmp_path / "disk"))[0] == 0
    return (tmp_path / "disk" / "runs" / "latest" / "cloud.ply").read_bytes()


def receipts(url: str, scratch: Path) -> set[str]:
    """Tasks that a store knows the results of."""
    work = WorkFolder(scratch, url)
    courier.look(work)
    return {json.loads(path.read_bytes())["task"] for path in work.receipts()}


def test_a_night_is_killed_and_another_machine_goes_on_with_what_has_gone_up(
    made: Callable[[str], Mirrored], s3: str, tmp_path: Path
) -> None:
    site = made(f"{s3}/killed")
    expected = on_disk(site, tmp_path)
    site.fault("slow", "0.1")
    quick = f"import wbflow.remote.mirror as m, wbflow.remote.courier as c; m.SMALL = {SMALL}; c.EVERY_SECONDS = 0.2"
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
    store = Objects(site.url)
    for _ in range(600):
        with contextlib.suppress(StoreError):
            if len(store.names("index")) >= 3:
                break
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    there = receipts(site.url, tmp_path / "scratch")
    assert 2 < len(there) < TASKS
    site.fault("slow", "0")
    site.machine("second")  # the first one's folder is gone with it
    record = site.run()
    assert record["tasks"] == {"cached": len(there), "ran": TASKS - len(there), "rejected": 0, "failed": 0, "skipped": 0}
    assert not site.ran() & there
    assert site.cloud == expected


def test_a_night_with_nothing_to_do_lists_once_and_fetches_no_artifact(
    made: Callable[[str], Mirrored], s3: str, requests: list[tuple[str, str]]
) -> None:
    site = made(f"{s3}/again")
    site.run()
    assert Counter(method for method, _ in requests)["put_object"] > TASKS
    requests.clear()
    record = site.run()
    assert record["tasks"]["cached"] == TASKS
    assert [name for method, name in requests if method == "list_objects_v2"] == ["again/index/"]
    assert {name for method, name in requests if method == "get_object"} == {"again/held.json"}
    assert len(requests) <= 12
    requests.clear()
    site.machine("second")
    code, words = site.told("status", "--json")
    assert (code, json.loads(words)["totals"]) == (0, {"cached": TASKS})
    assert not [name for _, name in requests if name.endswith((".wbf", ".ply", ".jpg"))]


def test_machines_take_turns(site: Mirrored) -> None:
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
    shown = [line.split()[0] for line in site.told("history")[1].splitlines()[1:]]
    assert {first["run"], second["run"], third["run"]} <= set(shown) | {p.name for p in (site.work / "runs").iterdir()}
    assert (site.work / "runs" / "latest").readlink().name == third["run"]
    assert Objects(site.url).read("runs/latest") == third["run"].encode()


def test_what_the_store_has_lost_is_made_anew_and_named(site: Mirrored, tmp_path: Path) -> None:
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
    site.machine("third")
    again = site.run("--force", "matches", "--force", "fuse")
    assert not any("made again" in text for text in again["repaired"]) and site.cloud == cloud


def test_a_damaged_segment_is_not_believed(site: Mirrored, tmp_path: Path) -> None:
    site.run()
    cloud = site.cloud
    for segment in (tmp_path / "store" / "index").iterdir():
        segment.write_bytes(segment.read_bytes()[:-20])
    site.machine("second")
    record = site.run()
    assert record["tasks"]["ran"] == TASKS and site.cloud == cloud
    assert all("index" in text and "made again" in text for text in record["repaired"]) and record["repaired"]
    site.machine("third")
    assert site.run()["tasks"]["cached"] == TASKS


def test_a_store_that_is_out_of_reach_is_said_before_anything_is_done(made: Callable[[str], Mirrored], s3: str) -> None:
    site = made("s3://no-such-bucket/toy")
    assert "what this machine knows" in site.told("status")[1]
    code, words = site.told("run")
    assert code == ExitCode.FAILED
    assert "s3://no-such-bucket/toy" in words and "AWS_ENDPOINT_URL" in words
    assert not (site.work / "runs").exists()


def test_an_extra_that_is_missing_is_named(site: Mirrored, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fsspec.core", None)
    code, words = site.told("run")
    assert code == ExitCode.USAGE and "pip install 'wbflow[cloud]'" in words


def test_a_store_that_goes_away_costs_no_night_and_gets_it_later(site: Mirrored, monkeypatch: pytest.MonkeyPatch) -> None:
    def away(*asked: object) -> None:
        raise StoreError(f"{site.url} does not answer")

    with monkeypatch.context() as gone:
        gone.setattr(Objects, "put", away)
        gone.setattr(Objects, "write", away)
        record = site.run(code=ExitCode.DEGRADED)
    (finding,) = record["verdict"]["findings"]
    assert finding["kind"] == "store-behind" and site.url in finding["text"] and "not yet" in finding["text"]
    cloud = site.cloud
    site.run()
    site.machine("second")
    assert site.run()["tasks"]["cached"] == TASKS
    assert site.cloud == cloud
    assert (site.work / "runs" / record["run"] / "run.json").is_file()


def holder(heard: datetime.datetime, **more: str) -> bytes:
    since = heard.isoformat(timespec="seconds")
    told = {"token": "t", "machine": "another", "process": "7 123", "host": "crane-pc", "since": since, "heard": since, **more}
    return json.dumps(told).encode()


def test_two_machines_do_not_write_at_once(site: Mirrored, monkeypatch: pytest.MonkeyPatch) -> None:
    site.run("--until", "frames")
    now, store = datetime.datetime.now(datetime.UTC), Objects(site.url)
    store.write(lease.NAME, holder(now))
    code, words = site.told("run")
    assert code == ExitCode.LOCKED and "crane-pc" in words and site.url in words and "--wait" in words
    assert json.loads(store.read(lease.NAME) or b"")["token"] == "t"
    monkeypatch.setattr(lease, "_SETTLE_SECONDS", 0.0)
    store.write(lease.NAME, holder(now - datetime.timedelta(minutes=11)))  # nobody has heard of it since
    assert site.run()["exit_code"] == ExitCode.GOOD
    store.write(lease.NAME, holder(now, machine=lease._machine(), process=f"{2**22 + 1} 5"))  # killed on this machine
    assert site.run()["exit_code"] == ExitCode.GOOD
    assert store.read(lease.NAME) is None


def test_only_one_of_two_makes_the_same_object(s3: str, tmp_path: Path) -> None:
    for url in (f"{s3}/one", f"file://{tmp_path}/one"):
        store = Objects(url)
        assert store.create("held", b"mine") and not store.create("held", b"yours")
        assert store.read("held") == b"mine" and store.read("nobody") is None


def test_who_was_taken_over_sends_nothing_more(site: Mirrored, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lease, "BEAT_SECONDS", 0.01)
    store = Objects(site.url)

    def listen(event: object) -> None:
        store.write(lease.NAME, holder(datetime.datetime.now(datetime.UTC)))

    import wbflow

    with monkeypatch.context() as patch:
        for name, value in site.env().items():
            patch.setenv(name, value)
        run = wbflow.run(site.file, backend="threading", jobs=1, listen=listen)
    assert run.record.exit_code == ExitCode.DEGRADED and run.record.verdict
    assert "taken the store over" in run.record.verdict.findings[0].text
    assert json.loads(store.read(lease.NAME) or b"")["token"] == "t"


def test_what_is_cleaned_away_goes_from_the_store_and_what_is_removed_by_hand_comes_back(site: Mirrored, tmp_path: Path) -> None:
    site.run()
    before = set((tmp_path / "store").rglob("*.wbf"))
    shutil.rmtree(site.work / "cache" / "matches")
    site.capture("gate").write_text("another view from gate")
    site.run()
    assert before <= set((tmp_path / "store").rglob("*.wbf"))
    assert site.told("pin", "--drop")[0] == 0
    assert site.told("clean", "--keep", "1")[0] == 0
    assert not before <= set((tmp_path / "store").rglob("*.wbf"))
    site.machine("second")
    assert site.run()["tasks"]["cached"] == TASKS


def test_the_index_is_brought_together(site: Mirrored, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("wbflow.remote.segments.MANY", 2)
    for _ in range(6):
        site.run()
    names = sorted(path.name for path in (tmp_path / "store" / "index").iterdir())
    wholes = [name for name in names if name.endswith("-whole")]
    assert len(wholes) == 2 and len(names) <= 7 and names[0] == wholes[0]
    site.machine("second")
    assert site.run()["tasks"]["cached"] == TASKS
    (tmp_path / "store" / "index" / wholes[-1]).write_bytes(b"")
    site.machine("third")
    record = site.run()
    assert record["tasks"]["cached"] == TASKS and any(wholes[-1] in text for text in record["repaired"])


def test_bytes_come_when_they_are_read(site: Mirrored) -> None:
    site.run()
    site.machine("second")
    assert site.told("status")[0] == 0
    artifact = next((site.work / "cache" / "geometry").rglob("*.wbf"))
    known = stand_in(artifact)
    assert known and artifact.stat().st_size == known.size
    import wbflow

    run = wbflow.open_run(wbflow.load_site(site.file))
    name = artifact.parent.name
    assert run.artifact(f"geometry {name}").F.shape == (3, 3)
    assert stand_in(artifact) is None


def test_captures_come_from_a_store_and_each_once(site: Mirrored, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site.run("--work", str(tmp_path / "disk"))
    cloud = (tmp_path / "disk" / "runs" / "latest" / "cloud.ply").read_bytes()
    delivered = tmp_path / "delivered"
    (site.folder / "captures").rename(delivered)
    site.keys = {"work": str(tmp_path / "work"), "captures": {"root": f"file://{delivered}", "pattern": "{camera}.txt"}}
    site.write()
    fetched: list[str] = []
    fetch = Objects.fetch

    def noted(store: Objects, name: str, to: Path) -> bool:
        fetched.append(name)
        return fetch(store, name, to)

    monkeypatch.setattr(Objects, "fetch", noted)
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


def test_a_bucket_is_shown_as_a_folder_whatever_else_it_holds(s3: str, tmp_path: Path) -> None:
    from wbflow.cache.untrusted import read_outside
    from wbflow.remote.delivery import bring

    store, root = Objects(f"{s3}/delivered"), tmp_path / "here"
    for name, data in {"yard/": b"", "yard/gate.txt": b"a view", "yard/gate.txt/odd": b"?", "../out": b"?"}.items():
        store.write(name, data)
    bring(root, store.url)
    assert read_outside(root / "yard" / "gate.txt") == b"a view"
    assert not (tmp_path / "out").exists()
