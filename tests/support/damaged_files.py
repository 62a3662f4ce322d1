"""Solution files that are damaged in seeded ways, by kind, and a process that reads and checks them."""

import io
import json
import sys
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

# Values that programs trip over, by their type.
NUMBERS = [0, -1, 2**32 - 1, 2**63, 10**400, 1e30, -1e30, 1e308, 1e-308, float("nan"), float("inf"), 0.5]
WORDS = [
    "",
    "a\nb",
    "\x1b[31m",
    "../../etc/passwd",
    "x" * 100_000,
    "\ud800",
    "universe",
    "ground",
    "robot.py",
]
STRANGE: list[Any] = [
    *NUMBERS,
    *WORDS,
    None,
    True,
    [],
    {},
    [[]],
    [None],
    {"a": 1},
    [1e30] * 3,
    [[0.0] * 3] * 3,
]
TYPES = ["<f8", ">f8", "<f4", "<i8", "<u8", "?", "<c16", "<U3", "S4", "<M8[s]"]


def damaged(kind: str, content: bytes, random: np.random.Generator) -> bytes:
    """A solution's file, damaged in one way of that kind."""
    return KINDS[kind](arrays_of(content), content, random)


def _meta(arrays: dict[str, np.ndarray], _: bytes, random: np.random.Generator) -> bytes:
    """One entry of the JSON, at any depth, replaced, removed or repeated."""
    meta = json.loads(str(arrays["meta"]))
    places = [*_places(meta)]
    keys = sorted({place[2] for place in places})
    key = keys[random.integers(len(keys))]  # each key is as likely, however long its lists are
    of_key = [place for place in places if place[2] == key]
    holder, index, _ = of_key[random.integers(len(of_key))]
    choice = random.integers(8)
    if choice == 0:
        del holder[index]
    elif choice == 1:
        holder[index] = [holder[index]] * int(random.choice([2, 50, 2000]))
    elif choice == 2 and isinstance(holder[index], int | float):
        holder[index] *= float(random.choice([-1.0, 1e3, 1e9, 1e-12]))
    else:
        holder[index] = STRANGE[random.integers(len(STRANGE))]
    return saved({**arrays, "meta": np.array(json.dumps(meta))})


def _places(value: Any, key: str = "") -> Iterator[tuple[Any, Any, str]]:
    entries = value.items() if isinstance(value, dict) else enumerate(value)
    for index, entry in entries:
        name = key or str(index)
        yield value, index, name
        if isinstance(entry, dict | list):
            yield from _places(entry, name)


def _array(arrays: dict[str, np.ndarray], _: bytes, random: np.random.Generator) -> bytes:
    """A sampled array with strange values, another shape or another type."""
    names = [name for name in arrays if not name.startswith(("meta", "model"))]
    return saved(_changed(arrays, names, random))


def _model(arrays: dict[str, np.ndarray], _: bytes, random: np.random.Generator) -> bytes:
    """An array of the model, likewise."""
    return saved(_changed(arrays, [name for name in arrays if name.startswith("model_")], random))


def _changed(
    arrays: dict[str, np.ndarray], names: list[str], random: np.random.Generator
) -> dict[str, np.ndarray]:
    name = names[random.integers(len(names))]
    array, choice = arrays[name].copy(), random.integers(6)
    if choice == 0:
        array = array[..., None] if random.integers(2) else array.ravel()[:-1]
    elif choice == 1 and array.dtype.kind != "U":
        array = np.nan_to_num(array.real.astype(float)).astype(TYPES[random.integers(len(TYPES))])
    elif choice == 2:
        return {key: value for key, value in arrays.items() if key != name}
    elif array.size:
        flat, count = array.reshape(-1), int(random.integers(1, 4))
        rows = random.integers(array.size, size=count)
        if array.dtype.kind == "U":
            flat[rows] = str(WORDS[random.integers(len(WORDS))])[: max(array.dtype.itemsize // 4, 1)]
        elif array.dtype.kind == "f":
            flat[rows] = float(random.choice([np.nan, np.inf, 1e308, -1e30, 1e12, 1e8, 0.0, -1.0, 1e-300]))
        elif array.dtype.kind == "b":
            flat[rows] = ~flat[rows]
        else:
            flat[rows] = int(random.choice([-1, 2**31, 2**32 - 1, 2**62, 0, 1, 7]))
    return {**arrays, name: array}


def _text(arrays: dict[str, np.ndarray], _: bytes, random: np.random.Generator) -> bytes:
    """An older file, whose model is a text alone, with some words of it changed."""
    words = str(arrays["model"]).split(" ")
    for place in random.integers(len(words), size=int(random.integers(1, 4))):
        words[place] = str(random.choice(["4294967295", "-1", "99999", "1e308", "nan", "", "x", "0"]))
    older = {name: array for name, array in arrays.items() if not name.startswith("model_")}
    return saved({**older, "model": np.array(" ".join(words))})


def _bytes(_: dict[str, np.ndarray], content: bytes, random: np.random.Generator) -> bytes:
    """Bytes flipped, or the end cut off."""
    if random.integers(3) == 0:
        return content[: int(random.integers(len(content)))]
    changed = bytearray(content)
    for place in random.integers(len(changed), size=int(random.integers(1, 9))):
        changed[place] = int(random.integers(256))
    return bytes(changed)


def _member(arrays: dict[str, np.ndarray], _: bytes, random: np.random.Generator) -> bytes:
    """The header of a member says something else, or the member is no array."""
    file = io.BytesIO()
    names = list(arrays)
    chosen = names[random.integers(len(names))]
    headers = [
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (1125899906842624,), }",
        b"{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 3), }",
        b"{'descr': '|O', 'fortran_order': False, 'shape': (3,), }",
        b"{'descr': '<U0', 'fortran_order': False, 'shape': (0, 4611686018427387904), }",
        b"{'descr': [('a', '<f8')], 'fortran_order': True, 'shape': (2,), }",
        b"{'descr': '<f8', 'shape': (",
        b"(" * 900,
        b"{'descr': __import__('os'), 'fortran_order': 1, 'shape': 0}",
    ]
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in [*names, *([chosen] if random.integers(5) == 0 else [])]:
            whole = io.BytesIO()
            np.save(whole, arrays[name], allow_pickle=False)
            data, choice = whole.getvalue(), random.integers(3)
            if name == chosen and choice == 0:
                header = headers[random.integers(len(headers))]
                data = (
                    b"\x93NUMPY\x01\x00"
                    + (len(header) + 1).to_bytes(2, "little")
                    + header
                    + b"\n"
                    + data[128:]
                )
            elif name == chosen:
                data = b"no array" if choice == 1 else data[: int(random.integers(len(data)))]
            archive.writestr(f"{name}.npy", data)
    return file.getvalue()


def arrays_of(content: bytes) -> dict[str, np.ndarray]:
    """The members of a file."""
    with np.load(io.BytesIO(content)) as archive:
        return {name: archive[name] for name in archive.files}


def saved(arrays: dict[str, np.ndarray]) -> bytes:
    """A file with these members."""
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


KINDS: dict[str, Callable[[dict[str, np.ndarray], bytes, np.random.Generator], bytes]] = {
    "meta": _meta,
    "array": _array,
    "model": _model,
    "text": _text,
    "bytes": _bytes,
    "member": _member,
}


def read_all(paths: list[Path]) -> None:
    """Read and check files; say before each which it is, and after it how it went, see `main`."""
    import warnings

    import trajopt

    warnings.simplefilter("ignore")
    for path in paths:
        print("begins", path.name, flush=True)
        try:
            trajopt.Solution.load(path)
            trajopt.check(path, integrate=False)
            outcome = "report"
        except trajopt.TrajoptError as error:
            outcome = "refused" if len(str(error).splitlines()) == 1 else f"lines {error!r:.300}"
        except Exception as error:
            last = error.__traceback__
            while last is not None and last.tb_next is not None:
                last = last.tb_next
            place = "" if last is None else f"{last.tb_frame.f_code.co_filename}:{last.tb_lineno}"
            outcome = f"traceback {type(error).__name__} {error!s:.200} at {place}".replace("\n", " ")
        print("ends", path.name, outcome, flush=True)


if __name__ == "__main__":
    read_all([Path(name) for name in sys.argv[1:]])
