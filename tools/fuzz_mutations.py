"""How `tools/fuzz.py` spoils what is valid: bytes, texts, JSON, NetCDF files and tables. All by a seeded generator."""

from __future__ import annotations

import json
import random
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa

NUMBERS = (0, 1, -1, 2, 127, 255, 256, 65535, 2**31 - 1, -(2**31), 2**32, 10**9, 2**53 + 1, 2**63 - 1, -(2**63), 10**30,
           0.5, -0.0, 1e-320, 1e-12, 1e12, 1.7e308, -1.7e308, float("nan"), float("inf"), float("-inf"))  # fmt: skip
PICKLE = b"cos\nsystem\n(S'touch FUZZED'\ntR."  # runs a command where something unpickles it
MARKUP = "</script><script>FUZZED</script><img src=x onerror=FUZZED>"
TEXTS = (
    "", " ", "\n", "a\nb", "\x00", "\x1b[31mred", "[red]", "[/]", "../../FUZZED", "/tmp/FUZZED", "~", "$HOME", MARKUP,
    "null", "nan", "inf", "-1", "1e999", "0x10", "é", "\u202e", "\U0001f9f5", "a" * 3000, "1 2", "0 0 -9.81", "{}",
    "[]",
    "!!python/object/apply:os.system ['touch FUZZED']", "${oc.env:HOME}", "${suite}", "_target_: os.system",
    "eval(1)", "fit", "held_out", "ok", "error", "calibration", "mechanics", "%s%n", "*", "builtin:", "pkg://os/",
    "pkg://",
    "dataset:x", "file:///etc",
)  # fmt: skip
RAW = ("1e999", "-1e999", "NaN", "Infinity", "1" * 5000, "[" * 3000, "{" * 50, '{"a":' * 3000, '"\\ud800"', "1.", "01")


def damaged(data: bytes, chance: random.Random) -> bytes:
    """One to eight small changes anywhere."""
    out = bytearray(data)
    for _ in range(chance.choice((1, 1, 1, 2, 4, 8))):
        chance.choice(_BYTES)(out, chance)
    return bytes(out)


def _flip(out: bytearray, chance: random.Random) -> None:
    if out:
        out[chance.randrange(len(out))] ^= 1 << chance.randrange(8)


def _set(out: bytearray, chance: random.Random) -> None:
    if out:
        out[chance.randrange(len(out))] = chance.choice((0, 1, 0x7F, 0x80, 0xFF, 10, 34, chance.randrange(256)))


def _word(out: bytearray, chance: random.Random) -> None:
    width = chance.choice("HIQ")
    value = int(chance.choice([n for n in NUMBERS if isinstance(n, int)])) % 2 ** (8 * struct.calcsize(width))
    place = chance.randrange(len(out) + 1)
    packed = struct.pack(chance.choice("<>") + width, value)
    out[place : place + len(packed)] = packed


def _cut(out: bytearray, chance: random.Random) -> None:
    del out[chance.randrange(len(out) + 1) :]


def _drop(out: bytearray, chance: random.Random) -> None:
    place = chance.randrange(len(out) + 1)
    del out[place : place + chance.choice((1, 2, 8, 100))]


def _again(out: bytearray, chance: random.Random) -> None:
    place, size = chance.randrange(len(out) + 1), chance.choice((1, 4, 16, 64, 512))
    out[place:place] = out[place : place + size] * chance.choice((1, 1, 2, 100))


def _insert(out: bytearray, chance: random.Random) -> None:
    place = chance.randrange(len(out) + 1)
    out[place:place] = chance.choice((*(t.encode() for t in TEXTS), *(r.encode() for r in RAW), PICKLE, bytes(64)))


def _move(out: bytearray, chance: random.Random) -> None:
    a, b, size = chance.randrange(len(out) + 1), chance.randrange(len(out) + 1), chance.choice((4, 8, 64, 512))
    out[a : a + size] = out[b : b + size]


_BYTES: tuple[Callable[[bytearray, random.Random], None], ...] = (
    _flip,
    _set,
    _word,
    _cut,
    _drop,
    _again,
    _insert,
    _move,
)


def other_text(text: str, chance: random.Random) -> bytes:
    """A text with other lines, words or numbers; now and then with other bytes."""
    lines = text.split("\n")
    for _ in range(chance.choice((1, 1, 2, 4))):
        at = chance.randrange(len(lines))
        words = lines[at].split(" ")
        word = chance.randrange(len(words))
        fresh = chance.choice((*TEXTS, *map(str, NUMBERS), *RAW))
        change = chance.randrange(6)
        if change == 0 and len(lines) > 1:
            del lines[at]
        elif change == 1:
            lines[at:at] = [lines[at]] * chance.choice((1, 1, 2, 50))
        elif change == 2:
            lines.insert(at, chance.choice(lines))
        elif change == 3:
            words[word] = fresh
            lines[at] = " ".join(words)
        else:
            head, colon, _ = lines[at].partition(": ")
            lines[at] = f"{head}{colon}{fresh}"
    out = "\n".join(lines).encode("utf-8", "surrogatepass")
    return damaged(out, chance) if chance.random() < 0.2 else out


def value(chance: random.Random) -> Any:
    """Something that is not expected."""
    kind = chance.randrange(6)
    if kind == 0:
        return chance.choice(NUMBERS)
    if kind == 1:
        return chance.choice(TEXTS)
    if kind == 2:
        return chance.choice((None, True, False, [], {}, [[]], {"": None}))
    if kind == 3:
        return [chance.choice(NUMBERS) for _ in range(chance.choice((1, 2, 3, 9)))]
    if kind == 4:
        return {"_target_": "os.system", "command": "touch FUZZED", "_args_": ["touch FUZZED"]}
    return f"@raw{chance.randrange(len(RAW))}@"


def other_json(document: Any, chance: random.Random) -> bytes:
    """A document with a few values replaced, removed, added or moved."""
    document = json.loads(json.dumps(document))
    for _ in range(chance.choice((1, 1, 1, 2, 3))):
        document = _other_node(document, chance)
    text = json.dumps(document)
    for n, raw in enumerate(RAW):
        text = text.replace(f'"@raw{n}@"', raw)
    out = text.encode("utf-8", "surrogatepass")
    return damaged(out, chance) if chance.random() < 0.15 else out


def _other_node(node: Any, chance: random.Random) -> Any:
    if not isinstance(node, dict | list) or not node or chance.random() < 0.15:
        return value(chance)
    keys = list(node) if isinstance(node, dict) else list(range(len(node)))
    key, change = chance.choice(keys), chance.randrange(8)
    if change == 0:
        del node[key]
    elif change == 1 and isinstance(node, dict):
        node[chance.choice(TEXTS)] = value(chance)
    elif change == 1:
        node += node
    elif change == 2:
        node[key] = node[chance.choice(keys)]
    else:
        node[key] = _other_node(node[key], chance)
    return node


# --- NetCDF ---------------------------------------------------------------------------------------------------------


def other_netcdf(path: Path, chance: random.Random) -> None:
    """Change attributes and variables of a file as HDF5 lets anybody do; now and then its bytes, too."""
    try:
        with h5py.File(path, "r+") as file:
            for _ in range(chance.choice((1, 1, 1, 2, 3))):
                chance.choice(_NETCDF)(file, chance)
    except Exception:
        pass  # not even HDF5 writes that; what was done so far stays
    if chance.random() < 0.3:
        path.write_bytes(damaged(path.read_bytes(), chance))


def _name(group: Any, chance: random.Random) -> str:
    return chance.choice(sorted(group) or ["time"])


def _attribute(file: Any, chance: random.Random) -> None:
    names = sorted(file.attrs)
    fresh = [
        chance.choice(NUMBERS), chance.choice(TEXTS), h5py.Empty("f"), np.arange(3.0), np.array(["a", "b"], object),
        np.bytes_(b"\xff\xfe"), np.float32(1), np.array([], float), file.ref, True, np.zeros((2, 2), "i1"),
    ]  # fmt: skip
    file.attrs[chance.choice(names + list(TEXTS[:3]))] = chance.choice(fresh)


def _no_attribute(file: Any, chance: random.Random) -> None:
    del file.attrs[chance.choice(sorted(file.attrs))]


def _of_variable(file: Any, chance: random.Random) -> None:
    """Attributes that a reader of NetCDF obeys."""
    names = ("units", "_FillValue", "missing_value", "scale_factor", "add_offset", "dtype", "coordinates", "_Unsigned",
             "calendar", "valid_range", "_Netcdf4Dimid", "_Netcdf4Coordinates", "DIMENSION_LIST", "CLASS", "NAME",
             "flag_values", "grid_mapping", "_Encoding")  # fmt: skip
    fresh = (chance.choice(NUMBERS), chance.choice(TEXTS), np.arange(2), "m", "seconds since 2000-01-01", "bool")
    file[_name(file, chance)].attrs[chance.choice(names)] = chance.choice(fresh)


def _values(file: Any, chance: random.Random) -> None:
    data = file[_name(file, chance)]
    whole = np.array(data[()])
    flat = whole.reshape(-1)
    change = chance.randrange(5)
    if change == 0:
        flat[chance.randrange(len(flat))] = chance.choice(NUMBERS)
    elif change == 1:
        flat[:] = chance.choice(NUMBERS)
    elif change == 2:
        flat[:] = flat[::-1].copy()
    elif change == 3:
        flat *= chance.choice((-1, 1e-9, 1e9, 1e300))
    else:
        flat[:] = flat[0]
    data[()] = whole


def _replaced(file: Any, chance: random.Random) -> None:
    """A variable of the same name with another type or shape."""
    name = _name(file, chance)
    shape, units = file[name].shape, file[name].attrs.get("units", "m")
    types = ("f4", ">f8", "i1", "u8", "f2", "c16", "S3", "O", "?", [("a", "f8"), ("b", "S2")], "V5", "g")
    shapes = (shape, (), (0,), (0, *shape[1:]), shape[1:], (*shape, 2), shape[::-1], (1,) * len(shape))
    of: Any = chance.choice(types)
    of = h5py.string_dtype() if of == "O" else of
    del file[name]
    file.create_dataset(name, chance.choice(shapes) if chance.random() < 0.7 else shape, of).attrs["units"] = units


def _claim(file: Any, chance: random.Random) -> None:
    """Far more values than the file holds."""
    name = _name(file, chance)
    shape, of, units = file[name].shape, file[name].dtype, file[name].attrs.get("units", "m")
    del file[name]
    size = tuple(chance.choice((10**9, 10**5, n)) for n in shape) or (10**9,)
    file.create_dataset(name, size, of, chunks=(1,) * len(size)).attrs["units"] = units


def _elsewhere(file: Any, chance: random.Random) -> None:
    """A variable whose values lie in another file, or in a ring."""
    name = _name(file, chance)
    of, shape = file[name].dtype, file[name].shape
    del file[name]
    change = chance.randrange(4)
    if change == 0:
        file[name] = h5py.ExternalLink("/etc/hostname", "/x")
    elif change == 1:
        file[name] = h5py.SoftLink(chance.choice((f"/{name}", "/", "/nowhere")))
    elif change == 2:
        file.create_dataset(name, shape, of, external=[("/proc/self/environ", 0, h5py.h5f.UNLIMITED)])
    else:
        layout = h5py.VirtualLayout(shape, of)
        layout[...] = h5py.VirtualSource("/etc/hostname", "x", shape)
        file.create_virtual_dataset(name, layout)


def _gone(file: Any, chance: random.Random) -> None:
    del file[_name(file, chance)]


def _group(file: Any, chance: random.Random) -> None:
    name = _name(file, chance)
    del file[name]
    file.create_group(name)["/" if chance.random() < 0.2 else "inside"] = np.zeros(2)


def _scale(file: Any, chance: random.Random) -> None:
    """Other dimensions on an axis."""
    one, other = file[_name(file, chance)], file[_name(file, chance)]
    if one.attrs.get("DIMENSION_LIST", np.empty(0)).dtype != object:  # spoilt before: HDF5 itself dies of asking for it
        return
    axis = one.dims[chance.randrange(len(one.dims))]
    for scale in list(axis.values()):
        axis.detach_scale(scale)
    if chance.random() < 0.5:
        axis.attach_scale(other)


_NETCDF: tuple[Callable[[Any, random.Random], None], ...] = (
    _attribute, _attribute, _no_attribute, _of_variable, _of_variable, _values, _values, _values, _replaced, _claim,
    _elsewhere, _gone, _group, _scale,
)  # fmt: skip


# --- tables ---------------------------------------------------------------------------------------------------------


def other_table(table: pa.Table, chance: random.Random) -> pa.Table:
    """Columns that are gone, of another type, or hold what no run writes; no rows, many rows; another schema."""
    for _ in range(chance.choice((1, 1, 2, 3))):
        change, n = chance.randrange(8), chance.randrange(max(1, table.num_columns))
        if change == 0 and table.num_columns > 1:
            table = table.remove_column(n)
        elif change == 1:
            names = [chance.choice(TEXTS[7:]) if k == n else name for k, name in enumerate(table.column_names)]
            table = table.rename_columns(names)
        elif change == 2:
            table = table.slice(0, chance.choice((0, 1)))
        elif change == 3:
            table = pa.concat_tables([table] * chance.choice((2, 50)))
        elif change == 4:
            table = table.replace_schema_metadata({"clothbench_schema": chance.choice(TEXTS), "x": "y" * 1000})
        else:
            table = table.set_column(n, table.column_names[n], _column(table.num_rows, chance))
    return table


def _column(rows: int, chance: random.Random) -> pa.Array:
    change = chance.randrange(7)
    if change == 0:
        return pa.nulls(rows)
    if change == 1:
        return pa.array([chance.choice(TEXTS) for _ in range(rows)], pa.string())
    if change == 2:
        return pa.array([float(chance.choice(NUMBERS)) for _ in range(rows)], pa.float64())
    if change == 3:
        return pa.array([chance.randrange(-(2**63), 2**63) for _ in range(rows)], pa.int64())
    if change == 4:
        return pa.array([[1.0, None]] * rows)
    if change == 5:
        return pa.array([{"a": 1}] * rows)
    return pa.array([PICKLE] * rows, pa.binary())
