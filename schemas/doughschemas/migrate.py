"""Version policy: a newer major is refused, a newer minor warns, an older one is brought forward.

What a step does to a dataset is in `doughdata.dataset.migrate`; here is which step follows which.
"""

import re
import warnings

from doughschemas.errors import VersionError
from doughschemas.records import SCHEMA_VERSION

__all__ = ["MIGRATIONS", "check_version", "is_newer", "migration_path"]

MIGRATIONS = {"1.0": "1.1"}  # old version -> the version that one step makes of it


def check_version(found: str, *, what: str) -> bool:
    """Whether data of a schema version can be read; True = as it is, False = migrate it first.

    Warns when the minor version is newer: fields that this release does not know are ignored.

    Raises:
        VersionError: no version, or a newer major; the message names both versions.
    """
    version, own = _parsed(found, what), _parsed(SCHEMA_VERSION, what)
    if version[0] > own[0]:
        raise VersionError(
            f"{what} has schema version {found}; this release reads {own[0]}.x: upgrade doughdata"
        )
    if version > own:
        warnings.warn(
            f"{what} has schema version {found}, newer than {SCHEMA_VERSION}; "
            "fields that this release does not know are ignored",
            stacklevel=3,
        )
    return version[0] == own[0]


def is_newer(found: str, *, what: str) -> bool:
    """Whether data are of a newer version than this release writes. Raises as `check_version`."""
    return _parsed(found, what) > _parsed(SCHEMA_VERSION, what)


def migration_path(found: str) -> list[str]:
    """Versions that an older one passes through on the way to `SCHEMA_VERSION`, in order.

    Raises:
        VersionError: no chain of steps leads there.
    """
    steps = []
    version = found
    while version != SCHEMA_VERSION:
        if version not in MIGRATIONS:
            raise VersionError(f"no migration from schema version {version} to {SCHEMA_VERSION}")
        version = MIGRATIONS[version]
        steps.append(version)
    return steps


def _parsed(version: str, what: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d+)\.(\d+)", version)
    if not match:
        raise VersionError(f"{what}: schema_version must be like {SCHEMA_VERSION}, got {version!r}")
    return int(match[1]), int(match[2])
