"""What a worker process does: lanes that come through a pipe are done one after the other, each task told of when it ends.

It ends with the run, however that ends: an idle worker finds its pipe closed, one that works is ended by the kernel (Linux) or
by a look at its parent every second.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
from multiprocessing.connection import Connection

from .machine import offer_first

_PR_SET_PDEATHSIG = 1  # prctl(2)


def serve(descriptor: int, parent: int) -> None:
    """Work until the pipe is closed.

    Parameters
    ----------
    descriptor : int
        This end of the pipe.
    parent : int
        Process id of the run.
    """
    _end_with(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the run decides what becomes of its workers
    offer_first()
    from .worker import Kept, Unsettled, do_lane

    pipe, kept = Connection(descriptor), Kept()
    try:
        pipe.send(None)
        while True:
            lanes, cache = pipe.recv()
            unsettled = Unsettled(cache)
            for lane, receipts in lanes:
                for done in do_lane(lane, cache, receipts, kept, unsettled):
                    pipe.send(done)
                    del done
            for lost in unsettled.settle():
                pipe.send(lost)
            pipe.send(None)
            del lanes, lane, receipts
    except (EOFError, BrokenPipeError, ConnectionResetError):
        sys.stdout.flush()
        os._exit(0)  # without waiting for threads that a stage may have left


def _end_with(parent: int) -> None:
    """Let this process die when its parent does."""
    told = False
    if sys.platform == "linux":
        told = ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) == 0
    if os.getppid() != parent:
        os._exit(1)
    if not told:
        threading.Thread(target=_watch, args=(parent,), daemon=True).start()


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(1.0)
    os._exit(1)
