"""A machine shop: smooth floor, white walls, machines of painted steel, racks, cranes; cameras along three of its walls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from wbflow_demo.parts.movers import traffic
from wbflow_demo.parts.structures import barrels
from wbflow_demo.render import textures as paint
from wbflow_demo.render.cameras import Viewpoint, viewpoint_on_post
from wbflow_demo.render.light import Lamp, Light, overcast_of
from wbflow_demo.render.paint import Rng
from wbflow_demo.render.photograph import Daytime, DemoSite, Night, Shots, photograph
from wbflow_demo.render.scene import STATIC, Scene, SceneBuilder

from . import fittings, machines
from .factory import DEEP, LAMPS, WIDE, roof, sealed_floor, walls
from .machines import Look, Skin
from .shapes import rod

MOUNTS = (
    (-11.5, -3.4, 4.0), (-8.6, -7.5, 4.5), (-3.0, -7.6, 3.9), (2.4, -7.6, 4.8),
    (7.6, -7.5, 4.2), (11.5, -4.2, 4.6), (11.5, 1.8, 4.9), (-11.5, 3.0, 4.4),
)  # fmt: skip
"""Camera positions in metres, neighbours 25 to 39 degrees apart as seen from the middle."""
PLACES = (
    ("lathe", -7.6, 3.4, 0.0), ("lathe", -2.4, 3.6, 0.0), ("mill", 5.6, 4.4, 0.0), ("mill", 9.2, 5.0, 0.0),
    ("press", 1.6, 4.9, 0.0), ("lathe", -6.8, -3.2, np.pi), ("lathe", 5.8, -3.2, np.pi), ("drill", -4.2, -3.0, 2.9),
    ("drill", -3.2, -3.1, 3.3), ("bench", -9.8, 7.2, 0.0), ("bench", -6.6, 7.2, 0.0), ("bench", 0.4, -4.2, np.pi),
    ("rack", -1.8, 7.2, 0.0), ("rack", 9.2, -6.6, np.pi), ("rack", -11.0, -0.4, np.pi / 2), ("drill", 8.6, -2.9, 3.0),
)  # fmt: skip
"""Kind, metres east and north, yaw."""
PALLETS = (
    (-8.2, 0.9, 0.1), (-7.8, -5.9, 0.0), (-5.6, -6.0, 0.05), (7.4, 1.1, -0.06), (10.6, 1.6, 0.1), (3.4, -6.4, 0.0),
    (5.6, -6.6, 0.1), (-4.6, 1.6, 0.2), (9.9, -3.4, 1.5),
)  # fmt: skip
SIGNS = (
    (("SCHUTZBRILLE", "TRAGEN"), (0.05, 0.16, 0.40)), (("AUSGANG",), (0.04, 0.28, 0.12)),
    (("RAUCHEN", "VERBOTEN"), (0.45, 0.05, 0.04)),
)  # fmt: skip
KINDS: dict[str, tuple[Callable[[SceneBuilder, Rng, float, Look, Skin], SceneBuilder], Skin]] = {
    "lathe": (machines.lathe, ((0.12, 0.24, 0.20), "VDF")),
    "mill": (machines.mill, ((0.10, 0.17, 0.30), "DECKEL")),
    "press": (machines.press, ((0.42, 0.17, 0.04), "HP 60")),
    "drill": (machines.drill, ((0.22, 0.27, 0.26), "")),
    "bench": (fittings.bench, ((0.13, 0.20, 0.32), "")),
    "rack": (fittings.rack, ((0.08, 0.15, 0.34), "")),
}


def workshop(shots: Shots) -> DemoSite:
    """Render the shop; it has 8 cameras.  Raises ValueError for impossible shots."""
    shots.check(len(MOUNTS))
    texel_m = shots.texel_m(10.0, 0.0105, 0.035)
    ways = (((-10.0, 0.2), (10.0, 0.4)), ((-10.0, -1.0), (9.0, -1.0)), ((-1.6, -6.4), (-1.9, -1.0)), ((4.3, 1.6), (4.0, 6.4)))
    night = Night(
        viewpoints=tuple(viewpoints()[: shots.cameras]),
        still=static_workshop(shots.random(1), texel_m, daylight=shots.light in ("day", "dusk")),
        traffic=traffic(shots.random(2), max(texel_m, 0.02), shots.captures, people=4, walks=ways),
        lighting=shop_light(shots.light),
    )
    return photograph(night, shots, shots.voxel_m(26.0))


def shop_light(light: Daytime) -> Light:
    """Light through the skylights, and lamps that are on except in the dark, with power that fits the exposure at each hour."""
    strength = {"day": 1.0, "dusk": 0.53, "night": 0.29, "dark": 0.0}[light]
    power = (11.0 * strength, 10.8 * strength, 10.1 * strength)
    return replace(overcast_of(light, LAMPS), lamps=tuple(Lamp(place, power) for place in LAMPS if strength))


def viewpoints() -> list[Viewpoint]:
    """Cameras that look down at the crane in the middle."""
    return [viewpoint_on_post(k, "wall", (x, y, z), (0.1 * x, 0.6, 0.9), 74.0, -0.15) for k, (x, y, z) in enumerate(MOUNTS)]


def static_workshop(rng: Rng, texel_m: float, *, daylight: bool = True) -> Scene:
    """Everything that stands still; textures at `texel_m` metres per texel; windows glow by daylight."""
    build = SceneBuilder()
    build.kind = STATIC
    floor = build.add_texture(sealed_floor(rng, texel_m))
    build.quad((-WIDE / 2, DEEP / 2, 0.0), (WIDE, 0, 0), (0, -DEEP, 0), floor)
    steel, yellow, red = (
        build.add_texture(paint.painted_steel(rng, 6.0, 2.0, texel_m, tone))
        for tone in ((0.36, 0.38, 0.38), (0.55, 0.38, 0.04), (0.42, 0.05, 0.04))
    )
    dark, bare = (build.add_texture(paint.cloth(rng, texel_m, tone)) for tone in ((0.045, 0.045, 0.05), (0.40, 0.40, 0.39)))
    look = Look(steel, dark, bare, yellow, red)
    walls(build, rng, texel_m, look.steel, daylight=daylight)
    roof(build, rng, texel_m, look.steel)
    parts = {kind: make(build, rng, texel_m, look, skin) for kind, (make, skin) in KINDS.items()}
    for kind, x, y, yaw in PLACES:
        build.stamp(parts[kind], (x, y, 0.0), yaw=yaw + float(rng.normal(0, 0.01)))
    build.stamp(fittings.gantry(build, look), (0.6, 0.9, 0.0), yaw=0.12)
    _bridge(build, look)
    _on_walls(build, rng, texel_m, look)
    _on_floor(build, rng, texel_m, look)
    return build.build()


def _bridge(build: SceneBuilder, look: Look) -> None:
    """The bridge crane under the roof: two girders from wall to wall, a trolley, a hook."""
    for x in (-6.3, -5.5):
        build.box((x, 0.0, 5.75), (0.22, DEEP - 0.9, 0.45), look.yellow)
    build.box((-5.9, 2.4, 6.2), (1.3, 1.0, 0.5), look.red)
    rod(build, (-5.9, 2.4, 6.2), (-5.9, 2.4, 4.4), 0.03, look.dark, sides=6)
    build.box((-5.9, 2.4, 4.0), (0.3, 0.2, 0.4), look.yellow)


def _on_walls(build: SceneBuilder, rng: Rng, texel_m: float, look: Look) -> None:
    """Boards, cabinets, radiators, extinguishers."""
    for k, (lines, tone) in enumerate(SIGNS):
        board = build.add_texture(paint.sign_board(rng, 1.3, 0.8, texel_m, lines, tone, (0.70, 0.69, 0.66)))
        build.box((-4.5 + 6.0 * k, DEEP / 2 - 0.06, 2.1), (1.3, 0.05, 0.8), board)
        build.box((WIDE / 2 - 0.06, -5.0 + 3.2 * k, 2.2), (0.8, 0.05, 0.6), board, yaw=-np.pi / 2)
    case = build.add_texture(machines.panel(rng, 1.2, 2.0, texel_m, (0.46, 0.47, 0.46)))
    for x in (3.6, 4.9, 11.0):
        build.box((x, DEEP / 2 - 0.3, 0.0), (1.2, 0.5, 2.0), case)
    for y in (-6.4, 6.2):
        build.box((-WIDE / 2 + 0.3, y, 0.0), (1.2, 0.5, 2.0), case, yaw=np.pi / 2)
    for x in (-9.0, 6.7):
        for k in range(12):
            build.box((x - 0.6 + 0.1 * k, DEEP / 2 - 0.12, 2.3), (0.06, 0.12, 0.6), look.bare)
    for x, y in ((-3.2, DEEP / 2 - 0.2), (7.9, DEEP / 2 - 0.2), (WIDE / 2 - 0.2, -0.2)):
        build.tube((x, y, 0.8), 0.09, 0.5, look.red, sides=9)


def _on_floor(build: SceneBuilder, rng: Rng, texel_m: float, look: Look) -> None:
    """Pallets with boxes and castings, bins, drums, three tool trolleys."""
    wood = build.add_texture(paint.planks(rng, 1.2, 0.8, texel_m, (0.40, 0.30, 0.18)))
    card = [build.add_texture(paint.sign_board(rng, 0.8, 0.6, texel_m, words, (0.42, 0.31, 0.19), (0.08, 0.07, 0.06)))
            for words in (("FLANSCH", "40 ST"), ("OBEN",), ("LAGER", "6204"))]  # fmt: skip
    for x, y, yaw in PALLETS:
        pallet = build.with_same_textures()
        for k in range(3):
            pallet.box((0.0, -0.35 + 0.35 * k, 0.0), (1.2, 0.1, 0.1), wood)
        pallet.box((0.0, 0.0, 0.1), (1.2, 0.8, 0.04), wood)
        for k in range(int(rng.integers(2, 7))):
            size, at = rng.uniform((0.3, 0.28, 0.2), (0.42, 0.38, 0.42)), (-0.38 + 0.38 * (k % 3), -0.2 + 0.4 * (k // 3), 0.14)
            texture = (*card, look.dark, look.bare)[int(rng.integers(5))]
            pallet.box(at, size, texture, yaw=float(rng.normal(0, 0.08)))
        build.stamp(pallet, (x, y, 0.0), yaw=yaw)
    tones = ((0.10, 0.25, 0.40), (0.50, 0.10, 0.04), (0.12, 0.30, 0.14))
    drums = [build.add_texture(paint.painted_steel(rng, 1.9, 0.9, texel_m, tone)) for tone in tones]
    barrels(build, rng, (9.6, 6.4), drums, count=6)
    barrels(build, rng, (-11.2, -6.2), drums, count=3)
    trolley = build.add_texture(machines.panel(rng, 1.0, 0.9, texel_m, (0.45, 0.06, 0.04)))
    for x, y, yaw in ((-4.6, 2.0, 0.3), (3.2, 2.6, -0.2), (2.4, -2.4, 2.9)):
        build.box((x, y, 0.1), (0.8, 0.5, 0.85), trolley, yaw=yaw)
        build.box((x, y, 0.95), (0.3, 0.2, 0.14), look.dark, yaw=yaw + 0.5)
    for k in range(6):
        build.box((-1.4 + 0.42 * k, -5.3, 0.0), (0.38, 0.5, 0.3 + 0.3 * (k % 2)), drums[k % 3], yaw=0.03 * k)
