"""Serves a counting action with a real rclpy: ten numbers per second for the goal's duration.

usage: action_server.py ACTION

A goal of no duration is rejected. It serves until it is killed.
"""

import sys
import time

import rclpy
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import MultiThreadedExecutor
from wm_msgs.action import Plan

PERIOD_S = 0.1


def count(goal):
    duration = goal.request.duration
    numbers = round((duration.sec + duration.nanosec * 1e-9) / PERIOD_S)
    for number in range(numbers):
        if goal.is_cancel_requested:
            goal.canceled()
            return Plan.Result(plans=number, message="canceled")
        goal.publish_feedback(Plan.Feedback(iteration=number))
        time.sleep(PERIOD_S)
    goal.succeed()
    return Plan.Result(plans=numbers, message="counted")


def judge(goal):
    wanted = goal.duration.sec or goal.duration.nanosec
    return GoalResponse.ACCEPT if wanted else GoalResponse.REJECT


def main():
    rclpy.init()
    node = rclpy.create_node("action_server")
    server = ActionServer(
        node,
        Plan,
        sys.argv[1],
        count,
        goal_callback=judge,
        cancel_callback=lambda goal: CancelResponse.ACCEPT,
        callback_group=ReentrantCallbackGroup(),
    )
    executor = MultiThreadedExecutor(4)
    executor.add_node(node)
    executor.spin()
    server.destroy()


main()
