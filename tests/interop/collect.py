"""Subscribes to topics of the suite with a real rclpy and prints what arrived, as JSON.

usage: collect.py --seconds LIMIT TOPIC:TYPE:COUNT[:latched] ...

Ends when every topic has brought COUNT messages, or after LIMIT seconds. A message becomes a dictionary of its fields;
stamps become nanoseconds, byte fields their length and SHA-256.
"""

import argparse
import array
import hashlib
import importlib
import json
import sys
import time

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy


def plain(value):
    if hasattr(value, "sec") and hasattr(value, "nanosec"):
        return value.sec * 1_000_000_000 + value.nanosec
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, array.array) and value.typecode == "B":
        value = value.tobytes()
    if isinstance(value, bytes):
        if len(value) == 1:  # a `byte` field, such as DiagnosticStatus.level
            return value[0]
        return {"len": len(value), "sha256": hashlib.sha256(value).hexdigest()}
    if isinstance(value, str) or value is None:
        return value
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value


def message_type(name):
    package, _, type_name = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), type_name)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("topics", nargs="+")
    arguments = parser.parse_args()

    rclpy.init()
    node = rclpy.create_node("collect")
    received, wanted = {}, {}
    for topic in arguments.topics:
        name, type_name, count, *latched = topic.split(":")
        received[name], wanted[name] = [], int(count)
        qos = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
        if latched:
            qos = QoSProfile(
                depth=1,
                reliability=ReliabilityPolicy.RELIABLE,
                durability=DurabilityPolicy.TRANSIENT_LOCAL,
            )
        node.create_subscription(
            message_type(type_name),
            name,
            lambda message, name=name: received[name].append(plain(message)),
            qos,
        )
    print("ready", file=sys.stderr, flush=True)
    end = time.monotonic() + arguments.seconds
    while time.monotonic() < end and any(len(received[n]) < wanted[n] for n in wanted):
        rclpy.spin_once(node, timeout_sec=0.2)
    json.dump({"received": received, "nodes": sorted(node.get_fully_qualified_node_names())}, sys.stdout)
    print(flush=True)
    node.destroy_node()
    rclpy.shutdown()


main()
