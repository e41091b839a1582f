"""Who computes: this process, several on this machine (loky), or a Dask cluster.

What they are given are module-level functions with their arguments. Nothing depends
on who computes it, nor on the order in which results come back. This module imports
little: each process that computes starts with it.
"""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from softwave_min.data import recording
from softwave_min.native import description
from softwave_min.runs.identity import run_identity

if TYPE_CHECKING:
    from distributed import Client
Arguments = tuple[Any, ...]

CONNECTING = 5.0
"""Longest that a scheduler may take to answer, in s."""
GLANCE = 0.5
"""How often a worker looks whether its parent is alive, in s."""


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
    source, and nothing is computed. Nor is what a file was read for: the identity knows
    nothing of it.
    """
    engine = description()
    if run_identity(function, parameters).digest != identity:
        return Outcome({}, 0.0, engine, "the worker has another source or environment.lock")
    started = time.perf_counter()
    try:
        with recording() as read:
            arrays = {name: np.asarray(array) for name, array in function(parameters).items()}
    except Exception as error:  # one failure must not stop the sweep
        return Outcome({}, 0.0, engine, in_a_line(error))
    if read:
        names = ", ".join(sorted(path.name for path in read))
        return Outcome({}, 0.0, engine, f"a run reads no file, and this one read {names}")
    return Outcome(arrays, time.perf_counter() - started, engine)


def in_a_line(error: BaseException) -> str:
    """What an error says, or else its kind."""
    return " ".join(str(error).split()) or type(error).__name__


class Executor(Protocol):
    """Those who compute, for as long as the context lasts."""

    here: bool
    """Whether on this machine."""
    ahead: int | None
    """Calls that are handed out at a time, so that what is submitted later need not wait for
    all others; None: all."""

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """Have a call made."""

    def __enter__(self) -> Self:
        """Engage them."""

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Let them go; at once after an error."""


def completed(
    executor: Executor, function: Callable[..., Any], calls: Sequence[Arguments]
) -> Iterator[tuple[int, Future[Any]]]:
    """Call the function once with each of the arguments; index and future as they are done.

    A worker that dies takes the calls of the others along. These are made again, one after the
    other: only the one that kills its worker once more has failed. A single call is made here.
    """
    if len(calls) == 1 and executor.here:
        yield 0, _called(function, *calls[0])
        return
    left, waiting, lost = enumerate(calls), dict[Future[Any], int](), list[int]()
    while True:
        room = None if executor.ahead is None else executor.ahead - len(waiting)
        for index, call in islice(left, room):
            waiting[executor.submit(function, *call)] = index
        if not waiting:
            break
        for future in wait(waiting, return_when=FIRST_COMPLETED).done:
            index = waiting.pop(future)
            if is_lost(future):
                lost.append(index)
            else:
                yield index, future
    for index in sorted(lost):
        alone = executor.submit(function, *calls[index])
        wait([alone])
        yield index, alone


def is_lost(future: Future[Any]) -> bool:
    """Whether a call that is over was not made because a worker died."""
    return not future.cancelled() and isinstance(future.exception(), BrokenExecutor)


def _called(function: Callable[..., Any], *arguments: Any) -> Future[Any]:
    future: Future[Any] = Future()
    try:
        future.set_result(function(*arguments))
    except Exception as error:  # the caller decides, as with other processes
        future.set_exception(error)
    return future


class Processes:
    """Processes on this machine, started when first needed; with one job, this one."""

    here = True

    def __init__(self, jobs: int) -> None:
        self.jobs = jobs
        # No process shall wait for its next call.
        self.ahead: int | None = 2 * jobs if jobs > 1 else 1
        self._pool: Any = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(kill_workers=kind is not None)
            self._pool = None

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """See `Executor`; with one job the call is made at once."""
        if self.jobs == 1:
            return _called(function, *arguments)
        try:
            future: Future[Any] = self._started().submit(function, *arguments)
        except BrokenExecutor:  # a worker died; the calls that it had are told so
            self._pool = None
            future = self._started().submit(function, *arguments)
        return future

    def _started(self) -> Any:
        if self._pool is None:
            from loky import ProcessPoolExecutor  # noqa: PLC0415 - not needed to find all current

            # loky renews a worker that has grown: each new structure of the model stays compiled.
            warnings.filterwarnings("ignore", message="A worker (was restarted|stopped)")
            self._pool = ProcessPoolExecutor(self.jobs, initializer=_serve, initargs=(os.getpid(),))
        return self._pool


def _serve(parent: int) -> None:
    """Leave interrupts to the parent, and end with it, which loky's queue would never tell."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(GLANCE)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


class Cluster:
    """The workers of a Dask cluster that is running already."""

    here = False
    ahead: int | None = None

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
        self._executor = self._client.get_executor(pure=False)
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._client is not None:
            self._client.close()

    def submit(self, function: Callable[..., Any], *arguments: Any) -> Future[Any]:
        """See `Executor`.

        Raises
        ------
        ConnectionError
            If the scheduler went away.
        """
        if self._client is None or self._client.status != "running":
            raise ConnectionError(f"--scheduler {self.address}: the connection was lost")
        future: Future[Any] = self._executor.submit(function, *arguments)
        return future
