"""Recordings as a study takes them: tracked, once for all cells of a store where that takes long."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.observation import Observation
from clothbench.core.optional import kinds_read
from clothbench.core.protocols import Tracker
from clothbench.engine.cells import digest, plugin_versions
from clothbench.plugins.discovery import OWN, Catalogue
from clothbench.recordings.codec import write
from clothbench.recordings.kinds import AnyRecording
from clothbench.recordings.nodes import LAYOUT, Recording, read_recording
from clothbench.recordings.points import PointCloud
from clothbench.recordings.silhouette import Silhouettes
from clothbench.recordings.tracked import Images, nodes_of, seen_in

FORM = 2  # of what is kept of tracked images: what `nodes_of` makes of an observation


def require_readable(
    recording: Recording | PointCloud | Images | Silhouettes, tracker: str, plugins: Catalogue
) -> None:
    """Refuse recordings that a tracker does not read, and name those that do."""
    if recording.kind in kinds_read(plugins.load("trackers", tracker)):
        return
    where = recording.path or recording.name
    raise ClothbenchError(
        f"{where}: found kind {recording.kind!r}, which the tracker {tracker!r} does not read; "
        f"take tracker={' or '.join(_able('trackers', recording.kind, plugins))}"
    )


def require_comparable(recording: AnyRecording, metric: str, plugins: Catalogue) -> None:
    """Refuse a metric on recordings that show something else than it compares: drapes, points without identity, or
    points that are known again, which is also what images are tracked to.
    """
    kind, shows = "nodes", "points of a sheet"
    if isinstance(recording, Silhouettes):
        kind, shows = "silhouette", "drapes, of which no point is seen"
    elif isinstance(recording, PointCloud):
        kind, shows = "points", "points without identity"
    kinds = kinds_read(plugins.load("metrics", metric))
    if kind in kinds or (kind == "nodes" and "silhouette" not in kinds):
        return
    able = " or ".join(_able("metrics", kind, plugins))
    raise ClothbenchError(
        f"{recording.path or recording.name}: found {shows}, which the metric {metric!r} does not compare; take "
        + (f"metric={able}" if kind != "nodes" else "recordings of kind 'silhouette'")
    )


def _able(plugin: str, kind: str, plugins: Catalogue) -> list[str]:
    """Names of the built-in trackers, or metrics, that say themselves that they read recordings of a kind."""
    own = [p.name for p in plugins.plugins if p.kind == plugin and p.distribution == OWN]
    return [name for name in own if kind in kinds_read(plugins.load(plugin, name))]


def watched(
    recording: Any, tracker: Tracker, options: Mapping[str, Any], plugins: Catalogue, kept: Path | None
) -> tuple[Recording | PointCloud, Observation]:
    """A recording as nodes, or as the cloud that it is, and what the tracker saw of it.

    Nodes and clouds are tracked each time; images once, and what came of them is kept in the folder `kept` as a
    recording of its own, under a key of the images, the tracker, its options and its version.
    """
    require_readable(recording, tracker.name, plugins)
    if isinstance(recording, Recording):
        return as_seen(recording, seen := tracked(tracker, recording), tracker.name), seen
    if isinstance(recording, PointCloud):
        return recording, cloud_seen(recording, tracked(tracker, recording), tracker.name)
    if kept is None:
        nodes = nodes_of(recording, tracked(tracker, recording))
        return nodes, seen_in(nodes)
    key = digest([recording.hash, dict(options), plugin_versions([("trackers", tracker.name)], plugins), FORM])
    path = kept / f"{key}.nc"
    if not path.is_file():
        write(nodes_of(recording, tracked(tracker, recording)), path, LAYOUT)
    nodes = dataclasses.replace(read_recording(path), path=recording.path)  # the same in the first cell as in others
    return nodes, seen_in(nodes)


def tracked(tracker: Tracker, recording: Any) -> Observation:
    """What the tracker makes of a recording, refused unless it is an observation of something."""
    seen = tracker.track(recording)
    if not isinstance(seen, Observation):
        raise ClothbenchError(f"tracker {tracker.name!r} gave {type(seen).__name__}, expected a clothbench.Observation")
    if seen.outlines is None and not seen.visible.any():
        raise ClothbenchError(f"tracker {tracker.name!r}: found no point visible in any frame, expected some")
    return seen


def cloud_seen(recording: PointCloud, seen: Observation, tracker: str) -> Observation:
    """The observation that a tracker gave of a cloud, refused unless it is one at the stamps and material points that
    are simulated.
    """
    same = np.array_equal(seen.time, recording.time) and np.array_equal(seen.material, recording.lattice)
    if not (seen.cloud and same):
        raise ClothbenchError(
            f"tracker {tracker!r}: found another observation of {recording.path or recording.name} than of a cloud, "
            "expected cloud=True, the recording's stamps, and its lattice as material"
        )
    return seen


def as_seen(recording: Recording, seen: Observation, tracker: str) -> Recording:
    """The recording with the stamps and points that a tracker gave of it, so that these are what is simulated; itself
    where it gave all of them.
    """
    if np.array_equal(seen.time, recording.time) and np.array_equal(seen.material, recording.material):
        return recording
    frames = np.searchsorted(recording.time, seen.time)
    filmed = recording.video if np.isin(seen.time, recording.time).all() else None
    try:
        return dataclasses.replace(
            recording, time=seen.time, material=seen.material, confidence=seen.confidence,
            position=np.where(seen.visible[..., None], seen.position, np.nan),
            video=filmed and dataclasses.replace(filmed, frame=filmed.frame[frames]),
        )  # fmt: skip
    except ClothbenchError as fault:
        raise ClothbenchError(f"tracker {tracker!r}: what it gave is no recording: {fault}") from None
