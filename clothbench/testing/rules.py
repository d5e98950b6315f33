"""How the kit speaks: a rule is a small function, a broken one is told in one line."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from clothbench.core.errors import ClothbenchError

# A rule looks at one plugin. It raises ConformanceError, or returns why it does not apply, or None if kept.
Rule = Callable[[Any], str | None]


class ConformanceError(AssertionError):
    """A plugin breaks a rule. One line: whose, which rule, what was found, what was expected."""


class NotApplicable(Exception):
    """Raised by a rule, or by what it calls, that cannot say anything about this plugin."""


@dataclass(frozen=True)
class Outcome:
    """A rule that was not broken; `skipped` says why it did not apply, "" if it did."""

    rule: str
    skipped: str = ""


def require(kept: object, found: object, expected: object) -> None:
    """Raise unless `kept` is true; found and expected are said in words, with units."""
    if not kept:
        raise ConformanceError(f"found {found}, expected {expected}")


def require_members(plugin: object, protocol: type, members: Iterable[str]) -> None:
    """The plugin has every member, a name that is an identifier, and a whole version number."""
    for member in members:
        require(hasattr(plugin, member), f"no {member!r}", f"all members of clothbench.{protocol.__name__}")
    name, version = plugin.name, plugin.version  # type: ignore[attr-defined]
    require(isinstance(name, str) and name.isidentifier(), f"name {name!r}", "an identifier")
    counted = isinstance(version, int) and not isinstance(version, bool) and version >= 1
    require(counted, f"version {version!r}", "a whole number from 1 on")


def require_refusal(work: Callable[[], object], what: str) -> None:
    """`work` must be refused with the one exception that a user is shown as one line."""
    try:
        work()
    except ClothbenchError:
        return
    except Exception as fault:
        require(False, f"{type(fault).__name__} for {what}", "a ClothbenchError")
    require(False, f"no complaint about {what}", "a ClothbenchError")


def rule_name(rule: Rule) -> str:
    return rule.__name__.replace("_", " ")


def choose(rules: Sequence[Rule], only: Iterable[str] | None) -> list[Rule]:
    """All rules, or those named; a name that does not exist is an error."""
    known = {rule_name(rule): rule for rule in rules}
    wanted = list(known) if only is None else list(only)
    for name in wanted:
        if name not in known:
            raise ClothbenchError(f"no conformance rule {name!r}; there are: {', '.join(known)}")
    return [known[name] for name in wanted]


def run_rules(subject: str, rules: Iterable[Rule], case: Any) -> tuple[Outcome, ...]:
    """Run the rules one after the other; the first that is broken is raised."""
    return tuple(Outcome(rule_name(rule), _judge(subject, rule, case)) for rule in rules)


def _judge(subject: str, rule: Rule, case: Any) -> str:
    where = f"{subject}: {rule_name(rule)}"
    try:
        return rule(case) or ""
    except NotApplicable as reason:
        return str(reason)
    except ConformanceError as fault:
        raise ConformanceError(f"{where}: {fault}") from None
    except Exception as fault:
        # The author needs the traceback of an exception, so it stays attached as the cause.
        first = (str(fault).strip().splitlines() or [""])[0]
        raise ConformanceError(f"{where}: found {type(fault).__name__}: {first}, expected no exception") from fault


def made(make: Callable[..., Any], kind: str, *args: Any, **options: Any) -> Any:
    """The plugin's object from what was registered for it; one that cannot be made is a broken rule, too."""
    try:
        return make(*args, **options)
    except Exception as fault:
        called = getattr(make, "__name__", repr(make))
        raise ConformanceError(
            f"{kind} {called}: making it: found {type(fault).__name__}: {fault}, expected no exception"
        ) from fault
