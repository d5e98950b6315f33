"""`clothbench store`: check a results folder, merge it into another, prune what is no longer wanted."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.engine.check import Finding, check
from clothbench.engine.leases import LEASES
from clothbench.engine.mirror import pull, results_folder
from clothbench.engine.progress import counting
from clothbench.engine.run import TRACKED
from clothbench.engine.store import JOURNAL, Store, require_results
from clothbench.engine.upkeep import DAY, merge, prunable, remove
from clothbench.plugins.discovery import catalogue


@dataclass(frozen=True)
class Done:
    """What came of a task: as data, in lines, and the exit code."""

    document: Any
    lines: list[str]
    code: int


def store_in(place: str, whole: bool = True) -> Store:
    """The store in a folder or a bucket, also one in which a run has begun and no cell is finished.

    whole: whether an object of a bucket that cannot be read is the user's error.
    """
    folder = results_folder(place, whole)
    begun = any((folder / name).is_dir() for name in (JOURNAL, LEASES, TRACKED))
    return Store(folder if begun else require_results(folder, place))


def checked(store: Store, options: argparse.Namespace) -> Done:
    broken = pull(store, again=True) if store.bucket is not None else {}
    with counting("cells") as told:
        findings = [*(Finding(store.cell(key), line) for key, line in broken.items()), *check(store, catalogue(), told)]
    faults = sum(not found.harmless for found in findings)
    lines = [f"{'left over' if found.harmless else 'fault'}: {found.line}" for found in findings]
    return Done(
        _document(findings), [*lines, f"{store.address}: {f'{faults} faults' if faults else 'ok'}"], int(faults > 0)
    )


def merged(store: Store, options: argparse.Namespace) -> Done:
    into = Store(results_folder(options.into))
    if into.folder.exists() and into.folder.samefile(store.folder):
        raise ClothbenchError(f"{into.address}: found the folder to merge from, expected another one")
    done = merge(store, into, catalogue())
    counts = {"taken": len(done.taken), "same": len(done.same), "errors": len(done.errors)}
    told = f"{counts['taken']} cells taken, {counts['same']} there already, {counts['errors']} errors left out"
    lines = [
        *(f"fault: {found.line}" for found in done.findings),
        f"{into.address}: {told}, {len(done.findings)} faults",
    ]
    return Done({**counts, "faults": _document(done.findings)}, lines, int(bool(done.findings)))


def pruned(store: Store, options: argparse.Namespace) -> Done:
    if store.bucket is not None and (options.cell or options.other_versions):
        raise ClothbenchError(
            f"{store.address}: nothing that is published in a bucket is deleted by clothbench; leave --cell and "
            "--other-versions out, or delete objects with the tools of the store"
        )
    found = prunable(
        store, catalogue(), older=options.older * DAY, other_versions=options.other_versions, keys=options.cell
    )
    for path, _ in found if not options.dry_run else ():
        remove(path)
    word = "would remove" if options.dry_run else "removed"
    lines = [*(f"{word}: {path}: {why}" for path, why in found), f"{store.folder}: {word} {len(found)}"]
    return Done([{"path": str(p), "why": why, "removed": not options.dry_run} for p, why in found], lines, 0)


def _document(findings: list[Finding]) -> list[dict[str, Any]]:
    return [{"path": str(found.path), "line": found.line, "harmless": found.harmless} for found in findings]


TASKS = {"check": checked, "merge": merged, "prune": pruned}
