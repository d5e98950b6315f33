"""An object store as the place of results: results are created once, read and listed, never replaced.

s3://BUCKET/PREFIX/cells/KEY.zip             a finished cell: the files of its folder
s3://BUCKET/PREFIX/errors/KEY/ATTEMPT.zip    an attempt at a cell that ended in an error, under a key of its own
s3://BUCKET/PREFIX/leases/KEY                no result: that a command is at a cell (`clothbench.engine.bucket_leases`)

What is in a bucket is read from its mirror, a folder of this machine (`clothbench.engine.mirror`).
"""

from __future__ import annotations

import contextlib
import errno
import functools
import importlib.util
import threading
import uuid
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from clothbench.core.create_only import AT_ONCE, at_once
from clothbench.core.errors import ClothbenchError

STORES = {"s3": "s3fs", "gs": "gcsfs"}  # by scheme: what fsspec reaches it with
MIRRORS = "stores"  # folder of all mirrors, in the cache
MARK = "bucket"  # file of a mirror that says what it mirrors
ATTEMPT = "attempt"  # file of a cell that ended in an error: which attempt that was
TRIES = 3  # of a create that the store answers with "busy", as S3 does where two of them meet


def is_address(text: object) -> bool:
    """Whether this names an object store and no folder."""
    return "://" in str(text)


def address_of(text: str) -> str:
    """An address as it is kept, without a slash at its end; a wrong one is a ClothbenchError."""
    scheme, _, rest = text.partition("://")
    if scheme not in STORES or not rest.strip("/") or set("*?[") & set(rest):
        raise ClothbenchError(f"{text}: found no place of results, expected a folder or s3://BUCKET/PREFIX")
    if importlib.util.find_spec(STORES[scheme]) is None:
        extra = "'clothbench[object]'" if scheme == "s3" else STORES[scheme]
        raise ClothbenchError(f"{text}: found no {STORES[scheme]}, which is needed for it: pip install {extra}")
    return text.rstrip("/")


def attempt_name() -> str:
    """Of an attempt: when it ended, and a word that no other has; the last one is the latest."""
    return f"{datetime.now(UTC):%Y%m%dT%H%M%S%fZ}-{uuid.uuid4().hex[:8]}"


def cell_object(key: str) -> str:
    return f"cells/{key}.zip"


def error_object(key: str, attempt: str) -> str:
    return f"errors/{key}/{attempt}.zip"


def lease_object(key: str) -> str:
    return f"leases/{key}"


def mirrors() -> Path:
    """The folder of all mirrors of this machine."""
    from clothbench.datasets.registry import cache_folder

    return cache_folder() / MIRRORS


def mirrored(folder: Path) -> Bucket | None:
    """What a folder is the mirror of; None of any other, whatever a file in it may say."""
    above = folder.resolve().parent
    if above.name != MIRRORS or above != mirrors().resolve():
        return None
    try:
        return Bucket((folder / MARK).read_text())
    except FileNotFoundError:  # or else what is put there would look as if it were published
        raise ClothbenchError(
            f"{folder}: found that this mirror of a bucket was deleted meanwhile, expected it as it was; run the same "
            "command again"
        ) from None


class Bucket:
    """The objects below one address. Whatever goes wrong on the way there is a ClothbenchError, one line."""

    def __init__(self, address: str):
        self.address = address_of(address)
        self._scheme, _, self._root = self.address.partition("://")

    def create(self, name: str, content: bytes) -> bool:
        """Create an object, whole or not at all; False if there is one of that name, which stays as it is."""
        with self._reached():
            for tried in range(1, TRIES + 1):
                try:
                    self._files.pipe_file(f"{self.address}/{name}", content, mode="create")
                    return True
                except OSError as fault:  # stores say in many ways that something is there; or it is our own, and
                    if isinstance(fault, FileExistsError) or self.there(name):  # the answer was lost: who asks compares
                        return False
                    if fault.errno != errno.EBUSY or tried == TRIES:
                        raise
        raise AssertionError("the loop returns or raises")

    def there(self, name: str) -> bool:
        with self._reached():
            return bool(self._files.exists(f"{self.address}/{name}"))

    def read(self, names: Sequence[str]) -> dict[str, bytes]:
        """The content of objects by name, of those that are there, read at the same time."""
        with self._reached():
            paths = {f"{self._root}/{name}": name for name in names}
            found = self._files.cat(list(paths), on_error="return") if paths else {}
            faults = [f for f in found.values() if isinstance(f, Exception) and not isinstance(f, FileNotFoundError)]
            if faults:
                raise faults[0]
            return {paths[path]: content for path, content in found.items() if isinstance(content, bytes)}

    def names(self, below: str) -> list[str]:
        """Names of all objects below one of them, in order."""
        with self._reached():
            return sorted(path[len(self._root) + 1 :] for path in self._files.find(f"{self.address}/{below}"))

    def dates(self, below: str) -> dict[str, object]:
        """When each object below one of them was written, as the object store says it, by its name."""
        with self._reached():
            found = self._files.find(f"{self.address}/{below}", detail=True)
            return {
                path[len(self._root) + 1 :]: of.get("LastModified", of.get("updated")) for path, of in found.items()
            }

    def replace(self, name: str, content: bytes) -> None:
        """Write an object that is no result anew."""
        with self._reached():
            self._files.pipe_file(f"{self.address}/{name}", content)

    def forget(self, name: str) -> None:
        """Delete an object that is no result; who may not delete leaves it there."""
        with contextlib.suppress(Exception):
            self._files.rm_file(f"{self.address}/{name}")

    @property
    def identity(self) -> list[str]:
        """What tells this place from all others: the same address may mean another one at another endpoint."""
        with self._reached():
            client = getattr(self._files, "s3", None)  # of S3 alone; others have but one
            return [self.address, str(client.meta.endpoint_url) if client is not None else ""]

    @property
    def _files(self) -> Any:
        return _files(self._scheme)

    @contextlib.contextmanager
    def _reached(self) -> Iterator[None]:
        """Makes one line of what the libraries on the way raise, of which there is no list."""
        try:
            yield
        except ClothbenchError:
            raise
        except Exception as fault:
            said = (str(fault).splitlines() or [""])[0].strip() or type(fault).__name__
            raise ClothbenchError(
                f"{self.address}: found that it cannot be used ({said}), expected {_expected(fault)}; nothing half-"
                "written is left: run the same command again"
            ) from fault


def _expected(fault: Exception) -> str:
    kind = type(fault).__name__
    if isinstance(fault, FileNotFoundError):
        return "a bucket that is there; make it, or give another with out=s3://BUCKET/PREFIX"
    if isinstance(fault, PermissionError) or "Credential" in kind or "Token" in kind:
        return "credentials that may list, read and write it (AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, AWS_PROFILE)"
    if getattr(fault, "errno", None) == errno.ENOSYS:
        return "an object store that honours If-None-Match"
    return "an endpoint that answers (AWS_ENDPOINT_URL where it is not Amazon's)"


@functools.cache
def _files(scheme: str) -> Any:
    """What fsspec reaches the objects with; settings of the user's own (FSSPEC_S3_…, files of fsspec and AWS) count."""
    import fsspec
    from fsspec.config import conf

    options: dict[str, Any] = {"use_listings_cache": False}
    if scheme == "s3":  # as many connections as there are threads in the probe
        options["config_kwargs"] = {"max_pool_connections": AT_ONCE, **conf.get("s3", {}).get("config_kwargs", {})}
    return fsspec.filesystem(scheme, **options)


# --- the probe ------------------------------------------------------------------------------------------------------


@functools.cache
def require_conditional(address: str) -> None:
    """Try an object store out, once in a process: of sixteen who create one object at once, one must come first.

    Raises a ClothbenchError, one line, where that is not so, and where it cannot be written to.
    """
    bucket, name = Bucket(address), f"probe/{attempt_name()}"
    first = _creates(bucket, name)
    bucket.forget(name)
    if first != 1:
        raise ClothbenchError(
            f"{address}: found an object store in which {first} of {AT_ONCE} creates of one object succeeded, expected "
            "exactly one, or commands that share it would lose results; give one that honours If-None-Match (Amazon "
            "S3, newer versions of MinIO and others)"
        )


def _creates(bucket: Bucket, name: str) -> int:
    """How many of those who create an object at once are told that they came first, where its content is theirs."""
    ready = threading.Barrier(AT_ONCE)

    def create(number: int) -> bool:
        ready.wait()
        return bucket.create(name, str(number).encode())

    won = [number for number, first in enumerate(at_once(create, list(range(AT_ONCE)))) if first]
    if len(won) == 1 and bucket.read([name]).get(name) != str(won[0]).encode():
        return AT_ONCE  # one was told that it came first, and yet another one's content is there
    return len(won)
