"""Sends goals of a counting action with a real rclpy; prints JSON.

usage: actions.py --seconds LIMIT --server NODE ACTION

The answer: what the graph has of the action, as `ros2 action list -t` and `ros2 action info` ask for it; and of each goal
the feedback that was heard, how it ended and with what: one that is counted to its end, with a picture that takes more
than a datagram; one that is canceled; one that is rejected; and one that nobody knows.
"""

import argparse
import json
import sys
import time

import rclpy
from action_msgs.msg import GoalStatusArray
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient
from rclpy.action.graph import (
    get_action_client_names_and_types_by_node,
    get_action_names_and_types,
    get_action_server_names_and_types_by_node,
)
from rclpy.qos import qos_profile_action_status_default
from sensor_msgs.msg import Image
from wm_msgs.action import Plan


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--server", required=True, help="the full name of its node")
    parser.add_argument("action")
    arguments = parser.parse_args()

    rclpy.init()
    node = rclpy.create_node("actions")
    client = ActionClient(node, Plan, arguments.action)
    if not client.wait_for_server(arguments.seconds):
        sys.exit(f"no server of {arguments.action} within {arguments.seconds} s")

    def wait(future, what):
        rclpy.spin_until_future_complete(node, future, timeout_sec=arguments.seconds)
        if not future.done():
            sys.exit(f"{what} did not come within {arguments.seconds} s")
        return future.result()

    def goal(tenths):
        goal = Plan.Goal()
        goal.duration.sec, goal.duration.nanosec = tenths // 10, tenths % 10 * 100_000_000
        return goal

    def send(goal):
        heard = []
        handle = wait(client.send_goal_async(goal, lambda news: heard.append(news.feedback.iteration)), "an answer")
        return handle, heard

    def end(handle, heard):
        answer = wait(handle.get_result_async(), "the result")
        # The result, another topic, may overtake the last feedback.
        deadline = time.monotonic() + 5
        while heard[-1:] != [answer.result.plans - 1] and time.monotonic() < deadline:
            rclpy.spin_once(node, timeout_sec=0.1)
        return {"feedback": heard, "status": answer.status, "plans": answer.result.plans, "message": answer.result.message}

    counted = goal(10)
    counted.goal.images = [Image(height=200, width=200, step=600, encoding="rgb8", data=bytes(120_000))]
    counted = end(*send(counted))

    handle, heard = send(goal(1000))
    while len(heard) < 3:
        rclpy.spin_once(node, timeout_sec=0.1)
    answer = wait(handle.cancel_goal_async(), "an answer")
    canceled = end(handle, heard)
    canceled["return_code"] = answer.return_code
    canceled["is_meant"] = [info.goal_id.uuid.tolist() for info in answer.goals_canceling] == [handle.goal_id.uuid.tolist()]
    canceled["again"] = wait(handle.cancel_goal_async(), "an answer").return_code

    rejected, _ = send(goal(0))

    cancel = node.create_client(CancelGoal, f"{arguments.action}/_action/cancel_goal")
    request = CancelGoal.Request()
    request.goal_info.goal_id.uuid[0] = 7
    cancel.wait_for_service(arguments.seconds)
    unknown = wait(cancel.call_async(request), "an answer").return_code

    statuses = []
    topic = f"{arguments.action}/_action/status"
    node.create_subscription(GoalStatusArray, topic, statuses.append, qos_profile_action_status_default)
    while not statuses:
        rclpy.spin_once(node, timeout_sec=0.1)

    namespace, name = arguments.server.rsplit("/", 1)
    json.dump(
        {
            "names": get_action_names_and_types(node),
            "served": get_action_server_names_and_types_by_node(node, name, namespace or "/"),
            "used": get_action_client_names_and_types_by_node(node, "actions", "/"),
            "counted": counted,
            "canceled": canceled,
            "rejected": not rejected.accepted,
            "unknown": unknown,
            "statuses": [status.status for status in statuses[-1].status_list],
        },
        sys.stdout,
    )
    print(flush=True)
    node.destroy_node()
    rclpy.shutdown()


main()
