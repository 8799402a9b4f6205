"""Scenes that only benches use: importing this package adds them to the scenes of `wbflow_demo`, which renders them."""

from __future__ import annotations

from wbflow_demo.scenes import SCENES, SceneRow

_ROWS = {
    "hall": SceneRow("scenes.hall:hall", "a market hall whose four sides are alike but for a few things", (8, 70), 8, 3),
    "hall-2": SceneRow("scenes.hall:hall_2", "a market hall that is the same after half a turn", (8, 70), 8, 3),
    "hall-4": SceneRow("scenes.hall:hall_4", "a market hall that is the same after a quarter turn", (8, 70), 8, 3),
    "houses": SceneRow("scenes.houses:houses", "a row of identical houses along a street", (0, 60)),
    "containers": SceneRow("wbflow_demo.depot:containers", "stacks of one and the same container", (4, 70)),
    "apron": SceneRow("scenes.apron:apron", "an airport apron with three aircraft of one type", (4, 80), 8, 3),
    "stadium": SceneRow("scenes.stadium:stadium", "a stadium with stands of identical seats", (4, 80), 10, 3),
    "quarry": SceneRow("scenes.quarry:quarry", "a quarry with three steps of broken rock", (4, 80), 8, 3),
    "platform": SceneRow("scenes.platform:platform", "a railway station with sleepers and windows that repeat", (4, 80), 8, 3),
    "warehouse": SceneRow("scenes.warehouse:warehouse", "rows of shelves of one pattern, filled with boxes", (4, 80), 8, 3),
    "building": SceneRow("scenes.building:building", "a building site: walls behind scaffolding, piers, timber", (4, 80), 8, 3),
    "harbour": SceneRow("scenes.harbour:harbour", "a quay with a barge, a portal crane and a basin of water", (4, 80), 8, 3),
    "solar": SceneRow("scenes.solar:solar", "a solar farm: rows of one and the same dark panel on a meadow", (4, 80), 8, 3),
    "tankfarm": SceneRow("scenes.tankfarm:tankfarm", "a refinery: nearly even tanks, racks of parallel pipes", (4, 80), 8, 3),
    "park": SceneRow("scenes.park:park", "a city park: lawn, trees and hedges of loose leaves, a fountain", (4, 80), 8, 3),
    "market": SceneRow("scenes.market:market", "an old town's market: striped awnings, gabled houses", (4, 80), 8, 3),
    "railyard": SceneRow("scenes.railyard:railyard", "a shunting yard under snow: rows of wagons of three types", (4, 80), 8, 3),
    "workshop": SceneRow("scenes.workshop:workshop", "a machine shop: smooth floor, white walls, steel machines", (4, 80), 8, 3),
    "construction": SceneRow("scenes.construction:construction", "a building site: a pit, a raw frame, a crane", (4, 80), 5, 3),
    "substation": SceneRow("scenes.substation:substation", "a switchyard: gantries, insulators, transformers", (4, 80), 5, 3),
    "study": SceneRow("scenes.study:study", "a study with even walls, seen by webcams", (4, 60), 4, 3),
    "mast": SceneRow("scenes.mast:mast", "a valley seen by cameras that hang on one mast", (0, 60), captures=3),
}
SCENES.update(_ROWS)
NAMES = tuple(_ROWS)
