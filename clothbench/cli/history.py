"""`clothbench history`: error and speed of every model against commit, from a folder of entries or from git."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.engine.store import Store
from clothbench.history.commits import commit_at
from clothbench.history.entries import add, entries_in, entries_of_git
from clothbench.history.page import write_page
from clothbench.history.series import all_series
from clothbench.history.show import document, print_history


def history(options: argparse.Namespace, results: Store | None) -> Any:
    """Do what was asked, and say it; the document for `--json`, None without. results: to be added."""
    if (options.folder is None) == (options.git is None):
        raise ClothbenchError("history: expected either a FOLDER of entries, or --git FILE")
    if options.machine is not None and options.git is None:
        raise ClothbenchError("history: --machine is for --git; entries of a FOLDER say their machine, leave it out")
    if options.commit is not None and results is None:
        raise ClothbenchError("history: --commit says what the RUNS of --add are of; add some, or leave it out")
    if results is not None:
        if options.folder is None:
            raise ClothbenchError("history: --add needs the FOLDER of entries that it is to add to, not --git")
        for path in add(options.folder, results, commit_at(options.commit or "HEAD", Path())):
            if not options.json:
                print(f"{path}: added")
    entries = entries_in(options.folder) if options.folder else entries_of_git(options.git, options.machine)
    series = all_series(entries)
    page = write_page(options.page, entries, series) if options.page else None
    if options.json:
        return document(entries, series)
    print_history(entries, series)
    if page:
        print(f"page: {page}")
    return None
