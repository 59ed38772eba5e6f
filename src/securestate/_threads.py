"""One thread for linear algebra: more could change the last bits, and only slow small matrices down."""

from __future__ import annotations

import threading
from functools import cache
from typing import Any

import scipy.linalg  # noqa: F401  # loads the libraries that the controller looks for
from threadpoolctl import ThreadpoolController


class _OneThread:
    """While anyone is inside, BLAS has one thread in this process."""

    def __init__(self) -> None:
        self._lock, self._inside = threading.Lock(), 0
        self._limit: Any = None

    def __enter__(self) -> None:
        with self._lock:
            self._limit = self._limit or _controller().limit(limits=1, user_api="blas")
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._limit and not self._inside:
                self._limit.restore_original_limits()
                self._limit = None


_ONE = _OneThread()


def one_blas_thread() -> _OneThread:
    """A context in which BLAS and LAPACK use one thread, in whatever thread of Python."""
    return _ONE


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()
