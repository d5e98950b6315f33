"""`json`: the numbers themselves, each with unit and interval, and where they come from."""

from __future__ import annotations

import json
import math
from typing import Any

from clothbench import Export, Twin

suffix = ".json"


def skip_reason() -> str | None:
    return None


def export(twin: Twin) -> Export:
    """All of the twin but its motion. A number that is infinite (nothing stretches) is null."""
    scene = twin.scene
    document: dict[str, Any] = {
        "name": twin.name,
        "material": {name: _quantity(twin, name, value) for name, value in twin.values.items()},
        "interval": twin.what,
        "size": {"width": scene.width, "height": scene.height, "unit": "m"},
        "grips": {"material": scene.grip_material.tolist(), "unit": "m"},
        "others": {name: {"value": value, "unit": unit} for name, (value, unit) in twin.others.items()},
        "provenance": dict(twin.provenance),
    }
    return Export(json.dumps(document, indent=1, ensure_ascii=False) + "\n", ())


def _quantity(twin: Twin, name: str, value: float) -> dict[str, Any]:
    low, high = twin.spread.get(name, (None, None))
    return {"value": value if math.isfinite(value) else None, "low": low, "high": high, "unit": twin.units[name]}
