"""Meshes travel with the dataset, so that a scene can be made and simulated anywhere."""

from dataclasses import replace
from hashlib import sha256
from typing import Any

from doughdata.dataset.store import Store
from doughdata.scenes import FamilyName, body_mesh, finger_mesh
from doughschemas import Body, Scene, Tool

__all__ = ["located", "resolve_family", "resolve_path", "store_family", "store_meshes"]

TOOLS, BODIES = "assets/tools/", "assets/bodies/"


def store_meshes(store: Store, scene: Scene) -> Scene:
    """Copy meshes of tools and bodies to `assets/`; the scene names these copies."""
    return replace(
        scene,
        tools=tuple(_stored_tool(store, tool) for tool in scene.tools),
        bodies=tuple(_stored_body(store, body) for body in scene.bodies),
    )


def resolve_path(store: Store, path: str) -> str:
    """Where a mesh that a scene names lies on this machine; a remote one is downloaded."""
    return str(store.fetch(path)) if path.startswith((TOOLS, BODIES)) else path


def located(store: Store, scene: Scene) -> Scene:
    """A stored scene whose tool meshes have paths that exist on this machine."""
    tools = (
        tool if tool.mesh is None else replace(tool, mesh=resolve_path(store, tool.mesh))
        for tool in scene.tools
    )
    return replace(scene, tools=tuple(tools))


def store_family(store: Store, source: str) -> str:
    """The text of a family (`FamilyName`) whose mesh, if it has one, lies in the dataset."""
    name = FamilyName.parse(source)
    if name.name != "mesh" or name.argument is None:
        return source
    return str(replace(name, argument=_stored_file(store, name.argument)))


def resolve_family(store: Store, source: str) -> str:
    """The text of a family with a path that exists on this machine."""
    name = FamilyName.parse(source)
    if name.argument is None:
        return source
    return str(replace(name, argument=resolve_path(store, name.argument)))


def _stored_tool(store: Store, tool: Tool) -> Tool:
    if tool.mesh is None:
        return tool
    own = _own(store, tool.mesh, TOOLS)
    if own is not None:
        return replace(tool, mesh=own)
    data: Any = finger_mesh(tool).export(file_type="glb")
    return replace(tool, mesh=_create(store, TOOLS, data), scale=1.0)


def _stored_body(store: Store, body: Body) -> Body:
    if body.shape != "mesh":
        return body
    return replace(body, parameters={**body.parameters, "file": _stored_file(store, _file(body))})


def _stored_file(store: Store, file: str) -> str:
    own = _own(store, file, BODIES)
    if own is not None:
        return own
    data: Any = body_mesh(file).export(file_type="glb")
    return _create(store, BODIES, data)


def _own(store: Store, path: str, folder: str) -> str | None:
    """The path relative to the dataset, if the file is the dataset's own."""
    if path.startswith(folder):
        return path
    own = str(store.local(folder))  # a scene of this dataset that was resolved before
    return folder + path[len(own) :].lstrip("/") if path.startswith(own) else None


def _create(store: Store, folder: str, data: bytes) -> str:
    path = f"{folder}{sha256(data).hexdigest()}.glb"
    store.create(path, data)
    return path


def _file(body: Body) -> str:
    return str(body.parameters.get("file", ""))
