"""The page of `clothbench improve` from rows alone: what is said for each verdict, and text escaped."""

from __future__ import annotations

import json
import re

import pytest
from test_page import checked

from clothbench.core.optional import EFFECT_FAMILIES
from clothbench.display.names import duration
from clothbench.studies.improve.drawings import DRAWINGS, drawing
from clothbench.studies.improve.figures import stage_figure
from clothbench.studies.improve.missing_page import balance_section
from clothbench.studies.improve.page import page_html
from clothbench.studies.improve.schema import IMPROVE_TABLES
from clothbench.studies.improve.terminal import verdict_lines
from clothbench.studies.improve.words import chance, p_is, remains, sentence, sham

NOTHING = {name: [] for name in IMPROVE_TABLES}
EFFECT = {
    "name": "lag", "place": "sensor", "summary": "late <i>", "tied_with": [], "p_value": 0.005, "selected_in": "3/3",
    "parameters": {"delay": {"value": 0.05, "low": 0.04, "high": None, "unit": "s"}},
}  # fmt: skip


def verdict(word: str, *effects: dict, **more) -> dict:
    after = 1.25 if effects else 5.0
    return {
        "schema": 1, "model": "springs", "base": ["drag"], "verdict": word, "effects": list(effects),
        "error_mm": {
            "fit": {"before": 4.0, "after": after - 0.25},
            "held_out": {"before": 5.0, "after": after, "ci95": [None, None], "per_recording": [], "placebo": None},
            "noise_floor": 1.0,
        },
        "unexplained_mm": 0.5, "hint": "", "candidates": [], "evaluations": 7, "wall_s": 61.0, "seed": 0,
        "recordings": {"fit": ["a"], "held_out": ["b"]}, **more,
    }  # fmt: skip


def rows() -> dict[str, list[dict]]:
    """One fit and one held-out recording of two nodes and two frames; what was not seen is None."""
    about = [
        {"recording": "a <b>", "split": "fit", "unit": "mm"},
        {"recording": "b", "split": "held_out", "unit": "mm"},
    ]
    error = {"coordinates": 6, "before": 4.0, "after": 1.0}
    unseen = {"coordinates": 0, "before": None, "after": None}
    part = {"rms": 1.0, "normal": 1.5, "warp": 0.7, "weft": 0.5, "next_frame": None}
    bins = {"against": "speed", "against_unit": "m/s", "low": 0.0, "high": 0.2}
    parameter = {
        "name": "k", "symbol": "k", "unit": "N/m", "value": 2.0, "low": None, "high": None, "at_bound": True,
        "meaning": "stiffness",
    }  # fmt: skip
    candidate = {
        "round": 1, "name": "lag", "place": "sensor", "summary": "late", "share": 0.9, "p_value": 0.005, "gain": 15.0,
        "unit": "mm²", "selected": 3, "of": 3, "why_not": "", "named": True,
    }  # fmt: skip
    alone = {
        "recording": "a <b>", "name": "k", "symbol": "k", "unit": "N/m", "scale": "log", "value": 3.0, "joint": 2.0,
        "low": None, "high": None, "outside": False, "at_bound": False,
    }  # fmt: skip
    return {
        **NOTHING,
        "errors": [{**a, "before": 4.0, "after": 1.0, "floor": 1.0} for a in about],
        "portrait": [{**a, "fit": fit, **part} for a in about for fit in ("before", "after")],
        "frames": [{**a, "time": t, **e} for a in about for t, e in ((0.0, error), (0.1, unseen))],
        "nodes": [{**a, "u": u, "v": 0.0, **e} for a in about for u, e in ((0.0, error), (0.1, unseen))],
        "against": [{**a, **bins, **error} for a in about],
        "parameters": [{**parameter, "fit": fit} for fit in ("before", "after")],
        "candidates": [candidate, {**candidate, "name": "wind", "gain": None, "named": False, "why_not": "chance"}],
        "stages": [{"stage": "calibrate", "wall_s": 2.0, "evaluations": 9}],
        "drift": [alone],
    }


def blocks(text: str) -> dict[str, dict]:
    content = json.loads(re.search(r'id="found">(.*?)</script>', text, re.DOTALL)[1])
    return {block["id"]: block["views"] for block in content["blocks"]}


def test_every_section_is_there_and_text_is_escaped(tmp_path):
    (tmp_path / "index.html").write_text(page_html(verdict("attributed", EFFECT), rows()), encoding="utf-8")
    text, checker = checked(tmp_path / "index.html")
    assert checker.scripts == 3
    assert "a <b>" not in re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)
    assert "late &lt;i&gt;" in text
    assert "held out, never fitted, which decide only whether the verdict stands" in text
    found = blocks(text)
    assert list(found) == ["errors", "frames", "map", "directions", "against", "drift", "stages"]
    assert list(found["frames"]) == ["b (held out)", "a &lt;b&gt; (fit)"]
    assert {line["meta"] for line in found["frames"]["b (held out)"][0]["data"]} == {
        "before",
        "after",
        "noise and mesh",
    }
    for name, views in found.items():
        assert len(views) < 2 or f'id="{name}-view"' in text


def test_without_an_effect_there_is_one_curve_only():
    found = blocks(page_html(verdict("unexplained", hint="look at the wind"), rows()))
    assert {line["meta"] for line in found["frames"]["b (held out)"][0]["data"]} == {"calibrated", "noise and mesh"}
    assert len(found["map"]["b (held out)"]) == 1


def test_a_run_that_was_stopped_has_gaps_and_no_numbers():
    gone = {"before": None, "after": None}
    stopped = {
        name: [{**r, **(gone if r.get("recording") == "b" and "after" in r else {})} for r in table]
        for name, table in rows().items()
    }
    part = dict.fromkeys(("rms", "normal", "warp", "weft"))
    stopped["portrait"] = [{**r, **(part if r["recording"] == "b" else {})} for r in stopped["portrait"]]
    text = page_html(verdict("attributed", EFFECT), stopped)
    assert blocks(text)["directions"]["b (held out)"][0]["data"][0]["y"] == [None, None, None]
    assert ">nan" not in text


def test_the_band_of_a_kernel_is_no_interval_of_the_truth():
    kernel = [{"lag": lag, "value": 0.4, "low": 0.3, "high": 0.5} for lag in (0.0, 0.5)]
    found = {"shares": {"velocity": 0.5}, "formula": None, "p_value": None, "recordings": {"used": 4, "of": 6}}
    text = balance_section(found, kernel, [])
    assert "From 4 of 6 recordings" in text
    assert "spread between recordings" in text
    assert "95 % intervals" not in text


def test_a_page_without_rows_still_says_the_verdict():
    text = page_html(verdict("complete"), NOTHING)
    assert "lacks nothing above the noise" in text
    assert blocks(text) == {}


def test_curves_are_told_in_newtons():
    error = verdict("attributed", EFFECT)["error_mm"]
    told = {"kind": "curve", "error": {"unit": "N", **error}, "unexplained": 0.02, "error_mm": None}
    found = verdict("attributed", EFFECT, **told, recordings={"fit": ["a", "c"], "held_out": ["b"]})
    about = {"recording": "run", "split": "fit", "unit": "N"}
    table = [{**about, "stretch": s, "force": s - 1, "before": 0.1, "after": s - 1} for s in (1.0, 1.1, 1.2)]
    text = page_html(found, {**NOTHING, "curves": table, "errors": [{**about, "before": 4.0, "after": 1.0}]})
    assert "falls from 5 to 1.25 N; the spread between runs alone would give 1 N." in text
    assert "; the noise of the only run alone would give 1 N." in page_html(verdict("complete", **told), NOTHING)
    shown = re.sub(r"<(script|style)[^>]*>.*?</\1>|<[^>]*>", "", text, flags=re.DOTALL)
    assert "mm" not in shown.replace("mm²", "")
    assert [line["meta"] for line in blocks(text)["curves"]["run (fit)"][0]["data"]] == ["measured", "before", "after"]


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (verdict("complete"), "lacks nothing above the noise: 5.00 mm on the held-out recordings"),
        (
            verdict("unexplained"),
            "leaves 0.50 mm beyond noise and mesh on the recordings fitted (4.75 mm) for which no effect can be named; "
            "5.00 mm on the held-out recordings",
        ),
        (
            verdict("unexplained", unexplained_mm=24**0.5),
            "beyond noise and mesh for which no effect can be named: 5.00 mm",
        ),
        (
            verdict("attributed", EFFECT),
            "lacks <b>lag</b>: late &lt;i&gt; (delay = 0.05 s). The error on the held-out recordings falls",
        ),
        (
            verdict("tied", {**EFFECT, "tied_with": ["twin"]}),
            "<b>lag</b>: late &lt;i&gt; (delay = 0.05 s) or <b>twin</b>, which these",
        ),
    ],
)
def test_the_verdict_is_one_sentence_or_two(found, said):
    assert said in sentence(found)


def test_a_model_without_a_mesh_that_leaves_nothing_above_the_noise_is_not_told_to_leave_something():
    found = verdict("unexplained", unexplained_mm=0.0)
    found["error_mm"]["mesh"] = 0.0
    assert "no more than the noise accounts for, so that nothing is named" in sentence(found)


def test_of_which_recordings_something_is_left_is_said():
    """What is beyond the noise on those fitted had stood before the error of those held out, as if they were one."""
    found = verdict("unexplained", unexplained_mm=(4.75**2 - 1) ** 0.5)
    assert "beyond noise and mesh remain, fit<" in page_html(found, rows())
    assert remains(found, rows())[0] == "4.64 mm beyond noise and mesh on the recordings fitted (4.75 mm)."
    unseen = verdict("unexplained", unexplained_mm=24**0.5)
    assert "beyond noise and mesh remain, held out<" in page_html(unseen, rows())
    found["error_mm"]["held_out"] |= {"before": None, "after": None}
    assert remains(found, rows())[0] == "4.64 mm beyond noise and mesh."
    assert "for which no effect can be named: 4.00 mm on the fit recordings" in sentence(found)


def test_words_beside_bars_have_room():
    stages = [{"stage": s, "wall_s": w, "evaluations": 7} for s, w in (("calibrate", 100.0), ("refits", 3.0))]
    drawn = stage_figure(stages)
    assert drawn["layout"]["xaxis"]["range"][1] == pytest.approx(180.0)
    assert drawn["data"][0]["text"] == ["3.0 s, 7", "100.0 s, 7"]


def test_where_most_is_left_in_time_says_whether_it_was_fitted():
    """Beside a size on the recordings fitted, and a hint of these."""
    frames = [{**r, "after": 3.0 if r["split"] == "held_out" else 1.0} for r in rows()["frames"]]
    said = remains(verdict("attributed", EFFECT), {**rows(), "frames": frames})
    assert "Largest in time at 0.00 s of b (held out): 3.00 mm." in said


def test_candidates_that_beat_chance_are_not_all_said_to_be_fitted():
    """Beside "is not among the 4 that promise most"."""
    found = page_html(verdict("unexplained"), rows())
    assert "Of those that beat chance the most promising were fitted in earnest" in found


def test_what_remains_says_where_when_and_how():
    said = " ".join(remains(verdict("attributed", EFFECT), rows()))
    for word in ("0.50 mm beyond noise and mesh", "normal 75 %", "u = 0 mm, v = 0 mm", "0.00 s of a &lt;b&gt;"):
        assert word in said


def on_a_mesh(word: str, *effects: dict, placebo: float | None = None, **more) -> dict:
    """A verdict that tells the mesh's error from the noise, with a placebo of that error on what was held out."""
    found = verdict(word, *effects, **more)
    found["error_mm"] |= {"noise": 1.0, "mesh": 1.4, "noise_floor": 1.72}
    if placebo is not None:
        found["error_mm"]["held_out"] |= {"placebo": {"name": "frame_scale", "after": placebo}}
    return found


def test_noise_and_mesh_stand_apart_and_neither_is_called_a_floor():
    found = on_a_mesh("attributed", EFFECT, placebo=1.25)
    text = page_html(found, rows())
    shown = re.sub(r"<(script|style)[^>]*>.*?</\1>|<[^>]*>", " ", text, flags=re.DOTALL)
    assert "noise alone would give 1.00 mm, and the mesh may be wrong by 1.40 mm" in shown
    assert "floor" not in shown
    lines = blocks(text)["frames"]["b (held out)"][0]["data"]
    assert {line["meta"]: line["y"][0] for line in lines[2:]} == {"noise": 1.0, "noise and mesh": 1.72}
    below = sentence(on_a_mesh("unexplained", unexplained_mm=0.0))
    said = (
        "What <b>springs</b> leaves on the recordings fitted (4.75 mm) is no more than noise and its mesh account for"
    )
    assert below.startswith(said)


def test_all_that_is_left_is_not_told_as_the_size_of_the_mesh_s_error():
    """Of the mesh no more is counted than is left: it may be wrong by more."""
    found = on_a_mesh("unexplained", unexplained_mm=0.0)
    found["error_mm"] |= {"mesh": (4.75**2 - 1) ** 0.5, "noise_floor": 4.75}
    assert "the mesh may be wrong by at least as much as the fit leaves above that (4.64 mm)" in sentence(found)
    assert "<b>≥ 4.64</b>mm that the mesh may be wrong by" in page_html(found, rows())
    assert "(no more of the mesh than the fit leaves), below which this mesh tells nothing" in page_html(found, rows())
    assert "<b>≥" not in page_html(on_a_mesh("attributed", EFFECT), rows())


@pytest.mark.parametrize(
    ("after", "said"), [(1.26, "changes nothing"), (1.4, "makes it worse"), (1.1, "lowers it still further")]
)
def test_the_placebo_is_told_in_words(after, said):
    found = on_a_mesh("attributed", EFFECT, placebo=after)
    assert f"A sham effect (frame_scale) added on top {said}: 1.25 → {after:.2f} mm" in page_html(found, rows())
    assert sham({**found["error_mm"], "unit": "mm"}).endswith(".")


def test_a_p_value_is_no_smaller_than_the_test_can_tell():
    assert (chance(0.005), chance(0.01), chance(0.001, 999)) == ("≤ 1/200", "0.01", "≤ 1/1000")
    assert (p_is(0.005), p_is(0.03)) == ("p ≤ 1/200", "p = 0.03")
    assert "p ≤ 1/200; best in 3/3 leave-one-out rounds" in page_html(verdict("attributed", EFFECT), rows())


@pytest.mark.parametrize(("drawn", "held", "said"), [
    (True, ["b"], "No recording states a split; which of them are held out was drawn with seed 3."),
    (True, [], "No recording states a split; nothing is held out."),
    (False, ["b"], ""),
    (None, ["b"], ""),  # of a verdict that was kept before it was told
])  # fmt: skip
def test_a_split_that_no_recording_states_is_told_on_the_page(drawn, held, said):
    settings = {"bounds": {}, "resolution": 9} | ({} if drawn is None else {"split_by_seed": drawn})
    found = verdict("complete", seed=3, settings=settings, recordings={"fit": ["a"], "held_out": held})
    page = page_html(found, NOTHING)
    assert ("states a split" in page) == bool(said)
    assert said in page


@pytest.mark.parametrize(("stated", "said"), [(False, True), (True, False), (None, False)])
def test_noise_that_no_recording_states_is_told_as_an_estimate(stated, said):
    found = verdict("complete")
    assert "neighbouring frames jump" not in page_html(found, NOTHING)  # of a verdict that was kept before it was told
    found["error_mm"]["noise_stated"] = stated
    line = "Not all recordings state their noise; it was told from how much neighbouring frames jump."
    assert (line in page_html(found, NOTHING)) == said
    terminal = "\n".join(verdict_lines(found))
    assert ("not all recordings state their noise; it was told" in terminal) == said


def test_every_family_of_effects_has_a_picture_and_no_other():
    assert set(DRAWINGS) == set(EFFECT_FAMILIES)
    for family in EFFECT_FAMILIES:
        picture = drawing(family, "what &lt;it&gt; shows")
        corners = [float(c) for at in re.findall(r'points="([^"]*)"', picture) for c in re.split("[ ,]", at)]
        assert min(corners[::2]) >= 0
        assert max(corners[::2]) <= 200
        assert min(corners[1::2]) >= 0
        assert max(corners[1::2]) <= 120
    assert drawing("tarot", "a stranger's") == ""
    assert '<svg class="sketch"' in page_html(verdict("attributed", {**EFFECT, "family": "clock"}), rows())
    assert '<svg class="sketch"' not in page_html(verdict("attributed", EFFECT), rows())


def test_drift_is_a_sign_only_where_the_mesh_is_fine_enough_and_searches_moved():
    (first,) = rows()["drift"]
    kept = {"value": first["joint"]}  # of a search that never left its start
    drift = [first | {"recording": n, **more} for n, more in zip("abc", ({"outside": True}, kept, kept), strict=True)]
    coarse = page_html(on_a_mesh("unexplained"), {**rows(), "drift": drift})
    assert (
        "Of 3 values 2 lie where their search began, or at a bound (hollow), and have no say. Standing out: k;"
        in coarse
    )
    assert "no sign of missing physics" in coarse.replace("\n", " ")
    found = on_a_mesh("unexplained")
    found["error_mm"]["mesh"] = 0.9
    fine = page_html(found, {**rows(), "drift": drift})
    assert "Standing out: k, which may be a sign of physics that the calibrated model lacks." in fine
    assert blocks(fine)["drift"]["k"][0]["data"][-1]["marker"]["symbol"] == ["diamond", "circle-open", "circle-open"]
    still = page_html(found, {**rows(), "drift": [first]})
    assert "None stands out" in still
    assert "never left" not in still


def test_more_than_elsewhere_is_said_of_what_is_more_alone():
    """Beyond chance, yet by a hundredth of the whole: "1 times" is told by neither terminal nor page."""
    row = {"kind": "where", "rms": 1.0, "unit": "mm", "p_value": 0.01}
    parts = (("upper left", 1.126), ("lower right", 1.04), ("lower left", 1.5))
    told = [{**row, "part": part, "ratio": ratio} for part, ratio in parts]
    told[2]["p_value"] = 0.2
    lines = list(verdict_lines(verdict("complete", whereabouts=told)))
    assert "more is left than elsewhere: upper left (1.13 times the whole)" in lines
    page = page_html(verdict("complete"), {**NOTHING, "whereabouts": told})
    assert page.count(">more than elsewhere<") == 1
    assert 'upper left <span class="pill note">more than elsewhere' in page
    none = verdict_lines(verdict("complete", whereabouts=told[1:]))
    assert not any(line.startswith("more is left") for line in none)


def test_durations():
    assert [duration(s) for s in (0.4, 59.6, 125.0)] == ["0 s", "1 min 0 s", "2 min 5 s"]
