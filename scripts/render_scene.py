#!/usr/bin/env python3
"""Renders a demo site of a scene that only benches use:  scripts/render_scene.py hall DIR [--small] [--light dusk] [--cameras 4]

Works like `wbflow demo --scene`, which offers yard, square and carpark.  Takes about a minute at full size.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import scenes  # noqa: F401  # adds its scenes to the table

from wbflow.commands.demo import write_demo
from wbflow_demo.scenes import SCENES


def main() -> None:
    """Render the requested scene."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=[*SCENES])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--small", action="store_true", help="320x180 pixels")
    parser.add_argument("--light", default="day", choices=["day", "dusk", "night", "dark"])
    parser.add_argument("--cameras", type=int)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    write_demo(given.folder, scene=given.scene, small=given.small, light=given.light, cameras=given.cameras, seed=given.seed)


if __name__ == "__main__":
    main()
