"""`croissant.json`: MLCommons Croissant 1.0 metadata (docs.mlcommons.org/croissant)."""

import json
from collections.abc import Mapping
from typing import Any

import pyarrow as pa

__all__ = ["croissant_json"]

DESCRIPTION = {  # table -> what a row is
    "scenes": "One row a scene: what it was made from, its split and its region.",
    "frames": "One row a key frame: time, opening of the gripper, components and their genus.",
    "topology_events": "Merges and splits between two key frames.",
    "graph_nodes": "Nodes of the scene-topology graph of every key frame.",
    "graph_edges": "Edges of that graph; a component's cycle rank is its genus.",
    "tool_poses": "Where both fingers are at every key frame.",
    "views": "Cameras of the depth images, and the row of each image.",
}
SPLITS = {
    "train": "cr:TrainingSplit",
    "val": "cr:ValidationSplit",
    "test": "cr:TestSplit",
}
CONTEXT = {  # the one that Croissant 1.0 asks for, word for word
    "@language": "en",
    "@vocab": "https://schema.org/",
    "citeAs": "cr:citeAs",
    "column": "cr:column",
    "conformsTo": "dct:conformsTo",
    "cr": "http://mlcommons.org/croissant/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataBiases": "cr:dataBiases",
    "dataCollection": "cr:dataCollection",
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "dct": "http://purl.org/dc/terms/",
    "equivalentProperty": "cr:equivalentProperty",
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "extract": "cr:extract",
    "field": "cr:field",
    "fileObject": "cr:fileObject",
    "fileProperty": "cr:fileProperty",
    "fileSet": "cr:fileSet",
    "format": "cr:format",
    "includes": "cr:includes",
    "isLiveDataset": "cr:isLiveDataset",
    "jsonPath": "cr:jsonPath",
    "key": "cr:key",
    "md5": "cr:md5",
    "parentField": "cr:parentField",
    "path": "cr:path",
    "personalSensitiveInformation": "cr:personalSensitiveInformation",
    "recordSet": "cr:recordSet",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "references": "cr:references",
    "regex": "cr:regex",
    "repeated": "cr:repeated",
    "replace": "cr:replace",
    "samplingRate": "cr:samplingRate",
    "sc": "https://schema.org/",
    "separator": "cr:separator",
    "source": "cr:source",
    "subField": "cr:subField",
    "transform": "cr:transform",
}


def croissant_json(
    info: Mapping[str, Any],
    tables: Mapping[str, pa.Table],
    *,
    name: str,
    description: str,
    license_name: str,
) -> bytes:
    """The document. Its paths are relative to the dataset.

    Args:
        info: `meta/info.json`, with the sha256 of the tables.
        tables: the derived tables.
        name: title of the dataset.
        description: one paragraph.
        license_name: an SPDX or Hugging Face name, or `unknown`.
    """
    document = {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": name,
        "description": description,
        "license": license_name,
        "version": f"{info['schema_version']}.0",
        "distribution": [
            *(_table_file(table, info["tables"][table]) for table in tables),
            *(_array_files(layer) for layer in info["layers"]),
        ],
        "recordSet": [
            _splits(info["splits"]),
            *(_records(table, tables[table].schema) for table in tables),
        ],
    }
    return (json.dumps(document, indent=1) + "\n").encode()


def _table_file(table: str, digest: str) -> dict[str, Any]:
    return {
        "@type": "cr:FileObject",
        "@id": f"{table}.parquet",
        "name": f"{table}.parquet",
        "contentUrl": f"meta/{table}.parquet",
        "encodingFormat": "application/x-parquet",
        "sha256": digest,
    }


def _array_files(layer: str) -> dict[str, Any]:
    return {
        "@type": "cr:FileSet",
        "@id": f"{layer}-arrays",
        "name": f"{layer}-arrays",
        "description": f"Zarr v3 arrays of layer {layer}; the commit records name the newest.",
        "encodingFormat": "application/vnd+zarr",
        "includes": f"data/{layer}/*/arrays.zarr/**",
    }


def _splits(splits: Mapping[str, Any]) -> dict[str, Any]:
    """The splits that the column `split` of the scenes refers to."""
    rows = [{"splits/name": split, "splits/url": SPLITS.get(split, "cr:Split")} for split in splits]
    return {
        "@type": "cr:RecordSet",
        "@id": "splits",
        "name": "splits",
        "description": "Splits of the scenes; every key frame and view is in that of its scene.",
        "dataType": "cr:Split",
        "key": {"@id": "splits/name"},
        "field": [
            {"@type": "cr:Field", "@id": "splits/name", "name": "name", "dataType": "sc:Text"},
            {"@type": "cr:Field", "@id": "splits/url", "name": "url", "dataType": "sc:URL"},
        ],
        "data": rows,
    }


def _records(table: str, schema: pa.Schema) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": table,
        "name": table,
        "description": DESCRIPTION[table],
        "field": [_field(table, column) for column in schema],
    }


def _field(table: str, column: pa.Field) -> dict[str, Any]:
    nested = pa.types.is_list(column.type) or pa.types.is_fixed_size_list(column.type)
    field = {
        "@type": "cr:Field",
        "@id": f"{table}/{column.name}",
        "name": column.name,
        "dataType": _type(column.type.value_type if nested else column.type),
        "source": {
            "fileObject": {"@id": f"{table}.parquet"},
            "extract": {"column": column.name},
        },
    }
    if nested:
        field["repeated"] = True
    if (table, column.name) == ("scenes", "split"):
        field["references"] = {"field": {"@id": "splits/name"}}
    return field


def _type(kind: pa.DataType) -> str:
    if pa.types.is_boolean(kind):
        return "sc:Boolean"
    if pa.types.is_integer(kind):
        return "sc:Integer"
    return "sc:Float" if pa.types.is_floating(kind) else "sc:Text"
