"""Transforms: those of the drive, and an exception where there is none."""

from types import SimpleNamespace

from rclpy import drive


class TransformException(Exception):
    pass


class Buffer:
    def lookup_transform(self, target, source, stamp):
        assert (target, source) == ("map", "base_link")
        pose = drive.poses.get(round(stamp.sec + 1e-9 * stamp.nanosec, 6))
        if pose is None:
            raise TransformException(f"no transform at {stamp.sec}.{stamp.nanosec}")
        return SimpleNamespace(transform=pose)


class TransformListener:
    def __init__(self, buffer, node):
        pass
