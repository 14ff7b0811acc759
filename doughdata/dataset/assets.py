"""Tool meshes travel with the dataset, so that a scene can be simulated anywhere."""

from dataclasses import replace
from hashlib import sha256
from typing import Any

from doughdata.dataset.store import Store
from doughdata.scenes import finger_mesh
from doughschemas import Scene, Tool

__all__ = ["resolve_tools", "store_tools"]

ASSETS = "assets/tools/"


def store_tools(store: Store, scene: Scene) -> Scene:
    """Copy tool meshes to `assets/tools/<sha256>.glb` [m, finger frame]; the scene names these."""
    return replace(scene, tools=tuple(_stored(store, tool) for tool in scene.tools))


def resolve_tools(store: Store, scene: Scene) -> Scene:
    """The scene with paths that exist on this machine."""
    tools = tuple(
        replace(tool, mesh=str(store.local(tool.mesh)))
        if tool.mesh is not None and tool.mesh.startswith(ASSETS)
        else tool
        for tool in scene.tools
    )
    return replace(scene, tools=tools)


def _stored(store: Store, tool: Tool) -> Tool:
    if tool.mesh is None or tool.mesh.startswith(ASSETS):
        return tool
    own = str(store.local(ASSETS))
    if tool.mesh.startswith(own):  # a scene of this dataset that was resolved before
        return replace(tool, mesh=ASSETS + tool.mesh[len(own) :].lstrip("/"))
    data: Any = finger_mesh(tool).export(file_type="glb")
    path = f"{ASSETS}{sha256(data).hexdigest()}.glb"
    store.create(path, data)
    return replace(tool, mesh=path, scale=1.0)
