"""`wbflow models`: published models are listed, downloaded and checked; a broken download is gone on with."""

from __future__ import annotations

import fcntl
import hashlib
import json
import re
import resource
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

from wbflow.cli.main import main
from wbflow.errors import ExitCode
from wbflow.site import published_models
from wbflow.site.published_models import PUBLISHED_MODELS, PublishedModel

CONTENT = np.random.default_rng(0).bytes(600_000)


class Publisher(BaseHTTPRequestHandler):
    """Serves `CONTENT` as /tiny.onnx, as `server.manner` says; as a proxy, it is asked for whole addresses."""

    server: Any

    def do_GET(self) -> None:
        manner = self.server.manner
        begin = 0
        asked = re.fullmatch(r"bytes=(\d+)-", self.headers.get("Range", ""))
        if asked and manner != "no ranges":
            begin = int(asked[1])
        self.server.requests.append((self.path, begin))
        body = CONTENT[begin:]
        if manner == "page":
            body = b"\n<!doctype html><title>Sign in</title>"
        elif manner == "other":
            body = CONTENT[::-1]
        if manner == "gone":
            self.send_error(404)
        elif begin >= len(CONTENT):
            self.send_error(416)
        else:
            self.send_response(206 if begin else 200)
            if begin:
                self.send_header("Content-Range", f"bytes {begin}-{len(CONTENT) - 1}/{len(CONTENT)}")
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body[: len(body) // 2] if manner == "cut" else body)

    def log_message(self, *_: Any) -> None:
        """Nothing is printed."""


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A server of the published model `tiny`, the only one."""
    with ThreadingHTTPServer(("127.0.0.1", 0), Publisher) as server:
        server.manner = "whole"  # type: ignore[attr-defined]
        server.requests = []  # type: ignore[attr-defined]
        threading.Thread(target=server.serve_forever, daemon=True).start()
        monkeypatch.setattr(published_models, "_RELEASE", f"http://127.0.0.1:{server.server_port}")
        for variable in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
            monkeypatch.delenv(variable, raising=False)
        yield server
        server.shutdown()


@pytest.fixture
def tiny(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the file of the model `tiny` belongs."""
    model = PublishedModel("tiny", "features", "tests", "MIT", len(CONTENT), hashlib.sha256(CONTENT).hexdigest())
    monkeypatch.setitem(PUBLISHED_MODELS, "tiny", model)
    monkeypatch.setenv("WBFLOW_MODELS", str(tmp_path / "models"))
    return model.path


def wbflow(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["models", *map(str, arguments)])


def state_of_tiny() -> str:
    rows = {row["name"]: row for row in json.loads(wbflow("--json").stdout)["models"]}
    return str(rows["tiny"]["state"])


def test_the_list_says_what_each_is_for_and_which_are_there(tiny: Path) -> None:
    listed = wbflow()
    assert listed.exit_code == ExitCode.GOOD and str(tiny.parent) in listed.output
    for name, model in PUBLISHED_MODELS.items():
        assert re.search(rf"^{name} .* missing +{model.stage}: {model.purpose}$", listed.output, re.MULTILINE)
        assert model.sha256 in listed.output and model.url in listed.output
    assert state_of_tiny() == "missing"
    tiny.parent.mkdir()
    tiny.write_bytes(CONTENT[:-1])
    assert state_of_tiny() == "wrong" and "or not all of it (599,999 bytes" in wbflow().output
    tiny.write_bytes(CONTENT)
    assert state_of_tiny() == "whole"


def test_folders_are_the_usual_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WBFLOW_MODELS", raising=False)
    monkeypatch.setenv("HOME", "/home/operator")
    monkeypatch.delenv("XDG_DATA_HOME", raising=False)
    assert str(PUBLISHED_MODELS["aliked-n32"].path) == "/home/operator/.local/share/wbflow/models/aliked-n32.onnx"
    monkeypatch.setenv("XDG_DATA_HOME", "/data")
    assert str(PUBLISHED_MODELS["aliked-n32"].path) == "/data/wbflow/models/aliked-n32.onnx"


def test_a_model_is_downloaded_once(server: Any, tiny: Path) -> None:
    done = wbflow("get", "tiny")
    assert done.exit_code == ExitCode.GOOD and f"{tiny}: now name it in a site file" in done.output
    assert tiny.read_bytes() == CONTENT and list(tiny.parent.iterdir()) == [tiny]
    again = wbflow("get", "tiny")
    assert again.exit_code == ExitCode.GOOD and "is there, and whole" in again.output
    assert len(server.requests) == 1


@pytest.mark.parametrize(("manner", "begins"), [("whole", 294_912), ("no ranges", 0)])
def test_a_download_that_was_cut_off_is_gone_on_with(server: Any, tiny: Path, manner: str, begins: int) -> None:
    server.manner = "cut"
    broken = wbflow("get", "tiny")
    assert broken.exit_code == ExitCode.FAILED and not tiny.exists()
    assert "tiny: the connection to 127.0.0.1 ended after 295 kB\n  wbflow models get tiny  goes on" in broken.output
    assert state_of_tiny() == "missing"
    server.manner = manner
    assert wbflow("get", "tiny").exit_code == ExitCode.GOOD
    assert tiny.read_bytes() == CONTENT and list(tiny.parent.iterdir()) == [tiny]
    assert [begin for _, begin in server.requests] == [0, begins]


def test_a_download_that_lacked_only_its_name_gets_it(server: Any, tiny: Path) -> None:
    tiny.parent.mkdir()
    tiny.with_name("tiny.onnx.part").write_bytes(CONTENT)
    assert wbflow("get", "tiny").exit_code == ExitCode.GOOD and tiny.read_bytes() == CONTENT


@pytest.mark.parametrize(
    ("manner", "message"), [("other", "is not the published tiny: 600,000 bytes, SHA-256 "), ("page", "it is a web page")]
)
def test_other_content_is_said_and_not_kept(server: Any, tiny: Path, manner: str, message: str) -> None:
    server.manner = manner
    done = wbflow("get", "tiny")
    assert done.exit_code == ExitCode.FAILED and message in done.output and "it was not kept" in done.output
    assert not list(tiny.parent.iterdir())
    server.manner = "whole"
    assert wbflow("get", "tiny").exit_code == ExitCode.GOOD


def test_a_server_without_the_file_is_named_with_its_answer(server: Any, tiny: Path) -> None:
    server.manner = "gone"
    done = wbflow("get", "tiny")
    assert done.exit_code == ExitCode.FAILED and "tiny: 127.0.0.1 answers 404 Not Found" in done.output
    assert not list(tiny.parent.iterdir())


def test_a_machine_without_network_is_told_which_file_to_copy_where(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(published_models, "_RELEASE", "http://127.0.0.1:9")
    done = wbflow("get", "tiny")
    assert done.exit_code == ExitCode.FAILED and "127.0.0.1 cannot be reached: Connection refused" in done.output
    assert f"download http://127.0.0.1:9/tiny.onnx on another machine, and copy it to {tiny}" in done.output
    downloaded = tmp_path / "Downloads" / "tiny (1).onnx"
    downloaded.parent.mkdir()
    downloaded.write_bytes(CONTENT)
    assert wbflow("get", "tiny", "--from", downloaded).exit_code == ExitCode.GOOD
    assert tiny.read_bytes() == downloaded.read_bytes() == CONTENT


def test_a_file_that_is_not_the_model_is_refused_and_stays_where_it_is(tiny: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.onnx"
    other.write_bytes(b"other")
    done = wbflow("get", "tiny", "--from", other)
    assert done.exit_code == ExitCode.FAILED and f"{other} is not the published tiny: 5 bytes" in done.output
    assert other.exists() and not list(tiny.parent.iterdir())
    missing = wbflow("get", "tiny", "--from", tmp_path / "nothing.onnx")
    assert missing.exit_code == ExitCode.USAGE and "nothing.onnx: No such file or directory" in missing.output


def test_a_proxy_of_the_environment_is_used_and_named_if_it_fails(
    server: Any, tiny: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(published_models, "_RELEASE", "http://models.example")
    monkeypatch.setenv("http_proxy", "http://user:s3cret@127.0.0.1:9")
    failed = wbflow("get", "tiny")
    assert (
        failed.exit_code == ExitCode.FAILED and "the proxy that HTTPS_PROXY or HTTP_PROXY names cannot be used" in failed.output
    )
    assert "s3cret" not in failed.output
    monkeypatch.setenv("http_proxy", f"http://127.0.0.1:{server.server_port}")
    assert wbflow("get", "tiny").exit_code == ExitCode.GOOD
    assert server.requests == [("http://models.example/tiny.onnx", 0)]


def test_a_disk_without_space_is_said_before_anything_is_downloaded(
    server: Any, tiny: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("wbflow.commands.models.free_bytes", lambda folder: 100_000)
    done = wbflow("get", "tiny")
    assert done.exit_code == ExitCode.FAILED and "no space for tiny: 600 kB needed, 100 kB free" in done.output
    assert not server.requests and not list(tiny.parent.iterdir())


def test_a_disk_that_fills_up_meanwhile_is_left_as_it_was(server: Any, tiny: Path) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, limits[1]))
    try:
        done = wbflow("get", "tiny")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert done.exit_code == ExitCode.FAILED and "no space for tiny" in done.output and "WBFLOW_MODELS=FOLDER" in done.output
    assert not list(tiny.parent.iterdir())


def test_a_folder_that_cannot_be_made_is_named(server: Any, tiny: Path) -> None:
    tiny.parent.write_text("a file")
    done = wbflow("get", "tiny")
    assert done.exit_code == ExitCode.FAILED and f"{tiny.parent}: " in done.output and "WBFLOW_MODELS=FOLDER" in done.output


def test_a_second_download_at_the_same_time_is_refused(server: Any, tiny: Path) -> None:
    tiny.parent.mkdir()
    with tiny.with_name("tiny.onnx.part").open("ab") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        done = wbflow("get", "tiny")
    assert done.exit_code == ExitCode.LOCKED and "another process is downloading tiny.onnx" in done.output


def test_an_unknown_name_is_a_usage_error_that_suggests_one() -> None:
    done = wbflow("get", "alikedn32")
    assert done.exit_code == ExitCode.USAGE and "did you mean 'aliked-n32'?" in done.output
