"""Runs the examples as a newcomer would: a robot maps a room over Zenoh, and a planner finds its way over REST.

usage: examples_run.py BINARY
"""

import math
import re
import subprocess
import sys

from common import ROOT, Server


def run(*arguments):
    return subprocess.run([sys.executable, *arguments], check=True, capture_output=True, text=True).stdout


def main():
    with Server(sys.argv[1]) as server:
        robot = ["examples/robot_zenoh.py", "--connect", server.zenoh, "--map", "room"]
        first = run(str(ROOT / robot[0]), *robot[1:])
        assert re.match(r"84 scans acknowledged, 0 rejected", first), first
        # Its numbers go on: a second drive is applied too.
        assert "84 scans acknowledged" in run(str(ROOT / robot[0]), *robot[1:])

        plan = [str(ROOT / "examples/planner_rest.py"), "--server", server.url, "--map", "room", "--start", "1.5,1.5"]
        found = run(*plan, "--goal", "6.5,4.5")
        points = [tuple(map(float, line.split(","))) for line in found.splitlines()[1:]]
        assert points[0] == (1.5, 1.5) and points[-1] == (6.5, 4.5)
        # It goes through the door: where it crosses the wall at x = 4, it keeps its radius from both posts.
        for (ax, ay), (bx, by) in zip(points, points[1:]):
            if min(ax, bx) <= 4 <= max(ax, bx):
                share = (4 - ax) / (bx - ax) if bx != ax else 0
                assert 2.3 <= ay + (by - ay) * share <= 3.1, (ax, ay, bx, by)
        length = sum(math.dist(a, b) for a, b in zip(points, points[1:]))
        assert math.dist(points[0], points[-1]) <= length < 9
        outside = subprocess.run([sys.executable, *plan, "--goal", "9.5,3"], capture_output=True, text=True)
        assert outside.returncode == 1 and "no way" in outside.stderr, outside
        print(f"examples: {first.strip()}; {found.splitlines()[0]}")


if __name__ == "__main__":
    main()
