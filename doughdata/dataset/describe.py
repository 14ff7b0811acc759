"""What describes a dataset to others, renewed with its tables: statistics, card, Croissant.

`info["documents"]` keeps their hashes, so that a damaged or outdated one is found.
"""

from collections.abc import Iterator, Mapping
from hashlib import sha256
from typing import Any

import pyarrow as pa

from doughdata.dataset.card import TITLE, card_digest, card_license, renewed_card
from doughdata.dataset.croissant import croissant_json
from doughdata.dataset.documents import dump_document, load_document
from doughdata.dataset.report import Problem
from doughdata.dataset.statistics import dataset_sizes, table_features, topology_statistics
from doughdata.dataset.store import Store
from doughschemas import DoughError

__all__ = ["Features", "check_documents", "describe", "known_arrays"]

CARD, CROISSANT, STATS = "README.md", "croissant.json", "meta/stats.json"
Features = Mapping[str, Mapping[str, list]]  # name -> min, max, mean, std, count


def describe(
    store: Store,
    info: Mapping[str, Any],
    tables: Mapping[str, pa.Table],
    *,
    arrays: Features | None = None,
    license_name: str | None = None,
) -> dict[str, str]:
    """Write `meta/stats.json`, `README.md` and `croissant.json`; returns document -> sha256.

    Args:
        store: where the dataset lies.
        info: its info, up to date.
        tables: its tables, up to date.
        arrays: statistics of arrays; by default those that are there, if nothing changed since.
        license_name: of the card; by default the one that it has.

    A card without the marks of ours is a user's own: it is left alone.

    Raises:
        DatasetError: the disk is full or read-only.
    """
    sizes, topology = dataset_sizes(info, tables), topology_statistics(tables)
    if arrays is None:
        arrays = known_arrays(store, info["fingerprint"])
    stats = dump_document(
        {
            "schema_version": info["schema_version"],
            "fingerprint": info["fingerprint"],
            **table_features(tables),
            **arrays,
        }
    )
    old = _text(store, CARD)
    measured = {"tables": list(tables), "sizes": sizes, "topology": topology, "info": info}
    card = renewed_card(old, measured, license_name=license_name)
    croissant = croissant_json(
        info, tables, name=TITLE, description=_summary(sizes), license_name=card_license(card)
    )
    found = {STATS: stats, CROISSANT: croissant, CARD: card.encode()}
    for name, data in found.items():
        if not store.exists(name) or store.read(name) != data:
            store.replace(name, data)
    hashes = {STATS: sha256(stats).hexdigest(), CROISSANT: sha256(croissant).hexdigest()}
    digest = card_digest(card)
    return hashes if digest is None else {**hashes, CARD: digest}


def check_documents(store: Store, info: Mapping[str, Any]) -> Iterator[Problem]:
    """Documents that are missing or not what the last refresh wrote."""
    advice = "has changed since it was written; `doughdata card` writes it again"
    for name, digest in info.get("documents", {}).items():
        try:
            data = store.read(name)
        except DoughError as error:
            yield Problem(file=name, message=str(error).removeprefix(f"{store.uri}: "))
            continue
        here = card_digest(data.decode(errors="replace")) if name == CARD else _digest(data)
        if here != digest:
            yield Problem(file=name, message=advice)


def known_arrays(store: Store, fingerprint: str) -> Features:
    """Statistics of arrays in `meta/stats.json`, if they are of this very content."""
    try:
        document = load_document(store.read(STATS), name=STATS) if store.exists(STATS) else {}
    except DoughError:
        return {}  # damaged: measured again when someone asks
    if document.get("fingerprint") != fingerprint:
        return {}
    return {name: value for name, value in document.items() if name.startswith(("sim/", "depth."))}


def _summary(sizes: Mapping[str, Any]) -> str:
    return (
        f"{sizes['scenes']} scenes of dough that is squeezed, cut and joined by a gripper, in "
        f"{sizes['frames']} key frames, with components, genus, meshes and depth images where "
        f"they were made (layers: {', '.join(sizes['layers']) or 'none'})."
    )


def _text(store: Store, name: str) -> str | None:
    return store.read(name).decode(errors="replace") if store.exists(name) else None


def _digest(data: bytes) -> str:
    return sha256(data).hexdigest()
