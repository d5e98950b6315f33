"""The settings of an executor, checked: which engine, where it is, what it gives a worker."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from typing import Any

from clothbench.core.errors import ClothbenchError
from clothbench.engine.settings import known_words, mapping, number, one_word, whole

LOCAL = "local"
ENGINES = {"dask": "distributed", "ray": "ray", "slurm": "submitit"}  # what each is imported as; extras have its name
CLUSTER = {"name", "address", "shared", "wait"}
WORDS = {
    LOCAL: {"name"}, "dask": CLUSTER, "ray": CLUSTER | {"cores"},
    "slurm": {"name", "cluster", "partition", "cores", "memory", "minutes", "parameters"},
}  # fmt: skip
CLUSTERS = ("slurm", "local")


def executor_settings(given: Any) -> dict[str, Any]:
    """The settings of the executor; {"name": "local"} where none is asked for. Its engine has to be installed."""
    stated = {"name": given} if isinstance(given, str) else mapping("executor", given) or {"name": LOCAL}
    name = stated.get("name")
    if name not in WORDS:
        raise ClothbenchError(f"setting 'executor' is {name!r}, expected one of {', '.join(WORDS)}")
    known_words(f"setting of executor {name!r}", stated, WORDS[name])
    if name != LOCAL and importlib.util.find_spec(ENGINES[name]) is None:
        raise ClothbenchError(
            f"setting 'executor' is {name}, which needs {ENGINES[name]}: pip install 'clothbench[{name}]'"
        )
    return {"name": name, **(_slurm(stated) if name == "slurm" else _cluster(stated) if name != LOCAL else {})}


def of_this_machine(executor: Mapping[str, Any]) -> bool:
    """Whether the workers of an executor are begun by the command, beside it."""
    return executor["cluster"] == "local" if executor["name"] == "slurm" else executor["address"] is None


def _cluster(stated: Mapping[str, Any]) -> dict[str, Any]:
    """Of Dask and Ray. shared: as stated; else workers of this machine find everything, and no others."""
    address, shared = stated.get("address"), stated.get("shared")
    if shared is not None and not isinstance(shared, bool):
        raise ClothbenchError(f"setting 'executor.shared' is {shared!r}, expected true or false")
    return {
        "address": None if address is None else one_word("executor.address", address),
        "shared": address is None if shared is None else shared,
        "cores": whole("executor.cores", stated.get("cores", 1), 1),
        "wait": number("executor.wait", stated.get("wait", 60), above=0.0),
    }


def _slurm(stated: Mapping[str, Any]) -> dict[str, Any]:
    """Of submitit, whose jobs always share a folder with the command."""
    cluster, memory, partition = (stated.get(name) for name in ("cluster", "memory", "partition"))
    if cluster not in (None, *CLUSTERS):
        raise ClothbenchError(f"setting 'executor.cluster' is {cluster!r}, expected one of {', '.join(CLUSTERS)}")
    return {
        "cluster": cluster or CLUSTERS[0],
        "partition": None if partition is None else one_word("executor.partition", partition),
        "cores": whole("executor.cores", stated.get("cores", 1), 1),
        "memory": None if memory is None else number("executor.memory", memory, above=0.0),
        "minutes": whole("executor.minutes", stated.get("minutes", 60), 1),
        "parameters": mapping("executor.parameters", stated.get("parameters")),
        "shared": True,
    }
