"""Files and folders that are there whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import math
import os
import re
import shutil
import stat
import tempfile
import warnings
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from decimal import Decimal
from itertools import chain, count, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from clothbench.core.errors import ClothbenchError

if TYPE_CHECKING:
    import numpy as np

# Names of what is not in its place yet, or has left it; the eight letters are tempfile's.
_HALF_FILE = re.compile(r"\..+\.[a-z0-9_]{8}\.part")
_HALF_FOLDER = re.compile(r"\.(new|old|[0-9a-f]+)\.[a-z0-9_]{8}")
CLEARLY = 3  # times as even as in the other reading, numbers in names are meant so
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_ODD = re.compile(r"\\u[dD]|[eE]\+?\d{3}")  # in JSON: what may be half a letter, or a number beyond all numbers


def file_name(recording: str) -> str:
    """ "case/swing 3" → "case_swing_3" """
    return re.sub(r"[^\w.-]+", "_", recording).lstrip(".") or "recording"


def file_names(recordings: Sequence[str]) -> list[str]:
    """The recordings' names as file names, each once."""
    out: list[str] = []
    for name in map(file_name, recordings):
        numbered = (f"{name}-{number}" for number in count(len(out) + 1))
        out.append(next(free for free in chain([name], numbered) if free not in out))
    return out


def require_folder(name: str) -> None:
    """Refuse an address, as of a bucket, where a folder of this machine is needed."""
    if re.match(r"\w{2,}:/", name):
        raise ClothbenchError(f"{name}: found an address, expected a folder; this command takes no bucket")


def in_order(paths: Iterable[Path]) -> list[Path]:
    """Files by their names, numbers in them as numbers: frame 2 before frame 10, 0.175 s before 0.2 s.

    What follows a point is a fraction, unless two names would then mean the same number (frames 1 and 10 of take 1, as
    1.1 and 1.10), or all share what is before it and it counts (98 to 103 of take 2, as 2.98 to 2.103). Names that may
    mean both, in different orders, are a ClothbenchError that names two of them.
    """
    files = sorted(paths)
    fractions, numbers = (
        {p: tuple(Decimal(part) if k % 2 else part for k, part in enumerate(re.split(number, p.name))) for p in files}
        for number in (r"(\d+(?:\.\d+)?)", r"(\d+)")
    )
    counted, timed = sorted(files, key=numbers.__getitem__), sorted(files, key=fractions.__getitem__)
    if counted == timed or len(set(fractions.values())) < len(files):
        return counted
    found = [list(re.finditer(r"(?<=\d\.)\d+", path.name)) for path in files]
    if not all(found) or len({p.name[: each[-1].start()] for p, each in zip(files, found, strict=True)}) > 1:
        return timed
    counts = _counts([each[-1][0] for each in found])
    if counts is None:
        one, other = next(pair for pair in zip(timed, counted, strict=True) if pair[0] != pair[1])
        raise ClothbenchError(
            f"{one}: found it beside {other.name}, and what follows the point may be a fraction or count the files; "
            "expected names that say which comes first; write the same number of digits after the point in all of them"
        )
    return counted if counts else timed


def _counts(digits: Sequence[str]) -> bool | None:
    """Whether digits that follow one number and a point count the files; None where they may be fractions as well.

    Counting leaves no gap, or writes zeros at the end that no fraction needs. Fractions begin with zeros, or follow
    each other at even steps, as counted they do not.
    """
    numbers, fractions = (sorted(Decimal(f"{lead}{each}") for each in digits) for lead in ("", "0."))
    if len(set(numbers)) < len(numbers):  # 1 and 01
        return False
    if len(set(fractions)) < len(fractions):  # 1 and 10
        return True
    if numbers[-1] - numbers[0] == len(numbers) - 1:
        return True
    counted = any(len(each) > 1 and each[-1] == "0" for each in digits)
    timed = any(len(each) > 1 and each[0] == "0" for each in digits) or _uneven(numbers) > CLEARLY * _uneven(fractions)
    return None if counted == timed else counted


def _uneven(ascending: Sequence[Decimal]) -> float:
    """The longest step over the shortest."""
    steps = [float(after - before) for before, after in pairwise(ascending)]
    return max(steps) / min(steps)


def entries(folder: Path) -> list[Path]:
    """What lies in a folder, by name, without what is hidden; nothing where there is no folder.

    One that may not be looked into is an OSError, where Path.glob finds nothing.
    """
    try:
        return [folder / name for name in sorted(os.listdir(folder)) if not name.startswith(".")]
    except FileNotFoundError:
        return []


def files_below(folder: Path, hidden: bool = False) -> list[Path]:
    """The files in a folder and in those below it, sorted; each folder once, also where links lead to it, and under the
    name at which it lies where it lies in `folder`. hidden: also what begins with a point.

    A folder that may not be looked into is an OSError, where Path.rglob passes over it; one that went meanwhile is not.
    """

    def told(fault: OSError) -> None:
        if not isinstance(fault, FileNotFoundError):
            raise fault

    out, known, left = [], set(), [str(folder)]
    while left:
        for place, folders, files in os.walk(left.pop(0), onerror=told):  # which goes along no link
            if (real := os.path.realpath(place)) in known:
                folders.clear()
                continue
            known.add(real)
            folders[:] = sorted(name for name in folders if hidden or not name.startswith("."))
            left += [path for path in (os.path.join(place, name) for name in folders) if os.path.islink(path)]
            out += [Path(place, name) for name in files if hidden or not name.startswith(".")]
    return sorted(out)


def sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def read_json(path: Path, expected: str) -> Any:
    """What a JSON file holds. Anything else than JSON in UTF-8, NaN and infinity among it, is refused in one line.

    expected: what the reader wants there, in words.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (ValueError, OSError) as fault:
        raise _no_json(path, fault, expected) from None
    return parsed_json(text, path, expected)


def parsed_json(text: str, where: object, expected: str) -> Any:
    """The same of a text; where: what a fault calls it."""

    def refused(word: str) -> Any:
        raise ValueError(f"{word} is no JSON")

    try:
        found = json.loads(text, parse_constant=refused)
        if _ODD.search(text):
            json.dumps(found, ensure_ascii=False, allow_nan=False).encode()
    except (ValueError, RecursionError) as fault:
        raise _no_json(where, fault, expected) from None
    return found


def json_text(document: Any, plain: bool = False) -> str:
    """A document as people and programs read it; NaN and infinity, which are no JSON, are a ValueError.

    plain: letters beyond ASCII escaped, which means the same.
    """
    return json.dumps(document, indent=1, ensure_ascii=plain, allow_nan=False)


def _no_json(where: object, fault: Exception, expected: str) -> ClothbenchError:
    said = getattr(fault, "strerror", None) or (str(fault).splitlines() or [type(fault).__name__])[0]
    return ClothbenchError(f"{where}: found no JSON that can be read ({said}), expected {expected}")


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a NumPy file, by name (.npz) or as "array" (.npy); no pickled ones, and none that claims more than
    the file holds. Faults raise OSError, ValueError or zipfile.BadZipFile.
    """

    try:
        if path.suffix.lower() == ".npy":
            with path.open("rb") as file:
                return {"array": _array(file, path.stat().st_size)}
        with zipfile.ZipFile(path) as archive:
            out: dict[str, np.ndarray] = {}
            for member in archive.infolist():
                if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                    raise ValueError(f"{member.filename} is packed as NumPy packs nothing")  # and maybe far denser
                with archive.open(member) as file:
                    out[member.filename.removesuffix(".npy")] = _array(file, member.file_size)  # type: ignore[arg-type]
            return out
    except (zipfile.BadZipFile, OSError, ValueError):
        raise
    except Exception as fault:  # what NumPy, zlib and the parser of headers raise for broken bytes is in no list
        raise ValueError((str(fault).splitlines() or [type(fault).__name__])[0]) from fault


def _array(file: BinaryIO, size: int) -> np.ndarray:
    """One array of a stream of so many bytes."""
    from numpy.lib import format as npy

    version = npy.read_magic(file)
    read = npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # files that Python 2 wrote are as good
        shape, _, of = read(file)
        if of.hasobject or math.prod(shape) * of.itemsize > size or min(shape, default=0) < 0:
            raise ValueError(f"a claim of {' × '.join(map(str, shape))} values of {of} in {size} bytes")
        file.seek(0)
        return npy.read_array(file, allow_pickle=False)


@contextmanager
def whole_file(path: str | os.PathLike[str], asked: bool = False) -> Iterator[Path]:
    """A temporary file beside `path` to write to; it takes the place of `path` when the block ends without a fault.

    asked: whether somebody asked for this very name. Where it is a link, what that leads to is written; any other link,
    which may lie in a folder that a stranger has packed, makes way. What is there and is no file, such as a device or a
    pipe, and a link that leads nowhere but to itself are a ClothbenchError.
    """
    named, link = Path(path), os.path.islink(path)
    if asked or not link:
        _require_file(named)
    path = Path(os.path.realpath(named)) if asked and link else named
    with placing(named):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
    os.close(handle)
    part = Path(name)
    try:
        yield part
        os.chmod(part, 0o666 & ~_umask())  # mkstemp keeps files to their owner; results are no secret
        with placing(named):
            os.replace(part, path)
    except BaseException as fault:
        part.unlink(missing_ok=True)
        _name(fault, named)
        raise


def _require_file(named: Path) -> None:
    """Refuse a place where something is that is no file. What a name stands for may have no other: /dev/fd/1."""
    try:
        mode = os.stat(named).st_mode
    except OSError as fault:  # whatever else is wrong there, writing says
        found = "a link that leads back to itself" if fault.errno == errno.ELOOP else ""
    else:
        found = "" if stat.S_ISREG(mode) or stat.S_ISDIR(mode) else "a device, pipe or socket"
    if found:
        raise ClothbenchError(f"{named}: found {found}, expected a file, or none yet; give another name")


@contextmanager
def whole_folder(path: str | os.PathLike[str], stays: Callable[[], bool] = lambda: False) -> Iterator[Path]:
    """A temporary folder beside `path` to fill; it takes the place of `path` when the block ends without a fault.

    stays: asked when there is a folder already; if it stays, what was filled is dropped. Taking the place is one rename
    that only succeeds where nothing is, so that of several processes that finish the same folder at once one comes
    first, and what stays is never absent, not even for a moment.
    """
    path = Path(path)
    with placing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(dir=path.parent, prefix=f".{path.name}."))
    try:
        yield part
        os.chmod(part, 0o777 & ~_umask())
        if not renamed(part, path):
            with alone(path.parent):  # what is moved out of the way must still be what was asked about
                _take_place(part, path, stays)
    except BaseException as fault:
        shutil.rmtree(part, ignore_errors=True)
        _name(fault, path)
        raise


def _take_place(part: Path, path: Path, stays: Callable[[], bool]) -> None:
    """Put a folder in place of what is there, or drop it if that stays."""
    while not renamed(part, path):
        if stays():
            shutil.rmtree(part, ignore_errors=True)
            return
        with contextlib.suppress(FileNotFoundError):  # somebody else has removed it: the place is free
            remove_folder(path)


def remove_folder(path: Path) -> None:
    """Remove a folder: out of sight by one rename, then file by file, so that nobody ever sees half of it."""
    with placing(path.parent):
        old = Path(tempfile.mkdtemp(dir=path.parent, prefix=".old."))
    try:
        with placing(path):
            os.replace(path, old / "old")
    finally:
        shutil.rmtree(old, ignore_errors=True)


def half_written(folder: Path) -> Iterator[Path]:
    """What processes that were killed left in a folder of the files and folders that they were about to put there, and
    what is being written there now.
    """
    for path in sorted(folder.glob(".*")):
        if (_HALF_FOLDER if path.is_dir() else _HALF_FILE).fullmatch(path.name):
            yield path


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """One process at a time may be in here; the lock goes with a process that is killed."""
    if os.name != "posix":  # no such lock; folders do not replace each other there either
        yield
        return
    import fcntl

    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def renamed(part: Path, path: Path) -> bool:
    """Rename a folder, if nothing but an empty folder is in its way."""
    with placing(path):
        try:
            os.replace(part, path)
        except OSError as fault:
            if fault.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
                return False
            raise
    return True


@contextmanager
def whole_files(folder: str | os.PathLike[str], instead_of: Sequence[str] = ()) -> Iterator[Path]:
    """A temporary folder to fill; when the block ends without a fault, every file in it takes its place below `folder`.

    What else lies in `folder` stays, but for older files that a pattern of `instead_of` ("tables/*.parquet") finds.
    """
    folder = Path(folder)
    with placing(folder):
        folder.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(dir=folder, prefix=".new."))
    try:
        yield part
        made = sorted(p.relative_to(part) for p in part.rglob("*") if p.is_file())
        for old in {p for pattern in instead_of for p in folder.glob(pattern)} - {folder / name for name in made}:
            old.unlink()
        for name in made:
            with placing(folder / name):
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                os.replace(part / name, folder / name)
    except OSError as fault:
        _name(fault, folder)
        raise
    finally:
        shutil.rmtree(part, ignore_errors=True)


@contextmanager
def placing(path: Path) -> Iterator[None]:
    """Let a fault of the system's about a place say which one was asked for, and what to do: it names what is ours
    alone, or nothing. That the disk is full says enough.
    """
    try:
        yield
    except OSError as fault:
        if fault.errno in FULL or fault.errno is None:
            raise
        said = f"cannot be written to ({os.strerror(fault.errno)}); give a folder of yours"
        raise OSError(fault.errno, said, str(path)) from fault


def _name(fault: BaseException, path: Path) -> None:
    """Let a fault say what could not be written, where it does not; that the disk is full is known to no name."""
    if isinstance(fault, OSError) and fault.errno is not None and fault.filename is None:
        fault.filename = str(path)


def _umask() -> int:
    """What the user takes away from the rights of new files; it can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask
