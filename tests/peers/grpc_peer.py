"""gRPC by grpcio: creates a map, streams a real log, watches it from its first commit, and asks.

usage: grpc_peer.py BINARY LOG
"""

import sys
import threading
import time

import grpc
import numpy as np

from common import Server, flaser, messages, scan_fields

BOX = {"min_x": -30.0, "min_y": -30.0, "max_x": 30.0, "max_y": 30.0, "depth": 14}


class Copy:
    """A planner's copy of a box of the map, kept by its changes."""

    def __init__(self, grid):
        self.grid, self.revision, self.messages = grid, 0, 0
        self.classes = np.frombuffer(grid.classes, np.uint8).reshape(grid.height, grid.width).copy()

    def take(self, change):
        assert not change.everything and change.since == self.revision, (change.since, self.revision)
        for block in change.blocks:
            side = 1 << (change.depth - block.depth)
            cells = np.frombuffer(block.classes, np.uint8).reshape(side, side)
            left, bottom = block.x * side - self.grid.x, block.y * side - self.grid.y
            x0, y0 = max(left, 0), max(bottom, 0)
            x1, y1 = min(left + side, self.grid.width), min(bottom + side, self.grid.height)
            self.classes[y0:y1, x0:x1] = cells[y0 - bottom : y1 - bottom, x0 - left : x1 - left]
        self.revision, self.messages = change.revision, self.messages + 1


def main():
    binary, log = sys.argv[1], sys.argv[2]
    module = messages()
    service, maps, scans = module("service_pb2_grpc"), module("map_pb2"), module("scan_pb2")
    queries, changes, free = module("query_pb2"), module("change_pb2"), module("free_pb2")
    recorded = list(flaser(log))
    with Server(binary) as server, grpc.insecure_channel(server.address) as channel:
        stub = service.MapServiceStub(channel)
        config = maps.MapConfig(min_obstacle_width=0.05)
        assert not stub.CreateMap(maps.CreateMapRequest(map="intel", config=config)).existed
        assert stub.CreateMap(maps.CreateMapRequest(map="intel", config=config)).existed

        copy = Copy(stub.GetGrid(queries.GetGridRequest(map="intel", **BOX)))
        watch = stub.WatchMap(changes.WatchMapRequest(map="intel", since=0, contents=True, **BOX))
        def follow():
            try:
                for change in watch:
                    copy.take(change)
            except grpc.RpcError as error:
                assert error.code() == grpc.StatusCode.CANCELLED, error

        def send():
            for sequence, (pose, ranges) in enumerate(recorded):
                scan = scans.Scan(robot="intel", **scan_fields(sequence, pose, ranges))
                yield scans.StreamScansRequest(map="intel", scan=scan)

        watcher = threading.Thread(target=follow, daemon=True)
        watcher.start()
        fates = list(stub.StreamScans(send()))
        assert [fate.sequence for fate in fates] == list(range(len(recorded)))
        assert not any(fate.duplicate or fate.HasField("rejected") for fate in fates)
        pose, ranges = recorded[0]
        extra = scans.Scan(robot="extra", **scan_fields(0, pose, ranges))
        final = stub.InsertScans(scans.InsertScansRequest(map="intel", scans=[extra])).revision
        until = time.monotonic() + 30
        while copy.revision < final and time.monotonic() < until:
            time.sleep(0.02)
        watch.cancel()
        watcher.join(30)
        assert not watcher.is_alive() and copy.revision == final, (copy.revision, final)
        whole = stub.GetGrid(queries.GetGridRequest(map="intel", **BOX))
        assert whole.revision == final and whole.classes == copy.classes.tobytes(), "the copy is not the map"

        again = list(stub.StreamScans(iter(list(send())[:100])))
        assert all(fate.duplicate for fate in again)
        state = stub.GetMap(maps.GetMapRequest(map="intel"))
        applied = {robot.robot: robot.applied for robot in state.robots}
        assert applied == {"extra": 1, "intel": len(recorded)}, applied

        point = maps.Point(x=recorded[0][0][0], y=recorded[0][0][1])
        disc = free.Region(disc=free.DiscRegion(center=point, radius=0.05))
        answer = stub.CheckGuaranteedFree(free.CheckGuaranteedFreeRequest(map="intel", regions=[disc]))
        assert answer.sound and len(answer.results) == 1
        try:
            stub.GetMap(maps.GetMapRequest(map="nowhere"))
            raise AssertionError("a map that is not there was found")
        except grpc.RpcError as error:
            assert error.code() == grpc.StatusCode.NOT_FOUND, error
            details = dict(error.trailing_metadata())["grpc-status-details-bin"]
            assert b"MAP_NOT_FOUND" in details and b"ubbmap" in details
        print(
            f"grpcio: {len(fates)} scans streamed and acknowledged, {copy.messages} changes to revision {final}, "
            "and the copy kept by them is the map"
        )


if __name__ == "__main__":
    main()
