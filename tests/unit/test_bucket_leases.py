"""Machines that work in one bucket share its cells by leases there; no clock of a machine's is asked, nothing fails."""

from __future__ import annotations

import datetime
from types import SimpleNamespace

import pytest

from clothbench.core.errors import ClothbenchError
from clothbench.engine import bucket_leases, leases
from clothbench.engine.bucket import Bucket
from clothbench.engine.leaderboard import ROW
from clothbench.engine.leases import Leases, Line

KEYS = [f"{n:016x}" for n in range(8)]


@pytest.fixture
def machines(machine, monkeypatch):
    """The leases of two machines, each with a mirror of its own."""
    monkeypatch.setattr(bucket_leases, "LIST", -1.0)  # every look is a listing
    with Leases(machine("one")) as one, Leases(machine("other")) as other:
        yield one, other


def put(store, key):
    store.put(
        key,
        {
            "rows": [
                {
                    **dict.fromkeys(ROW),
                    "suite": "s",
                    "case": "c",
                    "model": "m",
                    "status": "ok",
                    "value": 1.0,
                    "key": key,
                }
            ]
        },
    )


def test_what_one_machine_has_the_other_does_not_get_until_it_is_given_back(machines, s3):
    one, other = machines
    assert one.take(KEYS[0])
    assert one.take(KEYS[0])
    assert not other.take(KEYS[0])
    assert other.held == set()
    other.give_back(KEYS[0])  # which is not its own
    assert Bucket(s3).names("leases") == [f"leases/{KEYS[0]}"]
    one.give_back(KEYS[0])
    assert Bucket(s3).names("leases") == []
    assert other.take(KEYS[0])


def test_two_machines_compute_every_cell_once(machines):
    computed, taken = [], []
    lines = [Line(KEYS, held, str, taken.append) for held in machines]
    while any(lines):
        begun = []
        for line in lines:
            line._looked = float("-inf")
            begun.append(line.begin())
        for line, key in zip(lines, begun, strict=True):
            if key is not None:
                put(line.leases.store, key)
                line.leases.give_back(key)
                computed.append(key)
    assert sorted(computed) == KEYS
    assert sorted(taken) == KEYS  # the other machine's, each of which was brought here


def dated(s3, key, days):
    """Let an object store whose clock is so many days off date a lease anew."""
    from moto.s3.models import s3_backends

    bucket, _, prefix = s3.removeprefix("s3://").partition("/")
    (backend,) = [b for account in s3_backends.values() for b in account.values() if bucket in b.buckets]
    found = backend.buckets[bucket].keys[f"{prefix}/leases/{key}"]
    found.last_modified = found.last_modified + datetime.timedelta(days=days)


@pytest.mark.parametrize("days", [-400, 400])
def test_a_lease_counts_for_as_long_as_it_is_dated_anew_by_whatever_clock(machines, s3, monkeypatch, days):
    one, other = machines
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(bucket_leases, "time", SimpleNamespace(monotonic=lambda: clock.now))
    assert one.take(KEYS[0])
    dated(s3, KEYS[0], days)
    assert not other.take(KEYS[0])
    clock.now = 50.0
    dated(s3, KEYS[0], 1e-3)
    assert not other.take(KEYS[0])
    clock.now = 100.0
    assert not other.take(KEYS[0])
    clock.now = 115.0  # and 65 s after it was last seen to be written anew
    assert other.take(KEYS[0])
    assert Bucket(s3).names("leases") == [f"leases/{KEYS[0]}"]


def test_a_stale_lease_that_another_machine_has_taken_over_is_left_to_it(machines, s3, monkeypatch):
    one, other = machines
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(bucket_leases, "time", SimpleNamespace(monotonic=lambda: clock.now))
    assert one.take(KEYS[0])
    assert not other.take(KEYS[0])
    clock.now = 65.0
    assert not other.shared._live(f"leases/{KEYS[0]}", 0.0)
    dated(s3, KEYS[0], 1e-3)
    monkeypatch.setattr(bucket_leases, "LIST", 5.0)  # what was just listed is not listed anew
    assert not other.take(KEYS[0])
    assert other.held == other.shared.held == set()


def test_a_lease_is_renewed_while_it_is_held_and_not_afterwards(machines, s3):
    one, _ = machines
    assert one.take(KEYS[0])
    dated(s3, KEYS[0], -1)
    before = Bucket(s3).dates("leases")
    one.shared.renew()
    assert Bucket(s3).dates("leases") != before
    one.give_back(KEYS[0])
    one.shared.renew()
    assert Bucket(s3).names("leases") == []


def test_the_lease_of_a_process_of_this_machine_that_has_gone_is_free_at_once(machines, s3, monkeypatch):
    one, _ = machines
    assert one.take(KEYS[0])
    with Leases(one.store) as again:
        assert not again.take(KEYS[0])
        monkeypatch.setattr(leases, "live", lambda path: False)  # as one that was killed
        assert again.take(KEYS[0])


def test_a_bucket_that_takes_no_leases_stops_nobody_and_is_not_asked_again(machines, monkeypatch):
    asked = []

    def refuses(*_):
        asked.append(1)
        raise ClothbenchError("no right to")

    monkeypatch.setattr(Bucket, "create", refuses)
    one, other = machines
    assert one.take(KEYS[0])
    assert one.take(KEYS[1])
    assert other.take(KEYS[0])
    assert len(asked) == 2
    one.give_back(KEYS[0])


def test_what_another_machine_has_finished_is_brought_before_the_cell_is_begun(machines):
    one, other = machines
    put(one.store, KEYS[0])
    taken = []
    line = Line(KEYS[:2], other, str, taken.append)
    assert line.begin() == KEYS[1]
    assert taken == [KEYS[0]]
    assert other.held == {KEYS[1]}
