"""A time limit in wall time for code that may never end: the user's own Python."""

import _thread
import signal
import threading
from collections.abc import Callable
from typing import Any

LONGEST_S = 20.0


def is_late(run: Callable[[], None]) -> bool:
    """Run a function; interrupt it, as Ctrl-C does, after LONGEST_S. Returns whether it was
    interrupted.

    A KeyboardInterrupt by the user is passed on. For the main thread only.
    """
    late = threading.Event()
    handler_before = signal.getsignal(signal.SIGINT)

    def interrupt() -> None:
        """Interrupt the main thread. Called by the timer, in its own thread."""
        late.set()
        _thread.interrupt_main()

    def on_interrupt(_number: int, _frame: Any) -> None:
        """Raise for our interrupt, and for the user's unless it was ignored before."""
        if late.is_set() or handler_before is not signal.SIG_IGN:
            raise KeyboardInterrupt

    # Python installs no handler in a process that a shell started in the background, so an
    # interrupt would have no effect.
    signal.signal(signal.SIGINT, on_interrupt)
    timer = threading.Timer(LONGEST_S, interrupt)
    timer.daemon = True
    timer.start()
    try:
        run()
    except KeyboardInterrupt:
        if not late.is_set():
            raise
    except Exception:
        if not late.is_set():  # else it is a consequence of the interruption
            raise
    finally:
        timer.cancel()
        signal.signal(signal.SIGINT, handler_before)
    return late.is_set()
