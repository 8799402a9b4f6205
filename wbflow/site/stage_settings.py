"""The section `stages` of a site file, checked against the signatures of the stages' functions."""

from __future__ import annotations

import importlib.util
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..cache.fingerprint import FunctionError
from ..cache.untrusted import is_file
from ..errors import Location
from ..pipeline.binding import Binding, Bindings, method_parameters, methods_with_file
from ..pipeline.stages import COMPONENT, FUSE, STAGES, Stage
from ..words import printable
from .models import StageSettings
from .published_models import FOLDER_VARIABLE, PUBLISHED_MODELS
from .yaml_document import Problems, resolve_path, similar, suggest


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


def read_stages(sections: dict[str, Any], bindings: Bindings, problems: Problems) -> tuple[dict[str, StageSettings], Problems]:
    """The settings of every stage, from the section `stages`, and notes on renamed or removed parameters.

    The stages with a section are bound in `bindings`; faults are added to `problems`.
    """
    settings = {stage.name: StageSettings() for stage in STAGES}
    notes = Problems(problems.document)
    stages = {stage.name: stage for stage in STAGES}
    for name, section in sections.items():
        location: Location = ("stages", name)
        if name not in stages:
            remedy = suggest(name, stages, f"stages are {', '.join(stages)}")
            problems.add(location, f"unknown stage {name!r}", remedy, key=True)
        elif section is False:  # switched off
            if not stages[name].optional:
                remedy = f"optional stages: {', '.join(s.name for s in STAGES if s.optional) or 'none'}"
                problems.add(location, f"{name} cannot be switched off", remedy)
            settings[name] = StageSettings(enabled=False)
        elif section is None or section is True or isinstance(section, dict):
            values = dict(section) if isinstance(section, dict) else {}
            use = values.pop("use", None)
            settings[name] = _Section(stages[name], use, values, bindings, problems, notes).read()
        else:
            remedy = f"write {name}: {{parameter: value}}"
            problems.add(location, f"{section!r} is not a mapping of parameters", remedy)
    return settings, notes


@dataclass(frozen=True)
class _Section:
    """Reads the section of one stage."""

    stage: Stage
    use: Any
    """The value of the key `use`."""
    values: dict[str, Any]
    """All other values; while they are read, old names are replaced, and files are taken out."""
    bindings: Bindings
    problems: Problems
    notes: Problems

    @property
    def selector(self) -> str:
        """The key that selects the function: that of the stage's method if it has a choice, else `use`."""
        if self.stage.method and self.use is None:
            return self.stage.method.parameter
        return "use"

    def read(self) -> StageSettings:
        """The settings; faults and notes are added to `problems` and `notes`."""
        if self.use is not None and not (isinstance(self.use, str) and self.use):
            self._add_problem("use", f"{printable(repr(self.use), 80)} is not a function", _USE)
            return StageSettings()
        # 1. the function, by present names of parameters
        try:
            old_names = self._update_renamed()
            binding = self.bindings.bind_section(self.stage, self.use, self.values)
        except FunctionError as error:
            what = f"{error.where}: {error.what}" if error.where else error.what
            self._add_problem(self.selector, what, error.remedy or _USE)
            return StageSettings()
        for function in filter(None, (binding.function, binding.method)):
            package = re.split("[.:]", function.dotted)[0]
            if package in sys.stdlib_module_names:
                self._add_problem(self.selector, f"{function.dotted} is in Python's standard library, and not a stage", _USE)
                return StageSettings()
        # 2. its signature, and what the section gives it
        for fault in binding.faults():
            self._add_problem(self.selector, fault, _SIGNATURE)
        self._check_packages(binding)
        # files are taken out first: they are inputs, no parameters
        files = self._files(binding)
        elsewhere = self._set_elsewhere()
        for name, value in self.values.items():
            written = old_names.get(name, name)
            parameter = binding.parameters.get(name)
            if parameter is None:
                allowed = [known for known in binding.parameters if known not in elsewhere]
                self._report_unknown(binding, name, written, allowed)
                continue
            if name in elsewhere:
                self._add_problem(written, f"{name!r} is not set here", elsewhere[name], key=True)
                continue
            wrong = parameter.problem(value)
            if wrong:
                self._add_problem(written, wrong, f"the default is {parameter.shown}")
        for name, parameter in binding.parameters.items():
            if parameter.required and name not in self.values and name not in elsewhere:
                self._add_problem("use", f"{binding.function.dotted} has {name!r} without a default", f"set it here: {name}: ...")
        return StageSettings(self.use, self.values, files=files)

    def _check_packages(self, binding: Binding) -> None:
        """Report a package that the chosen method imports, and that only an extra of wbflow installs."""
        if binding.method is None:
            return
        libraries = self.bindings.reader.libraries(binding.method.dotted)
        for module, (package, extra) in _EXTRAS.items():
            if module in libraries and importlib.util.find_spec(module) is None:
                what = f"{printable(self.values.get(self.selector))} needs {package}, which is not installed"
                self._add_problem(self.selector, what, f"python -m pip install 'wbflow[{extra}]'")

    def _update_renamed(self) -> dict[str, str]:
        """Give parameters of earlier versions their present names and values; returns the old name by present name."""
        renamed = RENAMED.get(self.stage.name, {})
        removed = REMOVED.get(self.stage.name, frozenset())
        if not (renamed.keys() | removed) & self.values.keys():
            return {}
        # a function of the site's own may have a parameter with an old name: that one is meant then
        known = set(self.bindings.reader.signature(self.use or self.stage.function).parameters)
        for parameters in method_parameters(self.stage, self.bindings.reader).values():
            known.update(parameters)
        for old in removed & self.values.keys() - known:
            del self.values[old]
            what = f"{self.stage.name} has no {old!r} any more; it is ignored in this version"
            self.notes.add(("stages", self.stage.name, old), what, "leave it out", key=True)
        old_names = {}
        for old, change in renamed.items():
            new = change.current_name
            old_is_another_parameter = old != new and old in known
            # methods have different parameters: only those of present functions have a present name
            if old not in self.values or new not in known or old_is_another_parameter:
                continue
            old_value = self.values[old]
            new_value = old_value
            if isinstance(old_value, str):
                new_value = change.values.get(old_value, old_value)
            if (new, new_value) == (old, old_value):
                continue
            if old != new and new in self.values:
                self._add_problem(old, f"{old!r} is the old name of {new!r}, which is given as well", "keep the new one")
            del self.values[old]
            self.values[new] = new_value
            old_names[new] = old
            old_text = old
            new_text = new
            if new_value != old_value:
                old_text += f": {old_value}"
                new_text += f": {new_value}"
            what = f"{old_text!r} is written {new_text!r} now; the old way is still understood in this version"
            self.notes.add(("stages", self.stage.name, old), what, f"write {new_text}", key=True)
        return old_names

    def _files(self, binding: Binding) -> dict[str, Path]:
        """The files that the section names; they are removed from `values`, as their content matters, not their names."""
        paths: dict[str, Path] = {}
        function = binding.method or binding.function
        required = {argument.name for argument in function.arguments if argument.required}
        for name, need in binding.inputs.items():
            if need.kind != "file":
                continue
            stated = self.values.pop(name, None)
            if stated is None:
                if name in required:
                    self._add_problem(self.selector, f"{function.dotted} needs a file: {name}", _FILE.format(name=name))
            elif not isinstance(stated, str):
                self._add_problem(name, f"{printable(repr(stated), 80)} is not a path", _FILE.format(name=name))
            elif stated in PUBLISHED_MODELS:
                paths[name] = self._published(name, stated)
            else:
                paths[name] = self._own_file(name, stated)
        return paths

    def _published(self, key: str, name: str) -> Path:
        """The file of a published model, which has to be there, whole, and of this stage."""
        model = PUBLISHED_MODELS[name]
        if model.stage != self.stage.name:
            others = [other.name for other in PUBLISHED_MODELS.values() if other.stage == self.stage.name]
            remedy = f"for {self.stage.name} there are {', '.join(others)}" if others else _FILE.format(name=key)
            self._add_problem(key, f"{name} is a model for the stage {model.stage}", remedy)
            return model.path
        fault = model.fault()
        if fault:
            remedy = f"{model.command}  (as the user that runs wbflow; {FOLDER_VARIABLE} names another folder)"
            self._add_problem(key, fault, remedy)
        return model.path

    def _own_file(self, key: str, stated: str) -> Path:
        """The file at a path that the section gives."""
        path = resolve_path(stated, ("stages", self.stage.name, key), self.problems)
        if not is_file(path):
            remedy = similar(path) or suggest(stated, PUBLISHED_MODELS, "check the path; it is relative to the site file")
            self._add_problem(key, f"there is no file {printable(path)}", remedy)
        return path

    def _set_elsewhere(self) -> dict[str, str]:
        """The parameters that the section cannot set, each with what to do instead."""
        remedies = {}
        for parameter, site_key in self.stage.set_by_site().items():
            section = site_key.rpartition(".")[0]
            place = f"in the section {section}" if section else "at the top of the file"
            remedies[parameter] = f"set {parameter} {place}"
        if self.stage.name == FUSE:
            remedies[COMPONENT] = "leave it out: each component is worked on in turn"
        return remedies

    def _report_unknown(self, binding: Binding, key: str, written: str, allowed: list[str]) -> None:
        """Report a parameter that is unknown, or that only other methods than the chosen one read."""
        if binding.method:
            methods = [name for name, known in method_parameters(self.stage, self.bindings.reader).items() if key in known]
            methods += methods_with_file(self.stage, key, self.bindings.reader)
            if methods:
                what = f"{key!r} is not read by the chosen {self.selector}, {binding.method.dotted}"
                self._add_problem(written, what, f"leave it out, or choose {self.selector}: {' or '.join(methods)}", key=True)
                return
        remedy = suggest(key, allowed, f"parameters of {binding.function.dotted}: {', '.join(allowed) or 'none'}")
        self._add_problem(written, f"unknown parameter {key!r}", remedy, key=True)

    def _add_problem(self, name: str, what: str, remedy: str, *, key: bool = False) -> None:
        self.problems.add(("stages", self.stage.name, name), what, remedy, key=key)


_EXTRAS = {"onnxruntime": ("ONNX Runtime", "onnx")}
"""Modules that only an extra installs: the name of the package, and the extra."""
_USE = "write package.module:function; the module is installed, or lies beside the site file"
_FILE = "give its path, relative to the site file: {name}: models/matcher.onnx; or a name that  wbflow models  lists"
_SIGNATURE = "name the inputs as they are offered, and put parameters with defaults behind a bare *"
