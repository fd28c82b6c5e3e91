"""A planner's view of a map, with curl and numpy: none of this project's code on the client's side.

Starts the server on an empty directory, replays a log, reads the whole map at a coarse depth as .npy by curl, holds the
raster to the quadtree leaves of the same region, and holds a thousand guaranteed-free discs along the longest free row to a brute
force over the leaves.

usage: planner_view.py BINARY LOG
"""

import json
import re
import subprocess
import sys
import tempfile
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np

DEPTH, RESOLUTION, ORIGIN = 16, 0.1, -3276.8
UNKNOWN = 5


def call(url, body=None):
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data=data, headers={"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=60) as response:
        return json.load(response)


def curl_npy(url, path):
    subprocess.run(["curl", "--silent", "--show-error", "--fail", "--output", str(path), url], check=True)
    return np.load(path)


def box_of(columns, rows, depth):
    """The half-open box of cells of a depth, as query parameters."""
    cell = RESOLUTION * 2 ** (DEPTH - depth)
    edges = (columns[0], rows[0], columns[1], rows[1])
    names = ("min_x", "min_y", "max_x", "max_y")
    return "&".join(f"{name}={ORIGIN + edge * cell!r}" for name, edge in zip(names, edges))


def known_cells(url, depth):
    """Columns and rows of a depth that hold anything known."""
    leaves = [leaf for leaf in call(f"{url}/region?depth={depth}")["leaves"] if leaf["class"] != UNKNOWN]
    spans = [(leaf["x"] << (depth - leaf["depth"]), leaf["y"] << (depth - leaf["depth"]), 1 << (depth - leaf["depth"])) for leaf in leaves]
    columns = min(x for x, _, _ in spans), max(x + size for x, _, size in spans)
    rows = min(y for _, y, _ in spans), max(y + size for _, y, size in spans)
    return columns, rows


def check_raster(url, depth, folder):
    """The raster by curl is the painting of the quadtree leaves."""
    columns, rows = known_cells(url, depth)
    box = box_of(columns, rows, depth)
    raster = curl_npy(f"{url}/grid?{box}&depth={depth}&format=npy", folder / "grid.npy")
    assert raster.dtype == np.uint8 and raster.shape == (rows[1] - rows[0], columns[1] - columns[0]), raster.shape
    painted = np.zeros_like(raster)
    for leaf in call(f"{url}/region?{box}&depth={depth}")["leaves"]:
        size = 1 << (depth - leaf["depth"])
        x, y = leaf["x"] * size - columns[0], leaf["y"] * size - rows[0]
        painted[max(y, 0) : y + size, max(x, 0) : x + size] = leaf["class"]
    assert np.array_equal(raster, painted)
    print(f"depth {depth}: {raster.shape[1]} x {raster.shape[0]} cells, classes {raster.min()}..{raster.max()}, as the leaves say")
    return raster, columns, rows


def longest_free_row(raster):
    """(row, first, last + 1) of the longest run of cells of class 1."""
    best = (0, 0, 0)
    for y, row in enumerate(raster == 1):
        edges = np.flatnonzero(np.diff(np.concatenate(([0], row.astype(np.int8), [0]))))
        for first, end in zip(edges[::2], edges[1::2]):
            if end - first > best[2] - best[1]:
                best = (y, int(first), int(end))
    return best


def largest_class(raster, columns, rows, x, y, radius):
    """By brute force: the largest class of the closed leaves that a closed disc meets."""
    cx, cy = (x - ORIGIN) / RESOLUTION - columns[0], (y - ORIGIN) / RESOLUTION - rows[0]
    xs, ys = np.arange(raster.shape[1]), np.arange(raster.shape[0])
    dx = np.maximum(np.maximum(xs - cx, cx - xs - 1), 0)
    dy = np.maximum(np.maximum(ys - cy, cy - ys - 1), 0)
    meets = dx[None, :] ** 2 + dy[:, None] ** 2 <= (radius / RESOLUTION) ** 2
    return int(raster[meets].max())


def check_discs(url, raster, columns, rows):
    row, first, end = longest_free_row(raster)
    y = ORIGIN + (rows[0] + row + 0.5) * RESOLUTION
    radius = 0.23
    centers = [ORIGIN + (columns[0] + first + (end - first) * (i + 0.5) / 1000) * RESOLUTION for i in range(1000)]
    regions = [{"disc": {"center": {"x": x, "y": y}, "radius": radius}} for x in centers]
    answer = call(f"{url}/guaranteed-free", {"regions": regions, "tolerance": 0})
    assert answer["sound"] is True and len(answer["results"]) == 1000
    free = 0
    for x, result in zip(centers, answer["results"]):
        largest = largest_class(raster, columns, rows, x, y, radius)
        assert result["max_class"] == largest and result["free"] == (largest <= UNKNOWN - 1), (x, y, result, largest)
        assert result["free"] or result["witness"]["class"] == largest
        free += result["free"]
    length = (end - first) * RESOLUTION
    print(f"1000 discs of {radius} m along {length:.1f} m at y = {y:.2f}: {free} free, all as by brute force")
    assert free > 0


def main():
    binary, log = sys.argv[1], sys.argv[2]
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        server = subprocess.Popen(
            [binary, "serve", "--listen", "127.0.0.1:0", "--data", str(folder / "data")], stdout=subprocess.PIPE, text=True
        )
        try:
            ready = server.stdout.readline()
            address = re.search(r"http://[0-9.:]+", ready).group(0)
            subprocess.run([binary, "replay", log, "--map", "view", "--server", address, "--robots", "4"], check=True)
            url = f"{address}/v1/maps/view"
            check_raster(url, DEPTH - 2, folder)
            raster, columns, rows = check_raster(url, DEPTH, folder)
            check_discs(url, raster, columns, rows)
            try:
                call(f"{address}/v1/maps/nowhere")
                raise AssertionError("a map that is not there was found")
            except urllib.error.HTTPError as error:
                problem = json.load(error)
                assert error.code == 404 and problem["code"] == "MAP_NOT_FOUND", problem
        finally:
            server.terminate()
            assert server.wait(30) == 0, "the server did not end in peace"


if __name__ == "__main__":
    main()
