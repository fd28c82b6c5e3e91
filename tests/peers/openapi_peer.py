"""Schemathesis on the description that the server gives of itself: requests that fit it and requests that do not, each answered as it says.

Usage: openapi_peer.py BINARY [SECONDS [SEED]]
"""

import json
import os
import subprocess
import sys
import urllib.request
from pathlib import Path

from common import Server

HERE = Path(__file__).resolve().parent


def send(url, method, body):
    request = urllib.request.Request(url, json.dumps(body).encode(), {"content-type": "application/json"}, method=method)
    with urllib.request.urlopen(request) as answer:
        assert answer.status in (200, 201), answer.status


def prepare(url):
    """The map and the snapshot that the hooks name, and those of the description's examples, which may be changed and deleted."""
    with urllib.request.urlopen(f"{url}/openapi.json") as answer:
        paths = json.load(answer)["paths"]
    example = lambda path, method, name: paths[path][method]["requestBody"]["content"]["application/json"]["examples"][name]["value"]
    for name in ("kept", "hall"):
        send(f"{url}/v1/maps/{name}", "PUT", example("/v1/maps/{map}", "put", "configuration"))
        send(f"{url}/v1/maps/{name}/scans", "POST", example("/v1/maps/{map}/scans", "post", "scans"))
        send(f"{url}/v1/maps/{name}/snapshots", "POST", {"name": name})


def main(binary, seconds="60", seed="20261124"):
    with Server(binary) as server:
        prepare(server.url)
        tool = str(Path(sys.executable).parent / "schemathesis")
        arguments = [
            tool, "--config-file", str(HERE / "schemathesis.toml"), "run", f"{server.url}/openapi.json",
            "--max-time", seconds, "--seed", seed, "--checks", "all",
            # The stream of events has no end.
            "--exclude-operation-id", "WatchMap",
            # A server without tokens has nobody to refuse.
            "--exclude-checks", "ignored_auth,object_level_authorization",
            "--continue-on-failure", "--request-timeout", "60", "--warnings", "off",
        ]
        environment = {**os.environ, "SCHEMATHESIS_HOOKS": "openapi_hooks", "PYTHONPATH": str(HERE), "NO_COLOR": "1"}
        done = subprocess.run(arguments, env=environment, cwd=server.folder.name)
        assert done.returncode == 0, f"schemathesis found that the server is not as it says ({done.returncode})"
        # It has gone through scans and snapshots that were there, and the server still answers.
        with urllib.request.urlopen(f"{server.url}/v1/maps/kept") as answer:
            assert int(json.load(answer)["revision"]) > 1


if __name__ == "__main__":
    main(*sys.argv[1:])
