"""The number of threads of torch, on which the last bits of its sums depend."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

__all__ = ["one_thread"]


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep torch to one thread, for a block or, as a decorator, for a function.

    Results are then equal to the last bit on any number of threads, and come no later: matrices are
    small here, and waking other threads costs more.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
