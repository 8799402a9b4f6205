"""Pictures of a camera that is an HTTP server: snapshots, and Motion JPEG in whatever form.

Requests does what HTTP prescribes (redirects, logins, chunks, compression, TLS).  Motion JPEG is not read by the boundaries
between its parts, which cameras write with and without dashes, line feeds and lengths: a JPEG file says itself where it ends.
"""

from __future__ import annotations

import contextlib
import email.utils
import hashlib
import http.client
import re
import socket
import ssl
import time
import urllib.parse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import requests
import urllib3
from requests.adapters import HTTPAdapter
from requests.auth import AuthBase, HTTPDigestAuth

from ..plugins import load
from ..words import printable

Login = tuple[str, str]
"""User and password of a camera."""
Shot = tuple[bytes, float | None]
"""A picture file's bytes, and the Unix time when it was taken by the camera's clock; None if the camera sends no time."""

MOST_PICTURE_BYTES = 100_000_000
"""Largest picture that is read, bytes."""
MOST_OTHER_BYTES = 10_000_000
"""Most bytes that are read while no picture begins: a page, or compressed zeros, may have no end."""
_CHUNK_BYTES = 65536
"""Most bytes of an answer that are read at once."""
_PNG_START = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"IEND\xaeB`\x82"
_JPEG_START = b"\xff\xd8\xff"
_JPEG_END = b"\xff\xd9"
_DIGESTS = {"MD5", "MD5-SESS", "SHA", "SHA-256", "SHA-512"}
"""Algorithms of digest authentication that Requests computes."""
FINGERPRINT = re.compile(r"(?i)(?:sha-?256:)?((?:[0-9a-f]{2}:?){31}[0-9a-f]{2})")
"""SHA-256 of a certificate, as browsers and OpenSSL show it."""


urllib3.disable_warnings(urllib3.exceptions.InsecureRequestWarning)  # `tls: false` in the site file has been a decision


@dataclass(frozen=True)
class Access:
    """How a camera is reached besides its address."""

    login: Login | None = None
    tls: bool | str = True
    """For https: True, its certificate is verified by the known authorities; False, it is not; a SHA-256 fingerprint, it is
    exactly this certificate; a path, it is one of those in this PEM file or signed by one."""


def server_shots(url: str, access: Access, moments: Sequence[float], patience: float) -> Iterator[Shot]:
    """Yield a picture of a camera at each moment (Unix times, in order): of one request each, or of an endless response.

    Raises OSError with the reason if there is none; it contains neither the address nor the login.

    Parameters
    ----------
    url : http:// or https://.
    access : login and certificate.
    moments : when pictures are wanted.
    patience : timeout of the connection and of each part of an answer, seconds.
    """
    remaining = list(moments)
    with _session(url, access) as session:
        while remaining:
            time.sleep(max(0.0, remaining[0] - time.time()))
            try:
                with session.get(url, stream=True, timeout=patience) as response:
                    _refuse_failure(response, access)
                    for shot in _shots_of(response, remaining):
                        remaining.pop(0)
                        yield shot
            except requests.RequestException as error:
                raise OSError(_cause(error, url, patience)) from None


def _shots_of(response: requests.Response, remaining: Sequence[float]) -> Iterator[Shot]:
    """The pictures of a response, each the first at or after the first of the `remaining` moments, which the caller takes away.

    A response of one picture, and one that stalls after its first picture, end after that: the next request brings the next one.
    """
    is_multipart = response.headers.get("Content-Type", "").lower().startswith("multipart")
    is_single = "Content-Length" in response.headers and not is_multipart
    answered_at = None if is_multipart else _parse_date(response.headers.get("Date"))
    is_first = True
    pictures = _pictures(response)
    while remaining:
        try:
            picture, header = next(pictures)
        except StopIteration:
            return
        except (requests.Timeout, requests.ConnectionError, OSError):
            if is_first:
                raise
            return
        if is_first or time.time() >= remaining[0]:
            yield picture, _part_time(header) or answered_at
            answered_at = None
            is_first = False
        if is_single:
            return


def _pictures(response: requests.Response) -> Iterator[tuple[bytes, str]]:
    """Each complete JPEG or PNG file in a response, and the text before it; what lies between them is skipped.

    Raises OSError if the response ends without any, and with a part of one, or if it goes on and on without one.
    """
    reader = _PictureReader()
    size = 0
    count = 0
    beginning = b""
    for chunk in _chunks(response):
        size += len(chunk)
        beginning = beginning or bytes(chunk[:60])
        reader.add(chunk)
        # a chunk may complete several small pictures
        for picture, header in reader.complete():
            count += 1
            yield picture, header
        if not reader.has_begun and reader.waiting_bytes > MOST_OTHER_BYTES:
            raise OSError(_other_answer(response, size, beginning))
        if reader.waiting_bytes > MOST_PICTURE_BYTES:
            raise OSError(f"sends a picture of more than {MOST_PICTURE_BYTES / 1e6:.0f} MB")
    if reader.has_begun and not count:
        raise OSError(f"sent an incomplete picture ({reader.waiting_bytes:,} bytes)")
    if not count:
        raise OSError(_other_answer(response, size, beginning))


class _PictureReader:
    """Finds the pictures in bytes that arrive piece by piece.  Each byte is searched once: a body may have no end."""

    def __init__(self) -> None:
        self._data = bytearray()  # what has arrived behind the last complete picture
        self._start: int | None = None  # where a picture begins in it
        self._searched = (
            0  # how much of it has been searched for the beginning of a picture, or for the end of the one that began
        )

    @property
    def has_begun(self) -> bool:
        """Has a picture begun that is not complete yet?"""
        return self._start is not None

    @property
    def waiting_bytes(self) -> int:
        """How many bytes have arrived behind the last complete picture."""
        return len(self._data)

    def add(self, chunk: bytes) -> None:
        """Take what has arrived."""
        self._data += chunk

    def complete(self) -> Iterator[tuple[bytes, str]]:
        """The pictures that are complete now, each with the text before it."""
        while True:
            if self._start is None:
                self._find_start()
            if self._start is None:
                return
            end = self._find_end(self._start)
            if end is None:
                return
            picture = bytes(self._data[self._start : end])
            header = self._data[: self._start].decode("latin-1")
            del self._data[:end]
            self._start = None
            self._searched = 0
            if picture.endswith((_JPEG_END, _PNG_END)):  # otherwise the next picture has begun before the end of this one
                yield picture, header

    def _find_start(self) -> None:
        """Search for the beginning of a picture, JPEG or PNG."""
        # the first bytes of the mark may have come with the chunk before
        since = max(0, self._searched - len(_PNG_START) + 1)
        starts = [self._data.find(mark, since) for mark in (_JPEG_START, _PNG_START)]
        self._start = min((start for start in starts if start >= 0), default=None)
        self._searched = len(self._data)
        if self._start is not None:
            self._searched = self._start + 2

    def _find_end(self, start: int) -> int | None:
        """The offset behind the picture that begins at `start`; None if it is not complete yet."""
        if self._data.startswith(_PNG_START, start):
            place = self._data.find(_PNG_END, max(start, self._searched - len(_PNG_END) + 1))
            self._searched = len(self._data)
            return None if place < 0 else place + len(_PNG_END)
        read_jpeg = load("wbflow_stages.io.image_headers:read_jpeg")
        self._searched, is_complete = read_jpeg(self._data, self._searched)
        return self._searched if is_complete else None


def _chunks(response: requests.Response) -> Iterator[bytes]:
    """The body as it arrives: a picture must not wait until the beginning of the next one fills a buffer."""
    try:
        while True:
            chunk = response.raw.read1(_CHUNK_BYTES, decode_content=True)
            if not chunk:
                return
            yield chunk
    except urllib3.exceptions.ReadTimeoutError:
        raise requests.ReadTimeout from None
    except urllib3.exceptions.DecodeError:
        coding = response.headers.get("Content-Encoding", "")
        raise OSError(f"says that its answer is compressed ({printable(coding, 20)}), and it is not") from None
    except urllib3.exceptions.HTTPError:
        return  # the connection has ended early: the reader of pictures finds out what is missing


def _other_answer(response: requests.Response, size: int, beginning: bytes) -> str:
    """What a response holds instead of a picture, for the operator."""
    if not size:
        return f"sends an empty picture (status {response.status_code})"
    kind = response.headers.get("Content-Type", "no type")
    text = "".join(letter if letter.isprintable() else " " for letter in beginning.decode("latin-1")).strip()
    amount = f"{size:,} bytes"
    if size > MOST_OTHER_BYTES:
        amount = f"no picture begins in {size / 1e6:.0f} MB, and more comes"
    return f"sends something else than a picture (status {response.status_code}, {kind}, {amount}: {text[:40]!r})"


def _part_time(header: str) -> float | None:
    """When a picture of Motion JPEG was taken by the header of its part; None if that does not say it."""
    stamp = re.search(r"(?im)^x-timestamp:\s*(\d+(?:\.\d+)?)\s*$", header)
    if stamp:
        return float(stamp[1])
    date = re.search(r"(?im)^date:\s*(.+?)\s*$", header)
    if date is None:
        return None
    return _parse_date(date[1])


def _parse_date(text: str | None) -> float | None:
    """The Unix time of a date in HTTP's form; None if there is none, or it is no date."""
    if not text:
        return None
    try:
        return email.utils.parsedate_to_datetime(text).timestamp()
    except (ValueError, TypeError, OverflowError):
        return None


def _refuse_failure(response: requests.Response, access: Access) -> None:
    """Raises OSError for a status that is no success."""
    if response.ok:
        return
    advice = ""
    if response.status_code in {401, 403}:
        advice = ": check its user and password in the file of credentials"
        offers = _challenges(response)
        if access.login is None:
            advice = ": it wants user and password; name them in the file of captures.credentials"
        elif offers and not any(_is_known(offer) for offer in offers):
            ways = ", ".join(re.split(r"[\s,]", offer)[0] for offer in offers)
            advice = f": it wants a login of a kind that is not known ({ways}); choose Digest or Basic in the camera's settings"
    raise OSError(f"answered {response.status_code} {response.reason}{advice}")


class _Session(requests.Session):
    """A session that sends the login to the camera's own host alone, also after redirects, whatever the port."""

    def rebuild_auth(self, prepared_request: requests.PreparedRequest, response: requests.Response) -> None:
        """Take from a redirected request what must not go to another host, and digests, which are for one path."""
        headers: Any = prepared_request.headers
        is_digest = headers.get("Authorization", "").startswith("Digest")
        target = str(prepared_request.url)
        if is_digest or not _is_same_camera(str(response.request.url), target):
            headers.pop("Authorization", None)


def _is_same_camera(source: str, target: str) -> bool:
    """Is a redirect to the same host, and not from an encrypted connection to a plain one?"""
    old = urllib.parse.urlsplit(source)
    new = urllib.parse.urlsplit(target)
    return old.hostname == new.hostname and (old.scheme, new.scheme) != ("https", "http")


class _NoLogin(AuthBase):
    """No login, not even one of the user's .netrc file."""

    def __call__(self, request: requests.PreparedRequest) -> requests.PreparedRequest:
        return request


class _OnDemand(HTTPDigestAuth):
    """The login as the camera asks for it: by digest with the first of its algorithms that is known, else plainly.

    A camera may offer several ways, in one header or in several.
    """

    def __init__(self, url: str, login: Login) -> None:
        super().__init__(*login)
        self._url = url

    def handle_401(self, r: requests.Response, **kwargs: Any) -> requests.Response:
        """Send a refused request again, once, with the login."""
        if r.status_code != 401 or not _is_same_camera(self._url, str(r.url)):
            return r
        # 1. a digest, which does not reveal the password
        offers = _challenges(r)
        for offer in offers:
            if offer.lower().startswith("digest") and _is_known(offer):
                r.headers["www-authenticate"] = offer
                return super().handle_401(r, **kwargs)
        # 2. plainly, unless that has just been refused
        is_basic = any(offer.lower().startswith("basic") for offer in offers)
        if not is_basic or str(r.request.headers.get("Authorization", "")).startswith("Basic"):
            return r
        _ = r.content  # free the connection for the second request
        r.close()
        again = r.request.copy()
        # as UTF-8: Requests would encode text as Latin-1
        user = str(self.username).encode()
        password = str(self.password).encode()
        requests.auth.HTTPBasicAuth(user, password)(again)
        adapter: Any = r.connection
        answer: requests.Response = adapter.send(again, **kwargs)
        answer.history.append(r)
        answer.request = again
        return answer


def _challenges(response: requests.Response) -> list[str]:
    """The ways to log in that a server offers, `Digest realm=...` or `Basic realm=...`, in its order."""
    offers: list[str] = []
    for header in response.raw.headers.getlist("WWW-Authenticate"):
        for offer in re.split(r"(?i)(?=\b(?:basic|digest)\s+\w+\s*=)", header):
            if offer.strip(" ,"):
                offers.append(offer.strip(" ,"))
    return offers


def _is_known(offer: str) -> bool:
    """Can Requests log in this way: plainly, or by a digest of a known algorithm that does not cover the body (auth-int)?"""
    way = offer.lower()
    if way.startswith("digest"):
        algorithm = re.search(r'\balgorithm="?([\w-]+)', way)
        kinds = re.search(r'\bqop="?([\w, -]+)', way)
        has_algorithm = algorithm is None or algorithm[1].upper() in _DIGESTS
        return has_algorithm and (kinds is None or "auth" in re.split(r"[\s,]+", kinds[1]))
    return way.startswith("basic")


def _session(url: str, access: Access) -> requests.Session:
    """A session for the requests to a camera."""
    session = _Session()
    session.auth = _NoLogin()
    if access.login:
        session.auth = _OnDemand(url, access.login)
    if access.tls is not True:
        session.mount("https://", _Certificates(access.tls))
    return session


class _Certificates(HTTPAdapter):
    """Connections to a camera whose certificate no authority has signed; see `Access.tls`."""

    def __init__(self, tls: bool | str) -> None:
        self._tls = tls
        super().__init__()

    def init_poolmanager(self, *args: Any, **kwargs: Any) -> None:
        """Make the connections check what `tls` says, and nothing else."""
        context = ssl.create_default_context()
        context.check_hostname = False  # cameras are addressed by number, and their certificates name anything
        fingerprint = FINGERPRINT.fullmatch(str(self._tls))
        if self._tls is False or fingerprint:
            context.verify_mode = ssl.CERT_NONE
            # old cameras know short keys and old protocols only; who they are is known by the fingerprint, or not wanted
            context.set_ciphers("DEFAULT:@SECLEVEL=0")
            context.minimum_version = ssl.TLSVersion.MINIMUM_SUPPORTED
        else:
            context.load_verify_locations(str(self._tls))
            context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN  # the camera's own certificate is enough
        kwargs["ssl_context"] = context
        kwargs["assert_hostname"] = False
        if fingerprint:
            kwargs["assert_fingerprint"] = fingerprint[1].replace(":", "")
        super().init_poolmanager(*args, **kwargs)

    def cert_verify(self, conn: Any, url: str, verify: Any, cert: Any) -> None:
        """Keep the context's own checks, instead of those that Requests sets for each connection."""

    def build_connection_pool_key_attributes(self, request: Any, verify: Any, cert: Any = None) -> Any:
        """Keep the context's own checks, as above."""
        host, pool = super().build_connection_pool_key_attributes(request, verify, cert)
        pool.pop("ca_certs", None)
        pool.pop("ca_cert_dir", None)
        pool.pop("cert_reqs", None)
        return host, pool


def _cause(error: Exception, url: str, patience: float) -> str:
    """Why a request failed, for the operator.  Messages of the libraries contain the address, which may hold a password."""
    if isinstance(error, requests.Timeout):
        return f"does not answer within {patience:.0f} s"
    if isinstance(error, requests.exceptions.SSLError):
        return _certificate_fault(error, url, patience)
    if isinstance(error, requests.exceptions.ProxyError):
        return f"cannot be reached through the proxy of the environment ({_strerror(error)}): name cameras in no_proxy"
    if isinstance(error, requests.TooManyRedirects):
        return "redirects again and again"
    if isinstance(error, requests.exceptions.InvalidURL | requests.exceptions.InvalidSchema):
        return "has an address that is not valid"
    reason = innermost(error)
    if isinstance(reason, http.client.RemoteDisconnected):
        return "ends the connection without an answer"
    if isinstance(reason, http.client.HTTPException | urllib3.exceptions.InvalidHeader):
        return f"answers, but not as HTTP prescribes ({type(reason).__name__})"
    return f"cannot be reached: {_strerror(error)}"


def _strerror(error: Exception) -> str:
    """The system's words for the innermost reason of an error, else its kind."""
    reason = innermost(error)
    return getattr(reason, "strerror", None) or type(reason).__name__


def innermost(error: BaseException) -> BaseException:
    """The error that others were raised for."""
    for inner in (getattr(error, "reason", None), error.__cause__, error.__context__, *error.args):
        if isinstance(inner, BaseException):
            return innermost(inner)
    return error


def _certificate_fault(error: Exception, url: str, patience: float) -> str:
    """What is wrong with a certificate, and what to write if it is the camera's own."""
    text = str(error)
    reason = "its certificate is not trusted"
    if "ingerprints did not match" in text:
        reason = "its certificate is not the one whose fingerprint is stated as `tls`"
    elif found := re.search(r"certificate verify failed: ([\w -]+)", text):
        reason = f"{reason} ({found[1].strip()})"
    elif found := re.search(r"\[SSL: (\w+)\]", text):
        return f"no encrypted connection can be made ({found[1]})"
    address = urllib.parse.urlsplit(url)
    with contextlib.suppress(OSError, ValueError):
        fingerprint = _fingerprint(str(address.hostname), address.port or 443, patience)
        return f"{reason}; if it is the camera's own, trust it by  tls: 'sha256:{fingerprint}'"
    return f"{reason}; name the camera's certificate as `tls`"


def _fingerprint(host: str, port: int, patience: float) -> str:
    """SHA-256 of the certificate that a server shows now."""
    context = ssl._create_unverified_context()
    with socket.create_connection((host, port), patience) as plain, context.wrap_socket(plain, server_hostname=host) as encrypted:
        certificate = encrypted.getpeercert(binary_form=True) or b""
    digest = hashlib.sha256(certificate).hexdigest().upper()
    return ":".join(digest[k : k + 2] for k in range(0, len(digest), 2))
