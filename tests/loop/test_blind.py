"""The blind test in small: `clothbench improve` beside cloth that the reference simulation moves.

All of it (64 cases of full size, hours): `python tools/blind_test.py --out FOLDER --keep`.
"""

import blind_test
import pytest

KNOWN = "candidates=" + ",".join(effect.__name__ for effect in blind_test.EFFECTS)
SMALL = blind_test.Size(12, 1.6, ("fit", "fit", "fit", "held_out"), ("resolution=7", KNOWN))


def case_with(name: str) -> int:
    """The first case that holds this effect alone."""
    return next(n for n in blind_test.ONE if blind_test.drawn(n)[0].__name__ == name)


def test_each_effect_comes_twice():
    names = [blind_test.drawn(n)[0].__name__ for n in blind_test.ONE]
    assert sorted(names) == sorted(2 * [effect.__name__ for effect in blind_test.EFFECTS])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["clock_offset", "nothing"])
def test_verdict_on_a_small_case(name, tmp_path):
    case = 0 if name == "nothing" else case_with(name)
    row = blind_test.run(case, tmp_path, "mass_spring", SMALL)
    assert not row["false_names"], blind_test.line(row)
    if name != "nothing":
        assert row["hits"] == 1, blind_test.line(row)
        before, after = row["held_out_mm"]
        assert after < before
