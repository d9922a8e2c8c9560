"""Publishes `geometry_msgs/msg/PolygonStamped` on /zone, ten times a second, until it is killed.

usage: polygons.py with|without

With or without the service `~/get_type_description` (the parameter `start_type_description_service`). Prints `publishing`
after the first message.
"""

import sys

import rclpy
from geometry_msgs.msg import Point32, PolygonStamped
from rclpy.parameter import Parameter


def main():
    has_service = {"with": True, "without": False}[sys.argv[1]]
    rclpy.init()
    parameter = Parameter("start_type_description_service", Parameter.Type.BOOL, has_service)
    node = rclpy.create_node("zones", parameter_overrides=[parameter])
    publisher = node.create_publisher(PolygonStamped, "/zone", 10)
    published = 0

    def publish():
        nonlocal published
        message = PolygonStamped()
        message.header.frame_id = "map"
        message.header.stamp = node.get_clock().now().to_msg()
        message.polygon.points = [Point32(x=1.0, y=2.0, z=float(published))]
        publisher.publish(message)
        published += 1
        if published == 1:
            print("publishing", flush=True)

    node.create_timer(0.1, publish)
    rclpy.spin(node)


main()
