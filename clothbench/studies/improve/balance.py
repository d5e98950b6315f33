"""The balance of torques about the line of the grips: an identity of mechanics that no model's fault can touch.

A small rotation of the whole sheet about the line through its grips strains nothing and moves no grip, so neither what
is inside the cloth nor what holds it does any work on it (d'Alembert's principle; Lanczos 1970, The Variational
Principles of Mechanics, ch. IV). What is left of weight and inertia is what acts from outside: the air, and whatever
else nobody has named. No model is needed to see it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from clothbench.studies.improve.motion import Motion

POWERS = (1.5, 2.0, 2.5, 3.0)  # of the speed, in laws of drag
TIMES = (0.02, 0.05, 0.1, 0.15, 0.25, 0.4, 0.7, 1.2)  # s, relaxation times of the air


def late(motion: Motion, relaxation: float) -> np.ndarray:
    """(T, N) m/s: by how much the normal velocity is ahead of air that follows it in `relaxation` s (`air_memory`)."""
    speed = motion.along_normal
    out = np.zeros_like(speed)
    for k, step in enumerate(np.diff(motion.time)):
        s = step / relaxation
        out[k + 1] = np.exp(-s) * out[k] - np.expm1(-s) / s * (speed[k + 1] - speed[k])
    return out


def delayed(motion: Motion, relaxation: float) -> np.ndarray:
    """Forces per area (T, N, 3) against the normal velocity that the air does not have yet."""
    return -late(motion, relaxation)[..., None] * motion.normal


def power(motion: Motion, exponent: float) -> np.ndarray:
    """Forces per area (T, N, 3) against the normal velocity to a power."""
    speed = motion.along_normal
    return -(np.abs(speed) ** (exponent - 1) * speed)[..., None] * motion.normal


def along_axis(motion: Motion, axis: int, by_place: bool) -> np.ndarray:
    """Forces per area (T, N, 3) along an axis of the world, alike everywhere or growing against the place."""
    out = np.zeros_like(motion.x)
    out[..., axis] = -motion.x[..., axis] if by_place else 1.0
    return out


@dataclass(frozen=True)
class Term:
    """One term of a law. name: as it is told; formula: with its coefficient k, and behind a comma what another equation
    says of a quantity in it; unit: of the coefficient; force: per
    area (T, N, 3) at a coefficient of 1; slot: number of the coefficient in `missing_force`, shape: of a number beside
    it, and its value; positive: mass, which cannot be negative: a sheet without any would balance whatever it did;
    law: of `FORCE_LAWS`, by which effects say that they are this, or "".
    """

    name: str
    formula: str
    unit: str
    force: Callable[[Motion], np.ndarray]
    slot: int
    shape: tuple[int, float] | None = None
    positive: bool = False
    law: str = ""


def terms(steady: str = "xyz") -> tuple[Term, ...]:
    """What a missing force may go with: velocity to a power, acceleration, the past, place, and places on the cloth.

    steady: axes of the world along which a steady force would be seen.
    """
    return (
        Term("normal velocity", "−k v_n n", "kg/(m²·s)", lambda m: power(m, 1.0), 0),
        *(
            Term(f"normal velocity to the power {p:g}", f"−k |v_n|{'' if p == 2 else f'^{p - 1:g}'} v_n n",
                 f"N/m² (s/m)^{p:g}", partial(power, exponent=p), 1, (2, p),
                 law="normal velocity squared" if p == 2 else "")
            for p in POWERS
        ),
        Term("speed squared", "−k |v| v", "kg/m³", lambda m: -np.linalg.norm(m.v, axis=2, keepdims=True) * m.v, 3),
        Term("normal acceleration", "−k a_n n", "kg/m²",
             lambda m: -np.einsum("tnc,tnc->tn", m.a, m.normal)[..., None] * m.normal, 4, positive=True,
             law="normal acceleration"),
        *(
            Term(f"normal velocity of the last {t:g} s", f"−k w n, ẇ = v̇_n − w/({t:g} s)", "kg/(m²·s)",
                 partial(delayed, relaxation=t), 5, (6, t), positive=True, law="past normal velocity")
            for t in TIMES
        ),
        Term("normal velocity, lower down", "−k (s/H) v_n n", "kg/(m²·s)",
             lambda m: power(m, 1.0) * m.along[None, :, 1:], 7),
        Term("mass along the lower edge", "−k δ(s − H) (a − g)", "kg/m",
             lambda m: -(m.a - m.gravity) * m.lower_edge[None, :, None], 8, positive=True,
             law="mass along the lower edge"),
        Term("mass, lower down", "−k (s/H) (a − g)", "kg/m²",
             lambda m: -(m.a - m.gravity) * m.along[None, :, 1:], 9, positive=True),
        *(
            Term(f"a steady force along {axis}", f"k e_{axis}", "N/m²",
                 partial(along_axis, axis=i, by_place=False), 10 + i)
            for i, axis in enumerate("xyz")
            if axis in steady
        ),
        *(
            Term(f"place along {axis}", f"−k {axis} e_{axis}", "N/m³",
                 partial(along_axis, axis=i, by_place=True), 13 + i)
            for i, axis in enumerate("xyz")
        ),
    )  # fmt: skip
