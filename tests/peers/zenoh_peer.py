"""Zenoh by eclipse-zenoh: creates a map, sends a real log acknowledged and pipelined, watches its changes, and asks.

usage: zenoh_peer.py BINARY LOG
"""

import collections
import sys
import time

import zenoh

from common import Server, flaser, messages, scan_fields

IN_FLIGHT = 32


def one(replies, kind):
    """The message of the one reply."""
    answers = [reply.ok.payload.to_bytes() for reply in replies if reply.ok is not None]
    assert len(answers) == 1, "no answer, or more than one"
    return kind.FromString(answers[0])


def main():
    binary, log = sys.argv[1], sys.argv[2]
    module = messages()
    maps, scans, queries = module("map_pb2"), module("scan_pb2"), module("query_pb2")
    changes, free, errors = module("change_pb2"), module("free_pb2"), module("error_pb2")
    recorded = list(flaser(log))
    with Server(binary) as server:
        config = zenoh.Config()
        config.insert_json5("mode", '"client"')
        config.insert_json5("connect/endpoints", f'["{server.zenoh}"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        with zenoh.open(config) as session:
            ask = lambda key, kind, payload=b"": one(session.get(key, payload=payload, timeout=20.0), kind)
            create = maps.CreateMapRequest(config=maps.MapConfig(min_obstacle_width=0.05)).SerializeToString()
            assert not ask("ubbmap/intel/create", maps.CreateMapResponse, create).existed
            seen = []
            watch = session.declare_subscriber(
                "ubbmap/intel/changes",
                lambda sample: seen.append(changes.WatchMapResponse.FromString(sample.payload.to_bytes())),
            )
            waiting, applied, revision = collections.deque(), 0, 0
            for sequence, (pose, ranges) in enumerate(recorded):
                scan = scans.Scan(**scan_fields(sequence, pose, ranges))
                payload = scans.InsertScansRequest(scans=[scan]).SerializeToString()
                waiting.append(session.get("ubbmap/intel/insert/amr-7", payload=payload, timeout=20.0))
                if len(waiting) == IN_FLIGHT or sequence == len(recorded) - 1:
                    while waiting:
                        answer = one(waiting.popleft(), scans.InsertScansResponse)
                        assert not answer.rejected and answer.duplicates == 0, answer
                        applied, revision = applied + answer.applied, max(revision, answer.revision)
            assert applied == len(recorded)
            deadline = time.monotonic() + 20
            while (not seen or seen[-1].revision < revision) and time.monotonic() < deadline:
                time.sleep(0.05)
            assert seen[-1].revision == revision, (seen[-1].revision, revision)
            gaps = sum(later.since != earlier.revision for earlier, later in zip(seen, seen[1:]))
            watch.undeclare()

            state = ask("ubbmap/intel", maps.GetMapResponse)
            assert [(robot.robot, robot.applied) for robot in state.robots] == [("amr-7", len(recorded))]
            told = ask(f"ubbmap/intel/changes?since={revision - 1}", changes.GetChangesResponse)
            assert told.revision == revision and not told.everything
            leaves = ask("ubbmap/intel/region?min_x=-20;min_y=-20;max_x=20;max_y=20;depth=12", queries.GetRegionResponse)
            assert leaves.leaves and all(leaf.depth <= 12 for leaf in leaves.leaves)
            point = maps.Point(x=recorded[0][0][0], y=recorded[0][0][1])
            disc = free.Region(disc=free.DiscRegion(center=point, radius=0.05))
            asked = free.CheckGuaranteedFreeRequest(regions=[disc]).SerializeToString()
            assert ask("ubbmap/intel/guaranteed-free", free.CheckGuaranteedFreeResponse, asked).sound
            replies = list(session.get("ubbmap/nowhere", timeout=20.0))
            error = errors.Error.FromString(replies[0].err.payload.to_bytes())
            assert (error.code, error.advice) == ("MAP_NOT_FOUND", errors.ADVICE_REFUSED), error
            alive = [reply.ok.key_expr for reply in session.liveliness().get("ubbmap/@server/*")]
            assert len(alive) == 1
            print(f"eclipse-zenoh: {applied} scans acknowledged, {len(seen)} changes to revision {revision}, {gaps} gaps")


if __name__ == "__main__":
    main()
