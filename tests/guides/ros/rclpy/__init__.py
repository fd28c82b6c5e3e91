"""As much of ROS 2 as the guide's node asks for: spinning hands it a robot's messages, then ends as by Ctrl-C."""

import sys

from . import drive

_parameters = {}


def init(args=None):
    words = sys.argv[1:] if args is None else args
    for flag, word in zip(words, words[1:]):
        if flag == "-p":
            name, value = word.split(":=", 1)
            _parameters[name] = value


def parameter(name, default):
    value = _parameters.get(name)
    return default if value is None else type(default)(value)


def spin(node):
    drive.run(node)
    raise KeyboardInterrupt


def try_shutdown():
    pass
