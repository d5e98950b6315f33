"""The one decorator of compiled code. What it keeps on disk is keyed by the content of every source it is made of.

numba keys its cache by the file that a function stands in, and by that file's time stamp. Code that calls a helper of
another file, or has a number of one built in, would stay as it was after an edit there: a wrong result that nobody
sees. So here the key is a digest of the file's text and of the text of all modules that it imports, and they in turn.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.util
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from numba import njit, types
from numba.core import event
from numba.core.caching import IndexDataCacheFile
from numba.core.errors import NumbaExperimentalFeatureWarning

from clothbench.core.counting import CheckedCompiler

OTHERS = {*sys.stdlib_module_names, "numpy", "scipy", "numba", "llvmlite"}  # numba's own key knows their versions


def kernel(
    function: Callable | None = None, /, *, signature: Any = None, allocates: bool = True, **options: Any
) -> Any:
    """Compile a function with numba: `@kernel`, or `@kernel(signature=…, fastmath=True, …)` with options of `njit`.

    No branch for divisions by zero, no lock of the interpreter. With a signature it is compiled where it is defined,
    else when it is first called; either way the machine code lies on disk afterwards, until a source of it changes.

    allocates: whether it makes arrays, or calls what returns some. One that does not need not count who refers to them
    (every view of a row counts twice, a tenth to a quarter of the time of loops over small sheets), and is held to it:
    see `counting`.
    """

    def decorate(function: Callable) -> Callable:
        with warnings.catch_warnings():
            # Functions as values let one time loop call any effect; that numba marks them experimental is no news.
            warnings.simplefilter("ignore", NumbaExperimentalFeatureWarning)
            settings = {"pipeline_class": CheckedCompiler, "_nrt": allocates, **options}
            compiled = njit(error_model="numpy", nogil=True, **settings)(function)
            keep_on_disk(compiled)
            if signature is not None:
                compiled.compile(signature)
                compiled.disable_compile()
        return compiled

    return decorate if function is None else decorate(function)


# For functions that make no arrays.
lean_kernel = functools.partial(kernel, allocates=False)

# For sums that may be taken in any order; no numbers that are not finite are expected away.
fast_kernel = functools.partial(kernel, fastmath={"contract", "reassoc", "nsz", "arcp"})


class _Apart(CheckedCompiler):
    """numba's compiler, told that no argument that a function writes to overlaps another."""

    def define_pipelines(self) -> Any:
        self.state.flags.noalias = True
        return super().define_pipelines()


# The same for functions none of whose arguments overlaps one that is written to. Loops over many rows become vector
# code only with that promise (else the compiler would have to compare each row with each before every loop), and only
# where the index is unsigned: numba takes any other for one that may count from the end.
apart_kernel = functools.partial(fast_kernel, pipeline_class=_Apart)


class _Compiling(event.Listener):
    """How long numba has been compiling in this process, anybody's functions, in whatever threads."""

    def __init__(self) -> None:
        self.lock, self.depth, self.began, self.seconds = threading.Lock(), 0, 0.0, 0.0

    def on_start(self, event: Any) -> None:
        with self.lock:
            if self.depth == 0:
                self.began = time.perf_counter()
            self.depth += 1

    def on_end(self, event: Any) -> None:
        with self.lock:
            self.depth -= 1
            if self.depth == 0:
                self.seconds += time.perf_counter() - self.began


_compiling = _Compiling()
event.register("numba:compile", _compiling)


def compiled_for() -> float:
    """Seconds that this process has spent in compiling so far, which is no part of what a search takes."""
    with _compiling.lock:
        return _compiling.seconds


def bundle_type(kind: type, *fields: Any) -> Any:
    """numba's type of a named tuple, from the types of its fields: for kernels that take arguments in bundles."""
    return types.BaseTuple.from_types(fields, kind)


class _Index(IndexDataCacheFile):
    """numba's index of machine code on disk; one that an earlier version wrote, of classes that lie elsewhere now, is
    as good as none.
    """

    def _load_index(self) -> dict:
        try:
            return super()._load_index()
        except Exception:
            return {}


def keep_on_disk(compiled: Any) -> None:
    """Let numba cache a function under the digest of its sources; where this numba keeps its cache otherwise, not at
    all: slow, but never wrong.
    """
    stamp = digest_of(compiled.py_func.__module__)
    if stamp is None:  # typed in somewhere: there is no file to go by
        return
    compiled.enable_caching()
    cache = compiled._cache
    try:
        base = cache._impl.filename_base + ("" if compiled.targetoptions["_nrt"] else "-lean")
        assert isinstance(cache._cache_file, IndexDataCacheFile)
        cache._cache_file = _Index(cache_path=cache.cache_path, filename_base=base, source_stamp=stamp)
    except (AttributeError, AssertionError, TypeError):
        cache.disable()
        warnings.warn("this numba keeps its cache otherwise; kernels are compiled anew in every process", stacklevel=4)


def lies_on_disk(compiled: Any) -> bool:
    """Whether machine code of a function, from its sources as they are, is kept; so is what is never kept taken."""
    cache = compiled._cache
    return not isinstance(getattr(cache, "_cache_file", None), _Index) or bool(cache._cache_file._load_index())


@functools.cache
def digest_of(module: str) -> str | None:
    """SHA-256 over the texts of a module and of all that it imports, and they in turn; None if it is no file."""
    if source_of(module) is None:
        return None
    found, waiting = {module}, [module]
    while waiting:
        for name in imported_by(waiting.pop()):
            if name not in found:
                found.add(name)
                waiting.append(name)
    digest = hashlib.sha256()
    for name in sorted(found):
        digest.update(f"{name}\n".encode() + (source_of(name) or b""))
    return digest.hexdigest()


@functools.cache
def source_of(module: str) -> bytes | None:
    """The text of a loaded module; None if it has none, or is somebody else's."""
    file = getattr(sys.modules.get(module), "__file__", None)
    if module.partition(".")[0] in OTHERS or file is None or not file.endswith(".py"):
        return None
    path = Path(file)
    return path.read_bytes() if path.is_file() else None


@functools.cache
def imported_by(module: str) -> frozenset[str]:
    """The loaded modules with a source that a module imports, and those that what it imports from them came from."""
    return frozenset(name for name in _mentioned(module) if source_of(name) is not None)


def _mentioned(module: str) -> Iterator[str]:
    package = getattr(sys.modules[module], "__package__", None) or ""
    for node in _statements(ast.parse(source_of(module) or b"").body):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            given = "." * node.level + (node.module or "")
            origin = importlib.util.resolve_name(given, package) if node.level else given
            yield origin
            for alias in node.names:
                yield f"{origin}.{alias.name}"
                yield str(getattr(getattr(sys.modules.get(origin), alias.name, None), "__module__", None))


def _statements(nodes: Iterable[ast.AST]) -> Iterator[ast.AST]:
    """What is run when a module is loaded, also inside `try`, `if` and `with`.

    Nothing of functions: what they import when they run is no part of compiled code, and may not be loaded yet; as is
    what is there for type checkers only.
    """
    for node in nodes:
        yield node
        if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING"):
            yield from _statements(node.orelse)
        elif not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.expr):
            yield from _statements(ast.iter_child_nodes(node))
