"""A recording with one camera becomes one scene: read, pair, process, write."""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from doughdata.dataset.layers import RecordedScene
from doughdata.recordings.calibration import camera_lens
from doughdata.recordings.errors import RecordingError
from doughdata.recordings.frames import FrameReader
from doughdata.recordings.gripper import gripper_opening
from doughdata.recordings.options import TopicOptions
from doughdata.recordings.pairing import Pair, Pairing, pair_images, uniform_choice
from doughdata.recordings.protocol import Conversion, OnProgress
from doughdata.recordings.request import Request
from doughdata.recordings.source import Source
from doughdata.recordings.spooling import SpooledImages, spool_frames
from doughdata.recordings.tool_track import tool_track
from doughdata.recordings.topics import choose_topics
from doughdata.recordings.writing import commit_scene, known_scene, origin_of, room_for

__all__ = ["convert_recording"]


def convert_recording(
    request: Request, converter: object, open_source: Callable[[Path, OnProgress], Source]
) -> Conversion:
    """Convert a whole recording. Nothing is written before everything has been read.

    Raises:
        RecordingError: it is damaged and `salvage` is off, or it lacks what is needed.
        DatasetError: the dataset cannot be written.
    """
    room = room_for(request.dataset)
    origin = origin_of(converter, request.path, request.options())
    known = known_scene(request.dataset, origin)
    if known is not None:
        return known
    source = open_source(request.path, request.on_progress)
    _check_losses(request, source)
    topics = choose_topics(source, request.topics)
    pairing = pair_images(source, topics)
    pairs, skipped = _chosen(pairing, request.topics, room)
    intrinsics, notes = camera_lens(source, topics, request.topics)
    reader = FrameReader(source=source, topics=topics, pairs=pairs, intrinsics=intrinsics)
    with TemporaryDirectory(prefix="doughdata-") as folder:
        images = spool_frames(request, reader, Path(folder))
        losses = (*source.losses, *pairing.losses, *reader.losses)
        warnings = (
            *source.warnings,
            *pairing.warnings,
            *notes,
            *skipped,
            *images.warnings,
        )
        figures = _figures(source, pairing, pairs, images)
        parameters = {
            **origin,
            "topics": asdict(topics),
            "figures": figures,
            "losses": [asdict(loss) for loss in losses],
            "warnings": list(warnings),
        }
        record = _record(request, source, pairing, images, parameters)
        index = commit_scene(request.dataset, record)
    return Conversion(
        dataset=request.dataset,
        scenes=(index,),
        frames=len(images.stamps),
        losses=losses,
        warnings=warnings,
        figures=figures,
    )


def _check_losses(request: Request, source: Source) -> None:
    """Refuse a damaged container unless the user wants what is left of it."""
    if not source.losses or request.salvage:
        return
    reasons = "; ".join(loss.reason for loss in source.losses)
    of = "" if source.num_expected is None else f" of {source.num_expected}"
    raise RecordingError(
        f"{request.path}: {reasons}; {source.num_messages}{of} messages can be read: "
        "--salvage takes those and records the loss"
    )


def _chosen(
    pairing: Pairing, options: TopicOptions, room: int | None
) -> tuple[tuple[Pair, ...], list[str]]:
    """Pairs that become key frames, and a line if there are more than a scene can have."""
    pairs = pairing.pairs[:: options.every]
    if options.frames is not None:
        pairs = uniform_choice(pairs, options.frames)
    if room is None or len(pairs) <= room:
        return pairs, []
    line = (
        f"{room} of {len(pairs)} frames were taken, evenly in time: the dataset's scenes have "
        f"{room} key frames (a dataset of its own keeps all)"
    )
    return uniform_choice(pairs, room), [line]


def _record(
    request: Request,
    source: Source,
    pairing: Pairing,
    images: SpooledImages,
    parameters: dict[str, Any],
) -> RecordedScene:
    opening = gripper_opening(source, request.topics, images.stamps)
    track = tool_track(
        source, request.topics, pairing.frame, images.workspace.camera, images.stamps
    )
    seconds = (np.array(images.stamps, np.int64) - images.stamps[0]) / 1e9
    return RecordedScene(
        scene_id=request.path.name.partition(".")[0] or request.path.name,
        camera=images.workspace.camera,
        timestamps=seconds,
        depth=images.depth,
        segments=images.segments,
        color=images.color,
        num_bodies=images.workspace.pieces[0],
        opening=opening,
        tool_frames=track.frames,
        tool_position=track.position,
        tool_quaternion=track.quaternion,
        parameters=parameters,
    )


def _figures(
    source: Source, pairing: Pairing, pairs: tuple[Pair, ...], images: SpooledImages
) -> dict[str, Any]:
    return {
        "messages_read": source.num_messages,
        "messages_expected": source.num_expected,
        "depth_images": pairing.num_depth,
        "color_images": pairing.num_color,
        "pairs": len(pairing.pairs),
        "pairs_taken": len(pairs),
        "frames": len(images.stamps),
        "largest_offset": pairing.largest_offset,
        "depth_unit": images.depth.attributes["depth_unit"],
        **images.workspace.figures(),
    }
