"""Poses and lenses that are known too badly, although they may fit the images."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from wbflow_stages.contracts.pose_figures import PoseIssue

from ..pipeline.summaries import PosesSummary
from ..records.findings import Finding, finding
from ..records.record import RunRecord
from .facts import Facts
from .pose_votes import is_refuted
from .wording import listed


def check_poses(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Are poses and lenses known well enough?  Even wrong ones may fit the images."""
    poses = record.poses or PosesSummary()
    yield from _contradicted(poses, record)
    uncertain = poses.issues_of("uncertain")
    if uncertain:
        row_px = _largest(uncertain, "row_px")
        yield finding("poses-uncertain", tuple(uncertain), {"row_px": row_px}, row_px=row_px, cameras=listed(uncertain))
    inconsistent = poses.issues_of("inconsistent")
    if inconsistent:
        yield _inconsistent_finding(inconsistent)
    lenses = poses.issues_of("lens-undetermined")
    if lenses:
        focal = _largest(lenses, "focal")
        border_px = _largest(lenses, "border_px")
        figures = {"focal": focal, "border_px": border_px}
        words = {"cameras": listed(lenses), "focal_percent": 100 * focal, "border_px": border_px}
        yield finding("lens-undetermined", tuple(lenses), figures, None, None, **words)


def _contradicted(poses: PosesSummary, record: RunRecord) -> Iterator[Finding]:
    """Yield one finding for each reason why matches contradict stated poses."""
    if poses.contradiction:
        return  # the finding on the calibration as a whole explains these, too
    by_reason: dict[str, list[PoseIssue]] = {}
    for issue in poses.issues_of("contradicted").values():
        by_reason.setdefault(issue.text, []).append(issue)
    for reason, issues in by_reason.items():
        if poses.rows_confirm or all(is_refuted(issue, record) for issue in issues):
            continue
        cameras = tuple(issue.camera for issue in issues)
        yield finding("poses-contradicted", cameras, reason=reason)


def _largest(issues: Mapping[str, PoseIssue], figure: str) -> float:
    """The largest value of a figure of some issues; those without it count as 0."""
    return max(getattr(issue, figure) or 0.0 for issue in issues.values())


def _inconsistent_finding(issues: Mapping[str, PoseIssue]) -> Finding:
    """Return the finding about cameras whose pairs would rather have other poses, by camera."""
    strain = _largest(issues, "strain")
    excess_px = _largest(issues, "excess_px")
    figures = {}
    if strain:
        figures["strain"] = strain
    if excess_px:
        figures["excess_px"] = excess_px
    if strain:
        reason = f"those confirmed by a third camera fit other poses {strain:.0f} times better than noise explains"
    else:
        reason = f"with these poses they are {excess_px:.1f} px farther from their epipolar lines than with each pair's own F"
    return finding("poses-inconsistent", tuple(issues), figures, cameras=listed(issues), reason=reason)
