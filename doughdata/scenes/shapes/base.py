"""From a `Body` record to a solid, and the limits that every shape checks."""

from dataclasses import fields
from typing import Any

from doughdata import registry
from doughdata.stages import Shape
from doughschemas import Body, SceneError

__all__ = ["require_range", "shape_of"]

TYPES: dict[Any, str] = {float: "a number", int: "an integer", str: "text"}


def shape_of(body: Body) -> Shape:
    """The solid of a body, at its own origin.

    Raises:
        UnknownNameError: the shape is not registered.
        SceneError: a parameter is unknown, missing or outside its physical limits.
    """
    shape: Any = registry.load("shapes", body.shape)
    known = [f.name for f in fields(shape)]
    unknown = sorted(set(body.parameters) - set(known))
    if unknown:
        raise SceneError(
            f"shape {body.shape!r} has no {', '.join(unknown)} (it has: {', '.join(known)})"
        )
    for field in fields(shape):
        if field.name in body.parameters:
            _check_type(body, field.name, field.type)
    try:
        return shape(**body.parameters)
    except TypeError as error:
        raise SceneError(f"shape {body.shape!r}: {error} (it has: {', '.join(known)})") from error


def require_range(what: str, value: Any, low: float, high: float, *, unit: str = "m") -> None:
    """Check a physical quantity.

    Raises:
        SceneError: it is no number or outside [low, high].
    """
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (number and low <= value <= high):
        raise SceneError(f"{what} must be within {low:g}..{high:g} {unit}, got {value!r}".rstrip())


def _check_type(body: Body, name: str, kind: Any) -> None:
    """A parameter must have the type of its field; an integer may stand for a float."""
    value: Any = body.parameters[name]
    accepted = (int, float) if kind is float else kind
    if kind in TYPES and (isinstance(value, bool) or not isinstance(value, accepted)):
        raise SceneError(f"{body.shape} {name} must be {TYPES[kind]}, got {value!r}")
