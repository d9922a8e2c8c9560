"""A policy that looks before it acts. For each camera image it offers three candidate chunks and takes the one that is
predicted to end closest to the goal.

usage: python examples/choosing_policy.py [--goal IMAGE] [--images N]        (ROS 2 sourced, wm_msgs built)

It needs `wm encoder`, `wm evaluator` and a camera: the robot's, or `wm env`. Without --goal, publish the goal yourself.
It prints a line of JSON for each choice; one without costs was taken without a prediction.
"""

import argparse
import json
import pathlib

import rclpy
from builtin_interfaces.msg import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.time import Duration as Span
from rclpy.time import Time
from sensor_msgs.msg import CompressedImage
from wm_msgs.msg import Action, ActionCandidates, ActionChunk, Assessment

PERIOD = Duration(nanosec=200_000_000)  # time that one action takes; here that of a camera frame at 5 Hz
PREDICTED = 6  # actions per candidate: three model steps of the bundled model
TAKEN = 2  # actions taken of the best one before the next image: one model step
SIDEWAYS = [0.02, 0.0, -0.02]  # dy of each action [m]: left, none, right
PATIENCE = 10  # times that the env repeats an image before the policy moves without a prediction

parser = argparse.ArgumentParser()
parser.add_argument("--goal", type=pathlib.Path, help="JPEG or PNG of the scene at the goal")
parser.add_argument("--images", type=int, default=0, help="stop after this many different images; 0: never")
arguments = parser.parse_args()
rclpy.init()
node = rclpy.create_node("choosing_policy")
candidates = node.create_publisher(ActionCandidates, "/wm/action_candidates", 10)
actions = node.create_publisher(Action, "/wm/action", 10)
seen, answered = [], set()
asked = 0  # how often candidates were published for the newest image


def stamp_of(stamp):
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def chunk_of(image, sideways):
    chunk = ActionChunk(period=PERIOD)
    chunk.header.stamp, chunk.header.frame_id = image.header.stamp, "base_link"
    for index in range(PREDICTED):
        action = Action(values=[0.0, sideways, 0.0, 0.0, 0.0, 0.0, 1.0])  # dx dy dz droll dpitch dyaw open
        time = Time.from_msg(image.header.stamp) + Span(nanoseconds=index * PERIOD.nanosec)
        action.header.stamp, action.header.frame_id = time.to_msg(), "base_link"
        chunk.actions.append(action)
    return chunk


def take(image, index, costs):
    stamp = stamp_of(image.header.stamp)
    if stamp not in answered:
        print(json.dumps({"stamp": stamp, "costs": costs, "best": index}), flush=True)
    answered.add(stamp)
    for action in chunk_of(image, SIDEWAYS[index]).actions[:TAKEN]:
        actions.publish(action)


def see(image):
    global asked
    if not seen or stamp_of(image.header.stamp) > stamp_of(seen[-1].header.stamp):
        seen.append(image)
        asked = 0
    if len(seen) == 1:
        take(image, 1, [])  # a prediction needs two images and the action between them
    elif stamp_of(image.header.stamp) in answered:
        return
    elif asked == PATIENCE:
        take(image, 1, [])  # the encoder came too late for an image before this one: go on, it has this one
    else:
        # the env repeats an image until it is answered; the evaluator may not have been ready the first time
        asked += 1
        chunks = [chunk_of(image, sideways) for sideways in SIDEWAYS]
        candidates.publish(ActionCandidates(header=image.header, policy="choosing_policy", chunks=chunks))


def choose(assessment):
    stamp = stamp_of(assessment.candidates_stamp)
    if assessment.best < 0 or stamp in answered or stamp != stamp_of(seen[-1].header.stamp):
        return
    take(seen[-1], assessment.best, [candidate.cost for candidate in assessment.candidates])


if arguments.goal:
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    goals = node.create_publisher(CompressedImage, "/wm/goal/image/compressed", latched)
    kind = "png" if arguments.goal.suffix == ".png" else "jpeg"
    goals.publish(CompressedImage(format=kind, data=arguments.goal.read_bytes()))
node.create_subscription(CompressedImage, "/camera/image_raw/compressed", see, qos_profile_sensor_data)
node.create_subscription(Assessment, "/wm/assessment", choose, 10)
try:
    while rclpy.ok() and (arguments.images == 0 or len(seen) < arguments.images):
        rclpy.spin_once(node, timeout_sec=0.5)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
node.destroy_node()
rclpy.try_shutdown()
