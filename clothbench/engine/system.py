"""The machine and the versions that a result was computed with, and when."""

from __future__ import annotations

import functools
import platform
from datetime import UTC, datetime
from pathlib import Path
from typing import Any


@functools.cache
def system_info() -> dict[str, Any]:
    """The machine and the versions that a result was computed with."""
    import numba
    import numpy

    import clothbench
    from clothbench.core.parallel import available_cores

    return {
        "clothbench": clothbench.__version__, "python": platform.python_version(), "numpy": numpy.__version__,
        "numba": numba.__version__, "platform": platform.platform(terse=True), "cpu": _cpu(),
        "cores": available_cores(),
    }  # fmt: skip


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


def now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
