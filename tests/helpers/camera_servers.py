"""Camera servers on this machine: HTTP snapshots and Motion JPEG, with authentication and faults; RTSP with JPEG (RFC 2435)."""

from __future__ import annotations

import base64
import hashlib
import re
import socketserver
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from email.utils import formatdate
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import cv2
import numpy as np

USER, PASSWORD, REALM = "viewer", "s3cret/@word", "camera"
NTP_EPOCH = 2_208_988_800


def picture(value: int = 128, size: tuple[int, int] = (160, 96)) -> bytes:
    """A JPEG file with a horizontal gradient from 0 to `value`."""
    image = np.tile(np.linspace(0, value, size[0]).astype(np.uint8), (size[1], 1))
    return cv2.imencode(".jpg", np.dstack([image] * 3), [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()


def digest_of(method: str, header: str) -> bool:
    """Is a digest authorization right?"""
    fields = dict(re.findall(r'(\w+)="?([^",]+)"?', header))

    def md5(text: str) -> str:
        return hashlib.md5(text.encode(), usedforsecurity=False).hexdigest()

    first, second = md5(f"{USER}:{REALM}:{PASSWORD}"), md5(f"{method}:{fields.get('uri', '')}")
    middle = f"{fields['nonce']}:{fields['nc']}:{fields['cnonce']}:{fields['qop']}" if "qop" in fields else fields["nonce"]
    return fields.get("response") == md5(f"{first}:{middle}:{second}")


class HttpCamera(BaseHTTPRequestHandler):
    """Serves /snapshot; /basic and /digest with a password; /mjpeg; faults: /hang (for 60 s), /half (truncated), /text (HTML)."""

    server: Any

    def do_GET(self) -> None:
        kind, given = self.path.strip("/"), self.headers.get("Authorization", "")
        right = base64.b64encode(f"{USER}:{PASSWORD}".encode()).decode()
        if kind == "basic" and given != f"Basic {right}":
            return self._refuse(f'Basic realm="{REALM}"')
        if kind == "digest" and not (given.startswith("Digest ") and digest_of("GET", given)):
            return self._refuse(f'Digest realm="{REALM}", nonce="abc", qop="auth", algorithm=MD5')
        if kind == "hang":
            time.sleep(60)
        if kind == "mjpeg":
            return self._stream()
        data = b"<html>login</html>" if kind == "text" else picture()
        self.send_response_only(200)
        self.send_header("Date", formatdate(time.time() + self.server.ahead, usegmt=True))
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data[: len(data) // 2] if kind == "half" else data)
        return None

    def _refuse(self, how: str) -> None:
        self.send_response(401)
        self.send_header("WWW-Authenticate", how)
        self.send_header("Content-Length", "0")
        self.end_headers()

    def _stream(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        try:
            for k in range(200):
                data = picture(50 + k)
                length = f"Content-Length: {len(data)}\r\n" if k % 2 else ""  # some cameras send it, some do not
                self.wfile.write(f"--frame\r\nContent-Type: image/jpeg\r\n{length}\r\n".encode() + data + b"\r\n")
                time.sleep(0.05)
        except OSError:
            pass

    def log_message(self, *words: Any) -> None:
        """Print nothing."""


class _Http(ThreadingHTTPServer):
    daemon_threads = True
    ahead = 0.0
    """How far the server's clock is ahead, seconds."""

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Print nothing: the client has gone, and the message could end up in the captured output of another test."""


@contextmanager
def serving(server: Any, address: str, ahead: float) -> Iterator[str]:
    """Run a server whose clock is `ahead` seconds ahead; yields its address, with the port filled in."""
    server.ahead = ahead
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield address.format(port=server.server_address[1])
    finally:
        server.shutdown()
        server.server_close()


def http_camera(ahead: float = 0.0) -> AbstractContextManager[str]:
    """Run an HTTP camera; yields its address."""
    return serving(_Http(("127.0.0.1", 0), HttpCamera), "http://127.0.0.1:{port}", ahead)


class RtspCamera(socketserver.StreamRequestHandler):
    """Serves one Motion JPEG track, interleaved in the RTSP connection, with digest authentication."""

    server: Any

    def handle(self) -> None:
        try:
            while request := self._request():
                method, url, fields = request
                self._answer(method, url, fields)
        except OSError:
            pass

    def _request(self) -> tuple[str, str, dict[str, str]] | None:
        lines = []
        while (line := self.rfile.readline()) not in {b"", b"\r\n"}:
            lines.append(line.decode().strip())
        if not lines:
            return None
        method, url, _ = lines[0].split(" ", 2)
        return method, url, dict(line.split(": ", 1) for line in lines[1:] if ": " in line)

    def _answer(self, method: str, url: str, fields: dict[str, str]) -> None:
        def send(status: str, *head: str, body: str = "") -> None:
            length = [f"Content-Length: {len(body)}"] if body else []
            lines = [f"RTSP/1.0 {status}", f"CSeq: {fields.get('CSeq', '0')}", *head, *length]
            self.wfile.write(("\r\n".join(lines) + "\r\n\r\n" + body).encode())

        if method == "OPTIONS":
            return send("200 OK", "Public: OPTIONS, DESCRIBE, SETUP, PLAY, TEARDOWN")
        if not digest_of(method, fields.get("Authorization", "nonce=x")):
            return send("401 Unauthorized", f'WWW-Authenticate: Digest realm="{REALM}", nonce="abc"')
        if method == "DESCRIBE":
            sdp = "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=camera\r\nt=0 0\r\nm=video 0 RTP/AVP 26\r\na=control:track\r\n"
            return send("200 OK", "Content-Type: application/sdp", f"Content-Base: {url}/", body=sdp)
        if method == "SETUP":
            return send("200 OK", "Transport: RTP/AVP/TCP;unicast;interleaved=0-1", "Session: 1")
        if method == "PLAY":
            send("200 OK", "Session: 1", "RTP-Info: url=track;seq=0;rtptime=0")
            self._play()
        return send("200 OK", "Session: 1")

    def _play(self) -> None:
        start = time.time()
        for k in range(400):
            now = time.time()
            stamp = int((now - start) * 90_000)
            if k % 10 == 0:
                ntp = now + self.server.ahead + NTP_EPOCH
                report = struct.pack(">BBHIIIIII", 0x80, 200, 6, 1, int(ntp), int(ntp % 1 * 2**32), stamp, k, 0)
                self.wfile.write(b"$\x01" + struct.pack(">H", len(report)) + report)
            self._frame(picture(50 + k % 200), stamp, k)
            time.sleep(0.05)

    _sequence = 0

    def _frame(self, jpeg: bytes, stamp: int, k: int) -> None:
        tables = b"".join(jpeg[m.start() + 5 : m.start() + 69] for m in re.finditer(b"\xff\xdb\x00\x43", jpeg))
        scan = jpeg[jpeg.index(b"\xff\xda") + 14 :]
        size = bytes([160 // 8, 96 // 8])
        for at in range(0, len(scan), 1200):
            part, last = scan[at : at + 1200], at + 1200 >= len(scan)
            head = struct.pack(">BBHII", 0x80, 26 | (0x80 if last else 0), self._sequence & 0xFFFF, stamp & 0xFFFFFFFF, 1)
            head += b"\x00" + at.to_bytes(3, "big") + b"\x01\xff" + size
            head += b"\x00\x00" + struct.pack(">H", len(tables)) + tables if at == 0 else b""
            self.wfile.write(b"$\x00" + struct.pack(">H", len(head) + len(part)) + head + part)
            self._sequence += 1


class _Rtsp(socketserver.ThreadingTCPServer):
    daemon_threads = allow_reuse_address = True
    ahead = 0.0


def rtsp_camera(ahead: float = 0.0) -> AbstractContextManager[str]:
    """Run an RTSP camera; yields its address."""
    return serving(_Rtsp(("127.0.0.1", 0), RtspCamera), "rtsp://127.0.0.1:{port}/stream", ahead)


@contextmanager
def writing_into(folder: Any, write: Callable[[int], bytes], seconds: float = 0.7) -> Iterator[None]:
    """Run a camera that writes a picture into a folder every `seconds`; `write` returns the k-th."""
    stop = threading.Event()

    def work() -> None:
        k = 0
        while not stop.wait(seconds):
            (folder / f"{k:04}.jpg").write_bytes(write(k))
            k += 1

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()
