"""Converting a long recording: memory and speed.

Makes a recording of raw 640 x 480 colour and depth, once with index and summary and once without
either, and converts each in a process of its own. `peak_mb_*` is the largest resident memory of
that process minus what it was after importing every package; `frames_per_s` counts CPU seconds of
the indexed run. With --json one object is printed.

    python benchmarks/convert.py --json --megabytes 500
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.typesys import Stores, get_typestore

WIDTH, HEIGHT = 640, 480
FOCAL, TILT, CAMERA = 600.0, np.radians(45.0), 0.40  # [px], [rad], [m] above the table
PERIOD, START = 33_333_333, 1_700_000_000_000_000_000  # [ns]
CHUNK = 4 << 20
CHILD = """
import json, resource, sys, time
from importlib import import_module
from pathlib import Path
for name in ("cv2", "open3d", "zarr", "zstandard", "lz4.frame", "pyarrow.parquet", "numcodecs",
             "google_crc32c", "mcap_ros2.decoder", "mcap_ros1.decoder", "mcap_protobuf.decoder",
             "doughdata.recordings.mcap", "doughdata.recordings.mcap_source"):
    import_module(name)
def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
from doughdata.recordings.mcap import Mcap
before, start = peak(), time.process_time()
done = Mcap().convert(Path(sys.argv[1]), sys.argv[2])
seconds = time.process_time() - start
print(json.dumps({"peak": peak() - before, "seconds": seconds, "frames": done.frames,
                  "losses": len(done.losses), "imports_mb": before}))
"""


def scene(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Depth [mm] of a ball on a table seen at 45 degrees, with noise, and its colour image."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    x, y = (u - WIDTH / 2) / FOCAL, (v - HEIGHT / 2) / FOCAL
    normal = np.array([0.0, -np.cos(TILT), -np.sin(TILT)])  # of the table, in the camera
    depth = CAMERA / -(y * normal[1] + normal[2])
    middle = np.array([0.0, 0.0, CAMERA / np.sin(TILT)]) + normal * 0.03  # a ball of 30 mm
    a, b = x**2 + y**2 + 1, x * middle[0] + y * middle[1] + middle[2]
    root = b * b - a * (middle @ middle - 0.03**2)
    ball = root > 0
    depth[ball] = (b[ball] - np.sqrt(root[ball])) / a[ball]
    noisy = depth * 1e3 + rng.normal(0, 0.5, depth.shape)
    color = np.where(ball[..., None], (200, 40, 30), (150, 120, 90)) + rng.integers(-9, 9, (3,))
    return np.rint(noisy).astype(np.uint16), color.astype(np.uint8)


def write(path: Path, frames: int, *, indexed: bool) -> None:
    """A recording of so many frames, not compressed."""
    store, rng = get_typestore(Stores.ROS2_HUMBLE), np.random.default_rng(0)
    types = store.types
    images = [scene(rng) for _ in range(4)]
    options = {} if indexed else {"use_statistics": False, "use_summary_offsets": False}
    if not indexed:
        options |= {"repeat_channels": False, "repeat_schemas": False}
    kinds = IndexType.ALL if indexed else IndexType.NONE
    with path.open("wb") as file:
        writer = Writer(
            file,
            chunk_size=CHUNK,
            compression=CompressionType.NONE,
            index_types=kinds,
            **options,
        )
        writer.start(profile="ros2")
        channels = {}
        for number in range(frames):
            at = START + number * PERIOD
            stamp = types["builtin_interfaces/msg/Time"](*divmod(at, 10**9))
            header = types["std_msgs/msg/Header"](stamp, "camera")
            depth, color = images[number % len(images)]
            messages = {
                "/camera/depth/image": _image(types, header, "16UC1", depth),
                "/camera/color/image": _image(types, header, "rgb8", color),
                "/camera/depth/camera_info": _info(types, header),
            }
            for topic, message in messages.items():
                kind = message.__msgtype__
                if topic not in channels:
                    text, _ = store.generate_msgdef(kind, ros_version=2)
                    schema = writer.register_schema(kind, "ros2msg", text.encode())
                    channels[topic] = writer.register_channel(topic, "cdr", schema)
                writer.add_message(
                    channels[topic], at, bytes(store.serialize_cdr(message, kind)), at
                )
        writer.finish()


def _image(types: dict, header: object, encoding: str, pixels: np.ndarray) -> object:
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    kind = types["sensor_msgs/msg/Image"]
    return kind(header, HEIGHT, WIDTH, encoding, 0, rows.shape[1], rows.reshape(-1))


def _info(types: dict, header: object) -> object:
    k = np.array([FOCAL, 0, WIDTH / 2, 0, FOCAL, HEIGHT / 2, 0, 0, 1])
    p = np.array([FOCAL, 0, WIDTH / 2, 0, 0, FOCAL, HEIGHT / 2, 0, 0, 0, 1, 0])
    roi = types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    flat = (np.zeros(5), k, np.eye(3).reshape(-1), p)
    kind = types["sensor_msgs/msg/CameraInfo"]
    return kind(header, HEIGHT, WIDTH, "plumb_bob", *flat, 0, 0, roi)


def measure(path: Path, dataset: Path) -> dict:
    """Convert in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", CHILD, str(path), str(dataset)],
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(done.stdout)


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--megabytes", type=int, default=500)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    frames = max(2, arguments.megabytes * 10**6 // (WIDTH * HEIGHT * 5))
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for kind in ("indexed", "unindexed"):
            path = folder / f"{kind}.mcap"
            write(path, frames, indexed=kind == "indexed")
            found[f"file_mb_{kind}"] = round(path.stat().st_size / 1e6, 1)
            result = measure(path, folder / kind)
            assert (result["frames"], result["losses"]) == (frames, 0), result
            path.unlink()
            found[f"peak_mb_{kind}"] = round(result["peak"], 1)
            if kind == "indexed":
                found["frames_per_s"] = round(frames / result["seconds"], 2)
                found["imports_mb"] = round(result["imports_mb"], 1)
    found["frames"] = frames
    if arguments.json:
        print(json.dumps(found))
    else:
        for key, value in found.items():
            print(f"{key:<20}{value}")


if __name__ == "__main__":
    main()
