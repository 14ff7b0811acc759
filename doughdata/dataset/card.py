"""`README.md`: a Hugging Face dataset card. Its measured parts are renewed, the rest is yours."""

import re
from collections.abc import Mapping
from hashlib import sha256
from typing import Any

__all__ = ["TITLE", "card_digest", "card_license", "renewed_card"]

TITLE = "Dough with ground-truth topology"
YAML = ("# doughdata: begin (rewritten with every refresh)", "# doughdata: end")
BODY = ("<!-- doughdata: begin (rewritten with every refresh) -->", "<!-- doughdata: end -->")
UNKNOWN = "unknown"  # a license that Hugging Face knows
CLASSES = ((1e3, "n<1K"), (1e4, "1K<n<10K"), (1e5, "10K<n<100K"), (1e6, "100K<n<1M"))
SPLIT = "all_splits"  # a table holds the rows of all splits; its scenes say which


def renewed_card(
    old: str | None, measured: Mapping[str, Any], *, license_name: str | None = None
) -> str:
    """The card with its measured parts brought up to date.

    Args:
        old: text of the card that is there; a card without our marks is returned as it is.
        measured: `tables` (names), `sizes` (`dataset_sizes`), `topology` (`topology_statistics`),
            `info` (`meta/info.json`).
        license_name: by default the one that the card names, else `unknown`.
    """
    yaml = _yaml(measured, license_name or card_license(old))
    body = _body(measured)
    if old is None or not old.strip():
        return f"---\n{_block(YAML, yaml)}\n---\n\n{_block(BODY, body)}\n"
    for marks, text in ((YAML, yaml), (BODY, body)):
        pattern = re.escape(marks[0]) + ".*?" + re.escape(marks[1])
        block = _block(marks, text)
        old = re.sub(pattern, lambda _, block=block: block, old, count=1, flags=re.DOTALL)
    return old


def card_license(text: str | None) -> str:
    """The license that a card names."""
    found = re.search(r"^license: *(\S+)", text or "", flags=re.MULTILINE)
    return found[1] if found else UNKNOWN


def card_digest(text: str) -> str | None:
    """sha256 of the measured parts with their marks; None for a card that has none."""
    parts = []
    for begin, end in (YAML, BODY):
        found = re.search(re.escape(begin) + ".*?" + re.escape(end), text, flags=re.DOTALL)
        parts.append(found[0] if found else "")
    return sha256("\n".join(parts).encode()).hexdigest() if any(parts) else None


def _block(marks: tuple[str, str], text: str) -> str:
    return f"{marks[0]}\n{text}\n{marks[1]}"


def _yaml(measured: Mapping[str, Any], license_name: str) -> str:
    frames = measured["sizes"]["frames"]
    size = next((name for limit, name in CLASSES if frames < limit), "n>1M")
    lines = [
        f"pretty_name: {TITLE}",
        f"license: {license_name}",
        "task_categories:",
        "- robotics",
        "tags:",
        *(f"- {tag}" for tag in ("deformable-objects", "topology", "simulation", "depth", "zarr")),
        "size_categories:",
        f"- {size}",
        "configs:",
    ]
    for table in measured["tables"]:
        lines.append(f"- config_name: {table}")
        if table == "frames":
            lines.append("  default: true")
        lines += ["  data_files:", f"  - split: {SPLIT}", f"    path: meta/{table}.parquet"]
    return "\n".join(lines)


def _body(measured: Mapping[str, Any]) -> str:
    sizes, info = measured["sizes"], measured["info"]
    parts = [
        f"# {TITLE}",
        "What a gripper does to the topology of a soft body, key frame by key frame: components, "
        "their genus, and when pieces merge or part. SI units; z is up, the table is z = 0.",
        "## What it holds",
        _table(("", ""), _counts(sizes, info)),
        "## Scenes",
        _table(
            ("family", "split", "scenes"),
            [(*kind.rsplit("/", 1), n) for kind, n in sizes["scenes_by_family_and_split"].items()],
        ),
    ]
    if measured["topology"]:
        parts += ["## How scenes end", _table(ENDS, _ends(measured["topology"]))]
    return "\n\n".join([*parts, "## How to read it", READING.strip()])


ENDS = ("family", "final topology", "scenes", "share")
READING = """
```python
import doughdata

dataset = doughdata.open_dataset("path/of/this/folder")
frame = dataset.frame(scene=dataset.scene_indices[0], frame=0)
frame.particles.positions, frame.topology.genus
```

The tables under `meta/` are Parquet and open with `datasets.load_dataset(folder, "frames")`;
the arrays under `data/` are Zarr v3 and open with any Zarr client. `c` is the number of
components, `g` the genus of each. The column `split` of the scenes is the split of all their key
frames and views. `doughdata validate --deep` checks every byte.
"""


def _counts(sizes: Mapping[str, Any], info: Mapping[str, Any]) -> list[tuple]:
    rows: list[tuple] = [
        ("scenes", sizes["scenes"]),
        ("key frames a scene", info["num_frames"]),
        ("key frames", sizes["frames"]),
        ("layers", ", ".join(f"`{layer}`" for layer in sizes["layers"]) or "none"),
    ]
    rows += [(f"depth views, `{layer}`", count) for layer, count in sizes["views"].items()]
    if sizes["failed"]:
        rows.append(("failures", sizes["failed"]))
    return [
        *rows,
        ("format", info["schema_version"]),
        ("fingerprint", f"`{info['fingerprint']}`"),
    ]


def _ends(topology: Mapping[str, Any]) -> list[tuple]:
    return [
        (family, f"`{name}`", count, f"{found['final_share'][name]:.1%}")
        for family, found in topology.items()
        for name, count in found["final"].items()
    ]


def _table(head: tuple[str, ...], rows: list[tuple]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)
