"""Executors: every item once, results as they come, a dead worker costs one item."""

from collections.abc import Callable, Iterator

import pytest

from doughdata import registry
from doughdata.executors import WorkerCrash
from tests.executor_items import die_on_three, fail, slow_first, square

NAMES = ("serial", "processes", "ray")


@pytest.fixture(scope="module")
def local_ray() -> Iterator[None]:
    """Ray on this machine, started once: an executor that finds it running uses it."""
    with registry.load("executors", "ray")(workers=2):
        yield


@pytest.fixture
def executor(request: pytest.FixtureRequest) -> Callable[[str], object]:
    """Name -> executor of two workers."""

    def make(name: str) -> object:
        if name == "ray":
            request.getfixturevalue("local_ray")
        return registry.load("executors", name)(workers=2)

    return make


@pytest.mark.parametrize("name", NAMES)
def test_every_item_is_mapped_once(executor, name: str) -> None:
    """The results are those of the built-in map, in any order, over several calls."""
    with executor(name) as opened:
        for count in (7, 0, 5):
            assert sorted(opened.map(square, range(count))) == [x * x for x in range(count)]


@pytest.mark.parametrize("name", NAMES[1:])
def test_results_come_as_they_are_ready(executor, name: str) -> None:
    """A slow item does not hold back the fast ones."""
    with executor(name) as opened:
        assert list(opened.map(slow_first, range(4)))[-1] == 0


@pytest.mark.parametrize("name", NAMES[1:])
def test_a_killed_worker_costs_only_its_item(executor, name: str, capfd) -> None:
    """A worker killed by a signal is reported for its item; all others are done, in silence."""
    with executor(name) as opened:
        results = list(opened.map(die_on_three, range(6)))
    crashes = [r for r in results if isinstance(r, WorkerCrash)]
    assert [crash.item for crash in crashes] == [3]
    assert sorted(r for r in results if isinstance(r, int)) == [0, 1, 2, 4, 5]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", NAMES)
def test_an_exception_reaches_the_caller(executor, name: str) -> None:
    """An executor hides no error of the function."""
    with pytest.raises(ValueError, match="item 1"), executor(name) as opened:
        list(opened.map(fail, [1]))
