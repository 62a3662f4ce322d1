"""Kernels for other registers than the widest of this processor."""

from collections.abc import Iterator
from contextlib import contextmanager

from trajopt import _engine

# In bytes: all that this processor has.
REGISTERS = [size for size in (16, 32, 64) if size <= _engine.WIDEST_REGISTER]


@contextmanager
def registers(size: int) -> Iterator[None]:
    """Within it, kernels use registers of this size."""
    _engine.use_registers(size)
    try:
        yield
    finally:
        _engine.use_registers(_engine.WIDEST_REGISTER)
