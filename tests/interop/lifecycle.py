"""Drives a managed node of the suite through its lifecycle with a real rclpy, as `ros2 lifecycle` does; prints JSON.

usage: lifecycle.py --seconds LIMIT --output TOPIC:TYPE NODE TRANSITION ...

While it does so, it publishes camera images at 20 Hz. The answer: for each transition whether it was made, the state
and the labels of the transitions available after it, and how many messages came on TOPIC then (in an active node it
waits for three, else it listens for a second); the transition events; and the states and the transition graph of the
node, and of rclpy's own lifecycle node.
"""

import argparse
import importlib
import json
import sys
import time

import rclpy
from lifecycle_msgs.msg import TransitionEvent
from lifecycle_msgs.srv import ChangeState, GetAvailableStates, GetAvailableTransitions, GetState
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image

SERVICES = {
    "change_state": ChangeState,
    "get_state": GetState,
    "get_available_states": GetAvailableStates,
    "get_available_transitions": GetAvailableTransitions,
}


def pair(value):
    return [value.id, value.label]


def steps(transitions):
    return [[*pair(t.transition), pair(t.start_state), pair(t.goal_state)] for t in transitions]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--output", required=True)
    parser.add_argument("node")
    parser.add_argument("transitions", nargs="+")
    arguments = parser.parse_args()

    rclpy.init()
    node = rclpy.create_node("lifecycle")
    reference = LifecycleNode("reference")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    executor.add_node(reference)

    def clients(name):
        made = {service: node.create_client(t, f"{name}/{service}") for service, t in SERVICES.items()}
        for service, client in made.items():
            if not client.wait_for_service(arguments.seconds):
                sys.exit(f"no service {name}/{service} within {arguments.seconds} s")
        return made

    def call(client, request):
        future = client.call_async(request)
        executor.spin_until_future_complete(future, timeout_sec=arguments.seconds)
        if future.result() is None:
            sys.exit(f"{client.srv_name} did not answer within {arguments.seconds} s")
        return future.result()

    def graph(services):
        # Not get_transition_graph: its response exceeds a datagram of some networks, and is refused there.
        states = call(services["get_available_states"], GetAvailableStates.Request())
        found = call(services["get_available_transitions"], GetAvailableTransitions.Request())
        return {"states": [pair(s) for s in states.available_states], "steps": steps(found.available_transitions)}

    def graph_of_reference():
        services = clients("reference")
        request = ChangeState.Request()
        request.transition.label = "configure"
        call(services["change_state"], request)
        return graph(services)

    topic, type_name = arguments.output.split(":")
    package, _, name = type_name.split("/")
    came, events = [], []
    node.create_subscription(
        getattr(importlib.import_module(f"{package}.msg"), name), topic, came.append, qos_profile_sensor_data
    )
    node.create_subscription(TransitionEvent, f"{arguments.node}/transition_event", events.append, 10)
    camera = node.create_publisher(Image, "/camera/image_raw", 10)

    def picture():
        image = Image(height=64, width=64, encoding="rgb8", step=192, data=bytes(64 * 192))
        image.header.stamp = node.get_clock().now().to_msg()
        image.header.frame_id = "camera_optical_frame"
        camera.publish(image)

    node.create_timer(0.05, picture)
    services = clients(arguments.node)
    while node.count_publishers(f"{arguments.node}/transition_event") == 0:
        executor.spin_once(timeout_sec=0.1)

    def spin(seconds, is_enough=lambda: False):
        end = time.monotonic() + seconds
        while time.monotonic() < end and not is_enough():
            executor.spin_once(timeout_sec=0.05)

    spin(0.5)  # the reader of the events has to meet its writer, which no count shows
    made = []
    for label in arguments.transitions:
        request = ChangeState.Request()
        request.transition.label = label
        step = {"asked": label, "success": call(services["change_state"], request).success}
        if label != "shutdown":
            state = call(services["get_state"], GetState.Request()).current_state
            available = call(services["get_available_transitions"], GetAvailableTransitions.Request())
            step["state"] = state.label
            step["available"] = [t.transition.label for t in available.available_transitions]
            spin(0.3)  # what was under way before the transition
            came.clear()
            if state.label == "active":
                spin(arguments.seconds, lambda: len(came) >= 3)
            else:
                spin(1.0)
            step["messages"] = len(came)
        if label == "configure":
            described = graph(services)
        made.append(step)
    spin(1.0)
    json.dump(
        {
            "made": made,
            "events": [[pair(e.start_state), pair(e.goal_state), e.transition.label] for e in events],
            "of_node": described,
            "of_rclpy": graph_of_reference(),
        },
        sys.stdout,
    )
    print(flush=True)
    executor.shutdown()
    reference.destroy_node()
    node.destroy_node()
    rclpy.shutdown()


main()
