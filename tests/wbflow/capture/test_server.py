"""Cameras that are HTTP servers, as their makers build them: what works in a browser works here."""

from __future__ import annotations

import base64
import contextlib
import gzip
import hashlib
import re
import ssl
import subprocess
import time
import urllib.parse
import zlib
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner

from tests.helpers.camera_servers import picture, serving
from wbflow.capture.server import Access, server_shots
from wbflow.cli.main import main

LOGIN = ("viewer", "p@ss:w#rd ü")
PICTURES = [picture(60 + k) for k in range(0, 150, 3)]
THUMBNAIL = b"\xff\xe1" + (len(PICTURES[0]) + 2).to_bytes(2, "big") + PICTURES[0]
HASHES: dict[str, Callable[[bytes], Any]] = {"MD5": hashlib.md5, "SHA-256": hashlib.sha256, "SHA-512": hashlib.sha512}

STREAMS: dict[str, tuple[str, str, str]] = {
    # content type, what stands before each picture (with its length for LENGTH), and behind it
    "plain": (
        "multipart/x-mixed-replace; boundary=b",
        "--b\r\nContent-Type: image/jpeg\r\nContent-Length: LENGTH\r\n\r\n",
        "\r\n",
    ),
    "no-length": ("multipart/x-mixed-replace; boundary=b", "--b\r\nContent-Type: image/jpeg\r\n\r\n", "\r\n"),
    "no-line-end": ("multipart/x-mixed-replace; boundary=b", "--b\r\nContent-Type: image/jpeg\r\n\r\n", ""),
    "dashes-in-boundary": ("multipart/x-mixed-replace; boundary=--my", "--my\r\nContent-Type: image/jpeg\r\n\r\n", "\r\n"),
    "no-dashes": ("multipart/x-mixed-replace; boundary=my", "my\r\nContent-Length: LENGTH\r\n\r\n", "\r\n"),
    "quoted": ('multipart/x-mixed-replace; boundary="my frame"', "--my frame\r\nContent-Length: LENGTH\r\n\r\n", "\r\n"),
    "line-feeds": ("multipart/x-mixed-replace; boundary=b", "--b\nContent-Length: LENGTH\n\n", "\n"),
    "boundary-behind": ("multipart/x-mixed-replace;boundary=e8", "Content-Length: LENGTH\r\n\r\n", "\r\n--e8\r\n"),
    "padded": ("multipart/x-mixed-replace; boundary=b", "--b\r\nContent-Type: image/jpeg\r\n\r\n", "\0" * 500 + "\r\n"),
    "wrong-length": ("multipart/x-mixed-replace; boundary=b", "--b\r\nContent-Length: 17\r\n\r\n", "\r\n"),
    "no-boundary": ("multipart/x-mixed-replace", "", ""),
    "wrong-type": ("image/jpeg", "--b\r\nContent-Type: image/jpeg\r\n\r\n", "\r\n"),
    "no-type": ("", "--b\r\n\r\n", "\r\n"),
    "text-type": ("text/html", "--b\r\nContent-Type: image/jpeg\r\n\r\n", "\r\n"),
}
SNAPSHOTS: dict[str, bytes] = {
    "whole": PICTURES[0],
    "with-thumbnail": PICTURES[0][:2] + THUMBNAIL + PICTURES[0][2:],
    "padded": PICTURES[0] + bytes(8192),
    "stray-behind": PICTURES[0] + b"\x5a" * 513,
    "dahua": PICTURES[0] + b"dhav\x59\x19\x01\x00",
    "line-before": b"\r\n" + PICTURES[0],
    "fill-before": b"\xff" + PICTURES[0],
}


class Camera(BaseHTTPRequestHandler):
    """Serves /stream/NAME, /snapshot/NAME, /live/, /login/WAYS, /redirect/..., and faults."""

    protocol_version = "HTTP/1.1"
    server: Any
    count = 0

    def do_GET(self) -> None:
        kind, _, name = self.path.strip("/").partition("/")
        with contextlib.suppress(OSError):
            getattr(self, f"_{kind.replace('-', '_')}")(name)

    def _snapshot(self, name: str) -> None:
        self._send(SNAPSHOTS[name])

    def _live(self, name: str) -> None:
        """Another file at each request, as a live camera sends: its comment (JPEG's COM segment) holds the time."""
        comment = time.time_ns().to_bytes(8, "big")
        self._send(PICTURES[0][:2] + b"\xff\xfe\x00\x0a" + comment + PICTURES[0][2:])

    def _stream(self, name: str) -> None:
        kind, before, behind = STREAMS[name.removesuffix("-chunked")]
        is_chunked = name.endswith("-chunked")
        self.send_response(200)
        if kind:
            self.send_header("Content-Type", kind)
        if is_chunked:
            self.send_header("Transfer-Encoding", "chunked")
        self.end_headers()
        for data in PICTURES * 4:
            part = before.replace("LENGTH", str(len(data))).encode() + data + behind.encode()
            self.wfile.write(b"%x\r\n%s\r\n" % (len(part), part) if is_chunked else part)
            time.sleep(0.05)
        self.close_connection = True

    def _login(self, ways: str) -> None:
        """WAYS: SHA-256~MD5 and so on; basic; several in one header with +."""
        authorization = self.headers.get("Authorization", "")
        offers = [way for header in ways.split("~") for way in header.split("+")]
        if self._is_right(authorization, offers):
            return self._send(PICTURES[0])
        self.send_response(401)
        for header in ways.split("~"):
            self.send_header("WWW-Authenticate", ", ".join(self._offer(way) for way in header.split("+")))
        self.send_header("Content-Length", "0")
        self.end_headers()
        return None

    @staticmethod
    def _offer(way: str) -> str:
        if way == "basic":
            return 'Basic realm="camera, or so"'
        if way == "old":
            return f'Digest realm="cam", nonce="n{time.time()}"'
        return f'Digest realm="cam", qop="auth,auth-int", nonce="n{time.time()}", algorithm={way}'

    def _is_right(self, authorization: str, offers: list[str]) -> bool:
        user, password = LOGIN
        if authorization.startswith("Basic"):
            return "basic" in offers and base64.b64decode(authorization[6:]).decode() == f"{user}:{password}"
        if not authorization.startswith("Digest"):
            return False
        fields = dict(re.findall(r'(\w+)="?([^",]+)"?', authorization))
        name = fields.get("algorithm", "old")
        if name not in offers or fields["uri"] != self.path:
            return False

        def hashed(text: str) -> str:
            return str(HASHES.get(name, hashlib.md5)(text.encode()).hexdigest())

        middle = f"{fields['nonce']}:{fields['nc']}:{fields['cnonce']}:{fields['qop']}" if "qop" in fields else fields["nonce"]
        response: str = fields["response"]
        return response == hashed(f"{hashed(f'{user}:cam:{password}')}:{middle}:{hashed('GET:' + fields['uri'])}")

    def _redirect(self, target: str) -> None:
        self.send_response(302)
        self.send_header("Location", target if target.startswith("http") else f"/{target}")
        self.send_header("Content-Length", "0")
        self.end_headers()

    def _guarded(self, target: str) -> None:
        """A redirect that itself wants the login."""
        if not self._is_right(self.headers.get("Authorization", ""), ["basic"]):
            return self._login("basic")
        return self._redirect(target)

    def _spy(self, _: str) -> None:
        """Asks for the login, and remembers what was sent."""
        self.server.seen.append(self.headers.get("Authorization"))
        self._login("basic")

    def _gzip(self, _: str) -> None:
        self._send(gzip.compress(PICTURES[0]), {"Content-Encoding": "gzip"})

    def _date(self, text: str) -> None:
        self._send(PICTURES[0], {"Date": text.replace("_", " ")})

    def _status(self, code: str) -> None:
        self.send_response(int(code))
        self.send_header("Content-Length", "0")
        self.end_headers()

    def _wants(self, way: str) -> None:
        """A login of this kind, whatever is sent."""
        self.send_response(401)
        self.send_header("WWW-Authenticate", urllib.parse.unquote(way).replace("_", " "))
        self.send_header("Content-Length", "0")
        self.end_headers()

    def _not_compressed(self, _: str) -> None:
        self._send(PICTURES[0], {"Content-Encoding": "gzip"})

    def _not_http(self, _: str) -> None:
        self.wfile.write(b"ICY 200 OK\r\n\r\n" + PICTURES[0])
        self.close_connection = True

    def _nothing(self, _: str) -> None:
        self.close_connection = True

    def _jpeg_of_html(self, _: str) -> None:
        self._send(b"<html><body>Login</body></html>")

    def _html(self, _: str) -> None:
        self._send(b"<html><body>Login</body></html>", {"Content-Type": "text/html"})

    def _half(self, _: str) -> None:
        self._send(PICTURES[0][:-300])

    def _empty(self, _: str) -> None:
        self._send(b"")

    def _endless(self, content: str) -> None:
        """A body without an end in which no picture is, or in which one begins that never ends."""
        self.send_response(200)
        self.send_header("Content-Type", "image/jpeg")
        if content == "bomb":  # gigabytes of zeros
            self.send_header("Content-Encoding", "gzip")
        self.end_headers()
        self.close_connection = True
        packer = zlib.compressobj(9, zlib.DEFLATED, 31)
        zeros = bytes(1 << 20)
        self.wfile.write({"picture": PICTURES[0][:-2]}.get(content, b""))
        while True:
            self.wfile.write({"text": b"<p>Login " * 9999, "bomb": packer.compress(zeros)}.get(content, zeros))

    def _send(self, data: bytes, fields: dict[str, str] | None = None) -> None:
        self.send_response_only(200)
        for name, value in ({"Content-Type": "image/jpeg"} | (fields or {})).items():
            self.send_header(name, value)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *words: Any) -> None:
        """Print nothing."""


class Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Camera)
        self.seen: list[str | None] = []

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print nothing: the client has gone."""


@pytest.fixture(scope="module")
def server() -> Iterator[tuple[Server, str]]:
    running = Server()
    with serving(running, "http://127.0.0.1:{port}", 0.0) as url:
        yield running, url


@pytest.fixture
def address(server: tuple[Server, str]) -> str:
    return server[1]


def taken(url: str, access: Access | None = None, count: int = 2) -> list[bytes]:
    moments = [time.time() + 0.3 * k for k in range(count)]
    return [data for data, _ in server_shots(url, access or Access(LOGIN), moments, 20.0)]


@pytest.mark.parametrize("name", [*STREAMS, "plain-chunked", "no-length-chunked", "no-dashes-chunked"])
def test_motion_jpeg_of_any_form_gives_whole_pictures(address: str, name: str) -> None:
    pictures = taken(f"{address}/stream/{name}", count=3)
    assert len(pictures) == 3 == len(set(pictures))
    assert all(data in PICTURES for data in pictures)


@pytest.mark.parametrize("name", SNAPSHOTS)
def test_a_snapshot_is_saved_without_what_stands_around_it(address: str, name: str) -> None:
    whole = SNAPSHOTS["with-thumbnail"] if name == "with-thumbnail" else PICTURES[0]
    assert taken(f"{address}/snapshot/{name}") == [whole, whole]


ALONE = ["MD5", "SHA-256", "SHA-512", "old", "basic"]
SEVERAL = ["SHA-256~MD5", "MD5~SHA-256", "SHA-512-256~MD5", "SHA-256+MD5", "basic+MD5", "MD5~basic", "SHA-512-256~basic"]


@pytest.mark.parametrize("ways", [*ALONE, *SEVERAL])
@pytest.mark.parametrize("path", ["login", "redirect/login"])
def test_a_login_is_given_in_the_way_that_the_camera_asks_for(address: str, ways: str, path: str) -> None:
    assert taken(f"{address}/{path}/{ways}") == [PICTURES[0], PICTURES[0]]


@pytest.mark.parametrize("target", ["login/basic", "login/SHA-256", "snapshot/whole"])
def test_a_login_is_kept_through_a_redirect_on_the_same_host(address: str, target: str) -> None:
    assert taken(f"{address}/guarded/{target}") == [PICTURES[0], PICTURES[0]]


def test_no_login_is_sent_to_another_host(server: tuple[Server, str]) -> None:
    running, url = server
    elsewhere = url.replace("127.0.0.1", "localhost")
    running.seen.clear()
    for path in ("redirect", "guarded"):
        with pytest.raises(OSError, match="401"):
            taken(f"{url}/{path}/{elsewhere}/spy/")
    assert running.seen and set(running.seen) == {None}


def test_compressed_pictures_are_unpacked(address: str) -> None:
    assert taken(f"{address}/gzip") == [PICTURES[0]] * 2


@pytest.mark.parametrize("date", ["Sun,_32_Foo_2026_99:00:00_GMT", "nonsense", "0"])
def test_a_date_that_is_none_is_ignored(address: str, date: str) -> None:
    (shot,) = server_shots(f"{address}/date/{date}", Access(), [time.time()], 20.0)
    assert shot == (PICTURES[0], None)


@pytest.mark.parametrize(
    ("path", "access", "words"),
    [
        ("html", Access(), "status 200, text/html, 31 bytes: '<html><body>Login"),
        ("half", Access(), "incomplete picture"),
        ("empty", Access(), "empty picture"),
        ("status/404", Access(), "answered 404 Not Found"),
        ("status/500", Access(), "answered 500"),
        ("login/MD5", Access(), "answered 401.*captures.credentials"),
        ("login/MD5", Access(("viewer", "wrong")), "answered 401.*check its user and password"),
        ("login/basic", Access(("viewer", "wrong")), "answered 401.*check its user and password"),
        ("redirect/redirect/redirect/html", Access(), "something else"),
        ("wants/NTLM", Access(LOGIN), r"answered 401.*of a kind that is not known \(NTLM\); choose Digest or Basic"),
        ("wants/Bearer_realm=cam", Access(LOGIN), r"not known \(Bearer\)"),
        ('wants/Digest_realm="cam",_qop="auth-int",_nonce="n"', Access(LOGIN), r"not known \(Digest\)"),
        ("not-compressed", Access(), r"says that its answer is compressed \(gzip\), and it is not"),
        ("not-http", Access(), r"answers, but not as HTTP prescribes \(BadStatusLine\)"),
        ("nothing", Access(), "ends the connection without an answer"),
        ("status/204", Access(), r"an empty picture \(status 204\)"),
        ("jpeg-of-html", Access(), "status 200, image/jpeg, 31 bytes: '<html><body>Login"),
    ],
)
def test_the_reason_says_what_was_answered(address: str, path: str, access: Access, words: str) -> None:
    with pytest.raises(OSError, match=words) as caught:
        taken(f"{address}/{path}", access)
    assert "wrong" not in str(caught.value) and "127.0.0.1" not in str(caught.value)


def test_a_proxy_of_the_environment_that_is_in_the_way_is_named(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("no_proxy", "NO_PROXY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("http_proxy", "http://viewer:geheim@127.0.0.1:9")
    with pytest.raises(OSError, match=r"through the proxy of the environment .*Connection refused.*no_proxy") as caught:
        taken(f"{address}/snapshot/whole")
    assert "geheim" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("zeros", r"status 200, image/jpeg, no picture begins in 10 MB, and more comes"),
        ("text", r"no picture begins in 10 MB, and more comes: '<p>Login <p>Login"),
        ("bomb", r"no picture begins in 10 MB, and more comes"),
        ("picture", r"sends a picture of more than 100 MB"),
    ],
)
def test_a_body_without_an_end_is_given_up(address: str, content: str, words: str) -> None:
    begun = time.thread_time()
    with pytest.raises(OSError, match=words):
        taken(f"{address}/endless/{content}")
    # CPU time of this thread, which other work on the machine does not change: searching from the start took minutes
    assert time.thread_time() - begun < 5


def certificate(folder: Path, name: str) -> tuple[Path, Path]:
    key, file = folder / f"{name}.key", folder / f"{name}.pem"
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "3", "-subj", f"/CN={name}"]
    subprocess.run([*command, "-keyout", str(key), "-out", str(file)], check=True, capture_output=True)
    return file, key


@pytest.fixture(scope="module")
def encrypted(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[str, Path, Path]]:
    """Address, certificate of the camera, and one of another camera."""
    folder = tmp_path_factory.mktemp("tls")
    file, key = certificate(folder, "camera")
    running = Server()
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(file, key)
    running.socket = context.wrap_socket(running.socket, server_side=True)
    with serving(running, "https://127.0.0.1:{port}", 0.0) as url:
        yield url, file, certificate(folder, "other")[0]


def fingerprint(file: Path) -> str:
    return hashlib.sha256(ssl.PEM_cert_to_DER_cert(file.read_text())).hexdigest()


def test_a_self_signed_certificate_is_trusted_by_fingerprint_file_or_decision(encrypted: tuple[str, Path, Path]) -> None:
    url, file, _ = encrypted
    digits = fingerprint(file)
    colons = ":".join(digits.upper()[k : k + 2] for k in range(0, 64, 2))
    for tls in (False, str(file), f"sha256:{digits}", f"SHA256:{colons}"):
        assert taken(f"{url}/snapshot/whole", Access(LOGIN, tls)) == [PICTURES[0]] * 2
        assert taken(f"{url}/login/SHA-256", Access(LOGIN, tls)) == [PICTURES[0]] * 2


def test_another_certificate_is_refused_and_the_remedy_works(encrypted: tuple[str, Path, Path]) -> None:
    url, _, other = encrypted
    for tls in (True, str(other), f"sha256:{fingerprint(other)}"):
        with pytest.raises(OSError, match="its certificate") as caught:
            taken(f"{url}/snapshot/whole", Access(LOGIN, tls))
        advised = re.search(r"tls: '(sha256:[0-9A-F:]+)'", str(caught.value))
        assert advised
        assert taken(f"{url}/snapshot/whole", Access(LOGIN, advised[1])) == [PICTURES[0]] * 2


def site(folder: Path, cameras: list[dict[str, Any]], **captures: Any) -> Path:
    """A site whose cameras all have a url; there is no folder for captures."""
    settings = {"root": "captures", "pattern": "{camera}/{date}_{time}.jpg", "frames": 2, "seconds": 1, **captures}
    (folder / "site.yaml").write_text(yaml.safe_dump({"site": "net", "captures": settings, "cameras": cameras}))
    return folder / "site.yaml"


def test_a_site_of_cameras_on_the_network_needs_no_folder(tmp_path: Path, address: str) -> None:
    file = site(tmp_path, [{"id": name, "url": f"{address}/live"} for name in ("gate", "roof")])
    result = CliRunner().invoke(main, ["capture", str(file)])
    assert result.exit_code == 0, result.output
    assert len(list(tmp_path.glob("captures/*/*.jpg"))) == 4
    result = CliRunner().invoke(main, ["check", str(file)])
    assert result.exit_code == 0, result.output


def test_check_asks_each_camera_unless_there_is_no_network(tmp_path: Path, address: str) -> None:
    cameras = [
        {"id": "gate", "url": f"{address}/snapshot/whole"},
        {"id": "roof", "url": f"{address}/html"},
        {"id": "mast", "url": f"{address}/login/SHA-256"},
        {"id": "quay", "url": "http://127.0.0.1:9/snapshot"},
        {"id": "yard", "url": f"file://{tmp_path}/nowhere"},
        {"id": "crane", "url": f"{address}/snapshot/whole"},
    ]
    file = site(tmp_path, cameras)
    begun = time.time()
    output = CliRunner().invoke(main, ["check", str(file)]).output
    assert time.time() - begun < 15
    wanted = {"roof": "text/html", "mast": "captures.credentials", "quay": "cannot be reached", "yard": "there is no folder"}
    for camera, words in wanted.items():
        assert re.search(rf"site\.yaml:\d+:\d+: camera {camera}: .*{words}", output)
    assert not re.search("camera (gate|crane): (?!there is no capture)", output)
    offline = CliRunner().invoke(main, ["check", str(file), "--no-network"]).output
    assert "text/html" not in offline and "cannot be reached" not in offline


def test_user_and_password_in_an_address_get_their_own_remedy(tmp_path: Path) -> None:
    file = site(
        tmp_path, [{"id": "gate", "url": "http://viewer:geheim@10.0.0.5/snapshot"}, {"id": "roof", "url": "http://10.0.0.6/"}]
    )
    output = CliRunner().invoke(main, ["check", str(file), "--no-network"]).output
    assert "captures: {credentials: FILE}" in output and "list the cameras" not in output
    assert "geheim" not in output


@pytest.mark.parametrize("tls", ["sha256:12:34", "sha256:" + "g" * 64])
def test_a_fingerprint_that_is_none_is_named(tmp_path: Path, tls: str) -> None:
    file = site(tmp_path, [{"id": "gate", "url": "https://10.0.0.5/", "tls": tls}, {"id": "roof", "url": "https://10.0.0.6/"}])
    output = CliRunner().invoke(main, ["check", str(file), "--no-network"]).output
    assert "64 hexadecimal digits" in output
