"""The blind test in small: `clothbench improve` beside cloth that the reference simulation moves.

All of it (64 cases of full size, hours): `python tools/blind_test.py --out FOLDER --keep`.
"""

import json

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


@pytest.mark.parametrize(
    ("planted", "verdict", "named", "mesh", "worth"),
    [
        ({}, "complete", [], 0.5, "ok"),
        ({}, "unexplained", [], 2.0, "open"),
        ({}, "unexplained", [], 0.5, "alarm"),
        ({}, "attributed", ["frame_scale"], 0.5, "FALSE"),
        ({"frame_scale": {"ratio": 1.02}}, "unexplained", [], 2.0, "missed"),
        ({"frame_scale": {"ratio": 1.02}}, "attributed", ["frame_scale"], 0.5, "ok"),
        ({"stiff_seam": {}}, "unexplained", [], 2.0, "ok"),
    ],
)
def test_what_a_verdict_is_worth(planted, verdict, named, mesh, worth):
    effects = [{"name": n, "tied_with": [], "parameters": {}, "p_value": 0.005} for n in named]
    error = {"noise": 1.0, "mesh": mesh, "noise_floor": 1.0, "fit": {"before": 3.0, "after": 2.0}}
    error["held_out"] = {"before": 3.0, "after": None}
    row = blind_test.judged(planted, {"verdict": verdict, "effects": effects, "error_mm": error, "wall_s": 1.0})
    assert blind_test.mark(row) == worth
    (cells,) = (line.split("|")[1:-1] for line in blind_test.by_kind([row])[2:])
    assert [cell.strip() for cell in cells][5:] == ["3.00 mm", "– mm", "1 s"]


def test_cases_asked_anew_take_the_place_of_those_that_were_kept(tmp_path, monkeypatch):
    kept = [{"case": case, "stages": 12} for case in (0, 1, 2, 3)]
    monkeypatch.setattr(blind_test, "RESULTS", tmp_path / "kept.json")
    assert blind_test.with_kept(kept) == kept  # there is no table yet
    blind_test.RESULTS.write_text(json.dumps({"cases": kept}))
    rows = blind_test.with_kept([{"case": 2, "stages": 14}, {"case": 0, "stages": 14}])
    assert [row["case"] for row in rows] == [0, 1, 2, 3]
    assert blind_test.versions(rows) == "version 14 (cases 1, 3 of version 12)"
    assert blind_test.versions(rows[:1]) == "version 14"


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
