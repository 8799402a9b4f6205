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
from .yaml_document import Location, Problems, resolve_path, similar, suggest


@dataclass(frozen=True)
class Renamed:
    """A parameter with another name or other values in an earlier version; these are still accepted, with a note."""

    current_name: str
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
REMOVED: Mapping[str, frozenset[str]] = {"fuse": frozenset({"neighbours"})}
"""Parameters of earlier versions that were removed without replacement, by stage; accepted and ignored, with a note."""


def read_stages(
    sections: dict[str, Any], reader: FunctionReader, problems: Problems
) -> tuple[dict[str, StageSettings], Problems]:
    """The settings of each stage in the section `stages`, and notes on renamed or removed parameters; faults are added to
    `problems`."""
    settings: dict[str, StageSettings] = {}
    notes = Problems(problems.document)
    stages = {stage.name: stage for stage in STAGES}
    for name, section in sections.items():
        location: Location = ("stages", name)
        if name not in stages:
            remedy = suggest(name, stages, f"stages are {', '.join(stages)}")
            problems.add(location, f"unknown stage {name!r}", remedy, key=True)
        elif section is False:
            if not stages[name].optional:
                remedy = f"optional stages: {', '.join(s.name for s in STAGES if s.optional) or 'none'}"
                problems.add(location, f"{name} cannot be switched off", remedy)
            settings[name] = StageSettings(enabled=False)
        elif section is None or section is True or isinstance(section, dict):
            values = dict(section) if isinstance(section, dict) else {}
            settings[name] = _Section(stages[name], reader, problems, notes).read(values)
        else:
            remedy = f"write {name}: {{parameter: value}}"
            problems.add(location, f"{section!r} is not a mapping of parameters", remedy)
    return settings, notes


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
            self._add_problem("use", f"{printable(repr(use), 80)} is not a function", _USE)
            return StageSettings()
        try:
            old_names = {new: old for old, new in self._update_renamed(values, use).items()}
            binding = bind(self.stage, use, values, self.reader)
        except FunctionError as error:
            key = (self.chooser if use is None else "") or "use"
            self._add_problem(key, f"{error.where}: {error.what}" if error.where else error.what, error.remedy or _USE)
            return StageSettings()
        key = self.chooser if binding.method else "use"
        for function in filter(None, (binding.function, binding.method)):
            if function.dotted.partition(":")[0].partition(".")[0] in sys.stdlib_module_names:
                self._add_problem(key, f"{function.dotted} is in Python's standard library, and not a stage", _USE)
                return StageSettings()
        for fault in binding.faults():
            self._add_problem("use" if use else self.chooser, fault, _SIGNATURE)
        files = self._files(binding, values)
        for key, value in values.items():
            self._check_parameter(binding, key, value, old_names.get(key, key))
        for name, parameter in binding.parameters.items():
            if parameter.required and name not in values and name not in self._set_elsewhere():
                self._add_problem("use", f"{binding.function.dotted} has {name!r} without a default", f"set it here: {name}: ...")
        return StageSettings(use, values, files=files)

    def _files(self, binding: Binding, values: dict[str, Any]) -> dict[str, Path]:
        """The files that the section names; they are removed from `values`, as their content matters, not their names."""
        paths: dict[str, Path] = {}
        function, key = binding.method or binding.function, self.chooser if binding.method else "use"
        required = {argument.name for argument in function.signature.arguments if argument.required}
        for name in [name for name, need in binding.inputs.items() if need.kind == "file"]:
            stated, location = values.pop(name, None), ("stages", self.stage.name, name)
            if stated is None:
                if name in required:
                    self._add_problem(key, f"{function.dotted} needs a file: {name}", _FILE.format(name=name))
            elif not isinstance(stated, str):
                self._add_problem(name, f"{printable(repr(stated), 80)} is not a path", _FILE.format(name=name))
            else:
                paths[name] = resolve_path(stated, location, self.problems)
                if not is_file(paths[name]):
                    remedy = similar(paths[name]) or "check the path; it is relative to the site file"
                    self._add_problem(name, f"there is no file {printable(paths[name])}", remedy)
        return paths

    def _update_renamed(self, values: dict[str, Any], use: str | None) -> dict[str, str]:
        """Give parameters of earlier versions their present names and values, in place; returns present name by old name."""
        renamed, removed = RENAMED.get(self.stage.name, {}), REMOVED.get(self.stage.name, frozenset())
        if not (renamed.keys() | removed) & values.keys():
            return {}
        known = set(self.reader.signature(use or self.stage.function).parameters)
        known |= {name for of_method in method_parameters(self.stage, self.reader).values() for name in of_method}
        for old in removed & values.keys() - known:
            del values[old]
            what = f"{self.stage.name} has no {old!r} any more; it is ignored in this version"
            self.notes.add(("stages", self.stage.name, old), what, "leave it out", key=True)
        new_names = {}
        for old, change in renamed.items():
            if old not in values or change.current_name not in known or (change.current_name != old and old in known):
                continue
            value = values[old]
            has_new_value = isinstance(value, str) and value in change.values
            if change.current_name == old and not has_new_value:
                continue
            if change.current_name != old and change.current_name in values:
                what = f"{old!r} is the old name of {change.current_name!r}, which is given as well"
                self._add_problem(old, what, "keep the new one")
            del values[old]
            values[change.current_name] = change.values[value] if has_new_value else value
            new_names[old] = change.current_name
            new_text = f"{change.current_name}: {change.values[value]}" if has_new_value else change.current_name
            old_text = f"{old}: {value}" if has_new_value else old
            location: Location = ("stages", self.stage.name, old)
            what = f"{old_text!r} is written {new_text!r} now; the old way is still understood in this version"
            self.notes.add(location, what, f"write {new_text}", key=True)
        return new_names

    def _set_elsewhere(self) -> set[str]:
        """The parameters that are set elsewhere in the site file, or by the plan."""
        return {*self.stage.set_by_site(), *([COMPONENT] if self.stage.name == FUSE else [])}

    def _check_parameter(self, binding: Binding, key: str, value: Any, written: str) -> None:
        """Check one parameter.  written: its name in the file."""
        set_elsewhere = self._set_elsewhere()
        parameter = binding.parameters.get(key)
        if key in set_elsewhere and parameter:
            section = self.stage.set_by_site().get(key, "").rpartition(".")[0]
            where = f"in the section {section}" if section else "at the top of the file"
            remedy = f"set {key} {where}" if key != COMPONENT else "leave it out: each component is worked on in turn"
            self._add_problem(written, f"{key!r} is not set here", remedy, key=True)
        elif parameter is None:
            self._report_unknown(binding, key, written, [name for name in binding.parameters if name not in set_elsewhere])
        elif fault := parameter.problem(value):
            self._add_problem(written, fault, f"the default is {parameter.shown}")

    def _report_unknown(self, binding: Binding, key: str, written: str, allowed: list[str]) -> None:
        """Report a parameter that is unknown, or that only other methods than the chosen one read."""
        if binding.method:
            methods = [name for name, known in method_parameters(self.stage, self.reader).items() if key in known]
            methods += methods_with_file(self.stage, key, self.reader)
            if methods:
                what = f"{key!r} is not read by the chosen {self.chooser}, {binding.method.dotted}"
                self._add_problem(written, what, f"leave it out, or choose {self.chooser}: {' or '.join(methods)}", key=True)
                return
        remedy = suggest(key, allowed, f"parameters of {binding.function.dotted}: {', '.join(allowed) or 'none'}")
        self._add_problem(written, f"unknown parameter {key!r}", remedy, key=True)

    def _add_problem(self, name: str, what: str, remedy: str, *, key: bool = False) -> None:
        location: Location = ("stages", self.stage.name, name) if name else ("stages", self.stage.name)
        self.problems.add(location, what, remedy, key=key)


_USE = "write package.module:function; the module is installed, or lies beside the site file"
_FILE = "give its path, relative to the site file: {name}: models/matcher.onnx"
_SIGNATURE = "name the inputs as they are offered, and put parameters with defaults behind a bare *"
