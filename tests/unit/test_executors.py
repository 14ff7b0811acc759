"""Executors: every item once, results as they come, a dead worker costs one item."""

import os
import signal
import time

import pytest

from doughdata import registry
from doughdata.executors import WorkerCrash


def square(x: int) -> int:
    return x * x


def die_on_three(x: int) -> int:
    if x == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return x


def slow_first(x: int) -> int:
    time.sleep(2.0 if x == 0 else 0.0)
    return x


def fail(x: int) -> int:
    raise ValueError(f"item {x}")


@pytest.mark.parametrize("name", ["serial", "processes"])
def test_every_item_is_mapped_once(name: str) -> None:
    """The results are those of the built-in map, in any order, over two calls of one pool."""
    with registry.load("executors", name)(workers=2) as executor:
        for count in (7, 0, 5):
            assert sorted(executor.map(square, range(count))) == [x * x for x in range(count)]


def test_results_come_as_they_are_ready() -> None:
    """A slow item does not hold back the fast ones."""
    with registry.load("executors", "processes")(workers=2) as executor:
        assert list(executor.map(slow_first, range(4)))[-1] == 0


def test_a_killed_worker_costs_only_its_item() -> None:
    """A worker killed by a signal is reported for its item; all other items are done."""
    with registry.load("executors", "processes")(workers=2) as executor:
        results = list(executor.map(die_on_three, range(6)))
    crashes = [r for r in results if isinstance(r, WorkerCrash)]
    assert [crash.item for crash in crashes] == [3]
    assert sorted(r for r in results if isinstance(r, int)) == [0, 1, 2, 4, 5]


@pytest.mark.parametrize("name", ["serial", "processes"])
def test_an_exception_reaches_the_caller(name: str) -> None:
    """An executor hides no error of the function."""
    with (
        pytest.raises(ValueError, match="item 1"),
        registry.load("executors", name)(workers=1) as executor,
    ):
        list(executor.map(fail, [1]))
