"""Activates and deactivates a managed predictor with a real rclpy, and counts its endpoints in Fast DDS' graph; prints JSON.

usage: endpoints.py --seconds LIMIT --rounds N NODE

The answer: for the configured node, and after each round of activate and deactivate, how many publishers of
/wm/predicted, subscriptions to /wm/latent and servers of NODE/reset there are, and what NODE/reset answered while the
node was active and while it was not.
"""

import argparse
import json
import sys

import rclpy
from lifecycle_msgs.srv import ChangeState
from rclpy.executors import SingleThreadedExecutor
from wm_msgs.srv import Reset


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--rounds", type=int, required=True)
    parser.add_argument("node")
    arguments = parser.parse_args()

    rclpy.init()
    node = rclpy.create_node("endpoints")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    change_state = node.create_client(ChangeState, f"{arguments.node}/change_state")
    reset = node.create_client(Reset, f"{arguments.node}/reset")

    def call(client, request):
        if not client.wait_for_service(arguments.seconds):
            sys.exit(f"no service {client.srv_name} within {arguments.seconds} s")
        future = client.call_async(request)
        executor.spin_until_future_complete(future, timeout_sec=arguments.seconds)
        if future.result() is None:
            sys.exit(f"{client.srv_name} did not answer within {arguments.seconds} s")
        return future.result()

    def change(label):
        request = ChangeState.Request()
        request.transition.label = label
        if not call(change_state, request).success:
            sys.exit(f"{label} failed")

    def answer():
        response = call(reset, Reset.Request(keep_seed=True))
        return {"success": response.success, "message": response.message}

    def counts():
        infos = node.get_publishers_info_by_topic("/wm/predicted")
        return {
            "publishers": len(infos),
            "subscriptions": len(node.get_subscriptions_info_by_topic("/wm/latent")),
            "servers": node.count_services(f"{arguments.node}/reset"),
        }

    change("configure")
    rounds = [{"inactive": answer(), **counts()}]
    for _ in range(arguments.rounds):
        change("activate")
        active = answer()
        change("deactivate")
        rounds.append({"active": active, "inactive": answer(), **counts()})
    json.dump({"rounds": rounds}, sys.stdout)
    print(flush=True)
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown()


main()
