"""A glTF 2.0 file in the making: numpy arrays in, nodes, meshes and animations out.

pygltflib holds the JSON; this adds the packing of arrays into one buffer. Every array starts on a
multiple of four bytes, as the format asks for.
"""

from typing import Any

import numpy as np
from jaxtyping import Float, Float32, UInt32

from doughdata.registry import require_package

__all__ = ["Gltf"]

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963  # what a buffer view is for
KINDS = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}  # values an element -> type of the accessor
COMPONENTS = {"float32": 5126, "uint16": 5123, "uint32": 5125}
UPRIGHT = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]  # xyzw, from z up (ours) to y up (glTF's)


class Gltf:
    """One scene under a root node that turns z up into y up; all else is in metres, z up."""

    def __init__(self, name: str) -> None:
        self._lib = require_package("pygltflib", extra="export")
        lib = self._lib
        self._blob = bytearray()
        root = lib.Node(name=name, rotation=UPRIGHT, children=[])
        self._gltf = lib.GLTF2(
            asset=lib.Asset(version="2.0", generator="doughdata"),
            scene=0,
            scenes=[lib.Scene(nodes=[0], name=name)],
            nodes=[root],
        )

    def material(self, name: str, colour: Float[np.ndarray, " 3"], *, roughness: float) -> int:
        """Index of a new material; `colour` is sRGB, 0..1."""
        linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
        surface = self._lib.PbrMetallicRoughness(
            baseColorFactor=[*linear.tolist(), 1.0], metallicFactor=0.0, roughnessFactor=roughness
        )
        self._gltf.materials.append(
            self._lib.Material(name=name, pbrMetallicRoughness=surface, alphaCutoff=None)
        )
        return len(self._gltf.materials) - 1

    def mesh(
        self,
        name: str,
        vertices: Float32[np.ndarray, "vertices 3"],
        faces: UInt32[np.ndarray, "faces 3"],
        *,
        material: int,
        normals: Float32[np.ndarray, "vertices 3"] | None = None,
    ) -> int:
        """Index of a new mesh [m]; without normals a viewer shades its faces flat."""
        small = faces.astype(np.uint16 if len(vertices) < 2**16 - 1 else np.uint32)
        attributes = self._lib.Attributes(POSITION=self._array(vertices, ARRAY_BUFFER, span=True))
        if normals is not None:
            attributes.NORMAL = self._array(normals, ARRAY_BUFFER)
        primitive = self._lib.Primitive(
            attributes=attributes,
            indices=self._array(small.reshape(-1), ELEMENT_ARRAY_BUFFER),
            material=material,
        )
        self._gltf.meshes.append(self._lib.Mesh(name=name, primitives=[primitive]))
        return len(self._gltf.meshes) - 1

    def node(self, name: str, *, parent: int = 0, **fields: Any) -> int:
        """Index of a new node; `fields` are glTF's: mesh, translation, rotation, scale, extras."""
        self._gltf.nodes.append(self._lib.Node(name=name, **fields))
        index = len(self._gltf.nodes) - 1
        above = self._gltf.nodes[parent]
        above.children = [*(above.children or []), index]
        return index

    def animate(
        self,
        node: int,
        path: str,
        times: Float[np.ndarray, " keys"],
        values: Float[np.ndarray, "keys width"],
    ) -> None:
        """Set translation, rotation or scale of a node at each time [s], without blending."""
        if not self._gltf.animations:
            self._gltf.animations.append(self._lib.Animation(name="squeeze"))
        animation = self._gltf.animations[0]
        sampler = self._lib.AnimationSampler(
            input=self._array(np.asarray(times, np.float32), None, span=True),
            output=self._array(np.asarray(values, np.float32), None),
            interpolation="STEP",
        )
        animation.samplers.append(sampler)
        target = self._lib.AnimationChannelTarget(node=node, path=path)
        number = len(animation.samplers) - 1
        animation.channels.append(self._lib.AnimationChannel(sampler=number, target=target))

    def to_bytes(self) -> bytes:
        """The file in glTF's binary form, `.glb`."""
        self._gltf.buffers = [self._lib.Buffer(byteLength=len(self._blob))]
        self._gltf.set_binary_blob(bytes(self._blob))
        return b"".join(self._gltf.save_to_bytes())

    def _array(self, values: np.ndarray, target: int | None, *, span: bool = False) -> int:
        """Index of a new accessor; `span` says that the format asks for its least and greatest."""
        table = values.reshape(len(values), -1)
        data = np.ascontiguousarray(table).tobytes()
        lib, offset = self._lib, len(self._blob)
        self._blob += data + bytes(-len(data) % 4)
        self._gltf.bufferViews.append(
            lib.BufferView(buffer=0, byteOffset=offset, byteLength=len(data), target=target)
        )
        self._gltf.accessors.append(
            lib.Accessor(
                bufferView=len(self._gltf.bufferViews) - 1,
                componentType=COMPONENTS[table.dtype.name],
                count=len(table),
                type=KINDS[table.shape[1]],
                min=table.min(axis=0).tolist() if span else None,
                max=table.max(axis=0).tolist() if span else None,
            )
        )
        return len(self._gltf.accessors) - 1
