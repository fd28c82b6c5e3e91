"""Tokens by grpcio and curl: made by the command line, shown by both, refused by role, map and robot, and revoked while a stream is open.

usage: access_peer.py BINARY
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import grpc

from common import Server, messages, scan_fields

SCAN = scan_fields(1, (0.0, 0.0, 0.0), [2.0] * 90)


class Tokens:
    """A file of tokens, written by `ubbmap token`."""

    def __init__(self, binary, path):
        self.binary, self.path, self.known = binary, path, {}

    def run(self, *arguments):
        done = subprocess.run([self.binary, "token", *arguments, "--file", self.path], check=True, capture_output=True, text=True)
        return done.stdout.strip()

    def create(self, name, role, *more):
        token = self.run("create", "--name", name, "--role", role, *more)
        assert token.startswith("ubbmap_") and "\n" not in token, "stdout is not the token alone"
        self.known[name] = token

    def metadata(self, name):
        return [("authorization", f"Bearer {self.known[name]}")] if name else []


def refused(call, code, words):
    try:
        call()
    except grpc.RpcError as error:
        assert error.code() == code, error
        assert words in error.details(), error.details()
        return
    raise AssertionError(f"not refused with {code}")


def by_grpc(server, tokens):
    module = messages()
    service, maps, scans, changes = module("service_pb2_grpc"), module("map_pb2"), module("scan_pb2"), module("change_pb2")
    unknown, denied = grpc.StatusCode.UNAUTHENTICATED, grpc.StatusCode.PERMISSION_DENIED
    with grpc.insecure_channel(server.address) as channel:
        stub = service.MapServiceStub(channel)
        get = lambda name: stub.GetMap(maps.GetMapRequest(map="hall"), metadata=tokens.metadata(name))
        create = lambda name: stub.CreateMap(maps.CreateMapRequest(map="hall"), metadata=tokens.metadata(name))
        refused(lambda: create(""), unknown, "asks for a token")
        refused(lambda: create("planner"), denied, '"planner" has the role read')
        assert not create("boss").existed
        assert get("planner").name == "hall"
        refused(lambda: get("outsider"), denied, "its maps are yard-*")
        assert list(stub.ListMaps(maps.ListMapsRequest(), metadata=tokens.metadata("outsider")).maps) == []

        def send(robot):
            request = scans.InsertScansRequest(map="hall", scans=[scans.Scan(robot=robot, **SCAN)])
            return stub.InsertScans(request, metadata=tokens.metadata("amr-7"))

        assert send("amr-7").applied == 1
        refused(lambda: send("amr-8"), denied, '"amr-7" alone, not of "amr-8"')
        refused(lambda: list(stub.StreamScans(iter([]), metadata=tokens.metadata("planner"))), denied, "send scans")

        watch = stub.WatchMap(changes.WatchMapRequest(map="hall", since=0), metadata=tokens.metadata("planner"))
        assert next(watch).revision == 1
        tokens.run("revoke", "planner")
        refused(lambda: next(watch), unknown, '"planner" was revoked')
        refused(lambda: get("planner"), unknown, "not known")


def by_curl(server, tokens):
    def curl(path, name="", *more):
        header = ["-H", f"Authorization: Bearer {tokens.known[name]}"] if name else []
        form = ["--silent", "--show-error", "--write-out", "\n%{http_code} %header{www-authenticate}"]
        out = subprocess.run(["curl", *form, *header, *more, server.url + path], check=True, capture_output=True, text=True).stdout
        body, _, tail = out.rpartition("\n")
        status, _, challenge = tail.partition(" ")
        return int(status), body, challenge

    status, body, challenge = curl("/v1/maps")
    assert (status, json.loads(body)["code"], challenge) == (401, "UNAUTHENTICATED", 'Bearer realm="ubbmap"'), body
    status, body, challenge = curl("/v1/maps", "planner")
    assert status == 401 and "invalid_token" in challenge, (status, challenge)
    status, body, _ = curl("/v1/maps/hall", "outsider", "-X", "DELETE")
    assert (status, json.loads(body)["code"]) == (403, "PERMISSION_DENIED"), body
    assert curl("/v1/maps/hall", "amr-7")[0] == 200
    assert curl("/metrics")[0] == 401 and curl("/metrics", "boss")[0] == 200
    assert curl("/healthz")[0] == curl("/readyz")[0] == curl("/")[0] == 200
    # A body that is refused is read, so that curl does not end with an error of its own.
    with tempfile.NamedTemporaryFile() as large:
        large.write(b" " * (8 << 20))
        large.flush()
        assert curl("/v1/maps/hall/scans", "outsider", "--data-binary", f"@{large.name}")[0] == 403
        assert curl("/v1/maps/hall/scans", "", "--data-binary", f"@{large.name}")[0] == 401
    assert curl("/v1/maps/hall", "boss", "-X", "DELETE")[0] == 204


def main():
    binary = sys.argv[1]
    with tempfile.TemporaryDirectory() as folder:
        tokens = Tokens(binary, f"{folder}/tokens.toml")
        tokens.create("boss", "admin")
        tokens.create("planner", "read", "--expires", "1h")
        tokens.create("amr-7", "write", "--maps", "hall", "--robot", "amr-7")
        tokens.create("outsider", "admin", "--maps", "yard-*")
        assert os.stat(tokens.path).st_mode & 0o777 == 0o600
        written = Path(tokens.path).read_text()
        assert not any(token in written for token in tokens.known.values()), "a token is in the file"
        with Server(binary, settings={"UBBMAP_ACCESS__TOKENS": tokens.path}) as server:
            by_grpc(server, tokens)
            by_curl(server, tokens)
    print("tokens: grpcio and curl let in and refused by role, map, robot and revocation")


if __name__ == "__main__":
    main()
