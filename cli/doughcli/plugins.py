"""`doughdata plugins`: what is registered under each kind."""

from doughcli.options import JsonOption, emit_json

__all__ = ["command"]

NAME = "plugins"
HELP = "List every registered scene family, shape, simulator, check, mesher, sensor, ..."
EPILOG = "Example: doughdata plugins --json"


def command(as_json: JsonOption = False) -> None:
    """List registered plug-ins."""
    from doughdata import registry

    found = {kind: registry.names(kind) for kind in registry.KINDS}
    if as_json:
        emit_json(found)
        return
    for kind, names in found.items():
        print(f"{kind:<12}{', '.join(names) or '-'}")
