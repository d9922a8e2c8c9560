"""Subscribes like a user of rclpy, and prints the number of messages after each.

usage: listen.py reliable|best_effort DEPTH TOPIC TYPE

Runs until it is killed.
"""

import importlib
import sys

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy


def main():
    reliability, depth, topic, type_name = sys.argv[1:]
    rclpy.init()
    node = rclpy.create_node(f"listen_{reliability}")
    qos = QoSProfile(depth=int(depth), reliability=getattr(ReliabilityPolicy, reliability.upper()))
    came = 0

    def count(_):
        nonlocal came
        came += 1
        print(came, flush=True)

    package, _, name = type_name.split("/")
    message = getattr(importlib.import_module(f"{package}.msg"), name)
    node.create_subscription(message, topic, count, qos)
    rclpy.spin(node)


main()
