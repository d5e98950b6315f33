"""A described force as an effect: what `law` found, compiled, so that a model can be refitted with it and judged."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from clothbench import Parameter, ParameterSpace, effect_kernel
from clothbench.modelling import lean_kernel
from clothbench.studies.improve.law import Law

NAME = "described"
SOURCE = "the balance of torques about the grips (Law)"
# The numbers that a law may have, in the order of `missing_force`.
NUMBERS = (
    ("normal", "kg/(m²·s)"), ("power", "N/m² (s/m)^n"), ("exponent", "1"), ("isotropic", "kg/m³"),
    ("normal_mass", "kg/m²"), ("memory", "kg/(m²·s)"), ("time", "s"), ("lower", "kg/(m²·s)"), ("edge_mass", "kg/m"),
    ("lower_mass", "kg/m²"), ("x", "N/m²"), ("y", "N/m²"), ("z", "N/m²"), ("at_x", "N/m³"), ("at_y", "N/m³"),
    ("at_z", "N/m³"),
)  # fmt: skip
MASSES = (4, 8, 9)  # numbers of those that have inertia
FURTHEST = 3.0  # times the coefficient that the balance gave, within which the model's own fit looks for it


@lean_kernel
def lower_edge(uv):
    """v of the lowest row [m], u of its last node [m], and how many nodes it has."""
    lowest, widest, row = 0.0, 0.0, 0
    for i in range(uv.shape[0]):
        lowest, widest = max(lowest, uv[i, 1]), max(widest, uv[i, 0])
    for i in range(uv.shape[0]):
        row += int(uv[i, 1] > lowest - 1e-9)
    return lowest, widest, row


@lean_kernel
def edge_of(uv, i, edge):
    """How much of the lower edge [m] node i stands for."""
    lowest, widest, row = edge
    if uv[i, 1] <= lowest - 1e-9:
        return 0.0
    end = uv[i, 0] < 1e-9 or uv[i, 0] > widest - 1e-9
    return widest / (row - 1) * (0.5 if end else 1.0)


@effect_kernel(allocates=False)
def missing_force(t, dt, x, v, f, sheet, p, state):
    """Forces per area, against the unit normal n and the normal velocity v_n: p[0] v_n, p[1] |v_n|^(p[2] − 1) v_n,
    p[3] |v| v, p[5] w with ẇ = v̇_n − w/p[6] (as `air_memory`), p[7] (s/H) v_n; the weight of the masses p[8] (along the
    lower edge) and p[9] (s/H); p[10] to p[12] along x, y, z; −p[13] x e_x, −p[14] y e_y, −p[15] z e_z.

    state: 0 before the first step, the time of the last, then v_n and w of all nodes.
    """
    count, passed = x.shape[1], t - state[1]
    kept, share = 0.0, 0.0
    if state[0] != 0.0 and passed > 0.0:
        s = passed / p[6]
        kept = np.exp(-s)
        share = -np.expm1(-s) / s
    state[0], state[1] = 1.0, t
    before, ahead = state[2 : 2 + count], state[2 + count : 2 + 2 * count]
    edge = lower_edge(sheet.uv)
    for i in range(count):
        nx, ny, nz = sheet.normal[0, i], sheet.normal[1, i], sheet.normal[2, i]
        along = v[0, i] * nx + v[1, i] * ny + v[2, i] * nz
        speed = np.sqrt(v[0, i] ** 2 + v[1, i] ** 2 + v[2, i] ** 2)
        ahead[i] = kept * ahead[i] + share * (along - before[i])
        before[i] = along
        area, lower = sheet.area[i], sheet.uv[i, 1] / edge[0]
        push = p[0] * along + p[5] * ahead[i] + p[7] * lower * along
        if p[1] != 0.0 and along != 0.0:
            push += p[1] * np.abs(along) ** (p[2] - 1.0) * along
        mass = p[9] * lower * area + p[8] * edge_of(sheet.uv, i, edge)
        for c in range(3):
            pull = -push * sheet.normal[c, i] - p[3] * speed * v[c, i] + p[10 + c] - p[13 + c] * x[c, i]
            f[c, i] += area * pull + mass * sheet.gravity[c]


@effect_kernel(allocates=False)
def missing_mass(t, dt, x, v, mass, sheet, p, state):
    """p[4] kg/m² along the normal, p[8] kg/m along the lower edge, p[9] kg/m² growing towards it."""
    edge = lower_edge(sheet.uv)
    for i in range(x.shape[1]):
        nx, ny, nz = sheet.normal[0, i], sheet.normal[1, i], sheet.normal[2, i]
        air = p[4] * sheet.area[i]
        own = p[9] * sheet.uv[i, 1] / edge[0] * sheet.area[i] + p[8] * edge_of(sheet.uv, i, edge)
        mass[0, i] += air * nx * nx + own
        mass[1, i] += air * ny * ny + own
        mass[2, i] += air * nz * nz + own
        mass[3, i] += air * ny * nz
        mass[4, i] += air * nx * nz
        mass[5, i] += air * nx * ny


class Described:
    """The effect of a law: its coefficients are parameters, all other numbers are held (`held`)."""

    name = NAME
    version = 1
    place = "dynamics"
    summary = "the force that the balance of torques leaves"
    force = staticmethod(missing_force)

    def __init__(self, law: Law):
        if any(amount.term.slot in MASSES for amount in law.amounts):
            self.inertia = missing_mass
        values = {slot: 0.0 for slot in range(len(NUMBERS))} | {2: 2.0, 6: 0.1}
        self.start = {}
        for amount in law.amounts:
            self.start[amount.term.slot] = amount.value
            if amount.term.shape is not None:
                values[amount.term.shape[0]] = amount.term.shape[1]
        names = [name for name, _ in NUMBERS]
        self.held: Mapping[str, float] = {names[k]: v for k, v in values.items() if k not in self.start}
        self.parameters = ParameterSpace(tuple(self._parameter(k, values[k]) for k in range(len(NUMBERS))))

    def _parameter(self, slot: int, value: float) -> Parameter:
        name, unit = NUMBERS[slot]
        start = self.start.get(slot)
        ends = sorted((0.0, FURTHEST * start)) if start is not None else (0.0, 2 * value or 1.0)
        null = 0.0 if start is not None else None
        return Parameter(
            name, name, unit, (ends[0], ends[1]), "linear", value if start is None else start, "of the law", SOURCE,
            null=null,
        )  # fmt: skip

    def state_size(self, sheet) -> int:
        return 2 + 2 * sheet.area.shape[0]
