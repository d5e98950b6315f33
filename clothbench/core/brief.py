"""How records of many numbers show themselves at a prompt: by the shapes of their arrays, not by what is in them."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

SHORT = 4  # numbers of an array that are shown


def brief(record: Any) -> str:
    """`repr` of a dataclass, without fields that hold nothing; of many values `array(T × N × 3)` or `tuple(N)`."""
    fields = [(f.name, getattr(record, f.name)) for f in dataclasses.fields(record) if f.repr]
    told = [f"{name}={_brief(value)}" for name, value in fields if value is not None and not _empty(value)]
    return f"{type(record).__name__}({', '.join(told)})"


def _empty(value: Any) -> bool:
    return isinstance(value, str | dict | tuple | list) and not len(value)


def _brief(value: Any) -> str:
    if isinstance(value, tuple | list) and len(value) > SHORT:
        return f"{type(value).__name__}({len(value)})"
    if isinstance(value, tuple | list):
        return f"({', '.join(map(_brief, value))})"
    if not isinstance(value, np.ndarray):
        return repr(value)
    if value.size <= SHORT:
        return f"array({value.tolist()})"
    return f"array({' × '.join(map(str, value.shape))})"
