"""How often a law is described where none is, and found where one is: `python tools/blind_laws.py`.

Swung sheets of random size, weight, stiffness and motion, five recordings each, 81 nodes, 1 mm of noise, 1 % not seen.
In some nothing acts but weight and damping; in the others one of three laws that no plugin has. Beside the project's
own selection (`clothbench.studies.improve.law`), on the same torques and the same terms: sequentially thresholded least
squares as pysindy has it (Brunton, Proctor and Kutz 2016; `pip install pysindy`), and selection by hold-out with an F
test on the recordings that were held out (after LISDD, arXiv 2606.23215).
"""

from __future__ import annotations

import argparse
import dataclasses
from collections import Counter
from collections.abc import Callable

import numpy as np
from scipy.stats import f as fisher

from clothbench import Observation, Scene
from clothbench.plugins.discovery import catalogue
from clothbench.studies.improve.balance import terms
from clothbench.studies.improve.described import NUMBERS, Described
from clothbench.studies.improve.law import Amount, Law, law_of
from clothbench.studies.improve.motion import Motion, motion_of

NOISE, UNSEEN, RATE = 1e-3, 0.01, 30.0  # m, share, 1/s
TERMS = {term.name: term for term in terms()}
SLOTS = {"a memory": 5, "a power 1.5": 1, "a place": 14}
HALF = "normal velocity to the power 1.5"


def scene_of(random: np.random.Generator) -> Scene:
    """A sheet held at its upper corners, which move to and fro across it."""
    width, height = random.uniform(0.25, 0.4, 2)
    clock, times = np.linspace(0.0, 4.0, 601), np.arange(0.0, 4.0, 1 / RATE)
    rate, size, turn = random.uniform(0.5, 1.4), random.uniform(0.03, 0.06), random.uniform(-0.6, 0.6)
    away = size * np.minimum(clock / 0.5, 1.0) * np.sin(2 * np.pi * rate * clock + random.uniform(0, 6))
    held = np.array([[0.0, 0.0, 0.0], [width, 0.0, 0.0]])
    path = held + np.stack([np.sin(turn) * away, np.cos(turn) * away, 0 * away], axis=1)[:, None]
    u, v = (a.ravel() for a in np.meshgrid(np.linspace(0, width, 9), np.linspace(0, height, 9)))
    density = random.uniform(0.12, 0.25)
    return Scene(width, height, density, clock, held[:, [0, 2]], path, times, np.stack([u, v], axis=1),
                 resolution=(13, 13))  # fmt: skip


def planted(kind: str, random: np.random.Generator) -> Law | None:
    """The law of one kind with amounts of its own."""
    if not kind:
        return None
    if kind == "a memory":
        name, value = f"normal velocity of the last {random.choice([0.1, 0.15, 0.25])} s", random.uniform(0.4, 1.2)
    elif kind == "a power 1.5":
        name, value = HALF, random.uniform(0.3, 0.8)
    else:
        name, value = "place along y", random.uniform(3.0, 9.0)
    return Law((Amount(TERMS[name], value, value, value),), 0.0, 0.0, 0.0, 0.0, 0.0)


def motions(kind: str, seed: int) -> list[Motion]:
    """What is seen of five recordings of one sheet."""
    random = np.random.default_rng(seed)
    law, first = planted(kind, random), scene_of(random)
    truth = {"k1": random.uniform(100, 400), "k2": random.uniform(0.5, 5), "zeta": 0.05,
             "linear_drag.coefficient": random.uniform(0.05, 0.3)}  # fmt: skip
    out = []
    for _ in range(5):
        path = scene_of(random).grip_position
        shift = first.grip_position[0] - path[0]
        scene = dataclasses.replace(first, grip_position=path + shift)
        effects = [catalogue().make("effects", "linear_drag")]
        if law is not None:
            effects.append(effect := Described(law))
            names = [name for name, _ in NUMBERS]
            values = effect.held | {names[slot]: value for slot, value in effect.start.items()}
            truth |= {f"described.{name}": value for name, value in values.items()}
        simulation = catalogue().make("models", "mass_spring").prepare(scene, effects)
        theta = [truth.get(p.name, p.default if p.null is None else p.null) for p in simulation.parameters]
        position = simulation.run(np.array([theta])).position[0]
        seen = position + random.normal(0, NOISE, position.shape)
        visible = random.random(position.shape[:2]) > UNSEEN
        observation = Observation(scene.times, np.where(visible[..., None], seen, np.nan), visible, NOISE, scene.points)
        if (motion := motion_of(observation, scene, NOISE)) is not None and np.isfinite(position).all():
            out.append(motion)
    return out


def own(seen: list[Motion], seed: int) -> list[int]:
    law = law_of(seen, seed)
    return [] if law is None else [amount.term.slot for amount in law.amounts]


def columns(seen: list[Motion]) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """The damping and all terms (T, 1 + K), and the missing torque (T,), of each recording; every term of size 1."""
    tables = [np.column_stack([m.torque(-m.v), *(m.torque(t.force(m)) for t in TERMS.values())]) for m in seen]
    size = np.maximum(np.sqrt(np.mean(np.concatenate(tables) ** 2, axis=0)), 1e-300)
    return [table / size for table in tables], [m.missing for m in seen]


def thresholded(seen: list[Motion], seed: int) -> list[int]:
    """pysindy's optimizer; its threshold is a tenth of the size of what is missing, of terms of size 1."""
    from pysindy.optimizers import STLSQ

    tables, missing = columns(seen)
    target = np.concatenate(missing)
    scale = float(np.sqrt(np.mean(target**2)))
    fitted = STLSQ(threshold=0.1, alpha=1e-3).fit(np.concatenate(tables), target[:, None] / scale)
    slots = [term.slot for term in TERMS.values()]
    return sorted({slots[k - 1] for k in np.flatnonzero(fitted.coef_[0]) if k})


def split_tested(seen: list[Motion], seed: int) -> list[int]:
    """Terms added greedily on three recordings, each kept if an F test on the other two says that it helps."""
    tables, missing = columns(seen)
    fit, test = slice(0, 3), slice(3, 5)
    join: Callable = np.concatenate
    slots, chosen = [term.slot for term in TERMS.values()], [0]

    def left(which: slice, some: list[int]) -> float:
        design, target = join(tables[fit])[:, some], join(missing[fit])
        solution = np.linalg.lstsq(design, target, rcond=None)[0]
        return float(np.sum((join(missing[which]) - join(tables[which])[:, some] @ solution) ** 2))

    count = len(join(missing[test]))
    while len(chosen) < 4:
        best = min((k for k in range(1, len(slots) + 1) if k not in chosen), key=lambda k: left(fit, [*chosen, k]))
        before, after = left(test, chosen), left(test, [*chosen, best])
        if after >= before or fisher.sf((before - after) / (after / (count - len(chosen))), 1, count) > 0.05:
            break
        chosen.append(best)
    return sorted({slots[k - 1] for k in chosen if k})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--nothing", type=int, default=100, help="cases with nothing missing")
    parser.add_argument("--each", type=int, default=20, help="cases of each law")
    given = parser.parse_args()
    ways: dict[str, Callable] = {"own": own, "pysindy": thresholded, "split F test": split_tested}
    cases = [("", given.nothing), *((kind, given.each) for kind in SLOTS)]
    seed = 0
    for kind, number in cases:
        told: dict[str, Counter] = {way: Counter() for way in ways}
        for _ in range(number):
            seed += 1
            seen = motions(kind, seed)
            for way, find in ways.items():
                slots = find(seen, seed)
                told[way]["something"] += bool(slots)
                told[way]["right"] += bool(kind) and slots == [SLOTS[kind]]
                told[way]["among others"] += bool(kind) and SLOTS[kind] in slots and len(slots) > 1
        for way, found in told.items():
            print(
                f"{kind or 'nothing'} ({number}), {way}: " + ", ".join(f"{k} {v}" for k, v in found.items()), flush=True
            )


if __name__ == "__main__":
    main()
