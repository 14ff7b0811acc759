"""From what a commit recorded to the same stage again."""

from collections.abc import Mapping
from dataclasses import is_dataclass
from types import MappingProxyType
from typing import Any, get_args, get_type_hints

from doughdata import registry
from doughdata.dataset import StageRecord
from doughschemas import BadInputError

__all__ = ["rebuild_depth", "rebuild_stage"]

KINDS = MappingProxyType({"sim": "simulators", "topology": "topology", "mesh": "meshers"})


def rebuild_stage(layer: str, record: StageRecord) -> Any:
    """The object that made a layer, from its registered name and recorded configuration.

    Raises:
        UnknownNameError: no such plug-in is installed.
        BadInputError: the plug-in has other settings than the recorded ones.
    """
    make = registry.load(KINDS[layer], record.name)
    config = dict(record.config)
    given = config.pop("pull_apart", None)
    more = {} if given is None else {"pull_apart": _pull_apart(given)}
    return make(_config(make, config), **more)


def rebuild_depth(record: StageRecord) -> tuple[Any, Any]:
    """Renderer and sensor that made a layer `depth.<sensor>`.

    Raises:
        UnknownNameError: no such sensor is installed.
        BadInputError: renderer or sensor have other settings than the recorded ones.
    """
    from doughdata.render.depth import DepthStage

    config = dict(record.config)
    renderer = DepthStage(_config(DepthStage, config.pop("render")))
    make = registry.load("sensors", record.name)
    settings = _config(make, config)
    return renderer, make() if settings is None else make(settings)


def _pull_apart(config: Mapping[str, Any]) -> Any:
    from doughdata.sim.pull import MpmPullApart

    return MpmPullApart(_config(MpmPullApart, config))


def _config(make: Any, values: Mapping[str, Any]) -> Any:
    """The frozen configuration that a class is given, from plain JSON; None if it has none."""
    import dacite

    hint = get_type_hints(make.__init__).get("config")
    known = [kind for kind in (hint, *get_args(hint)) if is_dataclass(kind)]
    if not known:
        return None
    rules = dacite.Config(cast=[tuple], strict=True, type_hooks={float: float})
    try:
        return dacite.from_dict(known[0], dict(values), config=rules)  # type: ignore[type-var]
    except dacite.DaciteError as error:
        raise BadInputError(
            f"{make.__name__} of this release cannot take the recorded settings: {error}"
        ) from error
