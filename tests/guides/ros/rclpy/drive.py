"""A robot that drives 4 m through a round room of 6 m, as its messages tell it: some scans before it is localised, one without a pose."""

import math
from types import SimpleNamespace as Message

# In a stub the transforms are known here.
poses = {}

BEAMS = 180


def _stamp(step):
    return Message(sec=1000 + step // 10, nanosec=(step % 10) * 100_000_000)


def _scan(step, x):
    ranges = []
    for beam in range(BEAMS):
        angle = math.tau * beam / BEAMS
        # The sensor of the guide's map is 0.12 m ahead.
        dx = x + 0.12 - 2.0
        along = dx * math.cos(angle)
        ranges.append(-along + math.sqrt(along**2 + 36.0 - dx * dx))
    ranges[step % BEAMS] = math.nan
    ranges[(step + 7) % BEAMS] = math.inf
    header = Message(stamp=_stamp(step), frame_id="laser")
    return Message(header=header, angle_min=0.0, angle_increment=math.tau / BEAMS, scan_time=0.1, ranges=ranges)


def run(node):
    hand = lambda topic, message: node.subscriptions_by_topic[topic][1](message)
    twist = Message(linear=Message(x=0.5, y=0.0), angular=Message(z=0.1))
    hand("odom", Message(twist=Message(twist=twist)))
    covariance = [0.0] * 36
    covariance[0] = covariance[7] = 0.01**2
    covariance[35] = 0.004**2
    for step in range(46):
        x = 0.1 * step
        if step == 5:
            hand("amcl_pose", Message(pose=Message(covariance=covariance)))
        if step != 20:
            rotation = Message(x=0.0, y=0.0, z=0.0, w=1.0)
            poses[1000 + step / 10] = Message(translation=Message(x=x, y=1.0), rotation=rotation)
        hand("scan", _scan(step, x))
