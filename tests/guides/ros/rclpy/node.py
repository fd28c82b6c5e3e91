"""A node: parameters, subscriptions and a logger."""

from types import SimpleNamespace

import rclpy


class _Logger:
    def __init__(self, name):
        self.name = name

    def _say(self, level, text, **_):
        print(f"[{level}] [{self.name}]: {text}")

    def info(self, text, **more):
        self._say("INFO", text, **more)

    def warning(self, text, **more):
        self._say("WARN", text, **more)

    def error(self, text, **more):
        self._say("ERROR", text, **more)


class Node:
    def __init__(self, name):
        self.name = name
        self.subscriptions_by_topic = {}

    def declare_parameter(self, name, default):
        return SimpleNamespace(value=rclpy.parameter(name, default))

    def create_subscription(self, kind, topic, callback, qos):
        self.subscriptions_by_topic[topic] = (kind, callback)

    def get_logger(self):
        return _Logger(self.name)

    def destroy_node(self):
        pass
