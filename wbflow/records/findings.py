"""The verdict on a night, its findings and the health of each camera, as data.

`FINDINGS` is the table of all findings that a verdict can have: code, level, meaning, text and remedy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, model_serializer

from ..json_dataclass import JsonDataclass

Figures = Mapping[str, Any]
"""Reported figures of a camera, a pair, a night or the world by name: numbers, strings, and mappings of these."""

Level = Literal["good", "degraded", "failed"]
HealthState = Literal["ok", "shifted", "moved", "obscured", "stale", "wrong-scene"]

STATE_ALIASES = {"nudged": "shifted", "blind": "obscured", "foreign": "wrong-scene"}
"""Camera states as versions before 0.2 wrote them; they are still read for one more version."""
FINDING_ALIASES = {
    "camera-nudged": "camera-shifted",
    "camera-blind": "camera-obscured",
    "camera-foreign": "camera-wrong-scene",
    "camera-fruitless": "camera-no-usable-pair",
    "camera-alone": "camera-unpaired",
    "poses-strained": "poses-inconsistent",
}
"""Finding codes of versions before 0.2: still read for one more version, and written in addition to the new ones as `alias`."""
_FORMER = {new: old for old, new in FINDING_ALIASES.items()}


def _current(aliases: Mapping[str, str]) -> BeforeValidator:
    """Return a validator that replaces names of earlier versions with the current ones."""
    return BeforeValidator(lambda word: aliases.get(word, word) if isinstance(word, str) else word)


@dataclass(frozen=True)
class Finding(JsonDataclass):
    """A problem that the operator should look at."""

    kind: Annotated[str, _current(FINDING_ALIASES)]
    """Its code in `FINDINGS`: camera-lost, fewer-pairs, task-failed, ..."""
    subject: tuple[str, ...]
    """() for the site, (camera,), (left, right), or all cameras concerned."""
    text: str
    """The problem, in one line."""
    figures: Figures = field(default_factory=dict)
    """Measured values, by name."""
    expected: Figures = field(default_factory=dict)
    """Expected values, under the same names."""
    remedy: str = ""
    """What to do about it; "" if nothing can be done."""

    @property
    def about(self) -> str:
        """The subject in words; for more than two cameras only their number, since the text names them."""
        return "--".join(self.subject) if len(self.subject) <= 2 else f"{len(self.subject)} cameras"

    def __str__(self) -> str:
        return f"{self.about}: {self.text}" if self.subject else self.text

    @model_serializer(mode="wrap")
    def _with_alias(self, write: Any) -> dict[str, Any]:
        return {**write(self), **({"alias": _FORMER[self.kind]} if self.kind in _FORMER else {})}


@dataclass(frozen=True)
class FindingType:
    """A row of the table of findings."""

    code: str
    meaning: str
    """One sentence for the table in the documentation."""
    remedy: str
    """Default advice, used unless a more specific remedy is known."""
    text: str = "{reason}"
    """Text for the operator; the names in braces are filled in."""
    level: Level = "degraded"
    """Level of a night with this finding, unless the site file tolerates it."""


_BACK = "it is used again as soon as its captures are usable"
_COMPARE = "look at wbflow compare SITE.yaml; if it stays so, write expect: {since: DATE}"

FINDINGS: Mapping[str, FindingType] = {
    row.code: row
    for row in (
        FindingType(
            "stopped",
            "The time of --stop-at was over before all tasks were done.",
            "run it again without --stop-at, it continues from there; start earlier, or lower `resolution`",
            "{reason}: {tasks} not done",
        ),
        FindingType(
            "interrupted",
            "Somebody or something ended the run.",
            "run it again: it continues from there",
            "interrupted; everything finished is kept",
            level="failed",
        ),
        FindingType(
            "no-result",
            "The stage that --until names made nothing for the site.",
            "see to the cameras and pairs that the report names; run it again",
            "no {stage}: {reason}",
            level="failed",
        ),
        FindingType(
            "no-cloud",
            "The run made no cloud.",
            "see to the cameras and pairs that the report names; run it again",
            "no cloud: {reason}",
            level="failed",
        ),
        FindingType(
            "store-behind",
            "The object store does not have everything that was made; this machine has.",
            "the next run uploads it; until then only this machine has it",
        ),
        FindingType(
            "camera-lost",
            "A camera gave nothing: no capture, or none that can be read.",
            f"look at the camera: {_BACK}",
            "{reason}; left out tonight",
        ),
        FindingType(
            "camera-unsolved",
            "A camera's pose could not be solved.",
            "state its lens, if the site file does not (wbflow calibrate finds it): wide ones need that; "
            "or add a camera nearby that sees the same things from an angle between",
            "{reason}; left out tonight",
        ),
        FindingType(
            "camera-obscured",
            "A camera shows too little: dark, covered, dirty or out of focus.",
            "look at its lens, its focus, its light, and what stands in front of it",
        ),
        FindingType(
            "camera-stale",
            "A camera delivers pictures that are not of this night.",
            "look at its clock, its recorder, and the copying of its pictures",
        ),
        FindingType(
            "camera-wrong-scene",
            "A camera shows another place.",
            "check that it is the right camera on this input, and where it points; if it was moved for good, pin a new reference",
        ),
        FindingType(
            "camera-shifted",
            "A camera is turned by little: its pose is corrected, and it stays in use.",
            "fasten it; if it stays so, pin a new reference",
        ),
        FindingType(
            "camera-moved",
            "A camera stands or looks elsewhere than the reference or the site file says.",
            "look at it; calibrate it again if it has been moved, and pin a new reference",
        ),
        FindingType(
            "camera-unverified",
            "The stated pose of a camera is likely to be wrong; it is used all the same.",
            "look at it; if it has been moved, calibrate it again or leave out its pose",
        ),
        FindingType(
            "camera-unpaired",
            "A camera is in no pair.",
            "look at where it points, and at `pairs:` in the site file",
            "no other camera seems to see enough of what it sees: it is in no pair",
        ),
        FindingType(
            "camera-no-usable-pair",
            "A camera is in pairs, and none of them could be used.",
            "look at where it points, and whether anything stands in front of it",
        ),
        FindingType(
            "captures-in-motion",
            "Captures still grew after 10 s of waiting, or were replaced though their names have a date, while the run worked.",
            "run the night again; have captures complete before the run begins, and each night's under names of its own",
            "captures changed while the night was worked on: {captures}; run.json has the digests of those that were used",
        ),
        FindingType(
            "cameras-alike",
            "Two cameras or more deliver one and the same picture.",
            "look at which inputs of the recorder these cameras are on, and at what copies and names their pictures",
            "{cameras} deliver one and the same picture",
        ),
        FindingType(
            "poses-uncertain",
            "Stated poses are not exact enough for dense matching, and tonight's pictures do not improve them.",
            "measure these poses more exactly; or leave them out, to have them solved; or add a camera that sees what these see",
            "known poses are not exact enough, and tonight's pictures do not improve them: {cameras}; true matches may lie up to "
            "{row_px:.1f} px beside the row that is searched: depths may come from look-alikes",
        ),
        FindingType(
            "pictures-soft",
            "Pictures are too blurred, smeared, enlarged, noisy, faint, overexposed or coarsely coded to be measured in; "
            "`sigma_mm` may be too small.",
            "look at focus, glass, exposure time, gain and the quality at which captures are coded; or lower `resolution`",
            "pictures are too soft to be measured in: {cameras}; details are up to {detail_px:.1f} px apart, edges "
            "blurred by {blur_px:.1f} px, blocks of their coding stand out by a factor of {coarseness:.1f}, "
            "{noise_left:.0f} grey levels of noise are left, {saturated:.0%} is pure white, grey levels scatter by "
            "{contrast:.0f}: points may be off by more than they say",
        ),
        FindingType(
            "calibration-changed",
            "Lenses or poses are stated otherwise than when the reference was pinned, which is out of use until another one is.",
            "if it is meant, look at the cloud and pin it (wbflow pin SITE.yaml RUN); else bring the calibration file back",
            "what the site states of lenses and poses has changed since the reference was pinned: {reason}",
        ),
        FindingType(
            "calibration-contradicted",
            "Tonight's matches contradict the stated lenses or poses as a whole.",
            "calibrate the lenses again (wbflow calibrate), measure the poses again, or name the calibration that belongs to "
            "these captures; without `calibration:` lenses and poses are solved",
            "the matches contradict the stated calibration: {explanation}",
        ),
        FindingType(
            "poses-contradicted",
            "Stated poses contradict each other, or what the other cameras see; which is wrong is open, and they stay in use.",
            "measure these poses again, or name the calibration that belongs to these captures; a camera without pose is solved",
        ),
        FindingType(
            "pairs-disagree",
            "Pairs of one view give other depths to the same pixels, alike over much of the view: a pose or a lens is wrong.",
            "measure pose and lens of that camera again, or leave them out, to have them solved",
            "depths of one and the same view differ by up to {px:.1f} px as a whole between the pairs that give them, {limit:g} "
            "px are tolerated: {cause}",
        ),
        FindingType(
            "distances-contradicted",
            "A stated distance contradicts the other distances, or the positions of the cameras.",
            "measure it again; check its unit (metres), and between which cameras it is",
            "{pair} are stated to be {stated:.4g} m apart; by all else that is known it is {found:.4g} m{more}",
        ),
        FindingType(
            "control-contradicted",
            "Control points are not where the cameras see them.",
            "check their coordinates, and the pixels at which they are marked",
            "{points}: up to {off:.3g} m from where the cameras see them; {tolerated:.3g} m are tolerated",
        ),
        FindingType(
            "units-implausible",
            "The cameras stand nearer to each other, or farther apart, than those of any site.",
            "state positions and distances in metres; or name the coordinate system (crs), where such lengths are meant",
            "cameras stand {nearest:.4g} m from the nearest other one (median), the limit is {limit:g} m: are positions or "
            "distances in {unit}?",
        ),
        FindingType(
            "poses-inconsistent",
            "Matches contradict each other, and the solved poses rest on some of them.",
            "state poses and lenses that have been measured; or add a camera between those that stand far apart",
            "matches contradict each other: {cameras}; those that a third camera confirms fit other poses {factor:.0f} times "
            "better than noise explains, and the poses rest on these alone where that is possible: something repeats in "
            "the scene, or a lens is not as it is stated; cloud and poses may be bent, though they fit the pictures",
        ),
        FindingType(
            "lens-undetermined",
            "Lenses were not stated, and tonight's pictures do not determine them.",
            "state the lens (wbflow calibrate finds it); or add cameras that see the same things from nearer, farther or aside",
            "the lens was not stated, and tonight's pictures do not determine it: {cameras}; noise and wrong matches leave "
            "{focal_percent:.1f} % of its focal length open and {border_px:.1f} px at the border (standard deviations), often "
            "several times as much: cloud and poses may be bent or stretched, though they fit the pictures",
        ),
        FindingType(
            "task-failed",
            "A task failed; what needs its result was skipped.",
            "wbflow run -v SITE.yaml shows where",
            "{task} failed: {reason}{more}",
        ),
        FindingType(
            "cloud-doubtful",
            "By what its own cameras say of each point, too many points of the cloud are wrong.",
            "look at the cloud where confidence is low: surfaces that repeat, shine or show nothing need more cameras, or "
            "cameras closer together; a higher `confidence` of `fuse` keeps fewer points",
            "{percent:.1f} % of its points are expected to be right, {limit:.0f} % are asked for",
        ),
        FindingType("fewer-points", "The cloud has far fewer points than usual.", _COMPARE),
        FindingType("fewer-pairs", "Far fewer pairs could be used than usual or planned.", _COMPARE),
        FindingType("fewer-cameras", "Fewer cameras are in use than `expect:` says.", _COMPARE),
        FindingType("fewer-coverage", "Far less of the ground is seen than usual.", _COMPARE),
    )
}
"""All findings that a verdict can have, by code."""


def finding(
    code: str,
    subject: tuple[str, ...] = (),
    figures: Figures | None = None,
    expected: Figures | None = None,
    remedy: str | None = None,
    **words: Any,
) -> Finding:
    """Return a finding of the table.

    Parameters
    ----------
    code, words
        Its code in `FINDINGS`, and the values that fill in its text.
    subject
        The camera, pair or cameras; () for the site.
    figures, expected
        Measured and expected values, by name.
    remedy
        Replaces the remedy in the table; "" if nothing can be done.
    """
    row = FINDINGS[code]
    text = row.text.format(**words)
    return Finding(code, subject, text, figures or {}, expected or {}, row.remedy if remedy is None else remedy)


@dataclass(frozen=True)
class Verdict(JsonDataclass):
    """The verdict on a night."""

    level: Level
    findings: tuple[Finding, ...] = ()
    """Findings, the most important first; none for a good night."""
    acknowledged: tuple[Finding, ...] = ()
    """Findings that do not count because a user acknowledged them; `remedy` states who and until when.  Not written if empty."""

    @property
    def good(self) -> bool:
        """Is there nothing to look at?"""
        return self.level == "good"

    @model_serializer(mode="wrap")
    def _without_nothing(self, write: Any) -> dict[str, Any]:
        return {name: value for name, value in write(self).items() if value or name != "acknowledged"}


@dataclass(frozen=True)
class Health(JsonDataclass):
    """Condition of a camera, compared with earlier nights; fields with the same names as in `Finding` have the same meaning."""

    state: Annotated[HealthState, _current(STATE_ALIASES)]
    """shifted: turned slightly, still in use; moved; obscured: too dark, dirty or out of focus; stale: its pictures are not from
    tonight; wrong-scene: it shows another place."""
    text: str = ""
    figures: Figures = field(default_factory=dict)
    expected: Figures = field(default_factory=dict)
    remedy: str = ""

    @property
    def ok(self) -> bool:
        """Is the camera in its usual condition?"""
        return self.state == "ok"


@dataclass(frozen=True)
class Down(JsonDataclass):
    """How long a camera has given no results or had a fault."""

    since: str
    """The first such night, ISO 8601."""
    nights: int = 1
    """Number of such nights so far."""

    def words(self, left_out: bool = True) -> str:
        """Return since when, in words.  left_out: False for a camera that is used despite its fault, and thus is not "down"."""
        return f"{'down' if left_out else 'so'} since {self.since}, {self.nights} night{'s' * (self.nights != 1)}"


@dataclass(frozen=True)
class Usual(JsonDataclass):
    """The figures that a night is compared with: medians of the last good nights, or those of the reference."""

    nights: int
    figures: Mapping[str, float]
    """Figures of the whole site: points, pairs, ..."""
    cameras: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Figures of each camera, by id: brightness, ..."""
    reference: str = ""
    """Id of the run that a user has pinned, if the figures of the whole site come from it; "" otherwise."""
