"""Where data sets come from: pinned addresses, hashes, local copies, and fetching; without the net."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import pytest

from clothbench.cli.listings import dataset_rows
from clothbench.core.errors import ClothbenchError
from clothbench.datasets import registry
from clothbench.datasets.convert import converted

NAME = "iri_wam_cloth_swing"


@pytest.fixture
def small(monkeypatch):
    """The real entry cut down to two files with known bytes."""
    contents = {"Session_A/one_mesh.csv": b"one", "Session_A/two_tcp.csv": b"two"}
    files = {k: (f"a folder/{k}", hashlib.sha256(v).hexdigest()) for k, v in contents.items()}
    entry = replace(registry.DATASETS[NAME], files=files)
    monkeypatch.setattr(registry, "DATASETS", {NAME: entry})
    return entry, contents


def test_addresses_are_pinned_and_quoted():
    entry = registry.DATASETS[NAME]
    local = "Session_2021_07_05/range30_rep1_mesh.csv"
    assert entry.url(local) == (
        "https://raw.githubusercontent.com/Alados5/tfm_matlab/ea4056cea9b43a12f9a3ba538087f97101767305/"
        "learn_model/Gathered%20Data/Session_2021_07_05/Converted%20CSV/range30_rep1_mesh.csv"
    )
    assert all(len(digest) == 64 for _, digest in entry.files.values())
    assert entry.importer == "clothbench.datasets.iri_wam_cloth_swing:convert"


def test_a_file_is_no_folder_for_recordings(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(
        ClothbenchError, match="file: found files that no import made, expected an empty folder; give out="
    ):
        converted(NAME, out=str(tmp_path / "file"))


def test_unknown_data_set_names_the_known_ones():
    with pytest.raises(ClothbenchError, match="known: cusick_drape_bdp, iri_wam_cloth_swing"):
        registry.dataset("nothing")


def test_local_copy_is_found_in_or_as_the_folder(tmp_path, monkeypatch):
    monkeypatch.delenv(registry.ENVIRONMENT, raising=False)
    assert registry.local_copy(NAME) is None
    session = tmp_path / "iri-wam-cloth-swing" / "Session_2021_07_06"
    folder = session.parent
    session.mkdir(parents=True)
    (session / "range30_rep1_mesh.csv").touch()
    assert registry.local_copy(NAME, tmp_path) == folder
    assert registry.local_copy(NAME, folder) == folder
    monkeypatch.setenv(registry.ENVIRONMENT, str(tmp_path))
    assert registry.local_copy(NAME) == folder
    (tmp_path / "empty").mkdir()
    with pytest.raises(ClothbenchError, match="found no 'iri-wam-cloth-swing'"):
        registry.local_copy(NAME, tmp_path / "empty")
    with pytest.raises(ClothbenchError, match="is not a folder"):
        registry.local_copy(NAME, tmp_path / "absent")


def test_changed_bytes_are_refused_and_unknown_files_named(tmp_path, small):
    for local, content in {**small[1], "Session_A/more_mesh.csv": b"?"}.items():
        (tmp_path / local).parent.mkdir(exist_ok=True)
        (tmp_path / local).write_bytes(content + b"!" * local.startswith("Session_A/two"))
    check = registry.verify(NAME, tmp_path)
    assert check.unknown == {"Session_A/more_mesh.csv"}
    assert check.wrong == {"Session_A/two_tcp.csv"}


def test_files_that_the_pattern_does_not_name_are_checked_too(tmp_path, monkeypatch):
    content = {"clouds/0.pt": b"cloud", "camera.json": b"camera"}
    files = {k: (k, hashlib.sha256(v).hexdigest()) for k, v in content.items()}
    monkeypatch.setattr(
        registry, "DATASETS", {NAME: replace(registry.DATASETS[NAME], files=files, pattern="clouds/*.pt")}
    )
    (tmp_path / "clouds").mkdir()
    for local, stored in {**content, "camera.json": b"another"}.items():
        (tmp_path / local).write_bytes(stored)
    assert registry.verify(NAME, tmp_path) == registry.Check(frozenset(), frozenset({"camera.json"}))


def with_small_importer(monkeypatch):
    from clothbench.datasets import convert

    def importer(source, out, progress):
        (out / "one.nc").write_bytes(b"recording")
        (out / convert.REPORT).write_text('{"recordings": []}')

    monkeypatch.setattr(convert, "import_target", lambda target: importer)
    return convert


def test_an_import_replaces_its_own_files_only(tmp_path, small, monkeypatch):
    convert = with_small_importer(monkeypatch)
    (tmp_path / "iri-wam-cloth-swing").mkdir()
    about = {"data_dir": tmp_path, "out": tmp_path / "out"}
    made = convert.converted(NAME, **about)
    assert convert.converted(NAME, **about, again=True) == made
    (made / "mine.nc").write_bytes(b"mine")
    with pytest.raises(ClothbenchError, match=r"out: found mine\.nc, which the last import did not make"):
        convert.converted(NAME, **about, again=True)
    assert (made / "mine.nc").read_bytes() == b"mine"


@pytest.mark.parametrize("change", [{"version": 3}, {"commit": "another"}])
def test_recordings_of_an_older_importer_are_made_again(tmp_path, small, monkeypatch, change):
    convert = with_small_importer(monkeypatch)
    (tmp_path / "iri-wam-cloth-swing").mkdir()
    about = {"data_dir": tmp_path, "out": tmp_path / "out"}
    made = convert.converted(NAME, **about)
    (made / "one.nc").write_bytes(b"as it was")
    assert (convert.converted(NAME, **about) / "one.nc").read_bytes() == b"as it was"
    monkeypatch.setattr(registry, "DATASETS", {NAME: replace(small[0], **change)})
    assert (convert.converted(NAME, **about) / "one.nc").read_bytes() == b"recording"


@pytest.mark.parametrize("again", [False, True])
def test_a_folder_of_another_data_set_is_refused(tmp_path, monkeypatch, again):
    convert = with_small_importer(monkeypatch)
    (tmp_path / "iri-wam-cloth-swing").mkdir()
    made = convert.converted(NAME, data_dir=tmp_path, out=tmp_path / "out")
    with pytest.raises(ClothbenchError, match=f"dataset is '{NAME}', expected 'phi_sft_r1'"):
        convert.converted("phi_sft_r1", data_dir=tmp_path, out=made, again=again)


def test_recordings_made_of_another_copy_are_refused(tmp_path, small, monkeypatch):
    convert = with_small_importer(monkeypatch)
    for copy in ("a", "b"):
        (tmp_path / copy / "iri-wam-cloth-swing").mkdir(parents=True)
    made = convert.converted(NAME, data_dir=tmp_path / "a", out=tmp_path / "out")
    assert convert.converted(NAME, data_dir=tmp_path / "a", out=made) == convert.converted(NAME, out=made) == made
    with pytest.raises(ClothbenchError, match=r"found recordings made of .*/a/iri-.*, expected of .*/b/iri-"):
        convert.converted(NAME, data_dir=tmp_path / "b", out=made)
    with pytest.raises(ClothbenchError, match="data_dir: /nowhere is not a folder"):
        convert.converted(NAME, data_dir="/nowhere", out=made)


def stand_in_for_the_net(monkeypatch, served: dict[str, bytes]) -> list[str]:
    """Let pooch fetch from memory; what was asked for, in order."""
    import pooch.core

    asked: list[str] = []

    def download(url, output_file, _keeper, **_):
        asked.append(url)
        if url not in served:
            raise OSError("no route to host")
        Path(output_file).write_bytes(served[url])

    monkeypatch.setattr(pooch.core, "choose_downloader", lambda *_, **__: download)
    return asked


def test_fetch_verifies_and_keeps(tmp_path, small, monkeypatch):
    entry, contents = small
    monkeypatch.setenv("CLOTHBENCH_CACHE", str(tmp_path))
    monkeypatch.delenv(registry.ENVIRONMENT, raising=False)
    asked = stand_in_for_the_net(monkeypatch, {entry.url(k): v for k, v in contents.items()})
    seen = []
    assert dataset_rows()[0]["local_copy"] is None
    folder = registry.fetch(NAME, lambda done, planned, local: seen.append((done, planned, local)))
    assert {local: (folder / local).read_bytes() for local in contents} == contents
    assert seen[-1] == (2, 2, "Session_A/two_tcp.csv")
    registry.fetch(NAME)
    assert len(asked) == 2
    assert dataset_rows()[0]["local_copy"] == str(folder)
    (folder / "Session_A" / "two_tcp.csv").unlink()
    assert dataset_rows()[0]["local_copy"] is None


@pytest.mark.parametrize(("served", "expected"), [(b"forged", "hash"), (None, "give a local copy with data_dir=")])
def test_fetch_fails_in_one_line(tmp_path, small, monkeypatch, served, expected):
    entry, contents = small
    monkeypatch.setenv("CLOTHBENCH_CACHE", str(tmp_path))
    monkeypatch.setattr("time.sleep", lambda _: None)
    stand_in_for_the_net(monkeypatch, {} if served is None else {entry.url(k): served for k in contents})
    with pytest.raises(ClothbenchError, match=expected) as caught:
        registry.fetch(NAME)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.rglob("*.csv"))


@pytest.fixture
def curve(monkeypatch):
    """The real entry of the master curve, with known bytes."""
    digest = hashlib.sha256(b"curve").hexdigest()
    files = {"master_curve_data.mat": ("bending_validation/master_curve_data.mat", digest)}
    entry = replace(registry.DATASETS["cantilever_master_curve"], files=files)
    monkeypatch.setattr(registry, "DATASETS", {entry.name: entry})
    monkeypatch.delenv(registry.ENVIRONMENT, raising=False)
    return entry


def test_what_rests_on_a_data_set_without_recordings_is_told():
    without = [d for d in registry.DATASETS.values() if not d.importer]
    assert [d.name for d in without] == [
        "cantilever_618_fabrics", "cantilever_master_curve", "wang2011_arcsim_materials", "bias_extension_cao2008",
    ]  # fmt: skip
    assert all(d.use and d.licence and d.citation and len(d.commit) == 40 for d in without)
    told = {r["name"]: r["use"] for r in dataset_rows()}
    assert "physical_validation" in told["cantilever_master_curve"]
    assert told[NAME] == "recordings"


def test_originals_without_recordings_are_fetched_and_checked(tmp_path, curve, monkeypatch, capsys):
    from clothbench.cli.commands import main

    monkeypatch.setenv("CLOTHBENCH_CACHE", str(tmp_path / "cache"))
    stand_in_for_the_net(monkeypatch, {curve.url("master_curve_data.mat"): b"curve"})
    assert main(["import", curve.name]) == 0
    assert "1 file of cantilever_master_curve, with the registry's SHA-256; no recordings" in capsys.readouterr().out
    with pytest.raises(ClothbenchError, match="holds no recordings"):
        converted(curve.name, out=tmp_path / "out")
    copy = tmp_path / "cantilever-master-curve"
    copy.mkdir()
    with pytest.raises(ClothbenchError, match=r"master_curve_data\.mat: no such file"):
        registry.checked_copy(curve.name, copy)
    (copy / "master_curve_data.mat").write_bytes(b"forged")
    with pytest.raises(ClothbenchError, match=r"master_curve_data\.mat: SHA-256 differs"):
        registry.checked_copy(curve.name, tmp_path)
    (copy / "master_curve_data.mat").write_bytes(b"curve")
    assert registry.checked_copy(curve.name, tmp_path) == copy


@pytest.mark.data
@pytest.mark.parametrize("name", [name for name, d in registry.DATASETS.items() if not d.importer])
def test_the_originals_at_hand_are_the_registry_s(name, data_dir):
    if not (data_dir / registry.DATASETS[name].folder).is_dir():
        pytest.skip(f"{name} is not among the measured data")
    assert registry.checked_copy(name, data_dir).is_dir()
