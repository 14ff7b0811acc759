"""What executors call in the tests; importable in any worker."""

import os
import signal
import time

__all__ = ["die_on_three", "fail", "slow_first", "square"]


def square(x: int) -> int:
    """x squared."""
    return x * x


def die_on_three(x: int) -> int:
    """Kills its own process for 3."""
    if x == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return x


def slow_first(x: int) -> int:
    """Takes two seconds for 0."""
    time.sleep(2.0 if x == 0 else 0.0)
    return x


def fail(x: int) -> int:
    """Raises for everything."""
    raise ValueError(f"item {x}")
