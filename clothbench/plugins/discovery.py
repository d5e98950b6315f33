"""Guarded discovery: every plugin is loaded on its own, and a broken one is listed as broken, never in the way."""

from __future__ import annotations

import contextlib
import difflib
import functools
import importlib
import os
import signal
import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, PackageNotFoundError, entry_points
from importlib.metadata import version as version_of
from importlib.resources import files
from pathlib import Path
from typing import Any

import pluggy

import clothbench.plugins.hookspecs as hookspecs
from clothbench.core.errors import ENDS, ClothbenchError, known_names
from clothbench.plugins.hookspecs import Registration

KINDS = ("models", "effects", "metrics", "optimizers", "trackers")
ALL_KINDS = (*KINDS, "peers", "exporters", "studies")
OWN = "clothbench"
# What every class of a kind has (`core.protocols`), and not only its objects.
MEMBERS = {
    "models": ("name", "version", "capabilities", "prepare"),
    "effects": ("name", "version", "place", "summary"),
    "metrics": ("name", "version", "floor", "__call__"),
    "optimizers": ("name", "version", "ask", "tell"),
    "trackers": ("name", "version", "track"),
}
PATIENCE = "CLOTHBENCH_IMPORT_SECONDS"  # of a stranger's plugin, compiling included; the environment may say
IMPORT_SECONDS = 120.0


class PluginBroken(ClothbenchError):
    """A plugin that is installed but cannot be used; not the fault of who names it."""


@dataclass(frozen=True)
class Plugin:
    """One registered name, or a whole plugin module that could not be used (then `kind` is "module").

    `reason` says in one line why it is broken; None means that nothing is known against it.
    """

    kind: str
    name: str
    target: str
    summary: str
    distribution: str
    version: str
    reason: str | None = None


@dataclass(frozen=True)
class Catalogue:
    """All plugins found, broken ones included, and the config packages they contribute."""

    plugins: tuple[Plugin, ...]
    configs: tuple[str, ...] = ()
    _loaded: dict[tuple[str, str], Any] = field(default_factory=dict)

    def names(self, kind: str) -> list[str]:
        return [p.name for p in self.plugins if p.kind == kind and p.reason is None]

    def find(self, kind: str, name: str) -> Plugin:
        """The usable plugin of that name; else an error that says what there is, or why it is broken."""
        found = [p for p in self.plugins if p.kind == kind and p.name == name]
        usable = [p for p in found if p.reason is None]
        if usable:
            return usable[0]
        if found:
            raise PluginBroken(f"{singular(kind)} {name!r} is broken: {found[0].reason}")
        raise ClothbenchError(f"no {singular(kind)} named {name!r}; {known_names(str(name), self.names(kind))}")

    def load(self, kind: str, name: str) -> Any:
        """Import what the plugin registered: a class, a factory, or a module."""
        if (kind, name) not in self._loaded:
            plugin = self.find(kind, name)
            try:
                with quiet_output(), patience(plugin.distribution):
                    self._loaded[kind, name] = import_target(plugin.target)
            except ENDS:
                raise
            except BaseException as fault:
                raise self._broken(plugin, fault) from fault
        return self._loaded[kind, name]

    def make(self, kind: str, name: str, *args: Any, **options: Any) -> Any:
        """Build the plugin's object; an option it does not know is the user's error, in one line, and so is a plugin
        that cannot be made.
        """
        factory = self.load(kind, name)
        try:
            made = factory(*args, **options)
        except (ClothbenchError, *ENDS):
            raise
        except BaseException as fault:
            if not (isinstance(fault, TypeError) and "argument" in str(fault)):
                raise self._broken(self.find(kind, name), fault) from fault
            raise ClothbenchError(f"{singular(kind)} {name!r}: {_wrong(factory, options, fault)}") from fault
        # All effects that are installed are asked what they are before any of them is used.
        members = (*MEMBERS[kind], "parameters") if kind == "effects" else ()
        if without := [member for member in members if not hasattr(made, member)]:
            raise self._broken(self.find(kind, name), ClothbenchError(_without(kind, without)))
        return made

    @staticmethod
    def _broken(plugin: Plugin, fault: BaseException) -> PluginBroken:
        what = f"{singular(plugin.kind)} {plugin.name!r} ({plugin.distribution})"
        return PluginBroken(f"{what} is broken: {reason_of(fault)}")

    def made(self, kind: str) -> tuple[dict[str, Any], dict[str, str]]:
        """One object of every plugin of a kind, by name; and why there is none of those that cannot be made."""
        sound, broken = {}, {}
        for name in self.names(kind):
            try:
                sound[name] = self.make(kind, name)
            except ClothbenchError as fault:
                broken[name] = str(fault)
        return sound, broken


@functools.cache
def catalogue() -> Catalogue:
    """Discover all plugins, once per process."""
    seconds_to_import()  # a wrong one is told before it would pass for a plugin's fault
    return discover(entry_points(group=hookspecs.PROJECT))


def discover(points: Iterable[EntryPoint]) -> Catalogue:
    """Load entry points one by one; the built-in ones come first, then by distribution and name."""
    found: list[Plugin] = []
    configs: list[str] = []
    for point in sorted(points, key=lambda p: (_distribution(p)[0] != OWN, _distribution(p)[0], p.name)):
        plugins, more = _load(point)
        for plugin in plugins:  # one by one: a distribution may register a name twice
            found.append(_unless_taken(plugin, found))
        configs += more
    return Catalogue(tuple(found), tuple(configs))


def faulty_class(kind: str, loaded: Any) -> str:
    """What a plugin's class lacks or misstates, in a line, or ""; of a function that makes plugins nothing is known."""
    from clothbench.core.optional import libraries  # loads numpy, which listing plugins does without

    if not isinstance(loaded, type):
        return ""
    try:
        libraries(loaded)
    except ClothbenchError as fault:
        return str(fault)
    without = [name for name in MEMBERS.get(kind, ()) if not any(name in vars(one) for one in loaded.__mro__)]
    return _without(kind, without) if without else ""


def _without(kind: str, members: Iterable[str]) -> str:
    return f"it has no {', no '.join(members)}, which every {singular(kind)} has"


def singular(kind: str) -> str:
    """ "models" → "model", "studies" → "study"."""
    return f"{kind[:-3]}y" if kind.endswith("ies") else kind.removesuffix("s")


def _wrong(factory: Any, options: Iterable[str], fault: TypeError) -> str:
    """Why a plugin does not take what it was given: by the first option that is none of its own, if there is one."""
    from clothbench.core.optional import defaults_of, options_of  # loads numpy, which listing plugins does without

    stray = next((name for name in options if name not in options_of(factory)), None)
    if stray is None or "unexpected keyword" not in str(fault):
        return f"{one_line(fault)}; see `options` in clothbench plugins --json"
    return f"no option {stray!r}; {known_names(stray, defaults_of(factory))}"


def import_target(target: str) -> Any:
    """ "module:attribute" → the attribute; "module" → the module."""
    module, _, attribute = target.partition(":")
    value = importlib.import_module(module)
    for part in filter(None, attribute.split(".")):
        value = getattr(value, part)
    return value


def library_version(loaded: Any) -> str:
    """ "mujoco 4.0.0" of a plugin that is built on a library and says so in `built_on`; else ""."""
    from clothbench.core.optional import libraries  # loads numpy, which listing plugins does without

    names = libraries(loaded)
    for name in names:
        with contextlib.suppress(PackageNotFoundError):
            return f"{name} {version_of(name)}"
    return f"{names[0]} not installed" if names else ""


def config_groups(place: str) -> set[str]:
    """Folders at the top of a plugin's config package: Hydra's groups. Raises if there is no such package."""
    if place.startswith("pkg://"):
        return {entry.name for entry in files(place.removeprefix("pkg://")).iterdir() if entry.is_dir()}
    return {p.name for p in Path(place.removeprefix("file://")).iterdir() if p.is_dir()}


def quiet_output() -> AbstractContextManager[Any]:
    """What a plugin prints while it is imported goes to standard error: standard output may be a JSON document."""
    return contextlib.redirect_stdout(sys.stderr)


@contextlib.contextmanager
def patience(distribution: str) -> Iterator[None]:
    """Ends the import of a stranger's plugin that takes longer than `IMPORT_SECONDS` by a TimeoutError, again and again
    where the plugin catches it. Not where there is no such clock, or another thread imports.
    """
    seconds = seconds_to_import()
    timed = hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread()
    if distribution == OWN or not timed:
        yield
        return

    def ring(number: int, frame: object) -> None:
        raise TimeoutError(f"it was still being imported after {seconds:g} s; {PATIENCE} may give it more")

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds, 1.0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def seconds_to_import() -> float:
    """As the environment says, else `IMPORT_SECONDS`; what is no time is a ClothbenchError."""
    said = os.environ.get(PATIENCE, "")
    try:
        seconds = float(said or IMPORT_SECONDS)
    except ValueError:
        seconds = 0.0
    if not 0.0 < seconds < 1e8:
        raise ClothbenchError(f"environment variable {PATIENCE}: found {said[:80]!r}, expected seconds above 0")
    return seconds


def one_line(fault: BaseException) -> str:
    """An exception as one line for a report: type, and the first line of its message."""
    text = str(fault).strip().splitlines()
    return f"{type(fault).__name__}: {text[0]}" if text else type(fault).__name__


def reason_of(fault: BaseException) -> str:
    """Why something could not be done, in one line: clothbench's own errors say it themselves."""
    return str(fault) if isinstance(fault, ClothbenchError) else one_line(fault)


def _distribution(point: EntryPoint) -> tuple[str, str]:
    return (point.dist.name, point.dist.version) if point.dist is not None else ("unknown", "0")


def _unless_taken(plugin: Plugin, found: list[Plugin]) -> Plugin:
    """The plugin, marked broken if its name is taken: what a name means must not depend on luck."""
    for other in found:
        if (other.kind, other.name) == (plugin.kind, plugin.name) and other.reason is None:
            reason = f"the name is taken by {other.distribution} ({other.target}); rename one of the two"
            return Plugin(**{**plugin.__dict__, "reason": plugin.reason or reason})
    return plugin


def _load(point: EntryPoint) -> tuple[list[Plugin], list[str]]:
    """What one entry point registers: its plugins, or one broken "module"; and its config packages."""
    distribution, version = _distribution(point)

    def broken(reason: str) -> tuple[list[Plugin], list[str]]:
        return [Plugin("module", point.name, point.value, "", distribution, version, reason)], []

    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    try:
        with quiet_output(), patience(distribution):
            manager.register(point.load(), name=point.name)
        manager.check_pending()
        plugins = [p for kind in ALL_KINDS for p in _registered(manager, kind, distribution, version)]
        configs = [str(path) for paths in manager.hook.clothbench_configs() for path in paths]
        for place in configs:
            config_groups(place)
    except ENDS:
        raise
    except BaseException as fault:
        return broken(_explain(fault))
    if not plugins and not configs:
        return broken("it implements no clothbench hook; mark one with @clothbench.hookimpl")
    return plugins, configs


def _explain(fault: BaseException) -> str:
    """The reason for a broken module; a misspelt hook is answered with the right spelling."""
    text = one_line(fault)
    hooks = [name for name in vars(hookspecs) if name.startswith("clothbench_")]
    for word in text.replace("'", " ").replace('"', " ").split():
        if word.startswith("clothbench_") and word not in hooks:
            close = difflib.get_close_matches(word, hooks, n=1)
            return f"unknown hook {word!r}" + (
                f", did you mean {close[0]!r}?" if close else f"; there are {', '.join(hooks)}"
            )
    return text


def _registered(manager: pluggy.PluginManager, kind: str, distribution: str, version: str) -> list[Plugin]:
    out = []
    for registrations in getattr(manager.hook, f"clothbench_{kind}")():
        for r in registrations:
            if not isinstance(r, Registration):
                raise TypeError(f"clothbench_{kind} gave {type(r).__name__}, expected clothbench.Registration")
            reason = None if r.name.isidentifier() else f"{r.name!r} is not an identifier"
            out.append(Plugin(kind, r.name, r.target, r.summary, distribution, version, reason))
    return out
