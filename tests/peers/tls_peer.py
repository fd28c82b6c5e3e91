"""TLS by openssl, grpcio, httpx, curl and eclipse-zenoh: certificates made as docs/tls.md makes them, a robot known by its own, and strangers
who stay outside.

usage: tls_peer.py BINARY
"""

import json
import re
import ssl
import subprocess
import sys
import tempfile
from pathlib import Path

import grpc
import httpx
import zenoh

from common import ROOT, Server, messages, scan_fields

SCAN = scan_fields(1, (0.0, 0.0, 0.0), [2.0] * 90)
ACCESS = """
[[certificate]]
name = "operator"
role = "admin"
maps = ["*"]

[[certificate]]
name = "amr-*"
role = "write"
maps = ["*"]
"""


def documented_commands():
    """The commands of docs/tls.md that make certificates, as they stand there."""
    text = (ROOT / "docs/tls.md").read_text()
    blocks = re.findall(r"```console\n(.*?)```", text, re.S)
    lines = [line for block in blocks for line in block.replace("\\\n", " ").splitlines()]
    commands = [line.removeprefix("$ ") for line in lines if line.startswith("$ openssl req")]
    assert len(commands) >= 3, "docs/tls.md makes no certificates any more"
    return commands


def make(folder):
    """Those certificates, one of an operator, and those of a stranger with an authority of its own."""
    commands = documented_commands()
    operator = next(command for command in commands if "amr-7" in command).replace("amr-7", "operator")
    for where, every in ((folder, [*commands, operator]), (folder / "stranger", commands)):
        where.mkdir(exist_ok=True)
        for command in every:
            subprocess.run(command, shell=True, check=True, cwd=where, capture_output=True)


def refused(call):
    """What a client of gRPC is told that gets no connection."""
    try:
        call()
    except grpc.RpcError as error:
        assert error.code() == grpc.StatusCode.UNAVAILABLE, error
        return
    raise AssertionError("a stranger came in")


def by_grpc(server, folder):
    module = messages()
    service, maps, scans = module("service_pb2_grpc"), module("map_pb2"), module("scan_pb2")
    read = lambda name: (folder / name).read_bytes()
    trusted = read("ca.pem")

    def stub(own):
        shown = {"private_key": read(f"{own}.key"), "certificate_chain": read(f"{own}.pem")} if own else {}
        credentials = grpc.ssl_channel_credentials(root_certificates=trusted, **shown)
        return service.MapServiceStub(grpc.secure_channel(server.address, credentials))

    assert not stub("operator").CreateMap(maps.CreateMapRequest(map="hall")).existed
    robot = stub("amr-7")
    answer = robot.InsertScans(scans.InsertScansRequest(map="hall", scans=[scans.Scan(robot="amr-7", **SCAN)]))
    assert answer.applied == 1, answer
    stream = robot.StreamScans(iter([scans.StreamScansRequest(map="hall", scan=scans.Scan(robot="amr-7", **{**SCAN, "sequence": 2}))]))
    assert [told.sequence for told in stream] == [2]
    for call in (
        lambda: robot.InsertScans(scans.InsertScansRequest(map="hall", scans=[scans.Scan(robot="amr-8", **SCAN)])),
        lambda: robot.DeleteMap(maps.DeleteMapRequest(map="hall")),
    ):
        try:
            call()
        except grpc.RpcError as error:
            assert error.code() == grpc.StatusCode.PERMISSION_DENIED and "amr-7" in error.details(), error
        else:
            raise AssertionError("a robot did what it may not")
    listing = lambda own: stub(own).ListMaps(maps.ListMapsRequest())
    refused(lambda: listing(None))
    refused(lambda: listing("stranger/amr-7"))


def by_httpx(server, folder):
    trusting = ssl.create_default_context(cafile=folder / "ca.pem")
    trusting.load_cert_chain(folder / "amr-7.pem", folder / "amr-7.key")
    for http2 in (True, False):
        with httpx.Client(verify=trusting, http2=http2) as client:
            answer = client.get(f"{server.url}/v1/maps/hall")
            assert answer.status_code == 200 and answer.http_version == ("HTTP/2" if http2 else "HTTP/1.1"), answer
    with httpx.Client(verify=ssl.create_default_context(cafile=folder / "stranger/ca.pem")) as client:
        try:
            client.get(f"{server.url}/healthz")
        except httpx.ConnectError as error:
            assert "certificate verify failed" in str(error), error
        else:
            raise AssertionError("a server that nobody vouches for was trusted")


def by_curl(server, folder):
    own = ["--cert", folder / "amr-7.pem", "--key", folder / "amr-7.key"]
    curl = lambda *arguments: subprocess.run(["curl", "-sS", "--fail", "--max-time", "20", *arguments], capture_output=True, text=True)
    done = curl("--cacert", folder / "ca.pem", *own, f"{server.url}/v1/maps/hall")
    assert json.loads(done.stdout)["name"] == "hall", done
    # Without a certificate, without trust, without TLS.
    assert curl("--cacert", folder / "ca.pem", f"{server.url}/v1/maps/hall").returncode != 0
    assert curl(*own, f"{server.url}/v1/maps/hall").returncode == 60
    plain = subprocess.run(["curl", "-sS", "--max-time", "20", server.url.replace("https", "http")], capture_output=True, text=True)
    assert json.loads(plain.stdout)["code"] == "TLS_REQUIRED", plain


def by_zenoh(server, folder):
    module = messages()
    maps, scans = module("map_pb2"), module("scan_pb2")

    def session(own, endpoint):
        config = zenoh.Config()
        for key, value in {
            "mode": "client",
            "connect/endpoints": [endpoint],
            "connect/timeout_ms": 3000,
            "scouting/multicast/enabled": False,
            "transport/link/tls/root_ca_certificate": str(folder / "ca.pem"),
            **({"transport/link/tls/enable_mtls": True} if own else {}),
            **({"transport/link/tls/connect_certificate": str(folder / f"{own}.pem")} if own else {}),
            **({"transport/link/tls/connect_private_key": str(folder / f"{own}.key")} if own else {}),
        }.items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)

    payload = scans.InsertScansRequest(scans=[scans.Scan(**{**SCAN, "sequence": 3})]).SerializeToString()
    with session("operator", server.zenoh) as operator:
        replies = [reply.ok for reply in operator.get("ubbmap/hall", timeout=20.0)]
        assert maps.GetMapResponse.FromString(replies[0].payload.to_bytes()).name == "hall"
    for own, endpoint in ((None, server.zenoh), ("stranger/amr-7", server.zenoh), (None, server.zenoh.replace("tls/", "tcp/"))):
        try:
            session(own, endpoint).close()
        except zenoh.ZError:
            continue
        raise AssertionError(f"{own} at {endpoint} came in")
    return payload


def main():
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make(folder)
        (folder / "access.toml").write_text(ACCESS)
        (folder / "access.toml").chmod(0o600)
        settings = {
            "UBBMAP_TLS__CERT": str(folder / "server.pem"),
            "UBBMAP_TLS__KEY": str(folder / "server.key"),
            "UBBMAP_TLS__CLIENT_CA": str(folder / "ca.pem"),
            "UBBMAP_TLS__CLIENT_AUTH": "required",
            "UBBMAP_ACCESS__TOKENS": str(folder / "access.toml"),
        }
        with Server(sys.argv[1], settings=settings, zenoh="tls") as server:
            by_grpc(server, folder)
            by_httpx(server, folder)
            by_curl(server, folder)
            by_zenoh(server, folder)
    print("TLS: certificates of openssl; grpcio, httpx over HTTP/2 and HTTP/1.1, curl and eclipse-zenoh come in with theirs and not without")


if __name__ == "__main__":
    main()
