"""The section `stages` of a site file, checked against the signatures of the stages' functions."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..cache.fingerprint import FunctionError
from ..cache.untrusted import is_file
from ..pipeline.binding import Binding, bind, method_parameters, methods_with_file
from ..pipeline.functions import FunctionReader
from ..pipeline.stages import COMPONENT, FUSE, STAGES, Stage
from ..words import printable
from .models import StageSettings
from .yaml_document import Location, Problems, beside, did_you_mean, similar


@dataclass(frozen=True)
class Renamed:
    """A parameter with another name or other values in an earlier version; these are still accepted, with a note."""

    now: str
    values: Mapping[str, str] = field(default_factory=dict)
    """Present value by old value."""


RENAMED: Mapping[str, Mapping[str, Renamed]] = {
    "features": {"keypoints": Renamed("max_keypoints"), "light": Renamed("preprocessing", {"plain": "none", "robust": "clahe"})},
    "matches": {"matcher": Renamed("matcher", {"literal": "hao2011", "dominant": "hao2011-dominance"})},
    "rectify": {"method": Renamed("method", {"seed": "hao2011", "literal": "hao2011"})},
    "disparity": {"speck_share": Renamed("speckle_share")},
    "fuse": {"strict": Renamed("min_consistent_pairs")},
}
"""Renamed parameters by stage and old name."""
GONE: Mapping[str, frozenset[str]] = {"fuse": frozenset({"neighbours"})}
"""Parameters of earlier versions that were removed without replacement, by stage; accepted and ignored, with a note."""


def read_stages(
    sections: dict[str, Any], reader: FunctionReader, problems: Problems
) -> tuple[dict[str, StageSettings], Problems]:
    """The settings of each stage in the section `stages`, and notes on renamed or removed parameters; faults are added to
    `problems`."""
    found: dict[str, StageSettings] = {}
    notes = Problems(problems.document)
    known = {stage.name: stage for stage in STAGES}
    for name, section in sections.items():
        location: Location = ("stages", name)
        if name not in known:
            remedy = did_you_mean(name, known, f"stages are {', '.join(known)}")
            problems.add(location, f"unknown stage {name!r}", remedy, key=True)
        elif section is False:
            if not known[name].optional:
                remedy = f"optional stages: {', '.join(s.name for s in STAGES if s.optional) or 'none'}"
                problems.add(location, f"{name} cannot be switched off", remedy)
            found[name] = StageSettings(enabled=False)
        elif section is None or section is True or isinstance(section, dict):
            values = dict(section) if isinstance(section, dict) else {}
            found[name] = _Section(known[name], reader, problems, notes).read(values)
        else:
            remedy = f"write {name}: {{parameter: value}}"
            problems.add(location, f"{section!r} is not a mapping of parameters", remedy)
    return found, notes


@dataclass(frozen=True)
class _Section:
    """Reads the section of one stage."""

    stage: Stage
    reader: FunctionReader
    problems: Problems
    notes: Problems

    @property
    def chooser(self) -> str:
        """The parameter that selects the stage's method; "" if there is no choice."""
        return self.stage.method.parameter if self.stage.method else ""

    def read(self, values: dict[str, Any]) -> StageSettings:
        """The settings; faults and notes are added to `problems` and `notes`."""
        use = values.pop("use", None)
        if use is not None and not (isinstance(use, str) and use):
            self._problem("use", f"{printable(repr(use), 80)} is not a function", _USE)
            return StageSettings()
        try:
            written = {new: old for old, new in self._renamed(values, use).items()}
            bound = bind(self.stage, use, values, self.reader)
        except FunctionError as error:
            key = (self.chooser if use is None else "") or "use"
            self._problem(key, f"{error.where}: {error.what}" if error.where else error.what, error.remedy or _USE)
            return StageSettings()
        key = self.chooser if bound.method else "use"
        for function in filter(None, (bound.function, bound.method)):
            if function.dotted.partition(":")[0].partition(".")[0] in sys.stdlib_module_names:
                self._problem(key, f"{function.dotted} is in Python's standard library, and not a stage", _USE)
                return StageSettings()
        for fault in bound.faults():
            self._problem("use" if use else self.chooser, fault, _SIGNATURE)
        files = self._files(bound, values)
        for key, value in values.items():
            self._check(bound, key, value, written.get(key, key))
        for name, parameter in bound.parameters.items():
            if parameter.required and name not in values and name not in self._fed():
                self._problem("use", f"{bound.function.dotted} has {name!r} without a default", f"set it here: {name}: ...")
        return StageSettings(use, values, files=files)

    def _files(self, bound: Binding, values: dict[str, Any]) -> dict[str, Path]:
        """The files that the section names; they are removed from `values`, as their content matters, not their names."""
        found: dict[str, Path] = {}
        chosen, key = bound.method or bound.function, self.chooser if bound.method else "use"
        required = {argument.name for argument in chosen.signature.arguments if argument.required}
        for name in [name for name, need in bound.inputs.items() if need.kind == "file"]:
            stated, location = values.pop(name, None), ("stages", self.stage.name, name)
            if stated is None:
                if name in required:
                    self._problem(key, f"{chosen.dotted} needs a file: {name}", _FILE.format(name=name))
            elif not isinstance(stated, str):
                self._problem(name, f"{printable(repr(stated), 80)} is not a path", _FILE.format(name=name))
            else:
                found[name] = beside(stated, location, self.problems)
                if not is_file(found[name]):
                    remedy = similar(found[name]) or "check the path; it is relative to the site file"
                    self._problem(name, f"there is no file {printable(found[name])}", remedy)
        return found

    def _renamed(self, values: dict[str, Any], use: str | None) -> dict[str, str]:
        """Give parameters of earlier versions their present names and values, in place; returns present name by old name."""
        renamed, gone = RENAMED.get(self.stage.name, {}), GONE.get(self.stage.name, frozenset())
        if not (renamed.keys() | gone) & values.keys():
            return {}
        known = set(self.reader.signature(use or self.stage.function).parameters)
        known |= {name for of_method in method_parameters(self.stage, self.reader).values() for name in of_method}
        for old in gone & values.keys() - known:
            del values[old]
            what = f"{self.stage.name} has no {old!r} any more; it is ignored in this version"
            self.notes.add(("stages", self.stage.name, old), what, "leave it out", key=True)
        found = {}
        for old, row in renamed.items():
            if old not in values or row.now not in known or (row.now != old and old in known):
                continue
            value = values[old]
            changed = isinstance(value, str) and value in row.values
            if row.now == old and not changed:
                continue
            if row.now != old and row.now in values:
                self._problem(old, f"{old!r} is the old name of {row.now!r}, which is given as well", "keep the new one")
            del values[old]
            values[row.now] = row.values[value] if changed else value
            found[old] = row.now
            now = f"{row.now}: {row.values[value]}" if changed else row.now
            before = f"{old}: {value}" if changed else old
            location: Location = ("stages", self.stage.name, old)
            what = f"{before!r} is written {now!r} now; the old way is still understood in this version"
            self.notes.add(location, what, f"write {now}", key=True)
        return found

    def _fed(self) -> set[str]:
        """The parameters that are set elsewhere in the site file, or by the plan."""
        return {*self.stage.set_by_site(), *([COMPONENT] if self.stage.name == FUSE else [])}

    def _check(self, bound: Binding, key: str, value: Any, written: str) -> None:
        """Check one parameter.  written: its name in the file."""
        fed = self._fed()
        parameter = bound.parameters.get(key)
        if key in fed and parameter:
            section = self.stage.set_by_site().get(key, "").rpartition(".")[0]
            where = f"in the section {section}" if section else "at the top of the file"
            remedy = f"set {key} {where}" if key != COMPONENT else "leave it out: each component is worked on in turn"
            self._problem(written, f"{key!r} is not set here", remedy, key=True)
        elif parameter is None:
            self._unknown(bound, key, written, [name for name in bound.parameters if name not in fed])
        elif wrong := parameter.problem(value):
            self._problem(written, wrong, f"the default is {parameter.shown}")

    def _unknown(self, bound: Binding, key: str, written: str, allowed: list[str]) -> None:
        """Report a parameter that is unknown, or that only other methods than the chosen one read."""
        if bound.method:
            readers = [name for name, known in method_parameters(self.stage, self.reader).items() if key in known]
            readers += methods_with_file(self.stage, key, self.reader)
            if readers:
                what = f"{key!r} is not read by the chosen {self.chooser}, {bound.method.dotted}"
                self._problem(written, what, f"leave it out, or choose {self.chooser}: {' or '.join(readers)}", key=True)
                return
        remedy = did_you_mean(key, allowed, f"parameters of {bound.function.dotted}: {', '.join(allowed) or 'none'}")
        self._problem(written, f"unknown parameter {key!r}", remedy, key=True)

    def _problem(self, name: str, what: str, remedy: str, *, key: bool = False) -> None:
        location: Location = ("stages", self.stage.name, name) if name else ("stages", self.stage.name)
        self.problems.add(location, what, remedy, key=key)


_USE = "write package.module:function; the module is installed, or lies beside the site file"
_FILE = "give its path, relative to the site file: {name}: models/matcher.onnx"
_SIGNATURE = "name the inputs as they are offered, and put parameters with defaults behind a bare *"
