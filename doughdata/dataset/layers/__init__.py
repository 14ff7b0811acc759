"""One file a layer: records to arrays and tables, and back without loss."""

from doughdata.dataset.layers.depth import decode_depth, encode_depth
from doughdata.dataset.layers.mesh import decode_label_grid, decode_meshes, encode_mesh
from doughdata.dataset.layers.recorded import RecordedScene, decode_color, encode_recorded
from doughdata.dataset.layers.sim import decode_particles, decode_tool_poses, encode_sim
from doughdata.dataset.layers.topology import (
    decode_events,
    decode_frame_topology,
    decode_genus,
    decode_topology,
    encode_topology,
)

__all__ = [
    "RecordedScene",
    "decode_color",
    "decode_depth",
    "decode_events",
    "decode_frame_topology",
    "decode_genus",
    "decode_label_grid",
    "decode_meshes",
    "decode_particles",
    "decode_tool_poses",
    "decode_topology",
    "encode_depth",
    "encode_mesh",
    "encode_recorded",
    "encode_sim",
    "encode_topology",
]
