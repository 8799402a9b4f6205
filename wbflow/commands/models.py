"""`wbflow models`: which published models there are, which of them are on this machine, and how they get here."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO

from ..cache.atomic import DISK_FULL_ERRORS, free_bytes, sync_folder
from ..cache.checksum import sha256_of
from ..cache.untrusted import is_file
from ..errors import ExitCode, UsageError, WbflowError
from ..site.published_models import FOLDER_VARIABLE, PUBLISHED_MODELS, PublishedModel
from ..site.yaml_document import suggest
from ..words import format_size, printable
from .download import Progress, download, is_address

_ELSEWHERE = f"name a folder for models: {FOLDER_VARIABLE}=FOLDER"


def published_models() -> list[dict[str, Any]]:
    """Each published model as plain data, with `path`, `url`, and what is wrong with its file: `state` is "whole", "missing" or
    "wrong", and `fault` the words."""
    rows = []
    for model in PUBLISHED_MODELS.values():
        fault = model.fault()
        state = "whole"
        if fault:
            state = "wrong" if is_file(model.path) else "missing"
        rows.append({**asdict(model), "url": model.url, "path": str(model.path), "state": state, "fault": fault})
    return rows


def model_named(name: str) -> PublishedModel:
    """The published model of this name.  Raises UsageError."""
    if name not in PUBLISHED_MODELS:
        known = f"there are {', '.join(PUBLISHED_MODELS)}"
        raise UsageError(f"there is no published model {printable(name)!r}", remedy=suggest(name, PUBLISHED_MODELS, known))
    return PUBLISHED_MODELS[name]


def get_model(model: PublishedModel, source: str, progress: Progress) -> None:
    """Put the file of a model into the folder of models, under its name only once it is known to be the published one.

    Raises WbflowError if it cannot be had, is not the published file, or if there is no space.

    Parameters
    ----------
    model : PublishedModel
        The model.
    source : str
        Another address, or the path of a file that was downloaded elsewhere; "" for the published address.
    progress : callable
        Is told how many bytes have arrived.
    """
    part = model.path.with_name(f"{model.path.name}.part")  # a download that is broken off stays here, and is gone on with
    address = source or model.url
    try:
        part.parent.mkdir(parents=True, exist_ok=True)
        with _held(part) as file:
            _require_space(model, file)
            if is_address(address):
                download(address, file, progress)
            else:
                _copy(Path(address), file)
                progress(file.tell())
            file.flush()
            os.fsync(file.fileno())
            _check(model, part, address)
            part.replace(model.path)
        sync_folder(part.parent)
    except ConnectionError as error:
        raise WbflowError(f"{model.name}: {error}", remedy=_remedy_offline(model, part)) from None
    except OSError as error:
        if error.errno in DISK_FULL_ERRORS:
            part.unlink(missing_ok=True)
            raise _no_space(model) from None
        what = f"{printable(error.filename or part.parent)}: {error.strerror or error}"
        raise WbflowError(what, remedy=f"check the rights on {part.parent}, or {_ELSEWHERE}") from None


@contextlib.contextmanager
def _held(part: Path) -> Iterator[BinaryIO]:
    """The file of an unfinished download, which no other process writes meanwhile.  Raises WbflowError if one does."""
    with part.open("ab") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            error = WbflowError(f"another process is downloading {part.stem}", remedy="wait for it, or stop it")
            error.exit_code = ExitCode.LOCKED
            raise error from None
        try:
            yield file
        finally:
            if part.exists() and not part.stat().st_size:
                part.unlink()


def _copy(source: Path, file: BinaryIO) -> None:
    """Copy a file that was downloaded elsewhere.  Raises WbflowError if it cannot be read."""
    file.truncate(0)
    try:
        original = source.expanduser().open("rb")
    except OSError as error:
        raise UsageError(f"{printable(source)}: {error.strerror}", remedy="give an address (https://...) or a file") from None
    with original:
        shutil.copyfileobj(original, file)


def _check(model: PublishedModel, part: Path, address: str) -> None:
    """Raises WbflowError, and removes the file, if it is not the published one."""
    digest = sha256_of(part)
    if digest == model.sha256:
        return
    size = part.stat().st_size
    with part.open("rb") as file:
        is_page = file.read(200).lstrip().startswith(b"<")
    part.unlink()
    what = f"{printable(address)} is not the published {model.name}: {size:,} bytes, SHA-256 {digest}, not {model.sha256}"
    if is_page:
        what += "; it is a web page: a proxy or a portal may have answered instead"
    raise WbflowError(f"{what}; it was not kept", remedy=f"{model.command}  begins anew; published is {model.url}")


def _require_space(model: PublishedModel, file: BinaryIO) -> None:
    """Raises WbflowError if the disk has no space for the rest of the file."""
    if free_bytes(model.path.parent) < model.size_bytes - file.tell():
        raise _no_space(model)


def _no_space(model: PublishedModel) -> WbflowError:
    folder = model.path.parent
    what = (
        f"no space for {model.name}: {format_size(model.size_bytes)} needed, {format_size(free_bytes(folder))} free in {folder}"
    )
    return WbflowError(what, remedy=f"free some space, or {_ELSEWHERE}")


def _remedy_offline(model: PublishedModel, part: Path) -> str:
    """What to do if the file could not be downloaded, or not all of it."""
    elsewhere = f"download {model.url} on another machine, and copy it to {model.path}"
    if part.exists():
        return f"{model.command}  goes on where it stopped; or {elsewhere}"
    return f"{elsewhere}; or {model.command} --from FILE"
