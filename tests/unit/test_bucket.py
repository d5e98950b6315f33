"""Results in an object store: created once, whole or not at all, the same from every machine."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
import zipfile

import pytest

from clothbench import ClothbenchError
from clothbench.cli import main
from clothbench.core.packed import packed, unpacked
from clothbench.engine import bucket as buckets
from clothbench.engine.bucket import Bucket, mirrored, require_conditional
from clothbench.engine.disagreement import recorded
from clothbench.engine.leaderboard import ROW
from clothbench.engine.mirror import mirror_of, pull, results_folder
from clothbench.engine.store import Store

KEYS = [f"{n:016x}" for n in range(3)]


def row(key, value=1.0, **changes):
    about = {"suite": "s", "case": "c", "model": "m", "study": "calibration", "status": "ok", "key": key}
    return {**dict.fromkeys(ROW), **about, "value": value, **changes}


def put(store, key, value=1.0, **changes):
    return store.put(key, {"rows": [row(key, value, **changes)], "trace": [{"time": float(k)} for k in range(50)]})


@pytest.fixture
def machines(machine):
    """Stores of one bucket as two machines have them, each with a cache of its own."""
    return machine("one"), machine("other")


def values(store, monkeypatch, refresh=True):
    monkeypatch.setenv("CLOTHBENCH_CACHE", str(store.folder.parents[1]))
    if refresh:
        pull(store)
    return {r["key"]: r["value"] if r["status"] == "ok" else r["reason"] for r in store.rows()}


# --- what is promised of the store ------------------------------------------------------------------------------------


def test_what_one_machine_puts_the_other_finds(machines, s3, monkeypatch):
    one, other = machines
    folder = put(one, KEYS[0])
    assert Bucket(s3).names("") == [f"cells/{KEYS[0]}.zip"]
    assert values(other, monkeypatch, refresh=False) == {}
    assert values(other, monkeypatch) == {KEYS[0]: 1.0}
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == {
        p.name: p.read_bytes() for p in other.cell(KEYS[0]).iterdir()
    }
    assert other.has(KEYS[0])
    assert one.address == other.address == s3


def test_the_second_of_a_cell_takes_the_first_and_a_disagreement_is_told(machines, s3, monkeypatch):
    one, other = machines
    put(one, KEYS[0], 1.0)
    put(other, KEYS[0], 1.0)
    put(one, KEYS[1], 1.0)
    before = Bucket(s3).read([f"cells/{KEYS[1]}.zip"])
    with pytest.warns(
        UserWarning, match=rf"{s3}/cells/{KEYS[1]}.zip: computed twice, first \[1.0\], which stays, then"
    ):
        put(other, KEYS[1], 2.0)
    assert Bucket(s3).read([f"cells/{KEYS[1]}.zip"]) == before
    assert values(other, monkeypatch, refresh=False) == {KEYS[0]: 1.0, KEYS[1]: 1.0}
    (record,) = other.disagreements()
    values(one, monkeypatch)
    assert [recorded(path) for path in one.disagreements()] == [recorded(record)] == [([1.0], [2.0], [])]
    (name,) = Bucket(s3).names("disagreements")
    Bucket(s3).forget(name)
    values(one, monkeypatch)
    assert one.disagreements() == []


def test_errors_have_keys_of_their_own_and_give_way_to_a_result(machines, s3, monkeypatch):
    one, other = machines
    put(one, KEYS[0], None, status="error", reason="first")
    put(other, KEYS[0], None, status="error", reason="second")
    assert values(one, monkeypatch) == {KEYS[0]: "second"}
    assert not one.has(KEYS[0])
    put(one, KEYS[0], 3.0)
    assert values(other, monkeypatch) == {KEYS[0]: 3.0}
    names = Bucket(s3).names("")
    assert [name.split("/")[0] for name in names] == ["cells", "errors", "errors"]
    put(other, KEYS[0], None, status="error", reason="too late")
    assert values(other, monkeypatch) == {KEYS[0]: 3.0}


WRITES = """
import sys
from clothbench.engine.mirror import results_folder
from clothbench.engine.leaderboard import ROW
from clothbench.engine.store import Store
store = Store(results_folder(sys.argv[1]))
for k in range(20):
    status = "error" if k < 10 else "ok"
    about = {**dict.fromkeys(ROW), "suite": "s", "case": "c", "model": "m"}
    row = {**about, "status": status, "value": float(k), "key": f"{k % 10:04x}"}
    store.put(row["key"], {"rows": [row]})
"""


def test_processes_on_machines_of_their_own_write_the_same_cells(s3, tmp_path):
    writers = [
        subprocess.Popen(
            [sys.executable, "-c", WRITES, s3], stderr=subprocess.PIPE, text=True,
            env={**os.environ, "CLOTHBENCH_CACHE": str(tmp_path / str(number))},
        )
        for number in range(3)
    ]  # fmt: skip
    assert [writer.communicate()[1] for writer in writers] == [""] * 3
    assert sorted(r["value"] for r in Store(results_folder(s3)).rows()) == list(range(10, 20))
    assert len(Bucket(s3).names("cells")) == 10
    assert len(Bucket(s3).names("errors")) == 30


DIES = """
import os, signal, sys
from clothbench.engine.bucket import Bucket
from clothbench.engine.mirror import results_folder
from clothbench.engine.leaderboard import ROW
from clothbench.engine.store import Store
create = Bucket.create

def dies(self, name, content):
    if sys.argv[2] == "after":
        create(self, name, content)
    os.kill(os.getpid(), signal.SIGKILL)

store = Store(results_folder(sys.argv[1]))
Bucket.create = dies
about = {**dict.fromkeys(ROW), "suite": "s", "case": "c", "model": "m"}
store.put("0a", {"rows": [{**about, "status": "ok", "value": 1.0, "key": "0a"}]})
"""


@pytest.mark.parametrize(("when", "published"), [("before", 0), ("after", 1)])
def test_a_process_killed_while_it_publishes_leaves_a_whole_cell_or_none(s3, when, published, monkeypatch):
    killed = subprocess.run([sys.executable, "-c", DIES, s3, when], capture_output=True, text=True, check=False)
    assert killed.returncode == -9, killed.stderr
    store = Store(mirror_of(s3))
    assert not store.has("0a")  # nothing half-written counts here
    assert values(store, monkeypatch) == ({"0a": 1.0} if published else {})
    put(store, "0a")
    assert values(store, monkeypatch) == {"0a": 1.0}
    assert main(["store", "check", s3]) == 0


def test_a_mirror_follows_what_is_deleted_and_is_made_anew_when_it_is_lost(machines, s3, monkeypatch):
    one, _ = machines
    put(one, KEYS[0])
    put(one, KEYS[1])
    Bucket(s3).forget(f"cells/{KEYS[0]}.zip")  # a user, with the tools of the store
    assert values(one, monkeypatch) == {KEYS[1]: 1.0}


def test_a_listing_of_more_than_one_page_is_whole(s3, tmp_path):
    from moto.core import DEFAULT_ACCOUNT_ID
    from moto.s3.models import s3_backends

    store, keys = Store(mirror_of(s3)), [f"{n:016x}" for n in range(1001)]  # a page has 1,000 names
    content = packed({p.name: p.read_bytes() for p in put(Store(tmp_path / "other"), "0a").iterdir()})
    backend, name = s3_backends[DEFAULT_ACCOUNT_ID]["aws"], s3.split("/")[2]
    for key in keys:
        backend.put_object(name, f"runs/cells/{key}.zip", content)
        if key != keys[-1]:
            store.cell(key).mkdir(parents=True)
    assert pull(store) == {}
    assert sorted(os.listdir(store.folder / "cells")) == keys
    assert os.listdir(store.cell(keys[0])) == []  # what is here is not read again
    assert store.cell(keys[-1]).joinpath("rows.parquet").is_file()


# --- what is refused --------------------------------------------------------------------------------------------------


def test_the_probe_lets_one_of_sixteen_through_and_leaves_nothing(s3):
    require_conditional(s3)
    assert Bucket(s3).names("") == []


def test_a_store_that_does_not_keep_the_condition_is_refused(s3, monkeypatch, recordings_folder, tmp_path, capsys):
    from moto.s3.responses import S3Response

    put_object = S3Response.put_object

    def whatever(response):
        response.headers = {name: value for name, value in response.headers.items() if name != "If-None-Match"}
        return put_object(response)

    require_conditional.cache_clear()
    monkeypatch.setattr(S3Response, "put_object", whatever)
    run = ["run", f"recording={recordings_folder / 'sway-1.nc'}", "model=mass_spring", "optimizer=nelder_mead"]
    assert main([*run, "metric=node_error", "budget=3", "rerun=false", f"out={s3}"]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"clothbench: {s3}: found an object store in which 16 of 16 creates of one object succeeded")
    assert said.count("\n") == 1
    assert Bucket(s3).names("") == []


@pytest.mark.parametrize(
    ("address", "environment", "says"),
    [
        ("s3://no-such-bucket/runs", {}, "specified bucket does not exist), expected a bucket that is there"),
        ("s3://cloth/runs", {"AWS_ENDPOINT_URL": "http://127.0.0.1:9"}, "expected an endpoint that answers"),
        ("s3://cloth/runs", {"AWS_ACCESS_KEY_ID": "", "AWS_SECRET_ACCESS_KEY": ""}, "expected credentials that may"),
        ("ftp://cloth/runs", {}, "expected a folder or s3://BUCKET/PREFIX"),
        ("s3://cloth/*", {}, "expected a folder or s3://BUCKET/PREFIX"),
    ],
)
def test_what_cannot_be_reached_is_one_line(clothbench, s3, recordings_folder, tmp_path, address, environment, says):
    words = ["model=mass_spring", "optimizer=ga", "metric=node_error", "budget=3", "rerun=false", f"out={address}"]
    bare = {"AWS_MAX_ATTEMPTS": "1", "AWS_EC2_METADATA_DISABLED": "true", "HOME": str(tmp_path), **environment}
    for command in (["run", f"recordings={recordings_folder}", *words], ["leaderboard", "--out", address]):
        out = clothbench(*command, **bare)
        assert out.returncode == 2, out.stdout
        assert says in out.stderr
        assert out.stderr.count("\n") == 1
    assert {p.name for p in tmp_path.iterdir() if p.name[0] != "."} <= {"cache", "recordings"}


def test_a_missing_extra_is_one_line(monkeypatch):
    monkeypatch.setattr(buckets.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ClothbenchError, match=r"found no s3fs, .* pip install 'clothbench\[object\]'"):
        Bucket("s3://cloth/runs")


def test_an_address_where_a_folder_belongs_is_one_line(s3, capsys):
    with pytest.raises(ClothbenchError, match="found an address, expected a folder"):
        Store("s3:/cloth/runs")
    assert main(["leaderboard", "--out", s3]) == 2
    assert f"{s3}: found no results" in capsys.readouterr().err


def test_a_mirror_that_goes_while_it_is_in_use_is_one_line(s3):
    store = Store(mirror_of(s3))
    shutil.rmtree(store.folder)
    with pytest.raises(ClothbenchError, match="this mirror of a bucket was deleted meanwhile"):
        put(store, KEYS[0])


def test_a_folder_of_others_is_no_mirror_whatever_it_says(s3, tmp_path):
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "bucket").write_text(s3)
    assert mirrored(tmp_path / "runs") is None
    put(Store(tmp_path / "runs"), KEYS[0])
    assert Bucket(s3).names("") == []


@pytest.mark.parametrize("name", ["../out", "/out", "a/../../out", "C:/out", "a\\out", "folder/"])
def test_an_archive_that_reaches_out_of_its_folder_is_refused(name):
    with pytest.raises(ClothbenchError, match="is no file below its folder"):
        unpacked(packed({name: b"x"}), "here")


@pytest.mark.parametrize("names", [("a/b", "a"), ("a", "a/b"), ("a/b", "a//b")], ids=" ".join)
def test_files_that_would_take_each_others_place_are_refused(names):
    with pytest.raises(ClothbenchError, match="two files that would take each other's place"):
        unpacked(packed(dict.fromkeys(names, b"x")), "here")


def test_archives_that_are_broken_or_compressed_are_refused():
    made = io.BytesIO()
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("bomb", b"0" * 1_000_000)
    with pytest.raises(ClothbenchError, match=r"here: found no archive that can be read .*is compressed"):
        unpacked(made.getvalue(), "here")
    whole = packed({"rows.parquet": b"0123456789"})
    for broken in (b"", whole[:20], whole[:-1], whole.replace(b"345", b"354")):
        with pytest.raises(ClothbenchError, match="here: found no archive that can be read"):
            unpacked(broken, "here")
    assert unpacked(whole, "here") == {"rows.parquet": b"0123456789"}


# --- upkeep -----------------------------------------------------------------------------------------------------------


def test_check_reads_every_object_anew(machines, s3, capsys, monkeypatch):
    one, _ = machines
    monkeypatch.setenv("CLOTHBENCH_CACHE", str(one.folder.parents[1]))
    put(one, KEYS[0])
    assert main(["store", "check", s3]) == 0
    assert capsys.readouterr().out == f"{s3}: ok\n"
    (one.cell(KEYS[0]) / "rows.parquet").write_bytes(b"PAR1")  # a fault of the mirror alone is mended
    assert main(["store", "check", s3]) == 0
    capsys.readouterr()
    Bucket(s3).create(f"cells/{KEYS[1]}.zip", b"no archive")
    assert main(["store", "check", s3, "--json"]) == 1
    (found,) = json.loads(capsys.readouterr().out)
    assert found["line"].startswith(f"{s3}/cells/{KEYS[1]}.zip: found no archive that can be read")
    assert main(["leaderboard", "--out", s3]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_merge_from_a_folder_into_a_bucket_and_back(machines, s3, tmp_path, capsys):
    _, store = machines
    folder = Store(tmp_path / "a")
    put(folder, KEYS[0])
    put(folder, KEYS[1], None, status="error", reason="no memory")
    put(folder, KEYS[2], 2.0)
    put(store, KEYS[2], 1.0)
    assert main(["store", "merge", str(folder.folder), s3]) == 1
    out = capsys.readouterr().out
    assert f"{s3}: 2 cells taken, 0 there already, 0 errors left out, 1 faults" in out
    assert "found [1.0], which stays, and [2.0]" in out
    assert main(["store", "merge", s3, str(tmp_path / "b")]) == 0
    assert {r["key"]: r["value"] for r in Store(tmp_path / "b").rows()} == {KEYS[0]: 1.0, KEYS[1]: None, KEYS[2]: 1.0}
    assert main(["store", "merge", s3, s3]) == 2
    assert main(["store", "prune", s3, "--cell", KEYS[0]]) == 2
    assert main(["store", "prune", s3]) == 0
    assert len(Bucket(s3).names("cells")) == 2
