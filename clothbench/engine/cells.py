"""What the cells of every study share: recordings as they refer to them, keys, seeds, and versions of plugins.

A cell is plain data that travels to worker processes; its key is the hash of all that its result depends on.
"""

from __future__ import annotations

import fnmatch
import hashlib
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.plugins.discovery import Catalogue, library_version

FEW = 5  # names of recordings, to show what they are like


def digest(question: Any, digits: int = 16) -> str:
    """Hexadecimal digits of plain data, the same on every machine for the same question."""
    return hashlib.sha256(json.dumps(question, sort_keys=True).encode()).hexdigest()[:digits]


def options_in_use(options: Mapping[str, Mapping[str, Any]], names: Iterable[str]) -> dict[str, dict[str, Any]]:
    """The options of plugins of these names: what others are told makes no other question, and stays out of a key."""
    used = set(names)
    return {name: dict(told) for name, told in options.items() if name in used}


def seed_of(*problem: Any) -> int:
    """A seed hashed from what it is for: no generator is shared between purposes."""
    return int.from_bytes(hashlib.sha256(json.dumps(problem, sort_keys=True).encode()).digest()[:8], "big")


class Skipped(Exception):
    """The model says that it cannot do this scene; not a fault."""


_here: dict[str, str] = {}  # where recordings lie that were named by another process, by hash


@dataclass(frozen=True)
class Source:
    """A recording file as a cell refers to it: where it is, what it is called, its hash and its split."""

    path: str
    name: str
    hash: str
    split: str

    @property
    def file(self) -> str:
        """Where it is read from: its path, unless this process was told that it lies elsewhere (`lie_here`)."""
        return _here.get(self.hash, self.path)


def lie_here(files: Mapping[str, str]) -> None:
    """Tell this process where recordings lie, by hash: whoever made the cell may sit in another folder or machine."""
    _here.update(files)


VERSION = re.compile(r"(?P<kind>[^/;]+)/(?P<name>[^;]+?) \((?P<version>[^;]*)\)(?:; |$)")  # of those `listed` below


def listed(versions: Mapping[str, str]) -> str:
    """Versions of plugins as rows have them: "kind/name (version); …"."""
    return "; ".join(f"{name} ({version})" for name, version in sorted(versions.items()))


def plugin_versions(used: Iterable[tuple[str, str]], plugins: Catalogue) -> dict[str, str]:
    """ "kind/name" → "distribution version, plugin version" of what a cell uses; "broken" where it cannot load.

    With the version of the library that a plugin is built on: a cell skipped for want of it is another one later.
    """
    out = {}
    for kind, name in used:
        known = plugins.find(kind, name)
        try:
            loaded = plugins.load(kind, name)
            version = ", ".join(filter(None, (str(getattr(loaded, "version", 0)), library_version(loaded))))
        except ClothbenchError:
            version = "broken"
        out[f"{kind}/{name}"] = f"{known.distribution} {known.version}, {version}"
    return out


def installed_version(kind: str, name: str, plugins: Catalogue) -> str | None:
    """The version of a plugin as `plugin_versions` has it; None where it is not installed."""
    try:
        return plugin_versions([(kind, name)], plugins)[f"{kind}/{name}"]
    except ClothbenchError:
        return None


def matching(recordings: Sequence[Any], patterns: Sequence[str]) -> list[Any]:
    """Those whose name matches one of the patterns of `suite.select`; none is an error."""
    chosen = [r for r in recordings if any(fnmatch.fnmatch(r.name, p) for p in patterns)]
    if not chosen:
        names = [r.name for r in recordings]
        some = ", ".join(names[:FEW]) + (", …" if len(names) > FEW else "")
        raise ClothbenchError(
            f"setting 'suite.select' {list(patterns)} matches none of {len(names)} recordings: {some}"
        )
    return chosen


def require_own_names(sources: Iterable[Source], case: str = "") -> None:
    """Rows know a recording by its name alone: two of one name would be taken for one. case: theirs, to be told."""
    files: dict[str, str] = {}
    for s in sources:
        if s.name in files:
            other = f"{files[s.name]} of case {case!r}" if case else files[s.name]
            raise ClothbenchError(
                f"{s.path}: found the name {s.name!r}, which {other} has too; give each a name of its own"
            )
        files[s.name] = s.path


def resplit(sources: list[Source], seed: int) -> list[Source]:
    """A split by recording where the files state none: a third, at least one of two, is held out. Seeded, and the same
    in whatever order the files were named: it goes by their places, in the order in which a folder's come.
    """
    if any(s.split for s in sources) or len(sources) < 2:
        return [Source(s.path, s.name, s.hash, s.split or "fit") for s in sources]
    placed = sorted(range(len(sources)), key=lambda i: Path(os.path.abspath(sources[i].path)))
    order = np.random.default_rng(seed).permutation(len(sources))
    held = {placed[i] for i in order[: max(1, len(sources) // 3)]}
    return [Source(s.path, s.name, s.hash, "held_out" if i in held else "fit") for i, s in enumerate(sources)]
