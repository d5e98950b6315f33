"""What several models lack in common, and what is a fault of one."""

from __future__ import annotations

from clothbench.studies.improve.common import common_document
from clothbench.studies.improve.page import common_html
from clothbench.studies.improve.terminal import verdict_lines
from clothbench.studies.improve.verdict import AT_LIMIT
from clothbench.studies.improve.words import sentence


def verdict(model, *effects, word=None, after=1.0):
    """A verdict with effects by name, or as (name, tied with, …)."""
    pairs = [(e, []) if isinstance(e, str) else (e[0], list(e[1:])) for e in effects]
    error = {
        "fit": {"before": 5.0, "after": after},
        "held_out": {"before": 5.0, "after": after, "ci95": [3.0, 5.0],
                     "per_recording": [{"recording": "a", "before": 5.0, "after": after}]},
        "noise": 0.5, "mesh": 0.2, "noise_floor": 0.54,
    }  # fmt: skip
    return {
        "model": model, "verdict": word or ("attributed" if effects else "unexplained"), "key": model, "hint": "",
        "effects": [
            {"name": name, "tied_with": tied, "place": "dynamics", "summary": name, "p_value": 0.005,
             "selected_in": "4/4", "parameters": {"size": {"value": 1.0, "low": 0.5, "high": 2.0, "unit": "1"}}}
            for name, tied in pairs
        ],
        "candidates": [{"name": name, "p_value": 0.01} for name, ties in pairs for name in (name, *ties)],
        "error_mm": error, "unexplained_mm": 0.5, "evaluations": 10, "wall_s": 60.0,
    }  # fmt: skip


def said(*documents):
    found = common_document(documents)
    return found["verdict"], [e["name"] for e in found["effects"]], {m["name"]: m["own"] for m in found["models"]}


def test_what_all_lack_is_common_and_what_one_lacks_its_own():
    springs = verdict("springs", "drag", "bending", after=2.0)
    triangles = verdict("triangles", "drag")
    assert said(springs, triangles) == ("attributed", ["drag"], {"springs": ["bending"], "triangles": []})
    found = common_document([springs, triangles])
    assert found["model"] == "triangles"  # it comes nearer
    assert found["evaluations"] == 20
    assert "springs lacks bending, which triangles does not lack: a fault of its own" in found["hint"]


def test_a_tie_holds_what_all_of_them_tie():
    both = verdict("a", ("drag", "memory")), verdict("b", ("memory", "drag"), after=2.0)
    found = common_document(both)
    assert (found["verdict"], found["effects"][0]["name"]) == ("tied", "drag")
    assert found["effects"][0]["tied_with"] == ["memory"]
    decided = common_document([verdict("a", ("drag", "memory")), verdict("b", "memory", after=2.0)])
    assert (decided["verdict"], decided["effects"][0]["name"]) == ("attributed", "memory")
    assert decided["effects"][0]["tied_with"] == []


def test_a_name_in_common_is_one_that_every_model_has():
    """None names first what they share: it is told without the amounts of another."""
    models = verdict("a", ("clock", "mount", "filter")), verdict("b", ("rate", "filter", "mount"), after=2.0)
    found = common_document(models)
    (entry,) = found["effects"]
    assert (found["verdict"], entry["name"], entry["tied_with"]) == ("tied", "mount", ["filter"])
    assert (entry["parameters"], entry["p_value"], entry["selected_in"]) == ({}, 0.01, "")
    assert "clock" not in sentence(found) + "".join(verdict_lines({**found, "models": []}))
    assert "lacks <b>mount</b>: each model has it tied with another name or <b>filter</b>" in common_html(found)


def test_a_name_in_common_is_told_once():
    models = verdict("a", ("clock", "grip"), "grip"), verdict("b", "grip", after=2.0)
    assert [(e["name"], e["tied_with"]) for e in common_document(models)["effects"]] == [("grip", [])]


def test_a_model_that_lacks_nothing_makes_the_lacks_of_others_their_own():
    assert said(verdict("a", "bending"), verdict("b", word="complete")) == ("complete", [], {"a": ["bending"], "b": []})


def test_a_model_without_a_name_neither_bears_out_nor_contradicts():
    silent = verdict("c", after=9.0)
    assert said(verdict("a", "drag"), verdict("b", "drag"), silent)[:2] == ("attributed", ["drag"])
    found = common_document([verdict("a", "drag"), silent])
    assert (found["verdict"], found["effects"]) == ("unexplained", [])
    assert "fewer than 2 models have something to say" in found["hint"]


def test_the_page_shows_every_model_and_where_its_own_page_is():
    page = common_html(common_document([verdict("springs", "drag", "bending"), verdict("triangles", "drag")]))
    for words in ("each of <b>springs, triangles</b> lacks <b>drag</b>", 'href="cells/springs/index.html"',
                  "drag, bending (bending: a fault of its own)", "5.00 → 1.00 mm"):  # fmt: skip
        assert words in page


def test_models_that_tie_nothing_the_same_have_nothing_in_common():
    """Each of two shares a name with the third, and no name is of all three."""
    best = verdict("a", after=0.5, word="tied")
    best["effects"] = verdict("", "drag")["effects"]
    best["effects"][0]["tied_with"] = ["memory", "lag"]
    assert said(best, verdict("b", "memory"), verdict("c", "lag"))[:2] == ("unexplained", [])


def test_the_page_says_that_each_lacks_something_else():
    found = common_document([verdict("springs", "bending"), verdict("triangles", "drag")])
    assert found["verdict"] == "unexplained"
    assert "lacks is nothing that they have in common" in common_html(found)
    assert "no effect can be named" not in common_html(found)


def test_where_nothing_is_in_common_the_errors_are_of_the_calibrated_fit():
    found = common_document([verdict("a", "drag"), verdict("b", after=5.0)])
    error = found["error_mm"]
    assert found["effects"] == []
    assert error["fit"]["after"] == error["fit"]["before"] == 5.0
    assert error["held_out"]["after"] == error["held_out"]["before"] == 5.0
    assert found["unexplained_mm"] > 4.9
    assert "only <b>a</b> has something to say" in sentence(found)
    assert "no effect can be named" not in sentence(found)


def test_a_model_that_only_recordings_held_out_speak_against_does_not_leave_nothing():
    documents = [verdict(name, after=0.55) for name in "ab"]
    for found, left in zip(documents, (9.0, 12.0), strict=True):
        found["error_mm"]["held_out"] |= {"before": left, "after": left}
        found["unexplained_mm"] = (left**2 - 0.54**2) ** 0.5
    assert "no more than noise" not in common_document(documents)["hint"]
    documents[1]["unexplained_mm"] = 0.0
    assert "b leaves no more than noise and mesh account for" in common_document(documents)["hint"]


def test_where_nothing_is_in_common_the_best_calibrated_model_stands():
    better = verdict("b", after=2.0)
    for split in ("fit", "held_out"):
        better["error_mm"][split]["before"] = 2.0
    found = common_document([verdict("a", "drag"), better])
    assert (found["model"], found["error_mm"]["held_out"]["after"]) == ("b", 2.0)


def test_a_calibrated_model_a_little_above_noise_and_mesh_leaves_nothing_beyond_them():
    models = [verdict("a", "drag"), verdict("b", "hem")]
    for found in models:
        found["error_mm"]["fit"]["before"] = 0.6  # beside 0.54
    assert common_document(models)["unexplained_mm"] == 0.0


def test_one_model_that_lacks_nothing_says_nothing_in_common():
    found = common_document([verdict("a", word="complete"), verdict("b")])
    assert found["verdict"] == "unexplained"
    assert "only <b>a</b> has something to say" in sentence(found)


def test_what_two_of_three_lack_is_no_fault_of_their_own():
    found = common_document([verdict("a", "drag"), verdict("b", "drag"), verdict("c", word="complete", after=5.0)])
    assert (found["verdict"], found["model"]) == ("complete", "c")
    assert [m["own"] for m in found["models"]] == [[], [], []]
    assert "a and b lack drag, which c does not lack" in found["hint"]
    assert "of its own" not in found["hint"]


def test_what_could_not_be_judged_is_not_said_to_be_below_the_mesh():
    found = verdict("a") | {"hint": f"{AT_LIMIT}, but r7, held out, could not be simulated with it"}
    found["unexplained_mm"] = 0.0
    found["error_mm"]["held_out"]["before"] = None
    assert "not all of it could be judged" in sentence(found)
    assert "so that nothing is named" not in sentence(found)


def test_models_that_leave_no_more_than_noise_and_mesh_are_told_so_and_each_by_its_own_numbers():
    """The sentence had the best model's number for each, beside a hint that all leave what they have no name for."""
    at_floor, above = verdict("a", after=0.55), verdict("b", after=2.0)
    at_floor["unexplained_mm"] = 0.0
    both = common_document([at_floor, at_floor | {"model": "b"}])
    assert "What each of <b>a, b</b> leaves is no more than noise and its mesh account for" in sentence(both)
    assert "a leaves no more than noise and mesh account for, and neither" in both["hint"]
    one = common_document([at_floor, above])
    assert sentence(one).startswith("None of a and b has a name for what it leaves: ")
    assert "b leaves what it has no name for" in one["hint"]
