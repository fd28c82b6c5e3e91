"""Snapshots and files by grpcio, and maps for Nav2 read by PyYAML and Pillow, as Nav2's map server would read them.

usage: transfer_peer.py BINARY LOG
"""

import io
import sys
import zipfile

import grpc
import numpy as np
import yaml
from PIL import Image

from common import Server, flaser, messages, scan_fields

SCANS = 300
OPTIONS = [("grpc.max_receive_message_length", 64 << 20)]


def occupancy(image, info):
    """The occupancy grid of an image, the first row the lowest (nav2_map_server, map_io.cpp)."""
    shade = np.asarray(image, np.float64) / 255.0
    occ = shade if info["negate"] else 1.0 - shade
    free, occupied = info["free_thresh"], info["occupied_thresh"]
    between = np.rint((occ - free) / (occupied - free) * 100.0) if info["mode"] == "scale" else np.full(occ.shape, -1.0)
    cells = np.where(occupied < occ, 100, np.where(occ < free, 0, between))
    return cells[::-1].astype(int)


def check_nav2(archive, grid, mode, unknown):
    """Holds a map for Nav2 to the grid of the same revision, cell by cell; gives what it says of each class."""
    with zipfile.ZipFile(io.BytesIO(archive)) as files:
        assert files.testzip() is None and sorted(files.namelist()) == ["map.pgm", "map.yaml"]
        info = yaml.safe_load(files.read("map.yaml"))
        image = Image.open(io.BytesIO(files.read(info["image"])))
        image.load()
    assert image.format == "PPM" and image.mode == "L", (image.format, image.mode)
    assert info["mode"] == mode and info["negate"] == 0 and all(isinstance(at, float) for at in info["origin"]), info
    assert info["resolution"] == grid.cell_size and info["origin"][2] == 0.0
    left = round((info["origin"][0] - grid.min_x) / grid.cell_size)
    bottom = round((info["origin"][1] - grid.min_y) / grid.cell_size)
    width, height = image.size
    classes = np.frombuffer(grid.classes, np.uint8).reshape(grid.height, grid.width)
    part = classes[bottom : bottom + height, left : left + width]
    outside = classes.copy()
    outside[bottom : bottom + height, left : left + width] = unknown
    assert part.shape == (height, width) and (outside == unknown).all(), "what was cut off is not unknown"
    edges = [part[0], part[-1], part[:, 0], part[:, -1]]
    assert all((edge != unknown).any() for edge in edges), "the image is not cropped"
    cells = occupancy(image, info)
    said = {int(value): set(cells[part == value].tolist()) for value in np.unique(part)}
    assert all(len(says) == 1 for says in said.values()), said
    return {value: says.pop() for value, says in said.items()}


def main():
    binary, log = sys.argv[1], sys.argv[2]
    module = messages()
    service, maps, scans = module("service_pb2_grpc"), module("map_pb2"), module("scan_pb2")
    queries, snapshots, transfer = module("query_pb2"), module("snapshot_pb2"), module("transfer_pb2")
    recorded = [recording for recording, _ in zip(flaser(log), range(SCANS))]
    with Server(binary) as server, grpc.insecure_channel(server.address, OPTIONS) as channel:
        stub = service.MapServiceStub(channel)
        stub.CreateMap(maps.CreateMapRequest(map="intel", config=maps.MapConfig(depth=12, min_obstacle_width=0.05)))

        def send(first, last):
            for sequence, (pose, ranges) in enumerate(recorded[first:last], first):
                scan = scans.Scan(robot="intel", **scan_fields(sequence, pose, ranges))
                stub.InsertScans(scans.InsertScansRequest(map="intel", scans=[scan]))

        def leaves(name):
            answer = stub.GetRegion(queries.GetRegionRequest(map=name))
            return [(leaf.depth, leaf.x, leaf.y, getattr(leaf, "class")) for leaf in answer.leaves]

        def export(**fields):
            return b"".join(piece.data for piece in stub.ExportMap(transfer.ExportMapRequest(map="intel", **fields)))

        def load(name, file):
            yield transfer.ImportMapRequest(map=name)
            for at in range(0, len(file), 50_000):
                yield transfer.ImportMapRequest(data=file[at : at + 50_000])

        send(0, SCANS // 2)
        half, applied = leaves("intel"), stub.GetMap(maps.GetMapRequest(map="intel")).robots[0].applied
        taken = stub.CreateSnapshot(snapshots.CreateSnapshotRequest(map="intel", name="half"))
        assert taken.revision == SCANS // 2 and applied == SCANS // 2
        send(SCANS // 2, SCANS)
        full = leaves("intel")
        file = export()
        assert export(snapshot="half") != file
        restored = stub.RestoreSnapshot(snapshots.RestoreSnapshotRequest(map="intel", name="half"))
        assert restored.revision == SCANS + 1 and leaves("intel") == half != full
        assert [snapshot.name for snapshot in stub.ListSnapshots(snapshots.ListSnapshotsRequest(map="intel")).snapshots] == ["half"]
        assert stub.ImportMap(load("copy", file)).revision == SCANS
        assert leaves("copy") == full
        state = stub.GetMap(maps.GetMapRequest(map="copy"))
        assert state.robots[0].applied == SCANS and state.last_change > 1e9
        broken = bytearray(file)
        broken[len(file) // 2] ^= 1
        for damaged in (bytes(broken), file[:-1]):
            try:
                stub.ImportMap(load("broken", damaged))
                raise AssertionError("a damaged file was imported")
            except grpc.RpcError as error:
                assert error.code() == grpc.StatusCode.INVALID_ARGUMENT, error
                assert b"INVALID_FILE" in dict(error.trailing_metadata())["grpc-status-details-bin"]
        send(SCANS // 2, SCANS)
        assert leaves("intel") == full, "what was taken back can be sent again"

        unknown = state.unknown_class
        for depth in (12, 10):
            grid = stub.GetGrid(queries.GetGridRequest(map="intel", depth=depth))
            nav2 = {"format": transfer.EXPORT_FORMAT_NAV2, "depth": depth}
            said = check_nav2(export(**nav2), grid, "trinary", unknown)
            expected = {value: 0 if value < unknown else -1 if value == unknown else 100 for value in said}
            assert said == expected and set(said.values()) == {0, -1, 100}, said
            shades = check_nav2(export(mode=transfer.EXPORT_MODE_SCALE, **nav2), grid, "scale", unknown)
            assert all(cell > 0 for value, cell in shades.items() if value >= unknown), shades
            assert [shades[value] for value in sorted(shades)] == sorted(shades.values()), shades
        stub.DeleteSnapshot(snapshots.DeleteSnapshotRequest(map="intel", name="half"))
        assert not stub.ListSnapshots(snapshots.ListSnapshotsRequest(map="intel")).snapshots
        print(
            f"grpcio, PyYAML, Pillow: a snapshot restored and a file of {len(file)} bytes imported leaf for leaf; "
            f"maps for Nav2 say free where the grid is below unknown: {said}"
        )


if __name__ == "__main__":
    main()
