"""The verdict on a night, its findings and the health of each camera, as data.

`FINDINGS` is the table of all findings that a verdict can have: code, level, meaning, text and remedy.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from pydantic import model_serializer

from ..json_dataclass import JsonDataclass
from ..words import DISK_FULL_REMEDY

Figures = Mapping[str, Any]
"""Reported figures of a camera, a pair, a night or the world by name: numbers, strings, and mappings of these."""

Level = Literal["good", "degraded", "failed"]


@dataclass(frozen=True)
class Finding(JsonDataclass):
    """A problem that the operator should look at."""

    kind: str
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
    follows: tuple[str, ...] = ()
    """The cameras from whose loss it follows; () if it stands by itself.  Not written if empty."""

    @property
    def about(self) -> str:
        """The subject in words; for more than two cameras only their number, since the text names them."""
        if len(self.subject) > 2:
            return f"{len(self.subject)} cameras"
        return "--".join(self.subject)

    def __str__(self) -> str:
        beginning = self.text.partition(":")[0]
        if _names(beginning, self.about) or all(_names(beginning, name) for name in self.subject):
            return self.text  # it names its subject itself
        return f"{self.about}: {self.text}"

    @model_serializer(mode="wrap")
    def _with_alias(self, write: Any) -> dict[str, Any]:
        data: dict[str, Any] = write(self)
        if not self.follows:
            del data["follows"]
        row = FINDINGS.get(self.kind)
        if row and row.alias:
            data["alias"] = row.alias
        return data


def _names(text: str, name: str) -> bool:
    """Does a text contain a name as a word of its own?"""
    return re.search(rf"(?<![\w.-]){re.escape(name)}(?![\w.-])", text) is not None


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
    alias: str = ""
    """The code by which other programs know the finding, written beside its own."""


_USED_AGAIN = "it is used again as soon as it delivers usable captures"
_COMPARE = "run wbflow compare SITE.yaml to see what is missing; if it is meant to stay like this, set expect: {since: DATE}"

UNEXPECTED_CHANGE = "unexpected-change"
"""Code of the finding whose subject is the id of a change."""

FINDINGS: Mapping[str, FindingType] = {
    row.code: row
    for row in (
        FindingType(
            "stopped",
            "The time given by --stop-at came before all tasks were done.",
            "run it again without --stop-at (it continues where it stopped); start earlier, or lower `resolution`",
            "{reason}: {tasks} not done",
        ),
        FindingType(
            "interrupted",
            "The run was interrupted.",
            "run it again: it continues where it stopped",
            "interrupted; everything finished is kept",
            level="failed",
        ),
        FindingType(
            "no-result",
            "The stage named by --until gave no result for the site.",
            "fix the cameras and pairs that the report names, then run it again",
            "no {stage}: {reason}",
            level="failed",
        ),
        FindingType(
            "no-cloud",
            "The run made no cloud.",
            "fix the cameras and pairs that the report names, then run it again",
            "no cloud: {reason}",
            level="failed",
        ),
        FindingType(
            "disk-full",
            "The disk was full, and the run made no cloud.",
            DISK_FULL_REMEDY,
            "no cloud: {reason}",
            level="failed",
        ),
        FindingType(
            "disk-short",
            "The disk was full for some of the tasks.",
            DISK_FULL_REMEDY,
        ),
        FindingType(
            "store-behind",
            "Some results have not been uploaded to the object store.",
            "the next run uploads them; until then they exist on this machine only",
        ),
        FindingType(
            "camera-lost",
            "A camera has no capture, or none that can be read.",
            f"check the camera: {_USED_AGAIN}",
            "{reason}; left out tonight",
        ),
        FindingType(
            "camera-unsolved",
            "A camera's pose could not be solved.",
            "state its lens in the site file (wbflow calibrate measures it), which wide lenses need; "
            "or add a camera between it and its neighbours that sees the same things",
            "{reason}; left out tonight",
        ),
        FindingType(
            "camera-obscured",
            "A camera's picture shows too little: it is dark, covered, dirty or out of focus.",
            "check its lens, focus and lighting, and whether something blocks its view",
            alias="camera-blind",
        ),
        FindingType(
            "camera-stale",
            "A camera delivers pictures that were not taken this night.",
            "check its clock, its recorder, and the job that copies its pictures",
        ),
        FindingType(
            "camera-wrong-scene",
            "A camera shows another place.",
            "check which camera is connected to this input, and where it points; if it was moved for good, pin a new reference",
            alias="camera-foreign",
        ),
        FindingType(
            "camera-shifted",
            "A camera has turned slightly: its pose is corrected, and it stays in use.",
            "fasten it; if it is to stay like this, pin a new reference",
            alias="camera-nudged",
        ),
        FindingType(
            "camera-moved",
            "A camera is not where the reference or the site file has it, or points elsewhere.",
            "check its mount; if it has been moved, calibrate it again and pin a new reference",
        ),
        FindingType(
            "camera-unverified",
            "The stated pose of a camera is probably wrong, or nothing confirms it; there is too little evidence to replace it.",
            "check its mount; if it has been moved, calibrate it again, or leave out its pose to have it solved",
        ),
        FindingType(
            "camera-unpaired",
            "A camera is in no pair.",
            "check where it points, and `pairs:` in the site file",
            "no other camera seems to see enough of what it sees: it is in no pair",
            alias="camera-alone",
        ),
        FindingType(
            "camera-no-usable-pair",
            "None of a camera's pairs could be used.",
            "check where it points, and whether something blocks its view",
            alias="camera-fruitless",
        ),
        FindingType(
            "captures-in-motion",
            "During the run, captures were still growing after 10 s of waiting, or dated captures were replaced.",
            "run the night again; start runs when captures are complete, and give the captures of each night names of their own",
            "captures changed during the run: {captures}; run.json has the digests of those that were used",
        ),
        FindingType(
            "cameras-alike",
            "Two or more cameras deliver the same picture.",
            "check the recorder inputs of these cameras, and the job that copies and names their pictures",
            "{cameras} deliver the same picture",
        ),
        FindingType(
            "poses-uncertain",
            "Known poses are not exact enough for dense matching, and tonight's pictures could not improve them.",
            "measure these poses more exactly, leave them out to have them solved, or add a camera that sees the same things",
            "known poses of {cameras} are not exact enough, and tonight's pictures could not improve them: correct matches may "
            "be up to {row_px:.1f} px off the row that is searched, so depths may come from wrong matches",
        ),
        FindingType(
            "pictures-soft",
            "Pictures are too blurred, smeared, enlarged, shaken, noisy, faint, overexposed or strongly compressed to be "
            "measured in, or hot air distorts them; `sigma_mm` may be too small.",
            "check focus, glass, mount, exposure time, gain and JPEG quality; or lower `resolution`",
            "pictures of {cameras} are too poor to be measured in; worst values: smallest details {detail_px:.1f} px, edge blur "
            "{blur_px:.1f} px, JPEG blockiness {coarseness:.1f}, noise {noise_left:.0f} grey levels, {saturated:.0%} pure white, "
            "contrast {contrast:.0f} grey levels, matches {off_px:.1f} px from their epipolar lines{fit}; errors of points may "
            "be larger than their sigma_mm",
        ),
        FindingType(
            "calibration-changed",
            "The stated lenses or poses have changed since the reference was pinned; until a new one is pinned, there is none.",
            "if this is intended, look at the cloud and pin it (wbflow pin SITE.yaml RUN); if not, restore the calibration file",
            "the stated lenses or poses have changed since the reference was pinned: {reason}",
        ),
        FindingType(
            "calibration-contradicted",
            "Tonight's matches contradict the stated lenses or poses as a whole.",
            "calibrate the lenses again (wbflow calibrate), measure the poses again, or use the calibration file that belongs to "
            "these captures; without `calibration:`, lenses and poses are solved",
            "the matches contradict the stated calibration: {explanation}",
        ),
        FindingType(
            "observations-unused",
            "No camera could be placed by the observations that the site file names.",
            "wbflow observe SITE.yaml  says what they lack; wbflow check SITE.yaml  names rows that are hardly meant",
            "the observations place no camera: {reason}",
        ),
        FindingType(
            "poses-contradicted",
            "Stated poses contradict each other or the pictures; which of them is wrong is unknown, and all stay in use.",
            "measure these poses again, or use the calibration file that belongs to these captures; without a pose, it is solved",
        ),
        FindingType(
            "pairs-disagree",
            "Pairs give systematically different depths for the same view: a pose or a lens is wrong.",
            "measure pose and lens of that camera again, or leave them out to have them solved",
            "pairs disagree about the depths of a view, by up to {px:.1f} px over the whole view (limit {limit:g} px): {cause}",
        ),
        FindingType(
            "distances-contradicted",
            "A stated distance contradicts the other distances, or the positions of the cameras.",
            "measure it again; check its unit (metres), and that it names the right cameras",
            "{pair}: the stated distance is {stated:.4g} m; everything else that is known makes it {found:.4g} m{more}",
        ),
        FindingType(
            "control-contradicted",
            "The coordinates of control points contradict the places where the cameras see them.",
            "check their coordinates, and the pixels at which they are marked",
            "{points}: up to {off:.3g} m from where the cameras see them (limit {tolerated:.3g} m)",
        ),
        FindingType(
            "units-implausible",
            "The cameras are implausibly close together or far apart.",
            "state positions and distances in metres; if they are right, state the coordinate system (crs)",
            "the median distance from a camera to the nearest other one is {nearest:.4g} m (limit {limit:g} m): are positions or "
            "distances in {unit}?",
        ),
        FindingType(
            "poses-inconsistent",
            "Matches contradict each other, and the solved poses depend on some of them.",
            "state measured poses and lenses; or add a camera between those that are far apart",
            "matches of {cameras} contradict each other: {reason}: the scene has repeating structures, or a stated lens is "
            "wrong; poses and cloud may be distorted even though they fit the pictures",
            alias="poses-strained",
        ),
        FindingType(
            "lens-undetermined",
            "Lenses were not stated, and tonight's pictures do not determine them.",
            "state the lens (wbflow calibrate measures it); or add cameras that see the same things at other distances or angles",
            "the lens of {cameras} is not stated, and tonight's pictures do not determine it: its focal length is uncertain by "
            "{focal_percent:.1f} % and its distortion by {border_px:.1f} px at the border (standard deviations; real errors can "
            "be several times larger): poses and cloud may be bent or stretched even though they fit the pictures",
        ),
        FindingType(
            "task-failed",
            "A task failed; tasks that need its result were skipped.",
            "wbflow run -v SITE.yaml shows where",
            "{task} failed: {reason}{more}",
        ),
        FindingType(
            "cloud-doubtful",
            "The confidence of the points implies that too many of them are wrong.",
            "look at the cloud where confidence is low: repeating, shiny or plain surfaces need more cameras, or cameras "
            "closer together; a higher `confidence` of `fuse` keeps fewer points",
            "only {percent:.1f} % of the cloud's points are expected to be right (at least {limit:.0f} % required)",
        ),
        FindingType(
            UNEXPECTED_CHANGE,
            "Something has changed where the site file expects no change (`expect: {changes: none}`, or that of a zone).",
            "look at its pictures in the report; if it may stay: wbflow acknowledge SITE.yaml ID",
            "{change}",
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
    def _without_empty(self, write: Any) -> dict[str, Any]:
        return {name: value for name, value in write(self).items() if value or name != "acknowledged"}


@dataclass(frozen=True)
class Down(JsonDataclass):
    """How long a camera has given no results or had a fault."""

    since: str
    """The first such night, ISO 8601."""
    nights: int = 1
    """Number of such nights so far."""

    def words(self, left_out: bool = True) -> str:
        """Return since when it is down, in words.  left_out: False for a camera used despite its fault, so not "down"."""
        return f"{'down' if left_out else 'so'} since {self.since}, {self.nights} night{'s' * (self.nights != 1)}"


@dataclass(frozen=True)
class Baseline(JsonDataclass):
    """The figures that a night is compared with: medians of the last good nights, or those of the reference."""

    nights: int
    figures: Mapping[str, float]
    """Figures of the whole site: points, pairs, ..."""
    cameras: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Figures of each camera, by id: brightness, ..."""
    reference: str = ""
    """Id of the run that a user has pinned, if the figures of the whole site come from it; "" otherwise."""
