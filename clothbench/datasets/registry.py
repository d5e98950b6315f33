"""The public data sets clothbench knows: where each lies, at which commit, with which bytes, under which
licence.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files as package_files
from pathlib import Path
from types import MappingProxyType
from urllib.parse import quote

from clothbench.core.errors import ClothbenchError, nearest
from clothbench.core.files import sha256
from clothbench.core.progress import FileProgress

ENVIRONMENT = "CLOTHBENCH_DATA"
RAW = "https://raw.githubusercontent.com"


@dataclass(frozen=True)
class Dataset:
    """A public data set. files: path in a local copy → (path in the repository, SHA-256); importer:
    "module:attribute", "" of one that holds no recordings; use: what of it is used here, "" of recordings.

    folder: what a local copy's own folder is called; pattern: which files in it belong to the data set; version: of the
    importer, raised when it makes other recordings of them.
    """

    name: str
    title: str
    summary: str
    repository: str
    commit: str
    licence: str
    citation: str
    importer: str
    folder: str
    pattern: str
    files: Mapping[str, tuple[str, str]] = field(repr=False)
    version: int = 1
    use: str = ""

    @property
    def address(self) -> str:
        """Where people look at it, pinned to the commit."""
        return f"https://github.com/{self.repository}/tree/{self.commit}"

    def url(self, local: str) -> str:
        """Where the bytes of one file are fetched from; repository paths may hold spaces."""
        return f"{RAW}/{self.repository}/{self.commit}/{quote(self.files[local][0])}"


@dataclass(frozen=True)
class Check:
    """Files of a local copy, by relative path: unknown to the registry, and known but with other bytes."""

    unknown: frozenset[str]
    wrong: frozenset[str]


def _load(name: str) -> Dataset:
    stated = json.loads((package_files(__package__) / "files" / f"{name}.json").read_text(encoding="utf-8"))
    listed = {local: (upstream, digest) for local, (upstream, digest) in stated.pop("files").items()}
    return Dataset(**stated, files=MappingProxyType(listed))


DATASETS: Mapping[str, Dataset] = MappingProxyType(
    {
        name: _load(name)
        for name in (
            "cusick_drape_bdp",
            "iri_wam_cloth_swing",
            "knit_uniaxial_gatech",
            "phi_sft_r1",
            "cantilever_618_fabrics",
            "cantilever_master_curve",
            "wang2011_arcsim_materials",
            "bias_extension_cao2008",
        )
    }
)


def dataset(name: str) -> Dataset:
    """The data set of that name, or an error that lists the known ones."""
    if name not in DATASETS:
        raise ClothbenchError(f"no data set {name!r}; {nearest(name, DATASETS)}known: {', '.join(DATASETS)}")
    return DATASETS[name]


def local_copy(name: str, data_dir: str | os.PathLike[str] | None = None) -> Path | None:
    """The local copy of a data set: `data_dir`, else the folder in CLOTHBENCH_DATA, else None.

    Either may be the copy itself or the folder that contains it. A folder that was named but is neither is
    an error.
    """
    known = dataset(name)
    stated = data_dir if data_dir is not None else os.environ.get(ENVIRONMENT) or None
    if stated is None:
        return None
    given = Path(stated)
    if not given.is_dir():
        where = "data_dir" if data_dir is not None else ENVIRONMENT
        raise ClothbenchError(
            f"{where}: {given} is not a folder; give the folder with {known.folder!r} in it, or that folder"
        )
    for folder in (given / known.folder, given / known.name):
        if folder.is_dir():
            return folder
    if given.name in (known.folder, known.name) or any(given.glob(known.pattern)):
        return given
    raise ClothbenchError(
        f"{given}: found no {known.folder!r}, neither in it nor as it; check data_dir or {ENVIRONMENT}"
    )


def verify(name: str, folder: Path) -> Check:
    """Compare every file of a local copy that belongs to the data set, by its name or as the registry has it, with the
    registry's SHA-256.
    """
    known = dataset(name)
    present = {path.relative_to(folder).as_posix(): path for path in folder.glob(known.pattern) if path.is_file()}
    present |= {local: folder / local for local in known.files if (folder / local).is_file()}
    wrong = {local for local, path in present.items() if local in known.files and sha256(path) != known.files[local][1]}
    return Check(frozenset(set(present) - set(known.files)), frozenset(wrong))


def checked_copy(
    name: str, data_dir: str | os.PathLike[str] | None = None, progress: FileProgress | None = None
) -> Path:
    """The folder with the originals of a data set, a local copy or fetched, every file of it there with the registry's
    bytes.
    """
    known, local = dataset(name), local_copy(name, data_dir)
    if local is None:
        return fetch(name, progress)
    for file in known.files:
        if not (local / file).is_file():
            raise ClothbenchError(f"{local / file}: no such file, expected that of {known.address}; fetch it again")
    if wrong := sorted(verify(name, local).wrong):
        raise ClothbenchError(f"{local / wrong[0]}: SHA-256 differs from the registry's; fetch it again")
    return local


def cache_folder() -> Path:
    """What may be deleted and made again lies there: the system's own (pooch), or what CLOTHBENCH_CACHE names."""
    import pooch

    return Path(os.environ.get("CLOTHBENCH_CACHE") or pooch.os_cache("clothbench"))


def fetched(name: str) -> Path | None:
    """The folder with all files of a data set that has been fetched; None if it has not."""
    known = dataset(name)
    folder = _cache_of(known)
    return folder if all((folder / local).is_file() for local in known.files) else None


def _cache_of(known: Dataset) -> Path:
    return cache_folder() / known.name / known.commit[:12]


def fetch(name: str, progress: FileProgress | None = None) -> Path:
    """Download what is not in the cache yet, verify every SHA-256, and give the folder in the local layout.

    The cache is the system's own (pooch), or the folder named by CLOTHBENCH_CACHE.
    """
    import pooch

    known = dataset(name)
    cache = _cache_of(known)
    keeper = pooch.create(
        path=cache,
        base_url="",
        registry={local: f"sha256:{digest}" for local, (_, digest) in known.files.items()},
        urls={local: known.url(local) for local in known.files},
        retry_if_failed=2,
    )
    pooch.get_logger().setLevel("WARNING")
    for done, local in enumerate(sorted(known.files), start=1):
        try:
            keeper.fetch(local)
        except ValueError as fault:
            reason = f"{known.url(local)}: {str(fault).splitlines()[0]}"
            raise ClothbenchError(f"{reason}; the source changed or the download broke, try again") from None
        except OSError as fault:
            reason = f"{known.url(local)}: cannot be fetched ({str(fault).splitlines()[0]})"
            raise ClothbenchError(f"{reason}; give a local copy with data_dir=") from None
        if progress:
            progress(done, len(known.files), local)
    return cache
