"""Downloads a file over HTTP, and goes on with a download that was broken off."""

from __future__ import annotations

import http
import re
import urllib.parse
from collections.abc import Callable
from typing import BinaryIO

import requests

from ..capture.server import innermost
from ..words import format_size, printable

Progress = Callable[[int], None]
"""Is told, again and again, how many bytes have arrived in all."""

PATIENCE_SECONDS = 30.0
"""How long a server may be silent."""
_CHUNK_BYTES = 1 << 14
"""Bytes that are read at once; less than this may be lost when a connection ends early."""
_RANGE_NOT_SATISFIABLE = http.HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE


def is_address(text: str) -> bool:
    """Is it an address on the network, rather than a path?"""
    return re.match(r"https?://", text, re.IGNORECASE) is not None


def download(url: str, file: BinaryIO, progress: Progress) -> None:
    """Append to an open file what it lacks of the content of an address; a server that cannot go on begins anew.

    Proxies and certificates are those of the environment (HTTPS_PROXY, NO_PROXY, REQUESTS_CA_BUNDLE).  What has arrived is in
    the file, however this ends; whether it is the right content is for the caller to check.

    Raises ConnectionError with the reason, and OSError if the file cannot be written.
    """
    there = file.seek(0, 2)
    headers = {"Accept-Encoding": "identity"}  # the file itself: its length counts
    if there:
        headers["Range"] = f"bytes={there}-"
    try:
        with requests.get(url, headers=headers, stream=True, timeout=PATIENCE_SECONDS) as response:
            if there and response.status_code == _RANGE_NOT_SATISFIABLE:
                return  # nothing comes behind what is there already
            if not response.ok:
                raise ConnectionError(f"{_host(url)} answers {response.status_code} {printable(response.reason, 80)}")
            if not _goes_on(response, there):
                file.truncate(0)
                there = file.seek(0)
            for chunk in response.iter_content(_CHUNK_BYTES):
                file.write(chunk)
                there += len(chunk)
                progress(there)
    except requests.RequestException as error:
        raise ConnectionError(_reason(error, url, there)) from None


def _goes_on(response: requests.Response, there: int) -> bool:
    """Does an answer begin behind the bytes that are there?"""
    content_range = response.headers.get("Content-Range", "")
    begins = re.match(r"bytes (\d+)-", content_range)
    is_partial = response.status_code == http.HTTPStatus.PARTIAL_CONTENT
    return is_partial and begins is not None and int(begins[1]) == there


def _host(url: str) -> str:
    return urllib.parse.urlsplit(url).hostname or "the server"


def _reason(error: requests.RequestException, url: str, there: int) -> str:
    """Why a request failed, for people; messages of the libraries may contain the password of a proxy."""
    host = _host(url)
    cause = innermost(error)
    detail = printable(getattr(cause, "strerror", None) or type(cause).__name__, 200)
    if isinstance(error, requests.exceptions.ProxyError):
        return f"the proxy that HTTPS_PROXY or HTTP_PROXY names cannot be used: {_of_tunnel(cause) or detail}"
    if isinstance(error, requests.exceptions.SSLError):
        return f"the certificate of {host} is not trusted; one that your proxy signs goes into REQUESTS_CA_BUNDLE"
    if isinstance(error, requests.Timeout):
        return f"{host} does not answer within {PATIENCE_SECONDS:.0f} s"
    if isinstance(error, requests.exceptions.ChunkedEncodingError) or (there and isinstance(error, requests.ConnectionError)):
        return f"the connection to {host} ended after {format_size(there)}"
    if isinstance(error, ValueError):  # InvalidURL, InvalidSchema and the like
        return f"{printable(url, 200)} is not a valid address"
    return f"{host} cannot be reached: {detail}"


def _of_tunnel(cause: BaseException) -> str:
    """What a proxy answered to the request for a connection; "" if it did not."""
    answer = re.search(r"Tunnel connection failed: (.+)", str(cause))
    return printable(answer[1], 80) if answer else ""
