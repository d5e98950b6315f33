"""Commits, as git tells of them."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass
from pathlib import Path

from clothbench.core.errors import ClothbenchError

FORMAT = "--format=%H%x09%cI%x09%s"


@dataclass(frozen=True)
class Commit:
    """hash: all its digits; date: when it was committed, ISO 8601; subject: the first line of its message."""

    hash: str
    date: str
    subject: str


def commit_at(name: str, folder: Path) -> Commit:
    """The commit that a name (HEAD, a branch, a hash) means in the repository that a folder lies in."""
    return _commits(_git(folder, "log", "-1", FORMAT, "--end-of-options", name, "--"))[0]


def commits_of(path: Path) -> list[Commit]:
    """Every commit that changed a file, the oldest first."""
    return _commits(_git(_folder(path), "log", "--reverse", "--topo-order", FORMAT, "--", path.name))


def text_at(path: Path, commit: Commit) -> str | None:
    """The text of a file at a commit; None where it is not there."""
    inside = _git(_folder(path), "rev-parse", "--show-prefix").strip() + path.name
    if not _git(_folder(path), "ls-tree", "--name-only", "--full-tree", commit.hash, "--", inside):
        return None
    return _git(_folder(path), "show", f"{commit.hash}:{inside}")


def _folder(path: Path) -> Path:
    if not path.parent.is_dir():
        raise ClothbenchError(f"{path}: found no folder {path.parent}, expected a file in a git repository")
    return path.parent


def _git(folder: Path, *words: str) -> str:
    """What git prints. Its bytes may be of any encoding: what is no UTF-8 is replaced, and no line end is changed."""
    try:
        done = subprocess.run(
            ["git", "-c", "log.showSignature=false", "-C", folder, *words], capture_output=True, check=False
        )
    except FileNotFoundError:
        raise ClothbenchError("found no git on this machine; install it") from None
    if done.returncode:
        said = (_text(done.stderr).strip() or "no reason given").splitlines()[0]
        raise ClothbenchError(f"{folder}: git {words[0]} said: {said}; expected a git repository with that commit")
    return _text(done.stdout)


def _text(output: bytes) -> str:
    return output.decode("utf-8", errors="replace")


def _commits(log: str) -> list[Commit]:
    """Commits of a log. A subject may hold whatever else Python takes for the end of a line."""
    return [Commit(*line.split("\t", 2)) for line in log.split("\n") if line]
