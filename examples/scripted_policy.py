"""The smallest policy: one chunk of actions for each camera image, stamped with the image's stamp.

usage: python examples/scripted_policy.py [--images N]        (ROS 2 sourced, wm_msgs built)
"""

import argparse
import math

import rclpy
from builtin_interfaces.msg import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CompressedImage
from wm_msgs.msg import Action, ActionChunk

PERIOD = Duration(nanosec=200_000_000)  # time that one action takes; here that of a camera frame at 5 Hz

parser = argparse.ArgumentParser()
parser.add_argument("--images", type=int, default=0, help="stop after this many different images; 0: never")
arguments = parser.parse_args()
rclpy.init()
node = rclpy.create_node("scripted_policy")
chunks = node.create_publisher(ActionChunk, "/wm/action_chunk", 10)
seen = set()


def act(image):
    now = node.get_clock().now().to_msg
    chunk = ActionChunk(header=image.header, period=PERIOD)
    chunk.timing.capture, chunk.timing.receive, chunk.timing.start = image.header.stamp, now(), now()
    seen.add((image.header.stamp.sec, image.header.stamp.nanosec))
    sway = 0.01 * math.sin(len(seen) / 4)  # [m] along the base's y axis: left is positive
    action = Action(header=image.header, values=[0.0, sway, 0.0, 0.0, 0.0, 0.0, 1.0])  # dx dy dz droll dpitch dyaw open
    chunk.header.frame_id = action.header.frame_id = "base_link"
    chunk.actions = [action, action]
    chunk.timing.end = now()
    chunks.publish(chunk)


node.create_subscription(CompressedImage, "/camera/image_raw/compressed", act, qos_profile_sensor_data)
try:
    while rclpy.ok() and (arguments.images == 0 or len(seen) < arguments.images):
        rclpy.spin_once(node, timeout_sec=0.5)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
node.destroy_node()
rclpy.try_shutdown()
