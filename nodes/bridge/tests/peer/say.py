"""Publishes a latched text with a real rclpy until its standard input ends: say.py TOPIC TEXT"""

import sys

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from std_msgs.msg import String

rclpy.init()
node = rclpy.create_node("say")
publisher = node.create_publisher(String, sys.argv[1], QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL))
publisher.publish(String(data=sys.argv[2]))
sys.stdin.read()
