"""What is known of a function without importing it, remembered from run to run as long as no source file changes."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ..pipeline.signature import Argument, Parameter, Signature, read_signature, read_table
from .fingerprint import ModuleCode, Modules, fingerprint, function_digest, module_code
from .signed import Damaged, read_signed, write_signed

_FORM = 2
"""Of the memo; another one is not read."""
_OF = "what was read of functions"


@dataclass(frozen=True)
class FunctionInfo:
    """A function: its dotted name, what it asks for, and a fingerprint of all code that it runs."""

    dotted: str
    signature: Signature
    code: str


@dataclass
class FunctionReader:
    """Reads functions, and remembers in a file what it learnt of source files that have not changed since."""

    memo: Path | None = None
    folder: Path | None = None
    """Where modules may lie that are not installed: beside the site file."""
    modules: Modules = field(init=False)
    damage: str | None = None
    """What was wrong with the memo, if anything was: then every function is read again."""
    _known: dict[str, Any] = field(default_factory=dict)
    _stamps: dict[str, list[int] | None] = field(default_factory=dict)
    _fresh: bool = False

    def __post_init__(self) -> None:
        self.modules = Modules(self.folder)
        try:
            known = read_signed(self.memo, _OF) if self.memo else None
        except Damaged as damage:
            self.damage = f"{damage.what}: functions are read again"
            self._fresh = True
            known = None
        self._known = known if known and known.get("form") == _FORM else {}

    def read(self, dotted: str, table: str = "") -> FunctionInfo:
        """What is known of a function.

        Parameters
        ----------
        dotted : str
            "package.module:function".
        table : str
            Dotted name of the table of methods that it chooses from: what is in it does not enter the fingerprint.

        Raises
        ------
        FunctionError
            No such module or function, with what is missing.
        """
        module, _, name = dotted.partition(":")
        path = self.modules.file(module)
        if path is None or not name:
            self.modules.function(dotted)  # says what is wrong
        assert path is not None
        home, _, own_table = table.partition(":")
        left_out = own_table if home == module else ""
        digest = self._remembered(
            "functions",
            f"{dotted} {left_out}",
            path,
            lambda: ({"digest": function_digest(self.modules, module, path, name, left_out)}, {path}),
        )
        return FunctionInfo(dotted, self.signature(dotted), fingerprint(digest["digest"], module, self._closure(module)))

    def signature(self, dotted: str) -> Signature:
        """What a function asks for.  Raises FunctionError."""
        path = self.modules.file(dotted.partition(":")[0])
        if path is None:
            self.modules.function(dotted)  # says what is wrong
        assert path is not None
        return _unpacked(self._remembered("signatures", dotted, path, lambda: _packed(*read_signature(self.modules, dotted))))

    def table(self, dotted: str) -> dict[str, str]:
        """A table of methods: name -> dotted function.  Raises FunctionError."""

        path = self.modules.file(dotted.partition(":")[0])
        if path is None:
            read_table(self.modules, dotted)  # says what is wrong
        assert path is not None

        def read() -> tuple[dict[str, Any], set[Path]]:
            table, path = read_table(self.modules, dotted)
            return {"table": table}, {path}

        found: dict[str, str] = self._remembered("tables", dotted, path, read)["table"]
        return found

    def save(self) -> None:
        """Write what was learnt, for the next run."""
        if self.memo and self._fresh:
            write_signed(self.memo, _OF, self._known | {"form": _FORM})
            self._fresh = False

    def _closure(self, module: str) -> dict[str, ModuleCode]:
        found: dict[str, ModuleCode] = {}
        waiting = [module]
        while waiting:
            name = waiting.pop()
            path = self.modules.file(name)
            if name not in found and path is not None:
                found[name] = self._module(name, path)
                waiting.extend(found[name].imports)
        return found

    def _module(self, name: str, path: Path) -> ModuleCode:
        known = self._remembered("modules", name, path, lambda: (asdict(module_code(self.modules, name, path)), {path}))
        return ModuleCode(known["digest"], tuple(known["imports"]), tuple(known["libraries"]))

    def _remembered(
        self, shelf: str, name: str, path: Path, read: Callable[[], tuple[dict[str, Any], set[Path]]]
    ) -> dict[str, Any]:
        """What is known under a name, or read now: it holds as long as none of the files that it was told from changes.

        path: the file in which the name is to be found today.
        """
        known = self._known.setdefault(shelf, {}).get(name)
        if known is None or str(path) not in known["files"] or not self._unchanged(known["files"]):
            told, files = read()
            known = {"told": told, "files": {str(file): self._stamp(str(file)) for file in sorted(files)}}
            self._known[shelf][name] = known
            self._fresh = True
        result: dict[str, Any] = known["told"]
        return result

    def _unchanged(self, files: dict[str, list[int] | None]) -> bool:
        return all(self._stamp(file) == stamp for file, stamp in files.items())

    def _stamp(self, file: str) -> list[int] | None:
        """Time and size of a file, looked at once."""
        if file not in self._stamps:
            self._stamps[file] = _stamp_of(file)
        return self._stamps[file]


def _stamp_of(file: str) -> list[int] | None:
    try:
        status = os.stat(file)  # noqa: PTH116 (hot path)
    except OSError:
        return None
    return [status.st_mtime_ns, status.st_size]


def _packed(signature: Signature, files: set[Path]) -> tuple[dict[str, Any], set[Path]]:
    return asdict(signature), files


def _unpacked(told: dict[str, Any]) -> Signature:
    arguments = tuple(Argument(**argument) for argument in told["arguments"])
    parameters = {
        name: Parameter(**{**row, "kinds": tuple(row["kinds"]), "choices": tuple(row["choices"])})
        for name, row in told["parameters"].items()
    }
    return Signature(arguments, parameters, told["takes_any"])
