"""Which topics hold depth, colour and calibration, found by type, content and name."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice, takewhile
from pathlib import PurePosixPath

from doughdata.recordings.errors import RecordingError
from doughdata.recordings.images import COLOUR, holds_depth
from doughdata.recordings.options import TopicOptions
from doughdata.recordings.pictures import IMAGES, INFOS, Picture, PictureError, picture_of
from doughdata.recordings.source import Source, Topic

__all__ = ["ChosenTopics", "choose_topics"]

TRIED = 8  # messages looked at until one can be read
ALIGNED = "aligned_depth_to_color"


@dataclass(frozen=True, slots=True, kw_only=True)
class ChosenTopics:
    """Names of the topics that are used."""

    depth: str
    color: str | None
    info: str | None


def choose_topics(source: Source, options: TopicOptions) -> ChosenTopics:
    """Topics of one camera.

    Raises:
        RecordingError: a named topic is not there or of another type; no depth; or several
            cameras and no word about which.
    """
    pictures = dict(_first_pictures(source))
    depth = _depth(source, pictures, options)
    color = _colour(source, pictures, depth, options)
    return ChosenTopics(depth=depth, color=color, info=_info(source, pictures, depth, options))


def _first_pictures(source: Source) -> Iterator[tuple[str, Picture | None]]:
    """Image topics with their first readable image."""
    for topic in source.topics.values():
        if topic.kind not in IMAGES or not topic.count:
            continue
        found = None
        for message in islice(source.messages([topic.name]), TRIED):
            try:
                found = picture_of(message, topic.kind)
                break
            except PictureError:
                continue
        yield topic.name, found


def _named(source: Source, name: str, kinds: tuple[str, ...], option: str) -> str:
    topic = source.topics.get(name)
    if topic is None or not topic.count:
        raise RecordingError(f"{option}: no topic {name} with messages (there are: {_all(source)})")
    if topic.kind not in kinds:
        raise RecordingError(
            f"{option}: {name} holds {topic.schema or 'no known type'}, not {' or '.join(kinds)}"
        )
    return name


def _depth(source: Source, pictures: dict[str, Picture | None], options: TopicOptions) -> str:
    if options.depth_topic is not None:
        return _named(source, options.depth_topic, IMAGES, "--depth-topic")
    found = [name for name, picture in pictures.items() if picture and holds_depth(picture)]
    if not found:
        raise RecordingError(
            "no topic with depth (Image or RawImage 16UC1 or 32FC1, or compressedDepth): "
            f"the recording holds {_all(source)}; --depth-topic names one"
        )
    found = [name for name in found if ALIGNED in name] or found
    # The same stream may be there raw and compressed.
    found = [n for n in found if not any(n != m and n.startswith(f"{m}/") for m in found)]
    if len(found) > 1:
        raise RecordingError(f"several depth topics, choose one with --depth-topic: {_list(found)}")
    return found[0]


def _colour(
    source: Source, pictures: dict[str, Picture | None], depth: str, options: TopicOptions
) -> str | None:
    if options.color_topic == "none":
        return None
    if options.color_topic is not None:
        return _named(source, options.color_topic, IMAGES, "--color-topic")
    near: dict[str, tuple[int, int, int]] = {}
    for name, picture in pictures.items():
        if name == depth or picture is None or holds_depth(picture):
            continue
        if picture.compressed or picture.format in COLOUR:
            coloured = picture.compressed or COLOUR[picture.format][0] > 1
            named = "color" in name or "rgb" in name
            near[name] = (coloured and "infra" not in name, _shared(name, depth), named)
    best = [name for name, rank in near.items() if rank == max(near.values())]
    best = [n for n in best if not any(n != m and n.startswith(f"{m}/") for m in best)]
    if len(best) > 1:
        raise RecordingError(
            f"several colour topics, choose one with --color-topic (or none): {_list(best)}"
        )
    return best[0] if best else None


def _info(
    source: Source, pictures: dict[str, Picture | None], depth: str, options: TopicOptions
) -> str | None:
    if options.info_topic is not None:
        return _named(source, options.info_topic, INFOS, "--info-topic")
    infos = [t.name for t in source.topics.values() if t.kind in INFOS and t.count]
    folder = PurePosixPath(depth)
    for _ in range(2):  # compressed topics lie one level deeper
        folder = folder.parent
        beside = [name for name in infos if PurePosixPath(name).parent == folder]
        if len(beside) == 1 and "compressed" not in folder.name.lower():
            return beside[0]
    picture = pictures.get(depth)
    same = [n for n in infos if picture and picture.frame == _frame_of_info(source, n) != ""]
    same.sort(key=lambda name: -_shared(name, depth))
    if same:
        return same[0]
    return infos[0] if len(infos) == 1 else None


def _frame_of_info(source: Source, name: str) -> str:
    from doughdata.recordings.pictures import frame_of

    message = next(iter(source.messages([name])), None)
    return "" if message is None or message.error else frame_of(message.value)


def _shared(a: str, b: str) -> int:
    """How many leading parts two topic names share."""
    parts = zip(PurePosixPath(a).parts, PurePosixPath(b).parts, strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], parts))


def _all(source: Source) -> str:
    topics: list[Topic] = list(source.topics.values())
    return _list([f"{t.name} ({t.kind})" for t in topics if t.count]) or "no messages"


def _list(names: list[str]) -> str:
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return ", ".join(sorted(names)[:12]) + more
