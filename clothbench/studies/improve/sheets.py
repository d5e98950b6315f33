"""Evidence of sheets: positions of the nodes of moving cloth, in metres, reported in millimetres."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from clothbench.core.observation import Observation
from clothbench.core.protocols import Effect, Model, Score
from clothbench.core.resting import remember_rest
from clothbench.core.rollout import Rollout
from clothbench.core.scene import Scene
from clothbench.core.statistics import noise_among_neighbours
from clothbench.estimation.trials import Trial
from clothbench.recordings.nodes import Recording
from clothbench.studies.improve.evidence import Comparison, Rows, Surrogate, Unit, prepared, without_switches
from clothbench.studies.improve.law import moved_round
from clothbench.studies.improve.motion import motion_of
from clothbench.studies.improve.repeats import spread_of_repeats
from clothbench.studies.improve.settings import SearchSettings
from clothbench.studies.improve.sheet_tables import sheet_tables
from clothbench.studies.improve.torque import Balance, balance_of
from clothbench.studies.improve.whereabouts import whereabouts

LEAST_GRID = 1e-7  # m: a rounding finer than this is none that matters
MULTIPLES = 3  # different ones of a grid, by which it is known for one
THIRDS = ("upper", "middle", "lower")  # of a hanging sheet, along v
CLEARLY = 1.1  # how many times what is left in any other third has to be left in one of which it is said


class CoordinateError:
    """Root-mean-square over visible node coordinates [m]: the loop's own yardstick, a metric like any other.

    correction: (M,) m, added to the residual at the M visible coordinates: what is known of the mesh's own error.
    """

    name: ClassVar[str] = "coordinate_error"
    version: ClassVar[int] = 1
    unit = "m"

    def __init__(self, correction: np.ndarray | float = 0.0):
        self.correction = correction

    def __call__(self, observation: Observation, rollout: Rollout) -> Score:
        seen = observation.visible
        away = observation.differences(rollout.position)[:, seen].reshape(len(rollout.position), -1)
        away = away + self.correction
        return Score(np.sqrt(np.mean(away**2, axis=1)), self.unit, residual=away)

    def floor(self, observation: Observation) -> float:
        return observation.sigma


@dataclass(frozen=True, eq=False)
class SheetCase:
    """One recording of a sheet.

    name, split: as the recording has them, or the seed;
    recording: as it was read;
    observation: what the tracker saw of it;
    scene: what is simulated, with the mesh's resolution;
    switches: whether physics of the model's own that can be switched off stays on, as a calibration fitted it.
    """

    name: str
    split: str
    recording: Recording
    observation: Observation
    scene: Scene
    switches: bool = False

    @property
    def duration(self) -> float:
        """s, from the first frame to the last."""
        return float(np.ptp(self.observation.time))

    @property
    def last_moment(self) -> float:
        """s, from when effects count their moments, the grips' first stamp, to the last frame; frames may come late."""
        held = self.scene.grip_time[:1] if len(self.scene.grip_material) else ()
        return float(self.observation.time[-1] - min(self.scene.start_time, *held))

    def trial(self, model: Model, effects: Sequence[Effect], correction: np.ndarray | None) -> Trial:
        remember_rest(self.scene)  # searches ask for it again and again, with what does not change it
        simulation = prepared(model, self.scene, effects, self.recording.path or self.name)
        if not self.switches:
            simulation = without_switches(simulation, len(model.parameters))
        return Trial(
            self.name, self.observation, simulation, CoordinateError(0.0 if correction is None else correction)
        )

    def simulated(self, rollout: Rollout) -> np.ndarray:
        """Positions (T, N, 3) m."""
        return rollout.position[0]

    def moved(self, way: float, speed: float) -> SheetCase | None:
        """The grips' way from where they began, so many times as long and as fast, seen as often as it was."""
        scene, seen = self.scene, self.observation
        if scene.velocity is not None or not len(scene.grip_material):
            return None
        first, begin = scene.grip_position[0], scene.start_time
        moved = dataclasses.replace(
            scene, grip_position=first + way * (scene.grip_position - first),
            grip_time=begin + (scene.grip_time - begin) / speed, times=begin + (scene.times - begin) / speed,
        )  # fmt: skip
        return dataclasses.replace(
            self, scene=moved, observation=dataclasses.replace(seen, time=begin + (seen.time - begin) / speed)
        )

    def field(self, residual: np.ndarray) -> np.ndarray:
        """The residual (M,) m back on its frames and nodes (T, N, 3), 0 where nothing was seen."""
        return field_of(self.observation, residual)

    def surrogates(self, residual: np.ndarray, spread: bool = False) -> Surrogate:
        """What stays of it at each node is turned about the vertical, what moves is moved round in time and along its
        main directions reversed or not, so that it keeps them; both mirrored left to right or not. A picture has no
        vertical to turn about: there what stays is reversed along its rows and columns or not, too.

        spread: what stays lies otherwise over the cloth, too, as smoothly (`shared_out_anew`). Where every recording
        has amounts of its own, a sheet that is set off another way is as well explained as before.
        """
        observation = self.observation
        field, seen = self.field(residual), observation.visible
        if observation.sight is not None:
            field = observation.in_measured(field)
        staying = field.sum(axis=0) / np.maximum(seen.sum(axis=0), 1)[:, None]
        moving = np.where(seen[..., None], field - staying, 0.0)
        axes, image, in_space = main_directions(moving), mirror(observation.material), field.shape[-1] == 3
        smooth = np.linalg.qr(quadratics(observation.material))[0] if spread else None

        def draw(random: np.random.Generator) -> np.ndarray:
            angle = random.uniform(0, 2 * np.pi)
            c, s = np.cos(angle), np.sin(angle)
            turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, random.choice([-1.0, 1.0])]])
            stays = staying @ (turn if in_space else np.diag(random.choice([-1.0, 1.0], 2)))
            if smooth is not None:
                stays = shared_out_anew(stays, smooth, random)
            reverse = (axes * random.choice([-1.0, 1.0], len(axes))) @ axes.T
            drawn = stays + moved_round(moving, random) @ reverse
            return (drawn[:, image] if random.random() < 0.5 else drawn)[seen].ravel()

        return draw

    def peak(self, residual: np.ndarray) -> str:
        """The second in which most of it is."""
        from scipy.ndimage import uniform_filter1d

        time, field = self.observation.time, self.field(residual)
        second = max(1, round((len(time) - 1) / float(time[-1] - time[0])))
        return f"{time[int(np.argmax(uniform_filter1d((field**2).sum(axis=(1, 2)), second, mode='constant')))]:.1f} s"


@dataclass(frozen=True, eq=False)
class SheetEvidence:
    """Recordings of sheets beside meshes. cases: one for each recording."""

    cases: tuple[SheetCase, ...]

    kind: ClassVar[str] = "nodes"
    unit: ClassVar[Unit] = Unit("m", "mm", 1e3)
    # A second round without a gain has steps so short that only ripples are drawn once more.
    search: ClassVar[SearchSettings] = SearchSettings(patience=1)
    has_rerun: ClassVar[bool] = True
    textile: ClassVar[None] = None

    @property
    def in_pictures(self) -> bool:
        return any(case.observation.sight is not None for case in self.cases)

    @property
    def noise_stated(self) -> bool:
        return all(np.isfinite(case.observation.sigma) for case in self._fitted())

    def restricted(self, cases: Sequence[SheetCase]) -> SheetEvidence:
        return dataclasses.replace(self, cases=tuple(cases))

    def refined(self) -> SheetEvidence:
        cases = [dataclasses.replace(case, scene=refined(case.scene)) for case in self.cases]
        return self.restricted(cases)

    def relaid(self) -> tuple[()]:
        """Nothing is left to chance."""
        return ()

    def _fitted(self) -> list[SheetCase]:
        return [case for case in self.cases if case.split == "fit"]

    def noise(self) -> float:
        """σ of one coordinate [m]: as stated, else from how much neighbouring frames jump."""
        return float(np.sqrt(np.mean(np.square([noise_of(case.observation) for case in self._fitted()]))))

    def repeat_spread(self, residual: Sequence[np.ndarray]) -> float:
        return spread_of_repeats(
            [
                (case.recording, with_noise(case.observation), case.field(r))
                for case, r in zip(self._fitted(), residual, strict=True)
            ]
        )

    def objection(self, before: Sequence[np.ndarray], after: Sequence[np.ndarray], least: float = 0.0) -> str:
        """No identity is known of such recordings."""
        return ""

    def balance(self, seed: int) -> Balance | None:
        motions = [motion_of(case.observation, case.scene, noise_of(case.observation)) for case in self._fitted()]
        return balance_of(motions, seed)

    def whereabouts(self, residual: Sequence[np.ndarray], seed: int) -> Rows:
        fields = [
            (case.observation, case.scene, case.field(r)) for case, r in zip(self._fitted(), residual, strict=True)
        ]
        return whereabouts(fields, self.unit.scale, self.unit.reported, seed)

    def location(self, residual: Sequence[np.ndarray]) -> str:
        """Where on the sheet, in which recording and when in it most is left."""
        cases = self._fitted()
        squares: dict[str, list[np.ndarray]] = {name: [] for name in THIRDS}
        for case, one in zip(cases, residual, strict=True):
            field, seen = case.field(one), case.observation.visible
            third = np.minimum(3 * case.observation.material[:, 1] / case.scene.height, 2).astype(int)
            for k, rows in enumerate(squares.values()):
                rows.append(field[:, third == k][seen[:, third == k]].ravel() ** 2)
        scale, unit = self.unit.scale, self.unit.reported
        sizes = {
            n: scale * float(np.sqrt(np.concatenate(rows).mean())) for n, rows in squares.items() if any(map(len, rows))
        }
        first, *others = sorted(sizes, key=lambda name: -sizes[name])
        alike = bool(others) and sizes[first] < CLEARLY * sizes[others[0]]
        worst = int(np.argmax([float(np.mean(one**2)) for one in residual]))
        rest = ", ".join(f"{name} {size:.1f} {unit}" for name, size in sizes.items())
        around = cases[worst].peak(residual[worst])
        where = f"most is left in the {first} third ({rest}),"
        if alike:
            where = f"no third of the sheet has clearly more left than the others ({rest}); most is left"
        return f"{where} in {cases[worst].name}, and there around {around}"

    def tables(self, comparisons: Sequence[Comparison]) -> Mapping[str, Rows]:
        return sheet_tables(comparisons, self.unit)


def refined(scene: Scene) -> Scene:
    """The scene with cells of half the size."""
    assert scene.resolution is not None  # whoever makes the cases has set it
    nu, nv = scene.resolution
    return dataclasses.replace(scene, resolution=(2 * nu - 1, 2 * nv - 1))


def noise_of(observation: Observation) -> float:
    """σ of one coordinate [m]: as stated, else the rms over nodes and coordinates of what each shows as its own (a
    sensor may see one direction worse than others), no less than their rounding; NaN where it cannot be told.
    """
    if np.isfinite(observation.sigma):
        return observation.sigma
    x = np.where(observation.visible[..., None], observation.in_measured(observation.position), np.nan)
    return noise_among_neighbours(observation.time, x.reshape(len(x), -1), grid_of(x) / math.sqrt(12))


def with_noise(observation: Observation) -> Observation:
    """The observation, which knows its noise."""
    stated = np.isfinite(observation.sigma)
    return observation if stated else dataclasses.replace(observation, sigma=noise_of(observation))


def grid_of(x: np.ndarray) -> float:
    """What coordinates (T, N, C) m are rounded to [m]: their moves from frame to frame are whole multiples of the least
    of them, among them several different ones; 0 where they are not.
    """
    moves = np.abs(np.diff(x, axis=0))
    moves = moves[moves > LEAST_GRID]
    if not moves.size:
        return 0.0
    times = moves / moves.min()
    whole = np.round(times)
    return float(moves.min()) if (abs(times - whole) < 1e-3).all() and len(np.unique(whole)) >= MULTIPLES else 0.0


def field_of(observation: Observation, residual: np.ndarray) -> np.ndarray:
    """A residual (M,) m back on its frames and nodes (T, N, 3), in the world, 0 where nothing was seen."""
    out = np.zeros(observation.position.shape)
    out[observation.visible] = observation.in_space(residual.reshape(-1, observation.coordinates))
    return out


def main_directions(field: np.ndarray) -> np.ndarray:
    """The directions along which a field (T, N, D) moves most and least, one in each column (D, D): level ones and the
    vertical in space, rows and columns in a picture.
    """
    axes = np.eye(field.shape[-1])
    if len(axes) == 3:
        level = field[..., :2].reshape(-1, 2)
        axes[:2, :2] = np.linalg.eigh(level.T @ level)[1]
    return axes


def quadratics(material: np.ndarray) -> np.ndarray:
    """1, u, v, u², uv and v² of material points (N, 2), one in each column (N, 6), u and v from −1 to 1."""
    low, high = material.min(axis=0), material.max(axis=0)
    u, v = (2 * (material - low) / np.maximum(high - low, 1e-300) - 1).T
    return np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)


def shared_out_anew(field: np.ndarray, modes: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """A field (N, D) whose part in these orthonormal modes (N, K) is shared out among them anew, by a rotation of all
    K (Haar); each coordinate keeps its size.
    """
    turn, sign = np.linalg.qr(random.normal(size=(modes.shape[1], modes.shape[1])))
    known = modes.T @ field
    return field + modes @ ((turn * np.sign(np.diag(sign))) @ known - known)


def mirror(material: np.ndarray) -> np.ndarray:
    """For every material point (N, 2) the one nearest to its mirror image, left to right."""
    low, high = material[:, 0].min(), material[:, 0].max()
    image = np.stack([low + high - material[:, 0], material[:, 1]], axis=1)
    return np.argmin(((image[:, None] - material[None]) ** 2).sum(axis=2), axis=1)
