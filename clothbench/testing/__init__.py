"""The conformance kit: one call tells the author of a plugin whether it keeps the rules for its kind.

    from clothbench.testing import check_model
    check_model(MyModel)

Every check takes what is registered (the class or factory), returns one `Outcome` per rule, and raises
`ConformanceError` with one readable line at the first rule that is broken. `only` picks rules by name.
"""

from __future__ import annotations

import importlib

_HOME = {
    "check_model": "models",
    "check_effect": "effects",
    "check_metric": "metrics",
    "check_optimizer": "optimizers",
    "check_tracker": "trackers",
    "check_plugin": "kinds",
    "rule_names": "kinds",
    "ConformanceError": "rules",
    "Outcome": "rules",
}

__all__ = [
    "ConformanceError",
    "Outcome",
    "check_effect",
    "check_metric",
    "check_model",
    "check_optimizer",
    "check_plugin",
    "check_tracker",
    "rule_names",
]


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'clothbench.testing' has no attribute {name!r}")
    return getattr(importlib.import_module(f"clothbench.testing.{_HOME[name]}"), name)
