"""Who computes: this process, several on this machine, or a Dask cluster.

What they are given are module-level functions with their arguments. Nothing depends
on who computes it, nor on the order in which results come back. This module imports
little: each process that computes starts with it.
"""

from __future__ import annotations

import logging
import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    Future,
    ProcessPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from softwave_min.native import description
from softwave_min.runs.identity import run_identity

if TYPE_CHECKING:
    from distributed import Client

Arguments = tuple[Any, ...]

CONNECTING = 5.0
"""Longest that a scheduler may take to answer, in s."""
AHEAD = 4
"""Calls that each process has before it: it shall not wait, nor shall what is submitted later."""


@dataclass(frozen=True)
class Outcome:
    """What a run came to."""

    arrays: dict[str, NDArray[Any]]
    seconds: float
    engine: str
    failure: str = ""
    """Why there are no arrays."""


def attempt(
    function: Callable[[Any], Mapping[str, NDArray[Any]]], parameters: Any, identity: str
) -> Outcome:
    """Compute a run; what its function raises is an outcome as well.

    ``identity`` is the run's where it is asked for. Where it is another one, so is the
    source, and nothing is computed.
    """
    engine = description()
    if run_identity(function, parameters) != identity:
        return Outcome({}, 0.0, engine, "the worker has another source or environment.lock")
    started = time.perf_counter()
    try:
        arrays = {name: np.asarray(array) for name, array in function(parameters).items()}
    except Exception as error:  # one failure must not stop the sweep
        return Outcome({}, 0.0, engine, in_a_line(error))
    return Outcome(arrays, time.perf_counter() - started, engine)


def in_a_line(error: BaseException) -> str:
    """What an error says, or else its kind."""
    return " ".join(str(error).split()) or type(error).__name__


class Result(Protocol):
    """What a call came to."""

    def result(self) -> Any:
        """Value that the function returned; raises what it raised."""


class Workers(Protocol):
    """Those who compute, for as long as the context lasts."""

    here: bool
    """Whether on this machine."""

    def completed(
        self, function: Callable[..., Any], calls: Sequence[Arguments]
    ) -> Iterator[tuple[int, Result]]:
        """Call the function once with each of the arguments; results as they come.

        Yields
        ------
        (int, Result)
            Index of the call, and what it came to.
        """

    def __enter__(self) -> Self:
        """Engage them."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Let them go; at once after an error."""


class Processes:
    """Processes on this machine, started when first needed; with one job, this one."""

    here = True

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        self._pool: ProcessPoolExecutor | None = None
        self._strangers: set[multiprocessing.process.BaseProcess] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._pool is None:
            return
        self._pool.shutdown(wait=kind is None, cancel_futures=True)
        self._pool = None
        if kind is not None:
            for process in set(multiprocessing.active_children()) - self._strangers:
                process.terminate()

    def completed(
        self, function: Callable[..., Any], calls: Sequence[Arguments]
    ) -> Iterator[tuple[int, Result]]:
        """See `Workers`; a single call is made in this process."""
        if len(calls) == 1:
            yield 0, _called(function, calls[0])
            return
        left = enumerate(calls)
        waiting: dict[Future[Any], int] = {}
        while True:
            room = AHEAD * self.jobs - len(waiting) if self.jobs > 1 else 1
            waiting |= {self.submit(function, *call): index for index, call in islice(left, room)}
            if not waiting:
                return
            for future in wait(waiting, return_when=FIRST_COMPLETED).done:
                yield waiting.pop(future), future

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Have one call made, before those of `completed` that are still to be handed out.

        With one job it is made at once.
        """
        if self.jobs == 1:
            return _called(function, arguments)
        with _interrupts_held_back():  # for good in a worker, which ends with this process
            try:
                return self._started().submit(function, *arguments)
            except BrokenExecutor:  # a worker died; the calls that it had are told so
                self._pool = None
                return self._started().submit(function, *arguments)

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            self._strangers = set(multiprocessing.active_children())
            # Fork would copy the libraries' threads in an unknown state.
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self.jobs, context, initializer=_end_with_parent)
        return self._pool


def _called(function: Callable[..., Any], arguments: Arguments) -> Future[Any]:
    future: Future[Any] = Future()
    try:
        future.set_result(function(*arguments))
    except Exception as error:  # the caller decides, as with other processes
        future.set_exception(error)
    return future


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    former = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, former)


def _end_with_parent() -> None:
    """End this worker when its parent has died, which its queue would never tell it."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_watch, args=(parent.sentinel,), daemon=True).start()


def _watch(sentinel: int) -> None:
    multiprocessing.connection.wait([sentinel])
    os._exit(1)


class Cluster:
    """The workers of a Dask cluster that is running already."""

    here = False

    def __init__(self, address: str) -> None:
        self.address = address
        self._client: Client | None = None

    def __enter__(self) -> Self:
        """Connect.

        Raises
        ------
        ConnectionError
            If no scheduler answers at the address.
        """
        import distributed  # noqa: PLC0415 - takes a second, and few need it

        # What goes wrong is said once, by the results.
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        try:
            self._client = distributed.Client(self.address, timeout=CONNECTING)
        except (OSError, ValueError, TypeError) as error:
            reason = str(error).partition("\n")[0]
            text = f"--scheduler {self.address}: no Dask scheduler answers there ({reason})"
            raise ConnectionError(text) from None
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._client is not None:
            self._client.close()

    def completed(
        self, function: Callable[..., Any], calls: Sequence[Arguments]
    ) -> Iterator[tuple[int, Result]]:
        """See `Workers`.

        Raises
        ------
        ConnectionError
            If the scheduler went away.
        """
        import distributed  # noqa: PLC0415

        if self._client is None or self._client.status != "running":
            raise ConnectionError(f"--scheduler {self.address}: the connection was lost")
        waiting = {
            self._client.submit(function, *call, pure=False): index
            for index, call in enumerate(calls)
        }
        for future in distributed.as_completed(list(waiting)):
            yield waiting.pop(future), future
