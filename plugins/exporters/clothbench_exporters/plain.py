"""`json`: the numbers themselves, each with unit and interval, and where they come from."""

from __future__ import annotations

import dataclasses
import json
import math
from typing import Any

from clothbench import Export, Obstacle, Twin
from clothbench_exporters.mesh import first_pose

suffix = ".json"
SCHEMA = 1


def skip_reason() -> str | None:
    return None


def export(twin: Twin) -> Export:
    """All of the twin but its motion and that of its grips. A number that is infinite (nothing stretches) is null."""
    scene = twin.scene
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "name": twin.name,
        "material": {name: _quantity(twin, name, value, twin.units[name]) for name, value in twin.values.items()},
        "interval": twin.what,
        "size": {"width": scene.width, "height": scene.height, "unit": "m"},
        "grips": {
            "material": scene.grip_material.tolist(),
            "first_position": first_pose(twin).tolist(),
            "unit": "m",
        },
        "gravity": {"value": list(map(float, scene.gravity)), "unit": "m/s²"},
        "air_density": {"value": scene.air_density, "unit": "kg/m³"},
        "obstacles": [_obstacle(o) for o in scene.obstacles],
        "thickness": {"value": scene.thickness, "unit": "m"},
        "outline": None if scene.outline is None else {"material": scene.outline.tolist(), "unit": "m"},
        "others": {name: _quantity(twin, name, value, unit) for name, (value, unit) in twin.others.items()},
        "provenance": dict(twin.provenance),
    }
    return Export(json.dumps(document, indent=1, ensure_ascii=False) + "\n", ())


def _obstacle(obstacle: Obstacle) -> dict[str, Any]:
    """Lengths in metres; the radius of a plane is null."""
    radius = obstacle.radius if math.isfinite(obstacle.radius) else None
    return {**dataclasses.asdict(obstacle), "radius": radius, "unit": "m"}


def _quantity(twin: Twin, name: str, value: float, unit: str) -> dict[str, Any]:
    """determined: whether the data say what it is; null where nobody asked, as of a class of fabrics."""
    low, high = twin.spread.get(name, (None, None))
    return {
        "value": value if math.isfinite(value) else None, "low": low, "high": high, "unit": unit,
        "determined": twin.determined.get(name),
    }  # fmt: skip
