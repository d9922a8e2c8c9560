"""One of two hosts, as nodes/ros/tests/peers/hosts.rs has it in Rust: publishes a stream and a latched text, subscribes to
those of the other host, and prints once a second what has come.

usage: station.py OWN OTHER RATE BYTES

Runs until it is killed.
"""

import array
import sys

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String, UInt8MultiArray


def main():
    own, other, rate, size = sys.argv[1], sys.argv[2], float(sys.argv[3]), int(sys.argv[4])
    rclpy.init()
    node = rclpy.create_node(f"station_{own}")
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    stream = node.create_publisher(UInt8MultiArray, f"/{own}/stream", 10)
    text = node.create_publisher(String, f"/{own}/text", latched)
    text.publish(String(data=own))
    came = dict(stream=0, text=0)

    def count(name):
        came[name] += 1

    node.create_subscription(UInt8MultiArray, f"/{other}/stream", lambda _: count("stream"), 100)
    node.create_subscription(String, f"/{other}/text", lambda _: count("text"), latched)
    data = array.array("B", bytes(size))
    sent = 0

    def publish():
        nonlocal sent
        stream.publish(UInt8MultiArray(data=data))
        sent += 1

    node.create_timer(1 / rate, publish)
    node.create_timer(0.5, lambda: print(f"sent {sent} came {came['stream']} lost 0 text {came['text']}", flush=True))
    rclpy.spin(node)


main()
