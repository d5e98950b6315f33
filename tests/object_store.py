"""An object store of the tests' own: moto's S3 on the loopback address, and buckets in it."""

from __future__ import annotations

import itertools
import logging
import threading
from collections.abc import Callable, Iterator

import pytest

from clothbench.engine.mirror import results_folder
from clothbench.engine.store import Store

WHY = "moto, flask or s3fs is not installed: there is no object store to test with"
_numbers = itertools.count(1)


@pytest.fixture(scope="session")
def s3_server() -> Iterator[str]:
    """The endpoint of an S3 that honours If-None-Match, one request after the other."""
    server = pytest.importorskip("moto.server", reason=WHY)
    pytest.importorskip("s3fs", reason=WHY)
    from moto.s3.responses import S3Response

    put, lock = S3Response.put_object, threading.Lock()

    def alone(response):
        with lock:  # moto looks first and writes afterwards, and two who look at once both find nothing
            return put(response)

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    running = server.ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(S3Response, "put_object", alone)
        running.start()
        host, port = running.get_host_and_port()
        yield f"http://{host}:{port}"
        running.stop()


@pytest.fixture
def s3(s3_server, tmp_path, monkeypatch) -> str:
    """The address of results in a new bucket; the environment says how it is reached, and where its mirrors are."""
    import boto3

    monkeypatch.setenv("AWS_ENDPOINT_URL", s3_server)
    monkeypatch.setenv("AWS_ACCESS_KEY_ID", "anybody")
    monkeypatch.setenv("AWS_SECRET_ACCESS_KEY", "secret")
    monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
    monkeypatch.setenv("CLOTHBENCH_CACHE", str(tmp_path / "cache"))
    name = f"cloth-{next(_numbers)}"
    boto3.client("s3").create_bucket(Bucket=name)
    return f"s3://{name}/runs"


@pytest.fixture
def machine(s3, tmp_path, monkeypatch) -> Callable[[str], Store]:
    """The store of a bucket as a machine of some name has it, with a cache of its own."""

    def at(name: str) -> Store:
        monkeypatch.setenv("CLOTHBENCH_CACHE", str(tmp_path / name))
        store = Store(results_folder(s3))
        assert store.bucket is not None
        return store

    return at
