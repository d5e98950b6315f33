"""Work side by side: results in order, faults raised, and never more at a time than there are places."""

import threading
import time

import pytest

from clothbench.core import parallel
from clothbench.core.parallel import for_each, set_thread_count, share_cores, side_by_side, thread_count


@pytest.fixture(autouse=True)
def two_threads():
    set_thread_count(2)
    yield
    set_thread_count(0)


def test_results_come_in_order():
    assert side_by_side(lambda n: n * n, range(7)) == [0, 1, 4, 9, 16, 25, 36]


def test_a_fault_is_raised_here():
    with pytest.raises(ZeroDivisionError):
        side_by_side(lambda n: 1 // n, [1, 0, 2])


def test_no_more_at_a_time_than_threads():
    running, most, lock = 0, 0, threading.Lock()

    def work(_: int) -> None:
        nonlocal running, most
        with lock:
            running += 1
            most = max(most, running)
        time.sleep(0.002)
        with lock:
            running -= 1

    side_by_side(lambda _: for_each(work, range(4)), range(5))
    assert running == 0
    assert most == 2


@pytest.mark.parametrize("inner", [for_each, side_by_side])
def test_inside_of_itself_it_does_not_wait_for_ever(inner):
    done = []
    works = threading.Thread(
        target=lambda: for_each(lambda n: inner(lambda _: for_each(done.append, [n, n]), range(3)), range(4)),
        daemon=True,
    )
    works.start()
    works.join(20)
    assert sorted(done) == sorted(6 * [0, 1, 2, 3])


def test_who_is_left_has_all_the_cores(monkeypatch):
    """Several processes share the cores by how many of them are at work at the time."""
    monkeypatch.setattr(parallel, "available_cores", lambda: 6)
    monkeypatch.setattr(parallel, "_share", parallel._share)
    set_thread_count(0)
    at_work = 4
    share_cores(lambda: at_work)
    assert thread_count() == 1
    at_work = 2
    assert thread_count() == 3
    at_work = 1
    assert thread_count() == 6
