"""Fits and probes that workers do before they are asked for: the same finding, to the last bit."""

from __future__ import annotations

import dataclasses
import pickle

import numpy as np
import pytest
from test_curves import problem_of, runs

from clothbench.core.parallel import set_thread_count
from clothbench.engine.checkpoint import Checkpoint
from clothbench.studies.improve.ahead import ahead
from clothbench.studies.improve.document import verdict_document
from clothbench.studies.improve.fitting import fit
from clothbench.studies.improve.loop import improve

CANDIDATES = ["strain_locking", "load_offset"]


class Elsewhere:
    """A worker that gets copies, one after the other from the last, and cannot do what is number `lost`."""

    def __init__(self, lost: int | None = None):
        self.lost, self.done = lost, []

    def __call__(self, pieces):
        for number, piece in reversed(list(enumerate(pieces))):
            found = pickle.loads(pickle.dumps(piece))(print, 1)
            self.done.append(piece.function.__name__)
            yield number, None if number == self.lost else found


@pytest.fixture(autouse=True)
def threads_as_before():
    yield
    set_thread_count(0)


def planted(folder=None, elsewhere=None):
    problem = problem_of(runs(0, lambda e: 0.05 * np.expm1(9 * e)))
    return dataclasses.replace(problem, checkpoint=Checkpoint(folder), elsewhere=elsewhere)


def document(problem):
    found = verdict_document(improve(problem, CANDIDATES))
    for name in ("wall_s", "stages"):  # how long it took
        found.pop(name, None)
    return found


@pytest.mark.parametrize("lost", [None, 0])
def test_the_finding_is_the_same_whoever_did_the_fits(tmp_path, lost):
    workers = Elsewhere(lost)
    assert document(planted(tmp_path, workers)) == document(planted())
    assert workers.done.count("fit") >= 4
    assert {"probe_candidate", "refit"} <= set(workers.done)


def test_what_workers_did_is_not_done_again(tmp_path, monkeypatch):
    workers = Elsewhere()
    problem = planted(tmp_path, workers)
    questions = [(problem.restricted(case), (), None, 3) for case in problem.of_split("fit")]
    ahead(fit, questions)
    assert workers.done == ["fit"] * len(questions)
    ahead(fit, questions)  # a run that was stopped and goes on
    assert workers.done == ["fit"] * len(questions)

    def search(*_):
        raise AssertionError("searched again")

    monkeypatch.setattr("clothbench.studies.improve.fitting.search", search)
    assert [fit(*question).evaluations > 0 for question in questions] == [True] * len(questions)


def test_a_stricter_goal_ends_a_search_that_is_known_where_it_would_have_ended_it(tmp_path, monkeypatch):
    names = ("strain_locking",)
    start = np.array(planted().space(names).defaults)
    whole = fit(planted(tmp_path), names, start, 8)
    goal = whole.rms**2 / 4
    anew = fit(planted(), names, start, 8, goal=goal)
    assert anew.evaluations < whole.evaluations
    monkeypatch.setattr("clothbench.studies.improve.fitting.search", None)
    known = fit(planted(tmp_path), names, start, 8, goal=goal)
    assert known.theta.tolist() == anew.theta.tolist()
    assert known.evaluations == anew.evaluations


def test_a_search_that_was_given_up_is_done_again_for_a_weaker_goal(tmp_path):
    names = ("strain_locking",)
    start = np.array(planted().space(names).defaults)
    whole = fit(planted(), names, start, 8)
    fit(planted(tmp_path), names, start, 8, goal=whole.rms**2 / 4)
    assert fit(planted(tmp_path), names, start, 8).theta.tolist() == whole.theta.tolist()


def test_what_fails_there_fails_here_where_it_is_asked(tmp_path):
    problem = dataclasses.replace(planted(tmp_path, Elsewhere()), optimizer="no_such")
    questions = [(problem.restricted(case), (), None, 3) for case in problem.of_split("fit")]
    ahead(fit, questions)
    with pytest.raises(Exception, match="no_such"):
        fit(*questions[0])
