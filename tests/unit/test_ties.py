"""How far apart tied models would be, with rivals whose fit to the experiment is known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from clothbench.suggest.experiments import Unsimulated
from clothbench.suggest.information import beforehand, separation
from clothbench.suggest.ties import Compared, Tie, apart, refitted

COUNTED = 0.1  # m
WHOLE = slice(None)
RANDOM = np.random.default_rng(3)
SURE = np.zeros(400)  # by how much the model may be wrong there


def tie(matrix: np.ndarray, unit: float = 0.5) -> Tie:
    """Two models of which only what the recordings say of the rival's parameters matters here."""
    fit = SimpleNamespace(matrix=matrix, unit=np.full(len(matrix), unit))
    return Tie("one", "other", None, fit, 0.0)  # type: ignore[arg-type]


def bent(slope: float, bend: float, short_of: float = 0.3, never: float = 0.02) -> Compared:
    """A rival of one parameter, which moves every point by slope d + bend d² at d from 0.5: short of the other by 0.3 m
    at first, and by ± `never` m whatever its parameter is.
    """
    rest = never * np.tile([1.0, -1.0], 200)

    def compared(unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        d = float(unit[0]) - 0.5
        return rest - short_of + slope * d + bend * d**2, np.full((400, 1), slope + 2 * bend * d)

    return compared


def searched(one: Tie, compared: Compared) -> float:
    """√Δχ² [σ] of the best of ten thousand values of the one parameter."""
    units = np.linspace(0.0, 1.0, 10_001)
    moved = (units - one.rival.unit[0]) ** 2 * one.rival.matrix[0, 0]
    away = np.array([compared(unit[None])[0] for unit in units])
    return float(np.sqrt(((away / COUNTED) ** 2).sum(axis=1) + moved).min())


def test_a_linear_rival_gains_nothing_by_another_fit():
    tangent, before = RANDOM.normal(size=(400, 3)), RANDOM.normal(size=400)
    one = tie(10 * beforehand(3), 0.9)  # near the end of its range
    rival = refitted(one, lambda unit: (before + tangent @ (unit - one.rival.unit), tangent), COUNTED)
    doubt = RANDOM.normal(scale=0.3, size=400)
    found = apart(rival, WHOLE, doubt, lambda rows: rows, COUNTED)
    first = separation(before, tangent, one.rival.matrix, one.rival.unit, np.zeros(3), COUNTED, doubt)
    assert (found.sigma, found.least) == pytest.approx(first, rel=1e-6)
    assert found.rms == pytest.approx(np.sqrt(np.mean(before**2)))


@pytest.mark.parametrize(("slope", "bend"), [(0.2, 1.5), (0.2, 2.5), (1.0, -0.5), (0.15, 6.0)])
def test_a_rival_that_bends_is_promised_what_its_fit_leaves(slope, bend):
    """Little of it shows at the fit to the recordings; in the last case a whole step goes too far."""
    compared, one = bent(slope, bend), tie(np.array([[300.0]]))
    truth = searched(one, compared)
    rival = refitted(one, compared, COUNTED)
    found = apart(rival, WHOLE, SURE, lambda rows: rows, COUNTED)
    assert found.sigma == pytest.approx(truth, rel=0.1)
    before, tangent = compared(one.rival.unit)
    promised, _ = separation(before, tangent, one.rival.matrix, one.rival.unit, np.zeros(1), COUNTED, SURE)
    if bend > 0:
        assert promised > 2 * truth


def test_what_the_recordings_say_holds_a_rival_where_it_is():
    compared, one = bent(0.2, 1.5), tie(np.array([[1e8]]))
    found = apart(refitted(one, compared, COUNTED), WHOLE, SURE, lambda rows: rows, COUNTED)
    assert found.sigma == pytest.approx(np.sqrt(400 * (0.3**2 + 0.02**2)) / COUNTED, rel=1e-3)


def test_where_it_cannot_be_simulated_a_rival_does_not_go():
    compared, one = bent(0.6, 0.0), tie(np.array([[1.0]]))

    def up_to(unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        away, tangent = compared(unit)
        return (away if unit[0] < 0.85 else np.full_like(away, np.nan)), tangent

    stays = refitted(one, up_to, COUNTED).unit[0]  # after half a step to the end, and a quarter of what is left
    assert stays == pytest.approx(0.75 + 0.25 / 4, abs=1e-3)
    with pytest.raises(Unsimulated, match="with one and with other"):
        refitted(tie(np.array([[1.0]]), 0.9), up_to, COUNTED)
