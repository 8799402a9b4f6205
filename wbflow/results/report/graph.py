"""The pair graph as an SVG: cameras where they stand (seen from above) where poses are known, else on a circle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from html import escape

from ...store.record import PairRecord, RunRecord

WIDTH, HEIGHT, MARGIN = 640, 420, 56


@dataclass(frozen=True)
class Node:
    """A camera in the drawing."""

    id: str
    x: float
    y: float
    ok: bool


def pair_graph_svg(record: RunRecord, centres: dict[str, tuple[float, float]]) -> str:
    """SVG text of a run's pairs.  centres: world (x, y) of cameras by id, as far as known."""
    nodes = _layout([c.id for c in record.cameras], {c.id for c in record.cameras if c.ok}, centres)
    lines = [_edge(nodes, pair) for pair in sorted(record.pairs, key=lambda p: p.ok)]
    dots = [_dot(node) for node in nodes.values()]
    return f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" class="graph" role="img" aria-label="pair graph">{"".join(lines + dots)}</svg>'


def _layout(ids: list[str], ok: set[str], centres: dict[str, tuple[float, float]]) -> dict[str, Node]:
    if set(ids) <= set(centres) and len(ids) > 1:
        places = [centres[i] for i in ids]
    else:
        places = [(math.cos(a), -math.sin(a)) for a in (2 * math.pi * k / max(1, len(ids)) for k in range(len(ids)))]
    xs, ys = [p[0] for p in places], [p[1] for p in places]
    span = max(max(xs) - min(xs), (max(ys) - min(ys)) * WIDTH / HEIGHT, 1e-9)
    scale = (WIDTH - 2 * MARGIN) / span
    cx, cy = (min(xs) + max(xs)) / 2, (min(ys) + max(ys)) / 2
    return {
        i: Node(i, WIDTH / 2 + (x - cx) * scale, HEIGHT / 2 - (y - cy) * scale, i in ok)
        for i, (x, y) in zip(ids, places, strict=True)
    }


def _edge(nodes: dict[str, Node], pair: PairRecord) -> str:
    a, b = nodes[pair.left], nodes[pair.right]
    width = 1 + 4 * (pair.figures.get("density") or 0) if pair.ok else 1
    note = f"{pair.figures.get('inliers') or 0} inliers" if pair.ok else f"{pair.outcome}: {pair.reason}"
    style = f'class="{"good" if pair.ok else "bad"}" stroke-width="{width:.1f}"'
    title = escape(f"{a.id}–{b.id}: {note}")
    return f'<line x1="{a.x:.1f}" y1="{a.y:.1f}" x2="{b.x:.1f}" y2="{b.y:.1f}" {style}><title>{title}</title></line>'


def _dot(node: Node) -> str:
    kind = "good" if node.ok else "bad"
    text = f'<text x="{node.x:.1f}" y="{node.y - 12:.1f}" text-anchor="middle">{escape(node.id)}</text>'
    return f'<circle cx="{node.x:.1f}" cy="{node.y:.1f}" r="7" class="{kind}"/>{text}'
