"""A robot that maps a room over Zenoh: every scan is acknowledged when it is durable, and sent again until it is.

It drives through a simulated room of two halves with a door between them; take your localisation and your scanner in place of
`drive` and `measure`. What makes it safe to send a scan twice is its number.

    pip install eclipse-zenoh==1.10.2 grpcio-tools==1.85.1
    UBBMAP_ZENOH__MODE=router ubbmap serve &
    python examples/robot_zenoh.py --connect tcp/127.0.0.1:7447 --map room
"""

import argparse
import collections
import importlib
import math
import sys
import tempfile
import time
from pathlib import Path

import zenoh

PROTO = Path(__file__).resolve().parent.parent / "proto"
ROBOT = "amr-7"
BEAMS = 360
POSE_ERROR, HEADING_ERROR = 0.02, 0.005  # metres and radians: what the localisation promises to keep
IN_FLIGHT = 16  # scans sent and not acknowledged yet

# The walls of the room, metres: 8 x 6 with a wall across it that has a door.
WALLS = [(0, 0, 8, 0), (8, 0, 8, 6), (8, 6, 0, 6), (0, 6, 0, 0), (4, 0, 4, 2), (4, 3.4, 4, 6)]


def messages():
    """The message types of the interface, compiled from its definition."""
    from grpc_tools import protoc

    folder = tempfile.mkdtemp()
    files = [str(path) for path in (PROTO / "ubbmap/v1").glob("*.proto")]
    assert protoc.main(["protoc", f"-I{PROTO}", f"--python_out={folder}", *files]) == 0
    sys.path.insert(0, folder)
    names = ("map", "scan", "query", "error")
    return collections.namedtuple("Messages", names)(*(importlib.import_module(f"ubbmap.v1.{name}_pb2") for name in names))


def drive(steps):
    """Poses along a way through both halves."""
    corners = [(1.5, 1.5), (2.6, 2.7), (5.4, 2.7), (6.5, 4.5), (6.5, 1.5), (5.4, 2.7), (2.6, 2.7), (1.5, 4.5)]
    for leg in range(len(corners) - 1):
        (ax, ay), (bx, by) = corners[leg], corners[leg + 1]
        for step in range(steps):
            share = step / steps
            yield ax + (bx - ax) * share, ay + (by - ay) * share, math.atan2(by - ay, bx - ax)


def measure(x, y, theta):
    """Ranges of all beams from a pose: the nearest wall along each ray."""
    ranges = []
    for beam in range(BEAMS):
        angle = theta + math.tau * beam / BEAMS
        dx, dy = math.cos(angle), math.sin(angle)
        nearest = math.inf
        for x1, y1, x2, y2 in WALLS:
            ex, ey = x2 - x1, y2 - y1
            cross = dx * ey - dy * ex
            if abs(cross) < 1e-12:
                continue
            along = ((x1 - x) * ey - (y1 - y) * ex) / cross
            share = ((x1 - x) * dy - (y1 - y) * dx) / cross
            if along > 0 and 0 <= share <= 1:
                nearest = min(nearest, along)
        ranges.append(nearest)
    return ranges


def request(pb, sequence, pose):
    """One numbered scan; the robot's name is in the key."""
    x, y, theta = pose
    interval = lambda value, error: pb.scan.Interval(min=value - error, max=value + error)
    box = pb.scan.PoseBox(x=interval(x, POSE_ERROR), y=interval(y, POSE_ERROR), theta=interval(theta, HEADING_ERROR))
    scan = pb.scan.Scan(
        sequence=sequence,
        stamp=time.time(),
        pose=box,
        angle_min=0.0,
        angle_increment=math.tau / BEAMS,
        ranges=measure(x, y, theta),
        footprint_radius=0.25,
    )
    return pb.scan.InsertScansRequest(scans=[scan]).SerializeToString()


def ask(session, pb, key, payload=b""):
    """The payload of the one reply; retries what may be retried."""
    while True:
        for reply in session.get(key, payload=payload, timeout=2.0):
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
            error = pb.error.Error.FromString(reply.err.payload.to_bytes())
            if error.advice != pb.error.ADVICE_RETRY:
                raise SystemExit(f"{key}: {error.detail} ({error.code})")
        time.sleep(0.1)


def send(session, pb, key, waiting):
    """Waits for the oldest scan's acknowledgement; sends it again until there is one."""
    payload, replies = waiting.popleft()
    for reply in replies:
        if reply.ok is not None:
            return pb.scan.InsertScansResponse.FromString(reply.ok.payload.to_bytes())
    return pb.scan.InsertScansResponse.FromString(ask(session, pb, key, payload))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--connect", default="tcp/127.0.0.1:7447", help="endpoint of the server or of a router")
    parser.add_argument("--map", default="room")
    parser.add_argument("--steps", type=int, default=12, help="scans of each leg of the way")
    options = parser.parse_args()
    pb = messages()

    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{options.connect}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        settings = pb.map.MapConfig(resolution=0.05, min_obstacle_width=0.05)
        create = pb.map.CreateMapRequest(config=settings).SerializeToString()
        ask(session, pb, f"ubbmap/{options.map}/create", create)
        # Numbers go on where the map's end.
        known = pb.map.GetMapResponse.FromString(ask(session, pb, f"ubbmap/{options.map}"))
        first = next((robot.highest_sequence + 1 for robot in known.robots if robot.robot == ROBOT), 1)

        key = f"ubbmap/{options.map}/insert/{ROBOT}"
        waiting, applied, rejected, revision = collections.deque(), 0, 0, 0
        poses = list(drive(options.steps))
        for at in range(len(poses) + IN_FLIGHT):
            if at < len(poses):
                payload = request(pb, first + at, poses[at])
                waiting.append((payload, session.get(key, payload=payload, timeout=2.0)))
            if len(waiting) >= IN_FLIGHT or (at >= len(poses) and waiting):
                answer = send(session, pb, key, waiting)
                applied += answer.applied + answer.duplicates
                rejected += len(answer.rejected)
                revision = max(revision, answer.revision)
        while waiting:
            answer = send(session, pb, key, waiting)
            applied += answer.applied + answer.duplicates
            rejected += len(answer.rejected)
            revision = max(revision, answer.revision)
    print(f"{applied} scans acknowledged, {rejected} rejected, revision {revision}")
    sys.exit(0 if applied == len(poses) else 1)


if __name__ == "__main__":
    main()
