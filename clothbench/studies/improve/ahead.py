"""What is about to be asked, answered by workers before.

Fits and probes that do not wait for each other go to them, and what they keep on the way is put into the checkpoint.
Whoever then asks finds it there, so that nothing is decided here; what no worker could do is done where it is asked.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clothbench.core.parallel import set_thread_count
from clothbench.engine.checkpoint import Arrays, Checkpoint
from clothbench.plugins.discovery import catalogue
from clothbench.studies.improve.problem import array_digest

Question = tuple[Any, ...]  # a problem, and what else the function is called with


@dataclass(frozen=True, eq=False)
class Piece:
    """A call of a function for a worker, whose plugins and checkpoint take the place of the command's."""

    function: Callable[..., Any]
    question: Question

    def __call__(self, tell: Any, threads: int) -> dict[str, Arrays]:
        """All that was kept on the way, by key; nothing if it failed, which it will again where it is asked."""
        set_thread_count(threads)
        with tempfile.TemporaryDirectory(prefix="clothbench-") as folder:
            checkpoint = Checkpoint(Path(folder))
            problem = dataclasses.replace(self.question[0], plugins=catalogue(), checkpoint=checkpoint)
            try:
                self.function(problem, *self.question[1:])
            except Exception:
                return {}
            return checkpoint.everything()


def ahead(
    function: Callable[..., Any], questions: Sequence[Question], told: Callable[[int], None] = lambda done: None
) -> None:
    """Let workers, if there are any, answer `function(*question)` for all questions. told: how many are answered."""
    workers = questions[0][0].elsewhere if questions else None
    if workers is None:
        return
    asked = [q for q in questions if q[0].checkpoint.recall(_done(function, q)) is None]
    if len(asked) < 2:  # one alone is done here as soon
        return
    for count, (number, found) in enumerate(workers([_piece(function, q) for q in asked]), 1):
        checkpoint = asked[number][0].checkpoint
        for key, arrays in (found or {}).items():
            checkpoint.keep(key, **arrays)
        checkpoint.keep(_done(function, asked[number]))
        told(count)


def _piece(function: Callable[..., Any], question: Question) -> Piece:
    """With a problem that can travel."""
    problem = dataclasses.replace(question[0], plugins=None, checkpoint=Checkpoint(), elsewhere=None)
    return Piece(function, (problem, *question[1:]))


def _done(function: Callable[..., Any], question: Question) -> str:
    """Under which key it is kept that workers have answered, so that a resumed run asks them no more."""
    problem, *rest = question
    return problem.key("ahead", function.__name__, [_plain(one) for one in rest], sorted(problem.bounds.items()))


def _plain(value: Any) -> Any:
    if hasattr(value, "theta"):  # a fit
        return [list(value.effects), value.theta.tolist(), [array_digest(r) for r in value.residual]]
    return value.tolist() if hasattr(value, "tolist") else value
