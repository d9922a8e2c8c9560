"""Plays episodes of the env through its services with a real rclpy, side by side; prints JSON.

usage: env_services.py --seconds LIMIT --bag BAG --steps N EPISODE ...

All calls of a round are under way together. The answer: what each reset said, and of each episode the SHA-256 of its
images in order, the stamps, what the last call said, and how long the rounds took.
"""

import argparse
import hashlib
import json
import sys
import time

import rclpy
from wm_msgs.msg import Action, EnvObservation
from wm_msgs.srv import EnvReset, EnvStep


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--bag", required=True)
    parser.add_argument("--steps", type=int, required=True)
    parser.add_argument("episodes", nargs="+")
    arguments = parser.parse_args()

    rclpy.init()
    node = rclpy.create_node("env_services")
    reset = node.create_client(EnvReset, "/wm/env/reset")
    step = node.create_client(EnvStep, "/wm/env/step")
    images = {name: [] for name in arguments.episodes}

    def see(observation):
        seen = images[observation.episode_id]
        if observation.step != len(seen):
            sys.exit(f"{observation.episode_id}: step {observation.step} after {len(seen) - 1}")
        seen.append(observation.image)

    node.create_subscription(EnvObservation, "/wm/env/observation", see, 64)
    for client in (reset, step):
        if not client.wait_for_service(arguments.seconds):
            sys.exit(f"no service {client.srv_name} within {arguments.seconds} s")
    while node.count_publishers("/wm/env/observation") == 0:
        rclpy.spin_once(node, timeout_sec=0.1)
    time.sleep(0.5)  # the reader has to meet its writer, which no count shows

    def call(client, requests):
        futures = [client.call_async(request) for request in requests]
        for future in futures:
            rclpy.spin_until_future_complete(node, future, timeout_sec=arguments.seconds)
            if future.result() is None:
                sys.exit(f"{client.srv_name} did not answer within {arguments.seconds} s")
        return [future.result() for future in futures]

    def wait_for(step):
        end = time.monotonic() + arguments.seconds
        while any(len(seen) <= step for seen in images.values()):
            if time.monotonic() > end:
                sys.exit(f"no observation of step {step} within {arguments.seconds} s")
            rclpy.spin_once(node, timeout_sec=0.2)

    def nanoseconds(stamp):
        return stamp.sec * 1_000_000_000 + stamp.nanosec

    begun = call(
        reset,
        [EnvReset.Request(episode_id=name, bag=arguments.bag, bag_offset=1.0, seed=3) for name in arguments.episodes],
    )
    wait_for(0)
    started = time.monotonic()
    for index in range(arguments.steps):
        action = Action(values=[0.01 if index % 4 < 2 else -0.01, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
        action.header.frame_id = "base_link"
        answers = call(step, [EnvStep.Request(episode_id=name, actions=[action]) for name in arguments.episodes])
        for name, answer in zip(arguments.episodes, answers):
            if not answer.success:
                sys.exit(f"{name}: {answer.message}")
        wait_for(index + 1)
    taken = time.monotonic() - started
    refused = call(step, [EnvStep.Request(episode_id="nobody", actions=[Action(values=[0.0] * 7)])])[0]
    outcome = EnvStep.Request.SUCCESS
    closed = call(step, [EnvStep.Request(episode_id=name, close=True, outcome=outcome) for name in arguments.episodes])
    json.dump(
        {
            "begun": [
                {
                    "success": answer.success,
                    "episode_id": answer.episode_id,
                    "instruction": answer.instruction,
                    "actions_per_step": answer.actions_per_step,
                    "step_period": nanoseconds(answer.step_period),
                }
                for answer in begun
            ],
            "images": {
                name: [hashlib.sha256(bytes(image.data)).hexdigest() for image in seen] for name, seen in images.items()
            },
            "stamps": {name: [nanoseconds(image.header.stamp) for image in seen] for name, seen in images.items()},
            "steps": [answer.steps for answer in closed],
            "bags": [answer.bag for answer in closed],
            "timing": [nanoseconds(getattr(answers[0].timing, key)) for key in ("capture", "receive", "start", "end")],
            "refused": [refused.success, refused.message],
            "seconds": taken,
        },
        sys.stdout,
    )
    print(flush=True)
    node.destroy_node()
    rclpy.shutdown()


main()
