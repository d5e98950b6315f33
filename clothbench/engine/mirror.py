"""The results of a bucket as a folder of this machine: what is published there is brought here, and read from here.

The folder lies in the cache, one for each address and endpoint, and may be deleted whenever no command is at work. A
result is published in the bucket before it gets its place here (`Store.put`), so the folder holds none that the bucket
does not. Journals of unfinished cells stay on the machine that computes them.
"""

from __future__ import annotations

import contextlib
import os
import re
from pathlib import Path

from clothbench.core.errors import ClothbenchError
from clothbench.core.files import remove_folder, whole_file, whole_folder
from clothbench.core.packed import files_in, unpacked, write_files
from clothbench.engine.bucket import ATTEMPT, MARK, Bucket, cell_object, error_object, is_address, mirrors
from clothbench.engine.cells import digest
from clothbench.engine.store import DISAGREEMENTS, Store

AT_A_TIME = 64  # objects that are read together
_CELL = re.compile(r"cells/(?P<key>[0-9a-f]+)\.zip")
_ERROR = re.compile(r"errors/(?P<key>[0-9a-f]+)/[0-9A-Za-z-]+\.zip")
_RECORD = re.compile(DISAGREEMENTS + r"/[0-9a-f]+/[0-9a-f]+\.json")


def results_folder(place: str | os.PathLike[str], whole: bool = True) -> Path:
    """The folder that results are read from and put into; of an address its mirror, brought up to date.

    whole: an object that cannot be read is a ClothbenchError; else it is left out.
    """
    if not is_address(place):
        return Path(place)
    store = Store(mirror_of(str(place)))
    faults = pull(store)
    if faults and whole:
        raise ClothbenchError(next(iter(faults.values())))
    return store.folder


def mirror_of(address: str) -> Path:
    """The mirror of a bucket as it is; made if there is none."""
    bucket = Bucket(address)
    folder = mirrors() / digest(bucket.identity)
    if not (folder / MARK).is_file():
        with whole_file(folder / MARK) as part:
            part.write_text(bucket.address)
    return folder


def up_to_date(store: Store) -> Store:
    """The same store, with what others have published meanwhile if it is the mirror of a bucket."""
    if store.bucket is not None:
        pull(store)
    return store


def pull(store: Store, again: bool = False) -> dict[str, str]:
    """Bring what the bucket has and the mirror has not, and remove what the bucket has no more.

    again: read every object anew, whether it is here or not. Returns a line for every object that cannot be read.
    """
    assert store.bucket is not None
    here = objects_here(store)  # first: what comes to be between the two is in the bucket, too
    there = objects_there(store.bucket)
    for key in here.keys() - there.keys():
        with contextlib.suppress(FileNotFoundError):  # another process was faster
            remove_folder(store.cell(key))
    wanted = {name: key for key, name in there.items() if again or here.get(key) != name}
    names, faults = list(wanted), {}
    for first in range(0, len(names), AT_A_TIME):
        for name, content in store.bucket.read(names[first : first + AT_A_TIME]).items():
            try:
                _bring(store, wanted[name], name, content)
            except ClothbenchError as said:
                faults[wanted[name]] = str(said)
    _pull_disagreements(store, store.bucket)
    return faults


def pull_result(store: Store, key: str) -> None:
    """Bring the result of one cell, if the bucket has it by now."""
    assert store.bucket is not None
    for name, content in store.bucket.read([cell_object(key)]).items():
        _bring(store, key, name, content)


def _pull_disagreements(store: Store, bucket: Bucket) -> None:
    """Bring the records of cells that did not come to the same twice, and remove those that the bucket has no more."""
    here = {path.relative_to(store.folder).as_posix() for path in store.disagreements()}
    there = {name for name in bucket.names(DISAGREEMENTS) if _RECORD.fullmatch(name)}
    for name in here - there:
        (store.folder / name).unlink(missing_ok=True)
    for name, content in bucket.read(sorted(there - here)).items():
        with whole_file(store.folder / name) as part:
            part.write_bytes(content)


def objects_here(store: Store) -> dict[str, str]:
    """The object that each cell of a mirror is of, by the cell's key."""
    found = {}
    for folder in (store.folder / "cells").glob("[0-9a-f]*"):
        attempt = folder / ATTEMPT
        known = attempt.read_text().strip() if attempt.is_file() else None
        found[folder.name] = error_object(folder.name, known) if known else cell_object(folder.name)
    return found


def objects_there(bucket: Bucket) -> dict[str, str]:
    """The object that counts of each cell in a bucket, by the cell's key: its result, or else its latest error."""
    errors = {found["key"]: name for name in bucket.names("errors") if (found := _ERROR.fullmatch(name))}
    return errors | {found["key"]: name for name in bucket.names("cells") if (found := _CELL.fullmatch(name))}


def _bring(store: Store, key: str, name: str, content: bytes) -> None:
    """Put what an object holds in its place, whole; a result gives way to no error."""
    assert store.bucket is not None
    files = unpacked(content, f"{store.bucket.address}/{name}")

    def stays() -> bool:
        return files == files_in(store.cell(key)) if name == cell_object(key) else store.has(key)

    with whole_folder(store.cell(key), stays) as part:
        write_files(part, files)
