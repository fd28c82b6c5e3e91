"""Starts the image from a directory as docker/compose.yaml would, maps a room, stops it, starts it again, and has Prometheus read it.

usage: unshare --mount --net run_image.py STAGED WORK [PROMETHEUS]

STAGED is what docker/stage made, WORK an empty directory, PROMETHEUS the program; without it the figures are not looked at. Without root
or `unshare`, `run_image.py --here STAGED WORK` starts the binary as it is, on a free port.
"""

import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from pathlib import Path

import yaml

import figures
from image import ROOT, Container, Recipe, lay_out

SERVER = "http://127.0.0.1:8080"


def call(path, body=None, method=None, server=SERVER):
    """A request with a JSON body: (status, answer)."""
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(server + path, data, {"Content-Type": "application/json"}, method=method)
    try:
        with urllib.request.urlopen(request, timeout=20) as answer:
            return answer.status, json.loads(answer.read())
    except urllib.error.HTTPError as error:
        return error.code, json.loads(error.read())


def wants(path, expected, body=None, method=None, server=SERVER):
    """The answer, which must contain what is expected of it."""
    status, answer = call(path, body, method, server)
    assert status in (200, 201) and {key: answer.get(key) for key in expected} == expected, (path, status, answer)
    return answer


def map_a_room(server=SERVER):
    """A new map, one scan, one question."""
    wants("/healthz", {"status": "ok"}, server=server)
    wants("/readyz", {"status": "ready"}, server=server)
    wants("/v1/maps/hall", {"revision": "0"}, {"resolution": 0.05, "min_obstacle_width": 0.05}, "PUT", server)
    scan = json.loads((ROOT / "examples/scan.json").read_text())
    wants("/v1/maps/hall/scans", {"revision": "1", "applied": 1, "duplicates": 0}, scan, server=server)
    room_is_there(server)


def room_is_there(server=SERVER):
    """The map of `map_a_room`, with its window of sequence numbers."""
    scan = json.loads((ROOT / "examples/scan.json").read_text())
    wants("/v1/maps/hall/scans", {"revision": "1", "applied": 0, "duplicates": 1}, scan, server=server)
    asked = {"regions": [{"disc": {"center": {"x": 1.6, "y": 1.1}, "radius": 0.5}}, {"disc": {"center": {"x": 9, "y": 9}, "radius": 0.5}}]}
    answer = wants("/v1/maps/hall/guaranteed-free", {"sound": True}, asked, server=server)
    assert [result["free"] for result in answer["results"]] == [True, False], answer


def end(process, code=0):
    """SIGTERM, and what must come of it."""
    process.send_signal(signal.SIGTERM)
    assert process.wait(30) == code, f"the server ended with {process.returncode}"


def stays_shut(container):
    """What the confinement must prevent."""
    recipe = container.recipe
    assert recipe.uid != 0, "the image's user is root"
    code, printed = container.run([*recipe.entry, *recipe.command, "--data", "/elsewhere"])
    assert code == 1 and re.search(r"[Rr]ead-only", printed), f"the root is not read-only: {code} {printed}"
    assert not (container.target / "bin/sh").exists()


def compose_environment(recipe):
    """What the compose file sets for the server, which it must run as the image means it."""
    services = yaml.safe_load((ROOT / "docker/compose.yaml").read_text())["services"]
    for name, service in services.items():
        assert service["read_only"] and service["cap_drop"] == ["ALL"] and service["security_opt"] == ["no-new-privileges:true"], name
        assert all(port.startswith("127.0.0.1:") for port in service["ports"]), f"{name} is published beyond loopback"
        for source in (volume.split(":")[0] for volume in service["volumes"]):
            assert not source.startswith(".") or (ROOT / "docker" / source).is_dir(), f"{name}: there is no {source}"
    service = services["ubbmap"]
    assert service["user"] == recipe.one("USER")
    assert [volume.split(":")[1] for volume in service["volumes"]] == recipe.volumes
    port = recipe.one("EXPOSE")
    assert [published.rsplit(":", 1)[1] for published in service["ports"]] == [port]
    assert recipe.environment["UBBMAP_LISTEN"].endswith(f":{port}") and recipe.environment["UBBMAP_DATA_DIR"] in recipe.volumes
    return service["environment"]


def in_a_directory(staged, work, prometheus):
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    recipe = Recipe()
    lay_out(recipe, staged, work / "root")
    container = Container(recipe, work / "root", work / "data", {})
    try:
        lives(container, work, prometheus)
    finally:
        container.clear()


def lives(container, work, prometheus):
    recipe = container.recipe
    # The image alone does not open itself to a network.
    code, printed = container.run([*recipe.entry, *recipe.command])
    assert code == 64 and "insecure" in printed, f"without UBBMAP_INSECURE it must not start: {code} {printed}"
    assert not list((work / "data").iterdir())

    container.environment |= compose_environment(recipe)
    stays_shut(container)
    log = open(work / "server.log", "w")
    serve = lambda **environment: container.start([*recipe.entry, *recipe.command], stderr=log, environment=environment)

    assert not container.healthy(), "the health check passes without a server"
    server = serve()
    container.wait_healthy(server)
    map_a_room()
    end(server)
    assert not container.healthy(), "the health check passes without a server"

    server = serve()
    container.wait_healthy(server)
    room_is_there()
    server.kill()
    server.wait()
    server = serve(UBBMAP_ZENOH__MODE="router", UBBMAP_ZENOH__LISTEN="tcp/127.0.0.1:7447")
    container.wait_healthy(server)
    room_is_there()
    owners = {(path.stat().st_uid, path.stat().st_gid) for path in (work / "data").rglob("*")}
    assert owners == {(recipe.uid, recipe.gid)}, owners
    if prometheus:
        figures.look(prometheus, work, SERVER)
    end(server)
    log.close()
    lines = [json.loads(line) for line in (work / "server.log").read_text().splitlines()]
    # What --insecure warns of on purpose: itself, and each change that anyone made.
    warned = [line for line in lines if line["message"].startswith("--insecure") or (line["target"] == "ubbmap::audit" and line.get("insecure"))]
    bad = [line for line in lines if line["level"] in ("WARN", "ERROR") and line not in warned]
    assert lines and warned and not bad, bad
    print("image: refuses a network by itself; read-only root, a user without rights; health check, one scan, SIGTERM, kill -9, the same data again")


def here(staged, work):
    """The binary alone, where nothing can be mounted."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith("UBBMAP_")}
    arguments = [staged / "root/usr/local/bin/ubbmap", "serve", "--listen", "127.0.0.1:0", "--data", work / "data", "--log", "warn"]
    for again in (False, True):
        environment |= {"UBBMAP_ZENOH__MODE": "router", "UBBMAP_ZENOH__LISTEN": "tcp/127.0.0.1:0"} if again else {}
        process = subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True, env=environment)
        try:
            server = re.search(r"http://[0-9.:]+", process.stdout.readline()).group(0)
            health = [arguments[0], *Recipe().health[1:], "--server", server]
            subprocess.run(health, check=True, env=environment, capture_output=True)
            room_is_there(server) if again else map_a_room(server)
            end(process)
        finally:
            process.kill()
    print("binary: health check, one scan, SIGTERM, the same data again with Zenoh on")


def main():
    if sys.argv[1] == "--here":
        here(Path(sys.argv[2]), Path(sys.argv[3]))
    else:
        in_a_directory(Path(sys.argv[1]), Path(sys.argv[2]), *(sys.argv[3:4] or [None]))


if __name__ == "__main__":
    main()
