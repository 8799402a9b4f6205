"""What run.json contains of the stages' results, beyond what the stages report (`wbflow_stages.contracts`).

A receipt has all plain fields of a result.  Those that the engine reads are declared in the contracts, and are read into these
dataclasses (`run.state.summary_of`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, SerializerFunctionWrapHandler, ValidationError, WrapSerializer, model_serializer, model_validator

from wbflow_stages.contracts.camera_figures import CameraStagesFigures
from wbflow_stages.contracts.ground_figures import Change, ChangesFigures, CoverageFigures, CutFill
from wbflow_stages.contracts.observation_figures import ObservedCamera, ObservedFigures
from wbflow_stages.contracts.pair_figures import PairStagesFigures
from wbflow_stages.contracts.pose_figures import CalibrationCheck, PairCheck, PoseCheck, PosesFigures

from ..json_dataclass import JsonDataclass


class Summary(JsonDataclass):
    """Base of dataclasses that are empty if what is read does not fit: figures of another version, or of a function of the
    site's own."""

    @model_validator(mode="wrap")
    @classmethod
    def _read(cls, data: Any, read: Any) -> Self:
        try:
            summary: Self = read(data)
        except ValidationError:
            return cls()
        return summary


def _without_none(value: Any, write: SerializerFunctionWrapHandler) -> Any:
    """Write a dataclass, or None, without its fields that are None."""
    written = write(value)
    if not written:
        return written
    return {name: entry for name, entry in written.items() if entry is not None}


@dataclass(frozen=True)
class CameraFigures(CameraStagesFigures, Summary):
    """The figures of a camera in run.json: those of its stages, and its entries in site-wide results."""

    pose: Annotated[PoseCheck | None, WrapSerializer(_without_none)] = None
    """How well the images agree with its known pose."""
    verified: bool | None = None
    pose_from: str | None = None
    """stated, observed, refined, corrected or solved."""
    points: int | None = None
    misfit: float | None = None
    offset_px: Mapping[str, float] | None = None
    """By two of its dense partners, as `first--second`: overall difference of the depths from its pairs with them, pixels."""


@dataclass(frozen=True)
class PairFigures(PairStagesFigures, Summary):
    """The figures of a pair in run.json: those of its stages, and its entry in the result of the poses."""

    poses_px: float | None = None
    known: str | None = None


_MOST_ROW_SIGMAS = 3.5
"""Rows agree with the cameras up to this many `CalibrationCheck.sigmas` (140 unharmed nights: 3.2 at most)."""


@dataclass(frozen=True)
class PosesSummary(PosesFigures, Summary):
    """How the poses of the cameras were found; the cameras themselves are in cameras.json."""

    rows: CalibrationCheck | None = None
    """The check of the calibration by the row offsets that dense matching measures (stage `calibration`)."""
    pair_checks: Annotated[Mapping[str, PairCheck], Field(exclude=True)] = field(default_factory=dict)
    """In run.json, this field and the next two are entries of the pairs and cameras."""
    pose_checks: Annotated[Mapping[str, PoseCheck], Field(exclude=True)] = field(default_factory=dict)
    sources: Annotated[Mapping[str, str], Field(exclude=True)] = field(default_factory=dict)

    @property
    def unverified(self) -> bool:
        """Are lenses and poses stated, but were there too few matches to check them?"""
        was_checked = self.calibration is not None or (self.rows is not None and self.rows.pairs > 0)
        return self.source in {"calibration", "mixed"} and not was_checked

    @property
    def rows_agree(self) -> bool:
        """Do the row offsets that dense matching measures agree with the stated cameras?"""
        return self.rows is not None and self.rows.pairs > 0 and self.rows.sigmas <= _MOST_ROW_SIGMAS

    @property
    def rows_confirm(self) -> bool:
        """Do the rows of enough pairs agree to overrule keypoints?  Third cameras confirm look-alikes, too, if they see some."""
        return self.rows is not None and self.rows.confirmed and self.rows_agree

    @property
    def contradiction(self) -> CalibrationCheck | None:
        """The check that contradicts the stated calibration.  Rows, which are more exact, overrule keypoints that blame no single
        camera; and they are preferred if they alone name a cause, and all cameras share it."""
        by_keypoints = self.calibration if self.calibration and self.calibration.contradicted else None
        by_rows = self.rows if self.rows and self.rows.contradicted else None
        if by_keypoints and self.rows_confirm and not by_keypoints.cameras:
            return None
        if by_rows and not by_rows.cameras and not (by_keypoints and by_keypoints.cause):
            return by_rows
        return by_keypoints or by_rows


@dataclass(frozen=True)
class SiteSummary(Summary):
    """Summary of a site-wide stage that has a section in run.json and in the report, under its name."""

    AMOUNT: ClassVar[tuple[str, str]] = ("", "")
    """Unit and meaning of `amount`, if there is one; `expect` in the site file limits it under the name of the stage."""

    files: tuple[str, ...] = ()
    """Names of the published files."""
    reason: str | None = None
    """Why there is no result."""

    @property
    def amount(self) -> float | None:
        """The quantity that is compared with its usual value."""
        return None

    @property
    def table(self) -> tuple[tuple[str, ...], ...]:
        """Rows of cells, the first one with the titles of the columns; () without any."""
        return ()

    @property
    def sentences(self) -> tuple[str, ...]:
        """What is said of the result, instead of a list of its figures; () to have these listed."""
        return ()

    @property
    def objects(self) -> Mapping[str, RecordedChange]:
        """Things with a place, by name."""
        return {}

    @property
    def volumes(self) -> Mapping[str, CutFill]:
        """Volumes gained and lost, by zone."""
        return {}


@dataclass(frozen=True)
class ObservedSummary(ObservedFigures, SiteSummary):
    """How cameras were placed by observations of things."""

    @property
    def unplaced(self) -> dict[str, str]:
        """The cameras with observations that could not be placed, and why."""
        return {name: camera.reason for name, camera in self.cameras.items() if camera.reason}

    @property
    def table(self) -> tuple[tuple[str, ...], ...]:
        if not self.cameras:
            return ()
        rows = [("camera", "observations", "used", "residual px", "sigma", "sigma degrees", "clock")]
        for name, camera in self.cameras.items():
            if camera.reason:
                rows.append((name, f"{camera.observations:,}", "", "", "", "", ""))
                continue
            sigma = _shown(camera.sigma_m, ".4f")
            if self.metric and camera.sigma_m is not None:
                sigma = f"{1000 * camera.sigma_m:.0f} mm"
            counts = f"{camera.observations:,}", f"{camera.used:,}"
            residual = _shown(camera.reprojection_px, ".2f")
            rows.append((name, *counts, residual, sigma, _shown(camera.sigma_deg, ".3f"), self._clock(camera)))
        return tuple(rows)

    @property
    def sentences(self) -> tuple[str, ...]:
        if self.reason:
            return ()
        texts = [f"{name} is not placed: {reason}" for name, reason in self.unplaced.items()]
        unit = " m" if self.metric else ""
        if self.halves_m is not None and self.halves_deg is not None:
            texts.append(
                f"two halves of the observations agree within {self.halves_m:.3f}{unit} and {self.halves_deg:.3f} degrees"
            )
        if self.survey_m is not None:
            texts.append(f"the survey is {self.survey_m:.2f} m (median) from where the cameras see the thing")
        texts.append(f"scale: {self.scale or 'none'}")
        texts.extend(self.notes)
        return tuple(texts)

    def _clock(self, camera: ObservedCamera) -> str:
        """How far a camera's clock is from that of the first one, as text."""
        factor = 1.0
        digits = 2
        if self.time_unit == "s":
            factor = 1000.0
            digits = 0
        text = f"{factor * camera.offset:+.{digits}f}"
        if camera.offset_sigma:
            text += f" ± {factor * camera.offset_sigma:.{digits}f}"
        return f"{text} {'ms' if self.time_unit == 's' else 'frames'}"


def _shown(value: float | None, form: str) -> str:
    """A number as text, "-" if it is unknown."""
    return "-" if value is None else f"{value:{form}}"


@dataclass(frozen=True)
class CoverageSummary(CoverageFigures, SiteSummary):
    """How much of the ground the cameras see."""

    AMOUNT = ("m²", "seen by two cameras")

    @property
    def amount(self) -> float | None:
        if self.area_m2 is None or self.seen_by_two is None:
            return None
        return self.area_m2 * self.seen_by_two


@dataclass(frozen=True)
class RecordedChange(Change, JsonDataclass):
    """One thing that has appeared, vanished or moved."""

    first: str = ""
    """The first night on which it was seen, ISO 8601."""
    last: str = ""
    """The newest night on which it was seen."""
    grown: str = ""
    """The newest night on which it had grown for certain; "" if it never has."""
    news_most: float = 0.0
    """`volume_most` on the night when it was last news: the first one, or that of `grown`."""
    acknowledged: str = ""
    """Who has acknowledged the change, until when, and why; "" if it is not acknowledged."""

    @model_serializer(mode="wrap")
    def _without_empty(self, write: Any) -> dict[str, Any]:
        return {name: value for name, value in write(self).items() if value or name not in {"acknowledged", "grown"}}

    @property
    def news(self) -> str:
        """The night on which it was last news, because it was new or had grown."""
        return self.grown or self.first

    def words(self, unit: str, night: str = "") -> str:
        """Return what it is, its size and its place, as in "new 2.0 x 1.4 x 2.6 m at 11.3, 15.0".

        unit: of lengths; "" if the scale is unknown.  night: the night that speaks of it (ISO 8601); "" for any.
        """
        what = self.kind or "changed"
        if night and self.grown == night:
            what = f"{what} since {self.first}, grown to"
        elif night and self.first and self.first != night:
            what = f"{what} since {self.first},"
        size = " x ".join(f"{side:.1f}" for side in (self.length, self.width, self.height))
        place = f"{self.x:.1f}, {self.y:.1f}"
        unseen = "" if self.seen else f", not seen since {self.last}"
        return f"{what} {size} {unit}".rstrip() + f" at {place}{unseen}"

    def volume_words(self, unit: str) -> str:
        """Return the interval that holds its volume, as in "4.2 to 26.0 m³"."""
        return volume_words((self.volume_least, self.volume_most), (self.volume, self.volume_sigma), unit)


def volume_words(interval: tuple[float, float], seen: tuple[float, float], unit: str) -> str:
    """Return a volume in words: the interval that holds it or, if there is none, its seen part and the standard deviation."""
    text = "{:,.1f} ± {:.1f}".format(*seen)
    if interval[1]:
        text = "{:,.1f} to {:,.1f}".format(*interval)
    return f"{text} {unit}³" if unit else text


@dataclass(frozen=True)
class ChangesSummary(ChangesFigures, SiteSummary):
    """The changes since the night of the reference."""

    changes: Mapping[str, RecordedChange] | None = None
    gone: Mapping[str, RecordedChange] = field(default_factory=dict)
    """Changes of the night that these go on from that are there no more: all is as in the reference again."""

    @property
    def objects(self) -> Mapping[str, RecordedChange]:
        return self.changes or {}

    @property
    def volumes(self) -> Mapping[str, CutFill]:
        """Volumes by zone; "" is the whole site, or all zones together."""
        if self.cut_fill is None:
            return {}
        return {"": self.cut_fill, **self.zones}
