"""A folder's files as one object: a zip archive in which nothing is compressed, since tables and films are already."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath

from clothbench.core.errors import ClothbenchError

Files = Mapping[str, bytes]  # content, by the path below the folder, with "/" between its parts
LONGEST = 255  # bytes of a file's name
_DAY = (1980, 1, 1, 0, 0, 0)  # of every file in an archive, so that the same files make the same bytes


def files_in(folder: Path) -> dict[str, bytes]:
    """All files of a folder, in order."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def write_files(folder: Path, files: Files) -> None:
    for name, content in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def packed(files: Files) -> bytes:
    """One archive of them."""
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_STORED) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name, _DAY), content)
    return whole.getvalue()


def unpacked(content: bytes, where: str) -> dict[str, bytes]:
    """The files in an archive that anybody may have made; where: what a fault calls it.

    Raises a ClothbenchError for what is no whole archive, is compressed (and might be far larger than it looks), or
    would lie outside of the folder.
    """
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = archive.infolist()
            for member in members:
                _require_harmless(member)
            _require_apart([member.filename for member in members])
            if sum(member.file_size for member in members) > len(content):
                raise ValueError("a claim of more than it holds")
            return {member.filename: archive.read(member) for member in members}
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError, EOFError, RuntimeError) as fault:
        said = (str(fault).splitlines() or [type(fault).__name__])[0]
        raise ClothbenchError(
            f"{where}: found no archive that can be read ({said}), expected a cell's files; delete it and run again"
        ) from None


def _require_harmless(member: zipfile.ZipInfo) -> None:
    name, path = member.filename, PurePosixPath(member.filename)
    below = bool(path.parts) and not path.is_absolute() and ".." not in path.parts and not member.is_dir()
    plain = name.isprintable() and not set('\\:"') & set(name) and all(len(p.encode()) <= LONGEST for p in path.parts)
    if not (below and plain):
        raise ValueError(f"{name[:80]!r} is no file below its folder")
    if member.compress_type != zipfile.ZIP_STORED or member.file_size != member.compress_size:
        raise ValueError(f"{name!r} is compressed")


def _require_apart(names: Sequence[str]) -> None:
    """Of two files neither is the other one's folder, nor the same."""
    files = [PurePosixPath(name) for name in names]
    folders = {above for file in files for above in file.parents}
    if len(set(files)) < len(files) or folders & set(files):
        raise ValueError("two files that would take each other's place")
