"""The tables that state what recordings of a kind hold; `clothbench.recordings.codec` does the rest from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

# Kinds of recordings that there are; `clothbench.recordings.kinds` has their readers.
KINDS = ("nodes", "points", "curve", "laser", "depth", "video", "silhouette")
SPLITS = ("fit", "held_out", "")  # what the attribute `split` may state, in every kind that has it

Arrays = Mapping[str, np.ndarray]
Stated = Mapping[str, Any]


@dataclass(frozen=True)
class Variable:
    """One array of a recording.

    dims: names of its dimensions; unit: as its attribute `units` states it; dtype: in memory; level: of compression by
    zlib in the file, 1 to 9, or None; exact: a file must hold this very dtype; otherwise other numbers are converted.
    """

    dims: tuple[str, ...]
    unit: str
    dtype: type = float
    level: int | None = None
    exact: bool = False


@dataclass(frozen=True)
class Part:
    """A field of a record that is no single array, text or number: how it stands in the file.

    variables, attributes: what it may have there, by name; pack: the field → its arrays and attributes; unpack: those
    arrays that a file has, all its attributes and its path → the field, or None where the file has none.
    """

    variables: Mapping[str, Variable]
    attributes: tuple[str, ...]
    pack: Callable[[Any], tuple[Arrays, Stated]]
    unpack: Callable[[Arrays, Stated, Path], Any]


@dataclass(frozen=True)
class Layout:
    """What recordings of one kind hold; each entry is a field of its record, beside `notes` and `path`.

    kind: as the header states it; variables: in the order of the hash; texts and numbers: attributes, "" and NaN where
    a file does not state them; needed: attributes that a file must state; vectors: attributes of three numbers, each
    with what a reader is told to expect; parts: fields that are none of these; stated_first: in the hash, the
    attributes come before the arrays.
    """

    kind: str
    variables: Mapping[str, Variable]
    texts: tuple[str, ...]
    numbers: tuple[str, ...] = ()
    needed: tuple[str, ...] = ("name",)
    vectors: Mapping[str, str] = field(default_factory=dict)
    parts: Mapping[str, Part] = field(default_factory=dict)
    stated_first: bool = False

    @property
    def known(self) -> set[str]:
        """Attributes that are no notes: the header's, the record's fields, and those of its parts."""
        return {*self.attributes, *self.variables, *self.parts, "notes", "path"}

    @property
    def arrays(self) -> set[str]:
        """Variables that a file must or may have."""
        return {*self.variables, *(name for part in self.parts.values() for name in part.variables)}

    @property
    def attributes(self) -> set[str]:
        """Attributes that a file may state and that are no notes."""
        header = {"format", "format_version", "kind", *self.texts, *self.numbers, *self.vectors}
        return header | {name for part in self.parts.values() for name in part.attributes}
