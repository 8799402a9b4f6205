"""The table of stages: what each works on, what it needs, and the function that does it.  The one place that names functions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Scope = Literal["camera", "pair", "site"]
Which = Literal["same", "left", "right", "all", "around"]


@dataclass(frozen=True)
class Need:
    """One input of a stage.

    origin: the stage that makes it, or "site:lens", "site:placement", "site:captures", "site:mask", "site:survey" from
    the site file;
    which: of the same subject, of the pair's left or right camera, of all subjects that have it (as a mapping), or "around":
    of the cameras that the one in question makes pairs with, and of these pairs;
    part: a field of the artifact (see `artifact.parts`); of a mapping field of a site-wide stage, the entry of the camera or
    pair in question, else all of it;
    optional: may be missing (then the function gets None, or an entry less);
    unless_posed: not needed (an empty mapping) where the site file gives every camera's intrinsics and pose.
    """

    origin: str
    which: Which = "same"
    part: str = ""
    optional: bool = False
    unless_posed: bool = False


@dataclass(frozen=True)
class Stage:
    """One step of the pipeline.

    needs: inputs by the function's argument name; suffix: of the artifact's file; picture: function that draws the artifact
    (called with the result and the same inputs, or those of `picture_needs` by the same names; returns encoded bytes);
    optional: the site file may switch it off;
    settings: the part of the site file that also feeds its parameters, or "component": done once for each group of cameras
    that share a world.
    """

    name: str
    scope: Scope
    function: str
    needs: dict[str, Need]
    suffix: str = ".wbf"
    picture: str | None = None
    picture_needs: dict[str, Need] = field(default_factory=dict)
    optional: bool = False
    settings: Literal["", "pairs", "resolution", "component"] = ""


STAGES: tuple[Stage, ...] = (
    Stage(
        "frames",
        scope="camera",
        function="wbflow_stages.frames:clean_frame",
        needs={"captures": Need("site:captures"), "lens": Need("site:lens"), "mask": Need("site:mask", optional=True)},
        picture="wbflow_stages.io.previews:frame_preview",
        settings="resolution",
    ),
    Stage("features", scope="camera", function="wbflow_stages.features:detect", needs={"frame": Need("frames")}),
    Stage(
        "overlap",
        scope="site",
        function="wbflow_stages.overlap:estimate_overlap",
        needs={
            "views": Need("frames", "all", part="view"),
            "placements": Need("site:placement", "all"),
            "features": Need("features", "all", unless_posed=True),
        },
    ),
    Stage(
        "pairs",
        scope="site",
        function="wbflow.graph.pairs:select_pairs",
        needs={"overlap": Need("overlap")},
        settings="pairs",
    ),
    Stage(
        "matches",
        scope="pair",
        function="wbflow_stages.matches:match",
        needs={"left": Need("features", "left"), "right": Need("features", "right")},
    ),
    Stage(
        "geometry",
        scope="pair",
        function="wbflow_stages.geometry:estimate_geometry",
        needs={"matches": Need("matches"), "left": Need("features", "left"), "right": Need("features", "right")},
        picture="wbflow_stages.io.previews:matches_preview",
        picture_needs={"left": Need("frames", "left"), "right": Need("frames", "right")},
    ),
    Stage(
        "poses",
        scope="site",
        function="wbflow_stages.poses:solve_poses",
        needs={
            "views": Need("frames", "all", part="view"),
            "placements": Need("site:placement", "all"),
            "geometries": Need("geometry", "all"),
            "survey": Need("site:survey"),
        },
        optional=True,
    ),
    Stage(
        "rectify",
        scope="pair",
        function="wbflow_stages.rectify:rectify",
        needs={
            "geometry": Need("geometry"),
            "left": Need("poses", "left", part="cameras", optional=True),
            "right": Need("poses", "right", part="cameras", optional=True),
            "verdict": Need("poses", part="verdicts", optional=True),
        },
    ),
    Stage(
        "disparity",
        scope="pair",
        function="wbflow_stages.disparity:match_dense",
        needs={"left": Need("frames", "left"), "right": Need("frames", "right"), "rectification": Need("rectify")},
        picture="wbflow_stages.io.previews:disparity_preview",
    ),
    Stage(
        "depth",
        scope="camera",
        function="wbflow_stages.depth:view_depth",
        needs={
            "camera": Need("poses", part="cameras"),
            "cameras": Need("poses", "around", part="cameras"),
            "rectifications": Need("rectify", "around"),
            "disparities": Need("disparity", "around"),
        },
    ),
    Stage(
        "refine",
        scope="camera",
        function="wbflow_stages.refine:refine",
        needs={
            "frame": Need("frames"),
            "camera": Need("poses", part="cameras"),
            "depth": Need("depth"),
            "frames": Need("frames", "around"),
            "cameras": Need("poses", "around", part="cameras"),
        },
        picture="wbflow_stages.io.previews:depth_preview",
        optional=True,
    ),
    Stage(
        "fuse",
        scope="site",
        function="wbflow_stages.fuse:fuse",
        needs={
            "frames": Need("frames", "all"),
            "cameras": Need("poses", part="cameras"),
            "depths": Need("depth", "all"),
            "refined": Need("refine", "all", optional=True),
        },
        suffix=".ply",
        picture="wbflow_stages.io.previews:cloud_preview",
        settings="component",
    ),
)


def stage_named(name: str) -> Stage:
    """The row of a stage.  Raises KeyError."""
    return {stage.name: stage for stage in STAGES}[name]


def ancestors(name: str) -> set[str]:
    """Names of a stage and of all stages that it needs, directly or not."""
    found: set[str] = set()
    waiting = [name]
    while waiting:
        stage = stage_named(waiting.pop())
        if stage.name not in found:
            found.add(stage.name)
            waiting += [need.origin for need in stage.needs.values() if not need.origin.startswith("site:")]
    if found & {"matches", "rectify"}:
        found |= ancestors("pairs")
    return found
