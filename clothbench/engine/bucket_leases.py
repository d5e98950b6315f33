"""Leases in a bucket: which cells commands of other machines are at. Advice, as in a folder: no result rests on it.

s3://BUCKET/PREFIX/leases/KEY    host and process of the command that is at a cell; gone when it is done with it

Whoever has a lease writes it anew every now and then, and the object store dates it. One whose date has not changed for
a while is of a command that has gone: dates are only held against each other, and no machine's clock is asked.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Iterator

from clothbench.core.errors import ClothbenchError
from clothbench.engine.bucket import Bucket, lease_object

STALE = 60.0  # s in which a lease was not written anew, after which it counts for nothing
LIST = 5.0  # s between two listings of all leases


class BucketLeases:
    """The leases that a command holds in a bucket. One that refuses something is not asked again."""

    def __init__(self, bucket: Bucket, text: str):
        self.bucket, self.text = bucket, text.encode()
        self.held: set[str] = set()
        self.refused = False
        self._dates: dict[str, object] = {}  # of all leases, by their names, when they were last listed
        self._unchanged: dict[str, tuple[object, float]] = {}  # date of a lease, and since when it is known here [s]
        self._listed = -math.inf
        self._held_or_not = threading.Lock()

    def take(self, key: str) -> bool:
        """Take the lease of a cell; False if a command of another machine has it."""
        name = lease_object(key)
        if self.refused or key in self.held:
            return True
        with self._asked():
            if self._live(name, LIST):
                return False
            created = self.bucket.create(name, self.text)
            if not created and name in self._dates and not self._live(name, 0.0):  # nor has another taken it over
                self.bucket.forget(name)
                created = self.bucket.create(name, self.text)
            if created:
                self.held.add(key)
            return created
        return True

    def renew(self) -> None:
        for key in list(self.held):
            with self._held_or_not, self._asked():
                if key in self.held and not self.refused:  # one that was given back meanwhile is not made again
                    self.bucket.replace(lease_object(key), self.text)

    def give_back(self, key: str) -> None:
        with self._held_or_not:
            if key in self.held:
                self.held.discard(key)
                self.bucket.forget(lease_object(key))

    def clear(self, key: str, text: str) -> None:
        """Delete the lease of a command that is known to have gone, by what it had written there."""
        name = lease_object(key)
        with self._asked():
            if not self.refused and self.bucket.read([name]).get(name) == text.encode():
                self.bucket.forget(name)

    def _live(self, name: str, age: float) -> bool:
        """Whether a lease is there and was lately written anew, by a listing that is not older than `age` [s]."""
        now = time.monotonic()
        if now - self._listed >= age:
            self._dates, self._listed = self.bucket.dates("leases"), now
        if name not in self._dates:
            return False
        date, since = self._unchanged.get(name, (None, now))
        if date != self._dates[name]:
            since = now
        self._unchanged[name] = self._dates[name], since
        return now - since < STALE

    @contextlib.contextmanager
    def _asked(self) -> Iterator[None]:
        try:
            yield
        except ClothbenchError:  # what does matter to a result says so itself, when that is published
            self.refused = True
