"""What a person has to know of a night, as data: the verdict, its findings, and how each camera is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

Figures = Mapping[str, Any]
"""What is reported of a camera, a pair, a night or the world, by name: numbers, words, and mappings of these."""

Level = Literal["good", "degraded", "failed"]
HealthState = Literal["ok", "nudged", "moved", "blind", "stale", "foreign"]


STORE_BEHIND = "store-behind"
"""The kind of a finding: the object store does not have all that was done."""


def rounded(value: Any) -> Any:
    """Four digits are more than anybody reads."""
    if isinstance(value, Mapping):
        return {key: rounded(entry) for key, entry in value.items()}
    return round(value, 4) if isinstance(value, float) else value


@dataclass(frozen=True)
class Finding:
    """Something that a person should look at."""

    kind: str
    """What sort of thing, for programs: camera-lost, camera-foreign, fewer-pairs, task-failed, ..."""
    subject: tuple[str, ...]
    """() for the site, (camera,), (left, right), or all the cameras that it is about."""
    text: str
    """In one line."""
    figures: Figures = field(default_factory=dict)
    """What was measured, by name."""
    expected: Figures = field(default_factory=dict)
    """What it should have been, under the same names."""
    remedy: str = ""
    """What to do about it; "" where nothing can be."""

    @property
    def about(self) -> str:
        """The subject in words: of many cameras, which the text names, how many."""
        return "--".join(self.subject) if len(self.subject) <= 2 else f"{len(self.subject)} cameras"

    def __str__(self) -> str:
        return f"{self.about}: {self.text}" if self.subject else self.text

    def to_json(self) -> dict[str, Any]:
        numbers = {"figures": rounded(self.figures), "expected": rounded(self.expected)}
        return {"kind": self.kind, "subject": list(self.subject), "text": self.text, **numbers, "remedy": self.remedy}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Finding:
        """Raises KeyError, TypeError or ValueError for what is no finding."""
        numbers = dict(data.get("figures") or {}), dict(data.get("expected") or {})
        return Finding(data["kind"], tuple(data["subject"]), data["text"], *numbers, data.get("remedy") or "")


@dataclass(frozen=True)
class Verdict:
    """What a night came to."""

    level: Level
    findings: tuple[Finding, ...] = ()
    """What is to be looked at, the most important first; none of a good night."""

    @property
    def good(self) -> bool:
        """Is there nothing to look at?"""
        return self.level == "good"

    def to_json(self) -> dict[str, Any]:
        return {"level": self.level, "findings": [finding.to_json() for finding in self.findings]}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Verdict:
        """Raises KeyError, TypeError or ValueError for what is no verdict."""
        if data["level"] not in get_args(Level):
            raise ValueError(f"{data['level']!r} is no level of a verdict")
        return Verdict(data["level"], tuple(map(Finding.from_json, data.get("findings") or ())))


@dataclass(frozen=True)
class Health:
    """How a camera is, compared with what it has been."""

    state: HealthState
    """nudged: turned by little, still of use; moved; blind: too dark, dirty or out of focus; stale: not of tonight;
    foreign: another place."""
    text: str = ""
    """In one line."""
    figures: Figures = field(default_factory=dict)
    """What was measured, by name."""
    expected: Figures = field(default_factory=dict)
    """What it should have been, under the same names."""
    remedy: str = ""
    """What to do about it."""

    @property
    def ok(self) -> bool:
        """Is it as it has been?"""
        return self.state == "ok"

    def to_json(self) -> dict[str, Any]:
        numbers = {"figures": rounded(self.figures), "expected": rounded(self.expected)}
        return {"state": self.state, "text": self.text, **numbers, "remedy": self.remedy}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Health:
        """Raises KeyError, TypeError or ValueError for what says nothing of a camera."""
        if data["state"] not in get_args(HealthState):
            raise ValueError(f"{data['state']!r} is no state of a camera")
        numbers = dict(data.get("figures") or {}), dict(data.get("expected") or {})
        return Health(data["state"], data.get("text") or "", *numbers, data.get("remedy") or "")


@dataclass(frozen=True)
class Down:
    """Since when a camera gives nothing, or is not as it should be."""

    since: str
    """The first night, ISO 8601."""
    nights: int = 1
    """How many nights by now."""

    def __str__(self) -> str:
        return self.told()

    def told(self, left_out: bool = True) -> str:
        """In words; a camera that is used all the same is not down."""
        return f"{'down' if left_out else 'so'} since {self.since}, {self.nights} night{'s' * (self.nights != 1)}"

    def to_json(self) -> dict[str, Any]:
        return dict(vars(self))

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Down:
        """Raises KeyError, TypeError or ValueError for what says nothing of the kind."""
        return Down(str(data["since"]), int(data["nights"]))


@dataclass(frozen=True)
class Usual:
    """What the last good nights gave, each figure by its median, or the reference: what tonight is compared with."""

    nights: int
    """How many there were."""
    figures: Mapping[str, float]
    """Of the whole site: points, pairs, ..."""
    cameras: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Of each camera by id: brightness, ..."""
    reference: str = ""
    """The run that somebody has pinned, where the figures of the whole site are from that one."""

    def to_json(self) -> dict[str, Any]:
        base = {"nights": self.nights, "reference": self.reference}
        return {**base, "figures": rounded(self.figures), "cameras": rounded(self.cameras)}

    @staticmethod
    def from_json(data: Mapping[str, Any]) -> Usual:
        """Raises KeyError, TypeError or ValueError for what says nothing of the kind."""
        cameras = {camera: dict(figures) for camera, figures in data.get("cameras", {}).items()}
        return Usual(int(data["nights"]), dict(data["figures"]), cameras, str(data.get("reference") or ""))
