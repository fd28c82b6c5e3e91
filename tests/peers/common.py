"""What the peers have in common: a server, a recorded log, and the messages compiled from the interface's definition."""

import gzip
import importlib
import math
import os
import re
import socket
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
PROTO = ROOT / "proto"


class Server:
    """The release binary on an empty directory, with a router of Zenoh on a free port."""

    def __init__(self, binary, store="sled", settings=None, zenoh="tcp"):
        self.binary, self.store, self.settings, self.protocol = binary, store, settings or {}, zenoh

    def __enter__(self):
        self.folder = tempfile.TemporaryDirectory()
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.zenoh = f"{self.protocol}/127.0.0.1:{free.getsockname()[1]}"
        environment = {**os.environ, "UBBMAP_ZENOH__MODE": "router", "UBBMAP_ZENOH__LISTEN": self.zenoh, "UBBMAP_LOG": "warn", "UBBMAP_STORE": self.store, **self.settings}
        arguments = [self.binary, "serve", "--listen", "127.0.0.1:0", "--data", f"{self.folder.name}/data"]
        self.process = subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True, env=environment)
        ready = self.process.stdout.readline()
        self.url = re.search(r"https?://[0-9.:]+", ready).group(0)
        self.address = self.url.split("://")[1]
        return self

    def __exit__(self, *_):
        self.process.terminate()
        ended = self.process.wait(30)
        self.folder.cleanup()
        assert ended == 0, "the server did not end in peace"


def messages():
    """Compiles the interface with protoc; the modules by name."""
    from grpc_tools import protoc

    folder = tempfile.mkdtemp()
    files = sorted(str(path) for path in (PROTO / "ubbmap/v1").glob("*.proto"))
    arguments = ["protoc", f"-I{PROTO}", f"--python_out={folder}", f"--grpc_python_out={folder}", *files]
    assert protoc.main(arguments) == 0
    sys.path.insert(0, folder)
    return lambda name: importlib.import_module(f"ubbmap.v1.{name}")


def flaser(path):
    """Pose and ranges of every FLASER message of a CARMEN log."""
    with gzip.open(path, "rt") as lines:
        for line in lines:
            words = line.split()
            if words[:1] == ["FLASER"]:
                beams = int(words[1])
                ranges = [float(word) for word in words[2 : 2 + beams]]
                yield tuple(float(word) for word in words[2 + beams : 5 + beams]), ranges


def scan_fields(sequence, pose, ranges):
    """A scan of a half circle as the fields of the message, for JSON and protobuf alike."""
    interval = lambda value, error: {"min": value - error, "max": value + error}
    x, y, theta = pose
    return {
        "sequence": sequence,
        "pose": {"x": interval(x, 0.02), "y": interval(y, 0.02), "theta": interval(theta, 0.005)},
        "angle_min": -math.pi / 2,
        "angle_increment": math.pi / len(ranges),
        "ranges": ranges,
    }
