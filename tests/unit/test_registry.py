"""Plug-ins."""

import pytest

from doughdata import registry
from doughdata.stages import Mesher, SceneFamily, Sensor, Shape, Simulator, TopologyCheck
from doughschemas import MissingPackageError, UnknownNameError

PROTOCOLS = {
    "scenes": SceneFamily,
    "shapes": Shape,
    "simulators": Simulator,
    "topology": TopologyCheck,
    "meshers": Mesher,
    "sensors": Sensor,
}


@pytest.mark.parametrize("kind", PROTOCOLS)
def test_every_built_in_fits_its_protocol(kind: str) -> None:
    """Each registered plug-in is made without arguments and has the method of its stage."""
    for name in registry.names(kind):
        assert isinstance(registry.load(kind, name)(), PROTOCOLS[kind])


@pytest.mark.parametrize("kind", registry.KINDS)
def test_an_unknown_name_lists_the_known_ones(kind: str) -> None:
    """The message says what kind was meant and which names exist."""
    with pytest.raises(UnknownNameError, match="unknown") as caught:
        registry.load(kind, "nothing-of-the-kind")
    assert all(name in str(caught.value) for name in registry.names(kind))


def test_a_near_miss_is_hinted() -> None:
    """A misspelt name gets the right one as a hint."""
    with pytest.raises(UnknownNameError, match="did you mean 'doughnut'"):
        registry.load("scenes", "donut")


def test_a_missing_package_names_its_extra() -> None:
    """The error shows the line to type."""
    with pytest.raises(MissingPackageError, match=r'pip install "doughdata\[view\]"'):
        registry.require_package("a_package_that_does_not_exist", extra="view")
