"""The web server of `wbflow edit`: it serves the page to a browser on this machine that knows its secret address.

The address contains a token made for this session.  Requests with another host name (DNS rebinding: a foreign page whose name
resolves to this machine) are refused, too.  The page loads nothing from other servers.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Callable, Mapping
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import Any
from urllib.parse import unquote

from pydantic import ValidationError

from ..words import printable
from .session import GroundRequest, GuideRequest, Refused, SaveRequest, Session

_MOST_BYTES = 10_000_000
"""Largest size of a request's body."""
_TIMEOUT_SECONDS = 30
"""Timeout of an idle connection."""
_ASSETS = {"": ("edit.html", "text/html"), "edit.js": ("edit.js", "text/javascript"), "edit.css": ("edit.css", "text/css")}
_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}

Answer = tuple[str, bytes, Mapping[str, str]]
"""Content type, content, and further headers."""


class EditServer(ThreadingHTTPServer):
    """Serves one session at `address`, until the page reports that the user is done."""

    daemon_threads = True

    def __init__(self, session: Session) -> None:
        self.session = session
        self.token = secrets.token_urlsafe(24)
        self.done = False
        """The page has reported that the user is done."""
        super().__init__(("127.0.0.1", 0), _Handler)
        self.hosts = {f"{name}:{self.server_port}" for name in ("127.0.0.1", "localhost")}

    @property
    def address(self) -> str:
        """URL of the page."""
        return f"http://127.0.0.1:{self.server_port}/{self.token}/"


class _Handler(BaseHTTPRequestHandler):
    server: EditServer
    timeout = _TIMEOUT_SECONDS
    server_version = "wbflow"
    sys_version = ""

    def parse_request(self) -> bool:
        """Read a request of any method, and refuse it if the host or the token is wrong."""
        if not super().parse_request():
            return False
        token = self.path.removeprefix("/").partition("/")[0]
        # another host name: a foreign page whose name was made to resolve to this machine
        host_is_right = self.headers.get("Host", "") in self.server.hosts
        if host_is_right and secrets.compare_digest(token.encode(), self.server.token.encode()):
            return True
        self._send(HTTPStatus.FORBIDDEN, "text/plain", b"forbidden\n", {})
        return False

    def do_GET(self) -> None:
        self._respond(self._get)

    def do_POST(self) -> None:
        self._respond(self._post)
        if self.server.done:
            self.server.shutdown()

    def _respond(self, respond: Callable[[str], Answer]) -> None:
        path = self.path.removeprefix("/").partition("/")[2]
        try:
            return self._send(HTTPStatus.OK, *respond(path))
        except KeyError:
            return self._send(HTTPStatus.NOT_FOUND, "text/plain", b"not found\n", {})
        except ValidationError as error:
            return self._send(HTTPStatus.BAD_REQUEST, "text/plain", printable(str(error)).encode(), {})
        except (Refused, OSError) as error:
            return self._send(HTTPStatus.CONFLICT, "text/plain", str(error).encode(), {})

    def _get(self, path: str) -> Answer:
        session = self.server.session
        resource, _, name = unquote(path).partition("/")
        if not name and resource in _ASSETS:
            file, kind = _ASSETS[resource]
            return f"{kind}; charset=utf-8", (files(__package__) / "assets" / file).read_bytes(), {}
        if resource == "picture":
            info, jpeg = session.picture(name)
            return "image/jpeg", jpeg, {"X-Picture": json.dumps(info)}
        if resource == "shade":
            return "image/png", session.shade(name), {}
        if path == "state":
            return _json_answer(session.state())
        raise KeyError(path)

    def _post(self, path: str) -> Answer:
        session = self.server.session
        body = self._read_body()
        if path == "look":
            return _json_answer(session.posed.guides(GuideRequest.model_validate_json(body)))
        if path == "ground":
            return _json_answer(session.posed.on_ground(GroundRequest.model_validate_json(body)))
        if path == "save":
            return _json_answer(session.save(SaveRequest.model_validate_json(body)))
        if path == "done":
            self.server.done = True
            return _json_answer({})
        raise KeyError(path)

    def _read_body(self) -> bytes:
        length = self.headers.get("Content-Length", "")
        if self.headers.get_content_type() != "application/json" or not length.isdigit() or int(length) > _MOST_BYTES:
            raise Refused(f"a request is JSON of at most {_MOST_BYTES:,} bytes")
        return self.rfile.read(int(length))

    def _send(self, status: HTTPStatus, kind: str, content: bytes, headers: Mapping[str, str]) -> None:
        self.send_response(status)
        for name, value in {**_HEADERS, **headers, "Content-Type": kind, "Content-Length": str(len(content))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:
        """Log nothing, since addresses contain the token."""


def _json_answer(data: Any) -> Answer:
    return "application/json", json.dumps(data).encode(), {}
