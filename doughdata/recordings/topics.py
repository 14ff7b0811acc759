"""Which topics hold depth, colour and calibration, found by type, content and name."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice, takewhile
from pathlib import PurePosixPath

from doughdata.recordings.encodings import COLOUR
from doughdata.recordings.errors import RecordingError, UndecodableError
from doughdata.recordings.images import holds_depth
from doughdata.recordings.options import TopicOptions
from doughdata.recordings.pictures import IMAGES, INFOS, VIDEOS, Picture, PictureError, picture_of
from doughdata.recordings.source import Source

__all__ = ["ChosenTopics", "choose_topics"]

TRIED = 8  # messages looked at until one can be read
ALIGNED = "aligned_depth_to_color"
Pictures = Mapping[str, Picture | str]  # first image of each topic, or why it has none


@dataclass(frozen=True, slots=True, kw_only=True)
class ChosenTopics:
    """Names of the topics that are used."""

    depth: str
    color: str | None
    info: str | None  # calibration of the depth images
    color_info: str | None = None  # of the colour images


def choose_topics(source: Source, options: TopicOptions) -> ChosenTopics:
    """Topics of one camera.

    Raises:
        RecordingError: a named topic is not there or of another type; no depth; or several
            cameras and no word about which.
    """
    pictures = dict(_first_pictures(source))
    depth = _depth(source, pictures, options)
    color = _colour(source, pictures, depth, options)
    info = _info(source, pictures, depth, options)
    beside = None if color is None else _info_beside(source, color)
    return ChosenTopics(depth=depth, color=color, info=info, color_info=beside)


def _first_pictures(source: Source) -> Iterator[tuple[str, Picture | str]]:
    """Image topics with their first readable image, or why there is none."""
    for topic in source.topics.values():
        if not topic.count:
            continue
        if topic.kind in VIDEOS:
            yield topic.name, f"is video ({topic.kind}), which is not decoded"
        if topic.kind not in IMAGES:
            continue
        found: Picture | str = "has no readable image"
        try:
            for message in islice(source.messages([topic.name]), TRIED):
                try:
                    found = picture_of(message, topic.kind)
                    break
                except PictureError as error:
                    found = str(error)
        except UndecodableError as error:
            found = error.reason
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


def _depth(source: Source, pictures: Pictures, options: TopicOptions) -> str:
    if options.depth_topic is not None:
        return _named(source, options.depth_topic, IMAGES, "--depth-topic")
    good = {name: p for name, p in pictures.items() if isinstance(p, Picture)}
    found = [name for name, picture in good.items() if holds_depth(picture)]
    if not found and options.depth_scale is not None:
        found = [name for name, picture in good.items() if picture.format == "mono16"]
    if not found:
        bad = [f"; {name} {p}" for name, p in pictures.items() if isinstance(p, str)]
        raise RecordingError(
            "no topic with depth (Image or RawImage 16UC1 or 32FC1, or compressedDepth): "
            f"the recording holds {_all(source, good)}; --depth-topic names one{''.join(bad[:3])}"
        )
    found = [name for name in found if ALIGNED in name] or found
    # The same stream may be there raw and compressed.
    found = [n for n in found if not any(n != m and n.startswith(f"{m}/") for m in found)]
    if len(found) > 1:
        raise RecordingError(f"several depth topics, choose one with --depth-topic: {_list(found)}")
    return found[0]


def _colour(source: Source, pictures: Pictures, depth: str, options: TopicOptions) -> str | None:
    if options.color_topic == "none":
        return None
    if options.color_topic == depth:
        raise RecordingError(f"--color-topic: {depth} is the topic of depth")
    if options.color_topic is not None:
        return _named(source, options.color_topic, IMAGES, "--color-topic")
    near: dict[str, tuple[int, int, int]] = {}
    bad: list[str] = []
    for name, picture in pictures.items():
        if name == depth or (isinstance(picture, Picture) and holds_depth(picture)):
            continue
        reason = picture if isinstance(picture, str) else _unfit(picture)
        if reason is not None:
            bad += [f"{name} {reason}"] * bool(reason)
            continue
        named = "color" in name or "rgb" in name
        near[name] = (_coloured(picture) and "infra" not in name, _shared(name, depth), named)
    if bad and not near:
        raise RecordingError(
            f"no colour can be read: {'; '.join(bad[:3])}; --color-topic none leaves colour out"
        )
    best = [name for name, rank in near.items() if rank == max(near.values())]
    best = [n for n in best if not any(n != m and n.startswith(f"{m}/") for m in best)]
    if len(best) > 1:
        raise RecordingError(
            f"several colour topics, choose one with --color-topic (or none): {_list(best)}"
        )
    return best[0] if best else None


def _unfit(picture: Picture) -> str | None:
    """Why an image is no colour; "" if it does not claim to be (one channel), None if it is."""
    if picture.compressed:
        return None
    if picture.format == "mono16" or re.fullmatch(r"\d+[usf]c1", picture.format) is not None:
        return None if picture.format == "8uc1" else ""  # distances, labels, infrared
    if picture.format in COLOUR:
        return None
    return f"has colour encoding {picture.format[:20]!r}, which is not known"


def _coloured(picture: Picture | str) -> bool:
    return isinstance(picture, Picture) and (picture.compressed or not COLOUR[picture.format].grey)


def _info(source: Source, pictures: Pictures, depth: str, options: TopicOptions) -> str | None:
    if options.intrinsics is not None:
        return None
    if options.info_topic is not None:
        return _named(source, options.info_topic, INFOS, "--info-topic")
    beside = _info_beside(source, depth)
    if beside is not None:
        return beside
    infos, picture = _infos(source), pictures.get(depth)
    frame = picture.frame if isinstance(picture, Picture) else ""
    same = [name for name in infos if frame and frame == _frame_of_info(source, name)]
    same.sort(key=lambda name: -_shared(name, depth))
    if same:
        return same[0]
    return infos[0] if len(infos) == 1 else None


def _infos(source: Source) -> list[str]:
    return [t.name for t in source.topics.values() if t.kind in INFOS and t.count]


def _info_beside(source: Source, image: str) -> str | None:
    """The calibration in the folder of an image topic, if there is one."""
    infos, folder = _infos(source), PurePosixPath(image)
    for _ in range(2):  # compressed topics lie one level deeper
        folder = folder.parent
        beside = [name for name in infos if PurePosixPath(name).parent == folder]
        if len(beside) == 1 and "compressed" not in folder.name.lower():
            return beside[0]
    return None


def _frame_of_info(source: Source, name: str) -> str:
    from doughdata.recordings.pictures import frame_of

    try:
        message = next(iter(source.messages([name])), None)
    except UndecodableError:
        return ""
    return "" if message is None or message.error else frame_of(message.value)


def _shared(a: str, b: str) -> int:
    """How many leading parts two topic names share."""
    parts = zip(PurePosixPath(a).parts, PurePosixPath(b).parts, strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], parts))


def _all(source: Source, pictures: Mapping[str, Picture] | None = None) -> str:
    """All topics with messages: name, type, and of raw images the encoding."""
    named = []
    for topic in source.topics.values():
        picture = (pictures or {}).get(topic.name)
        form = f" {picture.format[:30]}" if picture is not None else ""
        named += [f"{topic.name} ({topic.kind or 'no schema'}{form})"] * bool(topic.count)
    return _list(named) or "no messages"


def _list(names: list[str]) -> str:
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return ", ".join(sorted(names)[:12]) + more
