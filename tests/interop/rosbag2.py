"""Calls the services of a player or recorder with a real rclpy, as `ros2 service call` does; prints JSON.

usage: rosbag2.py --seconds LIMIT [--listen SECONDS] [--topic TOPIC:TYPE ...] [--publish TOPIC] NODE SERVICE[=JSON] ...

Each SERVICE is one of rosbag2_interfaces, in lower case (`set_rate={"rate": 2.0}`). The answer is a list: for each its
response, and what came in the time of --listen after it: how many messages on each TOPIC, and the times on /clock [ns].
With --publish it publishes numbers, as std_msgs/String, at 50 Hz.
"""

import argparse
import importlib
import json
import sys
import time

import rclpy
import rosbag2_interfaces.srv
from rclpy.qos import QoSProfile, qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String


def fill(message, fields):
    for name, value in fields.items():
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        else:
            setattr(message, name, value)


def plain(message):
    return {name: getattr(message, name) for name in message.get_fields_and_field_types()}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--listen", type=float, default=0.5)
    parser.add_argument("--topic", action="append", default=[])
    parser.add_argument("--publish")
    parser.add_argument("node")
    parser.add_argument("services", nargs="+")
    arguments = parser.parse_args()

    rclpy.init()
    node = rclpy.create_node("rosbag2_user")
    counts, clock, writers = {}, [], []
    for topic in arguments.topic:
        name, type_name = topic.split(":")
        package, _, type_name = type_name.split("/")

        def count(_, name=name):
            counts[name] = counts.get(name, 0) + 1

        message = getattr(importlib.import_module(f"{package}.msg"), type_name)
        writers.append(node.create_subscription(message, name, count, QoSProfile(depth=1000)))
    node.create_subscription(
        Clock, "/clock", lambda m: clock.append(m.clock.sec * 10**9 + m.clock.nanosec), qos_profile_sensor_data
    )
    if arguments.publish:
        publisher = node.create_publisher(String, arguments.publish, 10)
        numbers = iter(range(10**9))
        node.create_timer(0.02, lambda: publisher.publish(String(data=str(next(numbers)))))

    def spin(seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            rclpy.spin_once(node, timeout_sec=0.05)

    steps = []
    for service in arguments.services:
        name, _, fields = service.partition("=")
        camel = "".join(part.capitalize() for part in name.split("_"))
        client = node.create_client(getattr(rosbag2_interfaces.srv, camel), f"{arguments.node}/{name}")
        end = time.monotonic() + arguments.seconds
        while not client.service_is_ready():
            rclpy.spin_once(node, timeout_sec=0.05)
            if time.monotonic() > end:
                sys.exit(f"no service {client.srv_name} within {arguments.seconds} s")
        if not steps:
            spin(1.0)  # the writers of the topics have to meet our readers
        counts.clear()
        clock.clear()
        request = client.srv_type.Request()
        fill(request, json.loads(fields or "{}"))
        future = client.call_async(request)
        rclpy.spin_until_future_complete(node, future, timeout_sec=arguments.seconds)
        if future.result() is None:
            sys.exit(f"{client.srv_name} did not answer within {arguments.seconds} s")
        spin(0.1)  # what was on its way when the call was answered
        at_answer = len(clock)
        spin(arguments.listen)
        steps.append(
            {
                "service": service,
                "response": plain(future.result()),
                "messages": dict(counts),
                "clock": clock[at_answer:],
            }
        )
        node.destroy_client(client)
    json.dump(steps, sys.stdout)
    print(flush=True)
    node.destroy_node()
    rclpy.shutdown()


main()
