"""What a site's functions ask for and which code they run, read from source and remembered until a source file changes."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..cache.fingerprint import Code, Modules, read_code
from ..cache.memo import Memo
from .signature import Argument, Parameter, Signature, read_signature, read_table

_FORM = f"3, Python {sys.version_info.major}.{sys.version_info.minor}"
"""Of the memo; another one is not read."""


@dataclass(frozen=True)
class FunctionInfo:
    """A function: its dotted name, what it asks for, and a fingerprint of all code that it runs."""

    dotted: str
    signature: Signature
    code: str


class FunctionReader(Memo):
    """Reads functions, and remembers in a file what it read, for as long as none of their source files changes.

    Nothing is imported: all stages with their libraries take 1.6 CPU seconds and 250 MB to import, and 0.8 seconds to read.
    """

    def __init__(self, memo: Path | None = None, folder: Path | None = None) -> None:
        """folder: where modules may lie that are not installed: beside the site file."""
        super().__init__(memo, "what was read of functions", "functions are read again")
        self.modules = Modules(folder)
        files = self.entries.get("files", {})
        if self.entries.get("form") != _FORM or any(_stamp(file) != stamp for file, stamp in files.items()):
            self.entries = {"form": _FORM, "files": {}, "known": {}}

    def read(self, dotted: str, table: str = "") -> FunctionInfo:
        """Return what is known of a function, "package.module:function".  Raises FunctionError, with what is missing.

        table: dotted name of the table of methods that it chooses from: what is in it does not enter the fingerprint.
        """
        home, _, own_table = table.partition(":")
        left_out = own_table if home == dotted.partition(":")[0] else ""

        def read() -> tuple[dict[str, Any], Iterable[Path]]:
            code = read_code(self.modules, dotted, left_out)
            return {"digest": code.digest, "libraries": code.libraries}, code.files

        known = self._remembered(f"code {left_out}", dotted, read)
        code = Code(known["digest"], tuple(known["libraries"]), ())
        return FunctionInfo(dotted, self.signature(dotted), code.fingerprint)

    def signature(self, dotted: str) -> Signature:
        """Return what a function asks for.  Raises FunctionError."""

        def read() -> tuple[dict[str, Any], Iterable[Path]]:
            signature, files = read_signature(self.modules, dotted)
            return asdict(signature), files

        return _signature(self._remembered("signature", dotted, read))

    def table(self, dotted: str) -> dict[str, str]:
        """Return a table of methods: name -> dotted function.  Raises FunctionError."""
        found: dict[str, str] = self._remembered("table", dotted, lambda: read_table(self.modules, dotted))
        return found

    def _remembered(self, what: str, dotted: str, read: Callable[[], tuple[Any, Iterable[Path]]]) -> Any:
        """Return what is known of a dotted name, or read it now, with the files that it is from."""
        entry = f"{what} {dotted} {self.modules.file(dotted.partition(':')[0])}"  # found elsewhere, it is another one
        known = self.entries["known"]
        if entry not in known:
            known[entry], files = read()
            self.entries["files"] |= {str(file): _stamp(str(file)) for file in files}
            self._changed = True
        return known[entry]


def _stamp(file: str) -> list[int] | None:
    """Time and size of a file; None where there is none."""
    try:
        status = Path(file).stat()
    except OSError:
        return None
    return [status.st_mtime_ns, status.st_size]


def _signature(entry: Mapping[str, Any]) -> Signature:
    arguments = tuple(Argument(**argument) for argument in entry["arguments"])
    return Signature(arguments, {name: Parameter(**row) for name, row in entry["parameters"].items()}, entry["takes_any"])
