"""A planner over REST: A* on a coarse depth of the map, and a guaranteed-free check of the path that it found.

The coarse grid is quick to search and says where nothing is known to stand; whether the robot's disc may follow the path is
asked of the server, which answers for every leaf that the sweep touches. Where it says no, the cell of its witness is closed and
the search goes on. Python's standard library alone.

    python examples/planner_rest.py --server http://127.0.0.1:8080 --map room --start 1.5,1.5 --goal 6.5,4.5
"""

import argparse
import base64
import heapq
import json
import math
import sys
import urllib.request

MOST_TRIES = 200


def call(url, body=None):
    data = None if body is None else json.dumps(body).encode()
    request = urllib.request.Request(url, data=data, headers={"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=30) as response:
        return json.load(response)


class Coarse:
    """The map at a coarse depth: the largest class of each cell."""

    def __init__(self, url, box, depth):
        bounds = "&".join(f"{name}={value}" for name, value in zip(("min_x", "min_y", "max_x", "max_y"), box))
        grid = call(f"{url}/grid?{bounds}&depth={depth}&format=json")
        self.width, self.height = grid["width"], grid["height"]
        self.x, self.y, self.size = grid["min_x"], grid["min_y"], grid["cell_size"]
        self.unknown = grid["class_count"] // 2
        self.classes = base64.b64decode(grid["classes"])
        self.closed = set()

    def cell(self, point):
        return int((point[0] - self.x) // self.size), int((point[1] - self.y) // self.size)

    def centre(self, cell):
        return self.x + (cell[0] + 0.5) * self.size, self.y + (cell[1] + 0.5) * self.size

    def is_open(self, cell):
        x, y = cell
        inside = 0 <= x < self.width and 0 <= y < self.height
        return inside and cell not in self.closed and self.classes[y * self.width + x] < self.unknown

    def neighbours(self, cell):
        for dx in (-1, 0, 1):
            for dy in (-1, 0, 1):
                other = cell[0] + dx, cell[1] + dy
                # No cutting of corners.
                ways = (other, (cell[0] + dx, cell[1]), (cell[0], cell[1] + dy))
                if (dx or dy) and all(self.is_open(way) for way in ways):
                    yield other, math.hypot(dx, dy)


def search(grid, start, goal):
    """A*: the cells from start to goal, or nothing."""
    distance = lambda cell: math.hypot(cell[0] - goal[0], cell[1] - goal[1])
    queue, cost, before = [(distance(start), start)], {start: 0.0}, {start: None}
    while queue:
        _, cell = heapq.heappop(queue)
        if cell == goal:
            path = []
            while cell is not None:
                path.append(cell)
                cell = before[cell]
            return path[::-1]
        for other, step in grid.neighbours(cell):
            total = cost[cell] + step
            if total < cost.get(other, math.inf):
                cost[other], before[other] = total, cell
                heapq.heappush(queue, (total + distance(other), other))
    return None


def pair(text):
    x, y = text.split(",")
    return float(x), float(y)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--server", default="http://127.0.0.1:8080")
    parser.add_argument("--map", default="room")
    parser.add_argument("--start", type=pair, required=True, metavar="X,Y")
    parser.add_argument("--goal", type=pair, required=True, metavar="X,Y")
    parser.add_argument("--radius", type=float, default=0.3, help="of the robot with what it may stray, metres")
    parser.add_argument("--levels", type=int, default=2, help="how many levels above the leaves to search")
    parser.add_argument("--margin", type=float, default=5.0, help="how far beyond start and goal to look, metres")
    options = parser.parse_args()
    url = f"{options.server}/v1/maps/{options.map}"

    depth = call(url)["config"]["depth"] - options.levels
    xs, ys = zip(options.start, options.goal)
    box = min(xs) - options.margin, min(ys) - options.margin, max(xs) + options.margin, max(ys) + options.margin
    grid = Coarse(url, box, depth)
    for tries in range(1, MOST_TRIES + 1):
        cells = search(grid, grid.cell(options.start), grid.cell(options.goal))
        if cells is None:
            print(f"no way from {options.start} to {options.goal} after {tries} tries", file=sys.stderr)
            sys.exit(1)
        points = [options.start, *(grid.centre(cell) for cell in cells[1:-1]), options.goal]
        path = {"path": {"points": [{"x": x, "y": y} for x, y in points], "radius": options.radius}}
        answer = call(f"{url}/guaranteed-free", {"regions": [path]})
        result = answer["results"][0]
        if result["free"]:
            length = sum(math.dist(a, b) for a, b in zip(points, points[1:]))
            print(f"guaranteed free at revision {answer['revision']}: {length:.2f} m, {len(points)} points, {tries} tries")
            for x, y in points:
                print(f"{x:.3f},{y:.3f}")
            return
        # Close the cell of the path that lies nearest to what is in the way.
        witness = result["witness"]
        middle = witness["min_x"] + witness["size"] / 2, witness["min_y"] + witness["size"] / 2
        nearest = min(cells[1:-1], key=lambda cell: math.dist(grid.centre(cell), middle), default=None)
        if nearest is None:
            break
        grid.closed.add(nearest)
    print("no way was found that is guaranteed free", file=sys.stderr)
    sys.exit(1)


if __name__ == "__main__":
    main()
