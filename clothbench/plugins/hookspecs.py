"""One hook per plugin kind; the docstring is the contract.

A plugin is a module named in the entry-point group `clothbench`. Its hooks only register: the code behind a
registration is imported when it is used. A first plugin:

    from clothbench import Registration, hookimpl

    @hookimpl
    def clothbench_models():
        return [Registration("my_model", "my_package.my_model:MyModel", "what it is, in one line")]
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import pluggy

PROJECT = "clothbench"
hookspec = pluggy.HookspecMarker(PROJECT)
hookimpl = pluggy.HookimplMarker(PROJECT)


@dataclass(frozen=True)
class Registration:
    """A plugin's name, where its class or factory lies ("module:attribute"), and one line on what it is."""

    name: str
    target: str
    summary: str


@hookspec
def clothbench_models() -> Iterable[Registration]:
    """Cloth models. The target, called with options as keywords, gives a `clothbench.Model`."""
    return ()


@hookspec
def clothbench_effects() -> Iterable[Registration]:
    """Physical effects. The target, called without arguments, gives a `clothbench.Effect`."""
    return ()


@hookspec
def clothbench_metrics() -> Iterable[Registration]:
    """Error measures. The target, called with options as keywords, gives a `clothbench.Metric`."""
    return ()


@hookspec
def clothbench_optimizers() -> Iterable[Registration]:
    """Searches. The target, called as `(space, seed=…, budget=…, **options)`, gives a `clothbench.Optimizer`."""
    return ()


@hookspec
def clothbench_trackers() -> Iterable[Registration]:
    """Trackers. The target, called with options as keywords, gives a `clothbench.Tracker`."""
    return ()


@hookspec
def clothbench_peers() -> Iterable[Registration]:
    """Other simulators for `clothbench bench` to measure beside the models.

    The target is a module with `skip_reason() -> str | None` and
    `step_sheet(side, dt, steps) -> run`, where run has `nodes`, `node_steps_per_s`, `finite` and `version`; and with
    `built_on` where it is built on a library (`clothbench.BuiltOn`), so that another version of that is measured anew.
    """
    return ()


@hookspec
def clothbench_exporters() -> Iterable[Registration]:
    """What `clothbench export` writes: a calibrated cloth as a file of another simulator.

    The target is a module with `skip_reason() -> str | None`, `suffix` (".xml") and `export(twin) -> Export`, which
    takes a `clothbench.Twin` and writes nothing itself: the text goes to disk whole or not at all.
    """
    return ()


@hookspec
def clothbench_studies() -> Iterable[Registration]:
    """Kinds of study. The target is a module with the members of `clothbench.engine.study.Study`: how settings become
    cells, how a cell is run, and what terminal and page show of the results.
    """
    return ()


@hookspec
def clothbench_configs() -> Iterable[str]:
    """Hydra search-path entries ("pkg://my_package.conf") whose groups (`suite/…`) join the built-in ones.

    A folder in it must not be called like a setting of `clothbench run` (model, recordings, …): Hydra would take the
    setting for that group, for everybody. Such an entry is left out, with a line that says so.
    """
    return ()
