"""What every tracker must keep: an observation of what was recorded, with nothing seen that was not there."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from clothbench.core.errors import ClothbenchError
from clothbench.core.observation import Observation
from clothbench.core.optional import TRACKED_KINDS, ReadsKinds, ShowsSteps, kinds_read
from clothbench.core.protocols import Tracker
from clothbench.estimation.watched import as_seen, cloud_seen
from clothbench.recordings.kinds import read_sheet
from clothbench.recordings.nodes import Recording
from clothbench.recordings.points import PointCloud
from clothbench.recordings.scenes import scene_of
from clothbench.testing import scenes
from clothbench.testing.rules import NotApplicable, Outcome, choose, made, require, require_members, run_rules

NEAR = 5e-3  # m: a tracker may smooth, it may not invent
SIGMA = 5e-4  # m


@dataclass(frozen=True, eq=False)
class TrackerCase:
    tracker: Tracker
    source: Recording | PointCloud | Path
    is_own: bool  # the source is the kit's recording, not what the author gave

    def track(self) -> Observation:
        try:
            observation = self.tracker.track(self.source)
        except ClothbenchError as refusal:
            says_so = isinstance(self.tracker, ReadsKinds) and kinds_read(self.tracker) & {"nodes", "points"}
            if not self.is_own or says_so:
                raise
            raise NotApplicable(f"it refuses a recording, give it a source: {refusal}") from None
        require(isinstance(observation, Observation), f"{type(observation).__name__}", "a clothbench.Observation")
        return observation


def check_tracker(
    make: Callable[..., Tracker],
    *,
    source: Recording | PointCloud | Path | None = None,
    only: Iterable[str] | None = None,
) -> tuple[Outcome, ...]:
    """Check the tracker that `make()` gives on `source`: raw data, or a recording (the kit has its own of nodes, and
    of points without identity for trackers that read nothing else).

    A tracker of raw data only, which refuses the kit's recording, needs a source; one with options is given as a
    function that makes it with them.
    """
    tracker = made(make, "tracker")
    own = swung_cloud if kinds_read(tracker) == {"points"} else swung_sheet
    case = TrackerCase(tracker, source or own(), is_own=source is None)
    return run_rules(f"tracker {getattr(tracker, 'name', make)!r}", choose(RULES, only), case)


def has_all_members(case: TrackerCase) -> None:
    require_members(case.tracker, Tracker, ("name", "version", "track"))


def keeps_what_it_offers(case: TrackerCase) -> str | None:
    """Its kinds of recordings are known ones, and pictures of its steps are pictures."""
    kinds = kinds_read(case.tracker)
    require(bool(kinds) and kinds <= TRACKED_KINDS, f"kinds {sorted(kinds)}", f"some of {sorted(TRACKED_KINDS)}")
    if not isinstance(case.tracker, ShowsSteps):
        return "shows no steps"
    seen = case.track()
    source = read_sheet(case.source) if isinstance(case.source, str | Path) else case.source
    shown = case.tracker.pictures(source, 0, seen)
    require(bool(shown), "no picture of any step", "at least one")
    for name, picture in shown.items():
        fine = isinstance(picture, np.ndarray) and picture.dtype == np.uint8 and picture.ndim == 3
        found = f"step {name!r} as {getattr(picture, 'dtype', type(picture).__name__)} {np.shape(picture)}"
        require(fine and picture.shape[2] == 3, found, "uint8 (H, W, 3)")
    return None


def gives_a_whole_observation(case: TrackerCase) -> None:
    o = case.track()
    require(
        len(o.time) > 0 and bool((np.diff(o.time) > 0).all()),
        "time stamps that do not increase",
        "increasing ones",
    )
    require(np.isfinite(o.time).all(), "time stamps that are not finite", "seconds")
    require(o.visible.dtype == bool, f"visible of type {o.visible.dtype}", "bool")
    require(o.visible.any() or o.outlines is not None, "no node seen in any frame", "at least one")
    require(np.isfinite(o.material).all(), "material coordinates that are not finite", "metres")
    require(np.isnan(o.sigma) or o.sigma >= 0, f"a noise of {o.sigma} m", "0 or above, or NaN if it is not known")


def sees_what_was_recorded(case: TrackerCase) -> str | None:
    """Where tracker and recording share a stamp and a material point, they see it in the same place; of a cloud, what
    it sees are points of the same frame.
    """
    if isinstance(case.source, PointCloud):
        _sees_the_cloud(case.track(), case.source)
        return None
    if not isinstance(case.source, Recording):
        return "tracks raw data, of which the kit does not know what they show"
    o, r = case.track(), case.source
    require(
        (o.time >= r.time[0] - 1e-9).all() and (o.time <= r.time[-1] + 1e-9).all(),
        "stamps beyond the recording",
        "none",
    )
    frames = np.abs(o.time[:, None] - r.time).argmin(axis=1)
    shared = np.abs(o.material[:, None] - r.material).max(axis=2)
    known = (np.abs(o.time - r.time[frames]) < 1e-9)[:, None] & (shared.min(axis=1) < 1e-9)
    require(known.any(), "no stamp and material point of the recording", "some to compare")
    recorded, nodes = known & r.visible[frames][:, shared.argmin(axis=1)], shared.argmin(axis=1)
    invented = int((o.visible & known & ~recorded).sum())
    require(invented == 0, f"{invented} nodes seen in frames where the recording has none", "0")
    away = np.linalg.norm(o.position - r.position[frames][:, nodes], axis=-1)[o.visible & recorded]
    require(away.size > 0, "none of the recorded nodes seen", "some")
    require(away.max() <= NEAR, f"a node {1e3 * away.max():.3g} mm from where it was recorded", "at most 5 mm")
    return None


def _sees_the_cloud(o: Observation, r: PointCloud) -> None:
    require(np.isin(o.time, r.time).all(), "stamps that the recording has not", "its own")
    for frame, seen, there in zip(r.position[np.searchsorted(r.time, o.time)], o.position, o.visible, strict=True):
        away = np.linalg.norm(seen[there][:, None] - frame[np.isfinite(frame).all(axis=1)], axis=-1)
        nearest = away.min(axis=1, initial=np.inf).max(initial=0.0)
        require(nearest <= NEAR, f"a point {1e3 * nearest:.3g} mm from all that were recorded with it", "at most 5 mm")


def serves_a_cell(case: TrackerCase) -> str | None:
    """What it gives can be simulated and compared: the scene has its stamps and points, whichever it left out."""
    if isinstance(case.source, PointCloud):
        try:
            cloud_seen(case.source, case.track(), case.tracker.name)
        except ClothbenchError as refusal:
            require(False, f"an observation that no scene can be made of ({refusal})", "one of the whole cloud")
        return None
    if not isinstance(case.source, Recording):
        return "tracks raw data, which states no scene before it is tracked"
    seen = case.track()
    try:
        scene = scene_of(as_seen(case.source, seen, case.tracker.name))
    except ClothbenchError as refusal:
        require(False, f"an observation that no scene can be made of ({refusal})", "two stamps or more, of its sheet")
    away = seen.differences(np.zeros((1, len(scene.times), len(scene.points), 3)))
    require(away.shape[1:3] == seen.visible.shape, f"differences of shape {away.shape[1:3]}", str(seen.visible.shape))
    return None


def gives_the_same_bits_twice(case: TrackerCase) -> None:
    first, again = case.track(), case.track()
    for name in ("time", "position", "visible", "material"):
        equal = np.array_equal(getattr(first, name), getattr(again, name), equal_nan=name != "visible")
        require(equal, f"another {name} when tracking again", "equal bits")
    require(repr(first.sigma) == repr(again.sigma), "another sigma when tracking again", "the same")


def leaves_the_recording_alone(case: TrackerCase) -> str | None:
    if not isinstance(case.source, Recording | PointCloud):
        return "tracks raw data on disk"
    before = case.source.hash
    case.track()
    require(case.source.hash == before, "a recording that tracking has changed", "the recording as it was")
    return None


def swung_sheet() -> Recording:
    """A recording by formula: 60 frames of a sheet swinging like a board, noise, gaps and a lost node."""
    scene, random = scenes.swinging(), np.random.default_rng(17)
    time = np.linspace(0.0, 0.4, 60)
    grips = scene.grips_at(time).mean(axis=1)
    angle = 0.3 * np.sin(6 * time)[:, None]
    below = scene.points[:, 1]
    along = np.broadcast_to(scene.points[:, 0] - scene.width / 2, (len(time), len(below)))
    hung = [along, below * np.sin(angle), -below * np.cos(angle)]
    position = grips[:, None] + np.stack(hung, axis=-1) + random.normal(0.0, SIGMA, (len(time), len(below), 3))
    position[random.random(position.shape[:2]) < 0.1] = np.nan
    position[:, 4] = np.nan
    return Recording(
        name="swung sheet", time=time, material=scene.points, position=position,
        grip_time=scene.grip_time, grip_material=scene.grip_material, grip_position=scene.grip_position,
        cloth_width=scene.width, cloth_height=scene.height, areal_density=scene.areal_density,
        noise_sigma=SIGMA,
    )  # fmt: skip


def swung_cloud() -> PointCloud:
    """`swung_sheet` as a cloud: its points in another order in every frame, one of which is blank."""
    r, random = swung_sheet(), np.random.default_rng(18)
    position = np.stack([random.permutation(frame) for frame in r.position])
    position[30] = np.nan
    position[~np.isfinite(position).all(axis=-1)] = np.nan
    return PointCloud(
        name="swung cloud", time=r.time, position=position, grip_time=r.grip_time, grip_material=r.grip_material,
        grip_position=r.grip_position, cloth_width=r.cloth_width, cloth_height=r.cloth_height,
        areal_density=r.areal_density, noise_sigma=SIGMA,
    )  # fmt: skip


RULES = (
    has_all_members,
    keeps_what_it_offers,
    gives_a_whole_observation,
    sees_what_was_recorded,
    serves_a_cell,
    gives_the_same_bits_twice,
    leaves_the_recording_alone,
)
