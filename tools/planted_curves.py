"""How often `improve` names what was planted in made-up force-extension curves, and what it names where nothing was.

    python tools/planted_curves.py [SETS]

Each set: six runs of a linear sample of 20 N, stretched by 60 %, with 0.1 N of noise and a stiffness that differs by
2 % from run to run; two runs held out. Printed: the verdict and the names, over SETS sets (12) of each kind.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Callable

import numpy as np

from clothbench.plugins.discovery import catalogue
from clothbench.recordings.curve import Curve
from clothbench.studies.improve.candidates import candidates_of
from clothbench.studies.improve.curves import curve_evidence
from clothbench.studies.improve.document import verdict_document
from clothbench.studies.improve.loop import improve
from clothbench.studies.improve.problem import Problem

RUNS, HELD_OUT, SAMPLES, LONGEST = 6, 2, 600, 0.6
STIFFNESS, NOISE, BETWEEN = 20.0, 0.1, 0.02  # N, N, share
Law = Callable[[np.ndarray], np.ndarray]  # strain → force beside the linear one [N]


def waves(seed: int, own: bool) -> Law:
    """Smooth waves of about 0.7 N that no candidate has: each run its own, or one for all."""
    random = np.random.default_rng(seed)

    def drawn() -> tuple[np.ndarray, np.ndarray]:
        return random.normal(0, 0.6, 3), random.uniform(0, 2 * np.pi, 3)

    shared = drawn()

    def law(strain: np.ndarray) -> np.ndarray:
        size, phase = drawn() if own else shared
        return sum(s * np.sin(4 * (k + 1) * strain + p) for k, (s, p) in enumerate(zip(size, phase, strict=True)))

    return law


def beyond(y: np.ndarray) -> np.ndarray:
    return np.expm1(y) - y


KINDS: dict[str, Callable[[int], Law]] = {
    "nothing": lambda seed: lambda e: 0 * e,
    "waves, each run its own": lambda seed: waves(seed, own=True),
    "waves, the same in all runs": lambda seed: waves(seed, own=False),
    "strain_locking, strong": lambda seed: lambda e: 0.05 * beyond(9 * e),
    "strain_locking, weak": lambda seed: lambda e: 0.005 * beyond(9 * e),
    "limited_extension": lambda seed: lambda e: 3 * (1 / (1 - 1.45 * e) - 1 - 1.45 * e),
    "stretch_stiffening": lambda seed: lambda e: 400 * np.where(e < 0.1, e**2, (2 * e - 0.1) * 0.1),
    "start_friction": lambda seed: lambda e: 1.5 * (1 - np.exp(-e / 0.02)),
    "clamp_slack": lambda seed: lambda e: STIFFNESS * (np.maximum((1 + e) / 1.08 - 1, 0) - e),
    "clamp_slip": lambda seed: lambda e: -STIFFNESS * 0.6 * np.maximum(e - 0.25, 0),
    "load_offset": lambda seed: lambda e: 0 * e + 0.8,
}


def runs(seed: int, law: Law) -> list[Curve]:
    random, out = np.random.default_rng(seed), []
    for number in range(RUNS):
        strain = np.linspace(0, LONGEST + random.uniform(0, 0.02), SAMPLES)
        force = (STIFFNESS * strain + law(strain)) * (1 + BETWEEN * random.standard_normal())
        force = force + random.normal(0, NOISE, SAMPLES)
        split = "fit" if number < RUNS - HELD_OUT else "held_out"
        out.append(Curve(f"run{number}", 1 + strain, force, "made up", noise_sigma=NOISE, split=split))
    return out


def outcome(seed: int, law: Law) -> str:
    """ "attributed: strain_locking" """
    plugins, curves = catalogue(), runs(seed, law)
    evidence = curve_evidence(curves, [c.split for c in curves])
    problem = Problem("linear_stretch", evidence, plugins, "least_squares")
    found = verdict_document(improve(problem, candidates_of(None, "curve", (), plugins)))
    names = [name for effect in found["effects"] for name in (effect["name"], *effect["tied_with"])]
    return ": ".join([found["verdict"], *([", ".join(sorted(names))] if names else [])])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="?", type=int, default=12, metavar="SETS", help="of each kind (default: 12)")
    sets = parser.parse_args().sets
    for kind, law in KINDS.items():
        seen = Counter(outcome(1000 + number, law(1000 + number)) for number in range(sets))
        print(f"{kind}: " + "; ".join(f"{count} × {what}" for what, count in seen.most_common()), flush=True)


if __name__ == "__main__":
    main()
