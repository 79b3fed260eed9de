"""A watch by the clock on the wall, for what may never come to an end: the user's own Python."""

import _thread
import signal
import threading
from collections.abc import Callable
from typing import Any

LONGEST_S = 20.0


def is_late(run: Callable[[], None]) -> bool:
    """Run it, as by Ctrl-C interrupted where it takes longer than LONGEST_S; whether it was.

    A KeyboardInterrupt of somebody who wants no more of it passes. In the main thread only.
    """
    late = threading.Event()
    usual = signal.getsignal(signal.SIGINT)

    def interrupt() -> None:
        late.set()
        _thread.interrupt_main()

    def on_interrupt(number: int, frame: Any) -> None:
        if late.is_set() or usual is not signal.SIG_IGN:
            raise KeyboardInterrupt

    # Otherwise nothing would interrupt what a shell has begun in the background.
    signal.signal(signal.SIGINT, on_interrupt)
    watch = threading.Timer(LONGEST_S, interrupt)
    watch.daemon = True
    watch.start()
    try:
        run()
    except KeyboardInterrupt:
        if not late.is_set():
            raise
    except Exception:
        if not late.is_set():  # otherwise it is what the interruption has become
            raise
    finally:
        watch.cancel()
        signal.signal(signal.SIGINT, usual)
    return late.is_set()
