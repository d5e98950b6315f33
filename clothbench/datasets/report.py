"""What an importer did with each source file: what came in, what was kept, what was left out and why."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from clothbench.core.files import whole_file


@dataclass(frozen=True)
class ImportReport:
    """One source file's way into a recording, or the reason why there is none.

    frames_in, frames_kept: counts; dropped: reason → frames; nodes_masked: reason → node sightings set to
    NaN; reordered: frames whose lattice was numbered unlike the first frame's; clock_offset_s ±
    clock_offset_sigma_s: taken off the node stamps; grip_residual_m: root mean square between held points as
    predicted and as seen; noise_sigma_m: per coordinate, at rest; notes: further remarks; skipped: why no
    recording was written, or None.
    """

    source: str
    output: str | None = None
    frames_in: int = 0
    frames_kept: int = 0
    dropped: Mapping[str, int] = field(default_factory=dict)
    nodes_masked: Mapping[str, int] = field(default_factory=dict)
    reordered: int = 0
    clock_offset_s: float = math.nan
    clock_offset_sigma_s: float = math.nan
    grip_residual_m: float = math.nan
    noise_sigma_m: float = math.nan
    notes: tuple[str, ...] = ()
    skipped: str | None = None


def as_json(report: ImportReport) -> dict[str, Any]:
    """Plain values for JSON; what is not known is null, never NaN."""
    plain = dataclasses.asdict(report)
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in plain.items()}


def write_report(reports: Iterable[ImportReport], path: Path, **header: Any) -> Path:
    """Write all reports as one JSON document, atomically."""
    text = json.dumps({**header, "recordings": [as_json(r) for r in reports]}, indent=1) + "\n"
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")
    return path
