"""What `metadata.yaml` says of a rosbag2 folder: its files and how many messages they hold."""

from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from doughdata.recordings.protocol import Loss

__all__ = ["METADATA", "Folder", "read_folder"]

METADATA = "metadata.yaml"  # written last: a recorder that was killed leaves none
STORAGE = (".mcap", ".db3")


@dataclass(frozen=True, slots=True, kw_only=True)
class Folder:
    """Files of a rosbag2 folder, and what they cannot tell by themselves."""

    parts: tuple[Path, ...]  # that are there, plain storage files
    num_expected: int | None  # messages of all files; None = nothing says
    compressed: bool  # by rosbag2 itself, whole files or each message
    losses: tuple[Loss, ...]
    warnings: tuple[str, ...]


def read_folder(path: Path) -> Folder:
    """Look into a folder and its description; damage in it is told, not raised."""
    parts = tuple(sorted(p for p in path.iterdir() if p.suffix in STORAGE))
    if not (path / METADATA).exists():
        line = f"there is no {METADATA}: nothing tells whether files are missing"
        return Folder(parts=parts, num_expected=None, compressed=False, losses=(), warnings=(line,))
    try:
        info = _information(path / METADATA)
        names = [PurePosixPath(str(name)).name for name in info["relative_file_paths"]]
        count = int(info["message_count"])
        mode = str(info.get("compression_mode", "")).lower()
    except Exception as error:  # any bytes may come: the library fails in any way
        reason = f"{METADATA} is damaged ({type(error).__name__}); files may be missing"
        loss = Loss(where=path.name, count=1, unit="damaged place", reason=reason)
        return Folder(parts=parts, num_expected=None, compressed=False, losses=(loss,), warnings=())
    missing = [name for name in names if not (path / name).exists()]
    reason = f"missing: {', '.join(missing[:3])}" + (" and more" if len(missing) > 3 else "")
    return Folder(
        parts=tuple(part for part in parts if part.name in names),
        num_expected=count,
        compressed=mode not in ("", "none"),
        losses=(Loss(where=path.name, count=len(missing), unit="file", reason=reason),)
        * bool(missing),
        warnings=(),
    )


def _information(path: Path) -> dict[str, Any]:
    from ruamel.yaml import YAML  # what rosbags reads it with

    found = YAML(typ="safe").load(path.read_text())["rosbag2_bagfile_information"]
    return dict(found)
