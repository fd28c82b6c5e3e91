"""REST by curl: creates a map, streams a real log line by line, follows its events, and asks.

usage: curl_peer.py BINARY LOG
"""

import json
import subprocess
import sys
import tempfile
import time

from common import Server, flaser, scan_fields

CURL = ["curl", "--silent", "--show-error", "--no-buffer"]


def call(*arguments):
    return json.loads(subprocess.run([*CURL, "--fail", *arguments], check=True, capture_output=True).stdout)


def events(lines):
    """The data of server-sent events."""
    return [json.loads(line.removeprefix("data: ")) for line in lines if line.startswith("data: ")]


def main():
    binary, log = sys.argv[1], sys.argv[2]
    lines = [
        json.dumps({"robot": "intel", **scan_fields(sequence, pose, ranges)}) for sequence, (pose, ranges) in enumerate(flaser(log))
    ]
    with Server(binary) as server, tempfile.NamedTemporaryFile("w+") as watched:
        url = f"{server.url}/v1/maps/intel"
        json_type = ("-H", "Content-Type: application/json")
        call("-X", "PUT", url, *json_type, "-d", '{"min_obstacle_width": 0.05}')
        watch = subprocess.Popen([*CURL, f"{url}/events?since=0"], stdout=watched)
        ndjson = ("-H", "Content-Type: application/x-ndjson", "-H", "Accept: application/x-ndjson")
        stream = subprocess.run(
            [*CURL, "--fail", *ndjson, "-X", "POST", "-H", "Transfer-Encoding: chunked", "--data-binary", "@-", f"{url}/scans"],
            input="\n".join(lines),
            check=True,
            capture_output=True,
            text=True,
        )
        fates = [json.loads(line) for line in stream.stdout.splitlines()]
        assert [fate["sequence"] for fate in fates] == [str(sequence) for sequence in range(len(lines))]
        assert not any(fate["duplicate"] or fate.get("rejected") for fate in fates)
        revision = int(fates[-1]["revision"])
        seen, deadline = [], time.monotonic() + 20
        while (not seen or int(seen[-1]["revision"]) < revision) and time.monotonic() < deadline:
            time.sleep(0.1)
            with open(watched.name) as text:
                seen = events(text.read().split("\n")[:-1])
        watch.terminate()
        watch.wait()
        assert int(seen[-1]["revision"]) == revision, (seen[-1]["revision"], revision)
        assert all(later["since"] == earlier["revision"] for earlier, later in zip(seen, seen[1:])), "a gap"

        resumed = subprocess.run(
            [*CURL, "--max-time", "1", "-H", f"Last-Event-ID: {revision - 1}", f"{url}/events"], capture_output=True, text=True
        )
        assert events(resumed.stdout.split("\n"))[0]["since"] == str(revision - 1)
        assert call(f"{url}/changes?since={revision - 1}")["revision"] == str(revision)
        assert call(url)["robots"][0]["applied"] == str(len(lines))
        print(f"curl: {len(fates)} scans streamed and acknowledged, {len(seen)} events to revision {revision} without a gap")


if __name__ == "__main__":
    main()
