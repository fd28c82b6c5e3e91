"""ROS 2 bags written by the PyPI package rosbags, in every form that it writes: `ubbmap build` makes the same map of them as of
JSON lines with the same scans and poses, whose boxes numpy computes here from the covariances."""

import json
import math
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from common import flaser
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

SCANS = 150
STEP = 0.2
RANGE_MAX = np.float32(50.0)
MOUNT = (0.2, -0.05, 0.3)
VARIANCES = np.diag([4e-4, 1e-4, 1.0, 1.0, 1.0, 2.5e-5])
# Positions go together: the box is that of the slanted ellipsoid.
VARIANCES[0, 1] = VARIANCES[1, 0] = 1e-4

store = get_typestore(Stores.ROS2_JAZZY)
types = store.types


def header(stamp, frame):
    nanoseconds = round(stamp * 1e9)
    time = types["builtin_interfaces/msg/Time"](sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
    return types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def quaternion(theta):
    return types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=math.sin(theta / 2), w=math.cos(theta / 2))


def heading(theta):
    """The heading as it comes out of the quaternion."""
    turn = quaternion(theta)
    return math.atan2(2 * turn.w * turn.z, 1 - 2 * turn.z * turn.z)


def transform(stamp, parent, child, x, y, theta):
    stamped = types["geometry_msgs/msg/TransformStamped"](
        header=header(stamp, parent),
        child_frame_id=child,
        transform=types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](x=x, y=y, z=0.0), rotation=quaternion(theta)
        ),
    )
    return types["tf2_msgs/msg/TFMessage"](transforms=[stamped])


def pose(stamp, x, y, theta):
    there = types["geometry_msgs/msg/Pose"](
        position=types["geometry_msgs/msg/Point"](x=x, y=y, z=0.0), orientation=quaternion(theta)
    )
    uncertain = types["geometry_msgs/msg/PoseWithCovariance"](pose=there, covariance=VARIANCES.reshape(36))
    return types["geometry_msgs/msg/PoseWithCovarianceStamped"](header=header(stamp, "map"), pose=uncertain)


def scan(stamp, ranges):
    count = len(ranges)
    return types["sensor_msgs/msg/LaserScan"](
        header=header(stamp, "laser"),
        angle_min=float(np.float32(-math.pi / 2)),
        angle_max=math.pi / 2,
        angle_increment=float(np.float32(math.pi / count)),
        time_increment=0.0,
        scan_time=0.1,
        range_min=0.0,
        range_max=float(RANGE_MAX),
        ranges=np.array(ranges, dtype=np.float32),
        intensities=np.array([], dtype=np.float32),
    )


def recording(log):
    """Scans of a recorded log: time, pose, ranges. Its own times may step back, so these count anew."""
    for index, (place, ranges) in enumerate(flaser(log)):
        if index == SCANS:
            return
        yield 1000.0 + STEP * index, place, ranges


def write(folder, plugin, mode, log, kind):
    path = folder / f"{plugin.name}-{mode.name}-{kind}".lower()
    writer = Writer(path, version=9, storage_plugin=plugin)
    if mode is not CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    names = {
        "/scan": "sensor_msgs/msg/LaserScan",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/tf_static": "tf2_msgs/msg/TFMessage",
        "/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
        "/note": "std_msgs/msg/String",
    }
    with writer:
        links = {topic: writer.add_connection(topic, name, typestore=store) for topic, name in names.items()}

        def put(topic, time, message):
            writer.write(links[topic], round(time * 1e9), store.serialize_cdr(message, names[topic]))

        put("/note", 999.0, types["std_msgs/msg/String"](data="not read"))
        if kind == "pose":
            put("/tf_static", 999.0, transform(0.0, "base_link", "laser", *MOUNT))
        for stamp, place, ranges in recording(log):
            put("/scan", stamp, scan(stamp, ranges))
            if kind == "tf":
                put("/tf", stamp + 0.01, transform(stamp, "map", "laser", *place))
            else:
                put("/pose", stamp + 0.01, pose(stamp, *place))
    return path


def hull(function, lowest, highest):
    """The range of sine or cosine over an angle: its ends, and the extremes between."""
    quarter = 0 if function is math.cos else 1
    turns = range(math.ceil(lowest / (math.pi / 2)), math.floor(highest / (math.pi / 2)) + 1)
    extremes = [function(turn * math.pi / 2) for turn in turns if (turn + quarter) % 2 == 0]
    values = [function(lowest), function(highest), *extremes]
    return np.array([min(values), max(values)])


def box(place, sigma):
    """The laser's box, of the robot's covariance and the mount: plain interval arithmetic about where they say that it is."""
    x, y, theta = place
    half = sigma * np.sqrt(np.diag(VARIANCES)[[0, 1, 5]])
    mx, my, mount = MOUNT
    # From the robot to the laser, and how far an error of the heading swings that.
    sin, cos = math.sin(heading(theta)), math.cos(heading(theta))
    u, v = mx * cos - my * sin, mx * sin + my * cos
    turn = half[2] * np.array([-1, 1])
    swing = np.sin(turn)
    less = hull(math.cos, *turn) - 1
    times = lambda interval, factor: np.sort(interval * factor)
    across = x + u + half[0] * np.array([-1, 1]) + times(less, u) + times(swing, -v)
    along = y + v + half[1] * np.array([-1, 1]) + times(swing, u) + times(less, v)
    turn = heading(theta) + turn
    return across, along, turn + heading(mount)


def text(path, log, kind, sigma):
    with path.open("w") as lines:
        first = {"range_min": 0.0, "range_max": float(RANGE_MAX)}
        print(json.dumps(first), file=lines)
        for stamp, place, ranges in recording(log):
            message = scan(stamp, ranges)
            line = {
                "t": stamp,
                "angle_min": message.angle_min,
                "angle_increment": message.angle_increment,
                "ranges": [float(value) for value in message.ranges],
            }
            if kind == "tf":
                line |= {"x": place[0], "y": place[1], "theta": heading(place[2])}
            else:
                names = ["x", "y", "theta"]
                line["pose"] = {name: {"min": b[0], "max": b[1]} for name, b in zip(names, box(place, sigma))}
            print(json.dumps(line), file=lines)


def build(binary, log, out, *flags):
    done = subprocess.run([binary, "build", str(log), "--out", str(out), "--json", *flags], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    counts = json.loads(done.stdout)
    assert counts["scans"] == SCANS and counts["left_out"] == 0, counts
    return out.read_bytes(), counts


def main(binary, log):
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        maps = {}
        for kind, flags, sigma in [("tf", ("--pose-error", "0.05,1deg"), 0), ("pose", (), 3), ("pose", ("--sigma", "2"), 2)]:
            text(folder / "log.jsonl", log, kind, sigma)
            plain = flags if kind == "tf" else ()
            expected, counts = build(binary, folder / "log.jsonl", folder / "expected.ubbmap", *plain)
            maps[kind, sigma] = expected
            forms = [(plugin, mode) for plugin in StoragePlugin for mode in CompressionMode]
            built = 0
            for plugin, mode in forms:
                # Storage is compressed by MCAP alone; a database compressed as a whole is refused.
                if plugin is StoragePlugin.SQLITE3 and mode in (CompressionMode.STORAGE, CompressionMode.FILE):
                    continue
                bag = folder / f"{plugin.name}-{mode.name}-{kind}".lower()
                if not bag.exists():
                    bag = write(folder, plugin, mode, log, kind)
                chosen = ("--pose-topic", "/pose") if kind == "pose" else ()
                found, _ = build(binary, bag, folder / "found.ubbmap", *flags, *chosen)
                assert found == expected, f"{bag.name}, {flags}: another map"
                built += 1
            assert built == 6, built
            print(f"bags by {kind}, {' '.join(flags) or 'sigma 3'}: {built} forms, {counts['leaf_area_free']:.0f} m2 free, the same map")
        assert len(set(maps.values())) == 3, "the poses' errors count"


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
