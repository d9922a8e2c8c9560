#!/usr/bin/env python3
"""An environment of gymnasium as a camera and an arm in ROS 2, with the topics and services of `wm sim_arm`.

usage: gym_node.py WORLD [--drive expert|random|mixed] [--episodes N] [--steps N] [--space FILE] [--ros-args ...]

WORLD is metaworld:TASK (such as metaworld:reach-v3), pusht, or gym:ENVIRONMENT, the name of any registered environment with
a Box of actions and pictures. Every 0.2 s the node does what /wm/command/twist, velocity, action and gripper asked for, and
publishes camera, action, pose, gripper and task. Without --drive it stands still until commands arrive. With --drive it runs
--episodes episodes of at most --steps frames itself: expert (of Meta-World), random motions, or mixed, from the one to the
other by episode. --space writes the action space for `wm train` and the executor.
"""

import argparse
import json
import math
import sys
import time
from collections import Counter

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped, TwistStamped
from rcl_interfaces.msg import SetParametersResult
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rclpy.utilities import remove_ros_args
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image
from std_msgs.msg import Bool, Float64, Float64MultiArray, String
from wm_msgs.msg import Action
from wm_msgs.srv import Reset
from worlds import STEP_S, RawWorld, State, WorldError, open_world

STEP_NS = round(STEP_S * 1e9)
AFTER = 3  # frames of an episode after its task is done
PAUSE = 3  # steps without frames between two episodes, so that `wm dataset` cuts there
RANDOM_SPEED = 0.15  # standard deviation of random motions [m/s]
KEPT = 0.8  # share of a random motion that the next one keeps


class Commands:
    """The commands of the arm, by the time of arrival [ns].

    A velocity holds for `timeout_s`. The motions of actions that arrive within a step add up, and are done once. Of raw
    actions the newest is done, once.
    """

    def __init__(self, timeout_s, frame):
        self.timeout_ns, self.frame = round(timeout_s * 1e9), frame
        self.forget()

    def forget(self):
        self.velocity, self.since_ns, self.opening = np.zeros(3), None, 1.0
        self.motion, self.raw = np.zeros(3), None

    def _take(self, velocity, now_ns):
        velocity = np.asarray(velocity, dtype=np.float64)
        if not np.isfinite(velocity).all():
            raise WorldError(f"not_finite: expected finite values, found {velocity.tolist()}")
        self.velocity, self.since_ns = velocity, now_ns

    def _expect_frame(self, frame):
        if self.frame and frame and frame != self.frame:
            raise WorldError(f"wrong_frame: expected a command in {self.frame!r}, found {frame!r}")

    def twist(self, message, now_ns):
        self._expect_frame(message.header.frame_id)
        linear = message.twist.linear
        self._take([linear.x, linear.y, linear.z], now_ns)

    def velocities(self, message, now_ns):
        if len(message.data) != 6:
            raise WorldError(f"wrong_length: expected vx, vy, vz, wx, wy, wz, found {len(message.data)} values")
        self._take(message.data[:3], now_ns)

    def action(self, message, space):
        """An action of the world's action space."""
        self._expect_frame(message.header.frame_id)
        names = [value["name"] for value in space["dimensions"]]
        values = np.asarray(message.values, dtype=np.float64)
        if values.shape != (len(names),):
            raise WorldError(f"wrong_length: expected {', '.join(names)}, found {values.size} values")
        if not np.isfinite(values).all():
            raise WorldError(f"not_finite: expected finite values, found {values.tolist()}")
        if names[:3] == ["dx", "dy", "dz"]:
            self.motion = self.motion + values[:3]
            if "gripper" in names:
                self.opening = min(max(float(values[names.index("gripper")]), 0.0), 1.0)
        else:
            self.raw = values

    def gripper(self, message):
        if not math.isfinite(message.data):
            raise WorldError(f"not_finite: expected an opening from 0 to 1, found {message.data}")
        self.opening = min(max(message.data, 0.0), 1.0)

    def take_step(self, now_ns):
        """The velocity [m/s], the opening and the raw action (None: no motion) of the step that ends now."""
        holds = self.since_ns is not None and now_ns - self.since_ns <= self.timeout_ns
        velocity = (self.velocity if holds else np.zeros(3)) + self.motion / STEP_S
        raw = self.raw
        self.motion, self.raw = np.zeros(3), None
        return velocity, self.opening, raw


class Drive:
    """Chooses the motions of an episode: the expert's, random ones, or both."""

    def __init__(self, kind):
        self.kind = kind

    def begin(self, episode, seed):
        self.random, self.velocity, self.opening = np.random.default_rng(seed), np.zeros(3), 1.0
        # mixed: from an undisturbed expert to one that mostly moves at random; every fifth episode is random alone
        self.noise = (episode % 10) / 10.0 if self.kind == "mixed" else 0.0
        self.is_random = self.kind == "random" or (self.kind == "mixed" and episode % 5 == 4)

    def step(self, world):
        fresh = self.random.normal(0.0, RANDOM_SPEED, 3)
        self.velocity = KEPT * self.velocity + math.sqrt(1.0 - KEPT**2) * fresh
        if isinstance(world, RawWorld):
            if self.kind != "random":
                raise WorldError(f"a world of the kind gym has no expert: use --drive random, not {self.kind}")
            return world.raw_step(self.random.uniform(world.low, world.high))
        if self.is_random:
            if self.random.random() < 0.1:
                self.opening = float(self.random.integers(2))
            return world.step(self.velocity, self.opening)
        return world.expert_step(self.noise * self.velocity)


def write_space(path, space):
    """Writes the action space to a new file. Raises `WorldError` if the file has another one."""
    text = json.dumps(space, indent=1)
    try:
        with open(path, "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError as error:
        with open(path, encoding="utf-8") as file:
            if file.read() != text:
                raise WorldError(f"{path} exists, with other contents: name another file") from error


class GymNode(Node):
    def __init__(self, arguments):
        super().__init__("gym", namespace="wm")
        self.arguments, self.counts, self.reported = arguments, Counter(), 0
        kind, _, task = arguments.world.partition(":")
        self.kind = kind
        self.declare_parameter("task", task)
        self.declare_parameter("seed", 0)
        self.frame = self.declare_parameter("base_frame", "base_link").value
        self.factor = float(self.declare_parameter("real_time_factor", 1.0).value)
        timeout_s = float(self.declare_parameter("command_timeout", 0.5).value)
        if self.factor < 0.0 or (self.factor == 0.0 and not arguments.drive):
            raise WorldError(f"expected a real_time_factor above 0 (0 only with --drive), found {self.factor}")
        self.worlds = {arguments.world: open_world(arguments.world)}
        self.name, self.last, self.shown_ns = arguments.world, None, None
        self.commands, self.drive = Commands(timeout_s, self.frame), Drive(arguments.drive)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.pictures = self.create_publisher(Image, "/camera/image_raw", 10)
        self.actions = self.create_publisher(Action, "action", 10)
        self.poses = self.create_publisher(PoseStamped, "ee_pose", 10)
        self.grippers = self.create_publisher(Float64, "gripper", 10)
        self.distances = self.create_publisher(Float64, "~/distance", 10)
        self.goals = self.create_publisher(Image, "goal/image", latched)
        self.instructions = self.create_publisher(String, "/task/instruction", latched)
        self.successes = self.create_publisher(Bool, "/task/success", latched)
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.clocks = self.create_publisher(Clock, "/clock", 1) if self.factor != 1.0 else None
        commands = self.commands
        self.create_subscription(TwistStamped, "command/twist", self.taking(commands.twist), newest)
        self.create_subscription(Float64MultiArray, "command/velocity", self.taking(commands.velocities), newest)
        take_action = self.taking(lambda message, _: commands.action(message, self.world.space))
        self.create_subscription(Action, "command/action", take_action, 100)
        self.create_subscription(Float64, "command/gripper", self.taking(lambda message, _: commands.gripper(message)), 10)
        self.create_service(Reset, "~/reset", self.answer)
        self.add_on_set_parameters_callback(self.check)
        self.now_ns = self.get_clock().now().nanoseconds
        self.create_timer(1.0, self.report)
        if arguments.space:
            write_space(arguments.space, self.world.space)

    @property
    def world(self):
        return self.worlds[self.name]

    def taking(self, take):
        """A callback that counts and logs what `take` refuses."""

        def callback(message):
            try:
                take(message, self.now_ns if self.clocks else self.get_clock().now().nanoseconds)
            except WorldError as refused:
                reason = str(refused).partition(":")[0]
                self.counts[f"dropped: {reason}"] += 1
                self.get_logger().warning(str(refused), throttle_duration_sec=5.0)

        return callback

    def world_of(self, task):
        return f"{self.kind}:{task}" if task else self.kind

    def check(self, parameters):
        for parameter in parameters:
            if parameter.name == "task":
                name = self.world_of(parameter.value)
                try:
                    if name not in self.worlds:
                        self.worlds[name] = open_world(name)
                except Exception as error:  # gymnasium raises errors of many kinds
                    return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def answer(self, request, response):
        seed = self.get_parameter("seed").value if request.keep_seed else request.seed
        try:
            self.name = self.world_of(self.get_parameter("task").value)
            self.begin(int(seed))
            response.success, response.message = True, self.world.instruction
        except (WorldError, ValueError) as refused:
            response.success, response.message = False, str(refused)
        return response

    def begin(self, seed):
        """Begins the task anew, and announces it."""
        self.commands.forget()
        self.last, self.shown_ns = self.world.reset(seed), None
        goal = self.world.goal_picture()
        if goal is not None:
            self.goals.publish(self.image(goal))
        self.instructions.publish(String(data=self.world.instruction))
        if not self.arguments.drive:
            self.successes.publish(Bool(data=False))
        self.get_logger().info(f"{self.name} with seed {seed}: {self.world.instruction}")

    def stamp(self, header, at_ns):
        header.stamp = Time(nanoseconds=at_ns).to_msg()
        header.frame_id = self.frame

    def image(self, pixels):
        image = Image(height=pixels.shape[0], width=pixels.shape[1], encoding="rgb8", step=3 * pixels.shape[1])
        self.stamp(image.header, self.now_ns)
        image.header.frame_id = "camera"
        image.data = pixels.tobytes()
        return image

    def show(self, state: State):
        self.shown_ns = self.now_ns
        self.pictures.publish(self.image(state.picture))
        if state.position is not None:
            pose = PoseStamped()
            self.stamp(pose.header, self.now_ns)
            place = pose.pose.position
            place.x, place.y, place.z = map(float, state.position)
            pose.pose.orientation.w = 1.0
            self.poses.publish(pose)
        if state.opening is not None:
            self.grippers.publish(Float64(data=state.opening))
        if math.isfinite(state.distance):
            self.distances.publish(Float64(data=state.distance))

    def publish_action(self, before, state, raw):
        """Publishes the action from the last picture to this one, with the stamp of the last picture.

        After a reset there is none: no picture shows where the action began.
        """
        if self.shown_ns is None:
            return
        if before.position is None:
            values = raw
        else:
            values = list(state.position - before.position)
            values += [state.commanded] if state.opening is not None else []
        if values is not None:
            action = Action(values=np.asarray(values, dtype=np.float32))
            self.stamp(action.header, self.shown_ns)
            self.actions.publish(action)

    def step(self):
        """One step of the world, from the last picture to one at the present stamp."""
        before = self.last
        raw = None
        if self.arguments.drive:
            state = self.drive.step(self.world)
        else:
            velocity, opening, raw = self.commands.take_step(self.now_ns)
            if not isinstance(self.world, RawWorld):
                state = self.world.step(velocity, opening)
            elif raw is None:
                state = self.world.state()
            else:
                state = self.world.raw_step(raw)
        self.publish_action(before, state, raw)
        self.show(state)
        if state.is_done != before.is_done and not self.arguments.drive:
            self.successes.publish(Bool(data=state.is_done))
            if state.is_done:
                self.get_logger().info("the task is done")
        self.last = state

    def wait(self):
        """Waits for the next step while commands and calls are taken. Steps that were missed are skipped."""
        if self.clocks:
            due = time.monotonic() + (STEP_S / self.factor if self.factor else 0.0)
            self.now_ns += STEP_NS
            while True:
                rclpy.spin_once(self, timeout_sec=max(due - time.monotonic(), 0.0))
                if time.monotonic() >= due:
                    break
            self.clocks.publish(Clock(clock=Time(nanoseconds=self.now_ns).to_msg()))
            return
        due_ns, now_ns = self.now_ns + STEP_NS, self.get_clock().now().nanoseconds
        if now_ns - due_ns > STEP_NS:
            missed = (now_ns - due_ns) // STEP_NS
            self.counts["dropped: late_step"] += missed
            due_ns += missed * STEP_NS
        while (left_ns := due_ns - self.get_clock().now().nanoseconds) > 0:
            rclpy.spin_once(self, timeout_sec=left_ns / 1e9)
        self.now_ns = due_ns

    def run(self):
        first = self.get_parameter("seed").value
        if not self.arguments.drive:
            self.begin(first)
            self.show(self.last)
            while rclpy.ok():
                self.wait()
                self.step()
            return
        done = 0
        for episode in range(self.arguments.episodes):
            self.begin(first + episode)
            self.drive.begin(episode, first + episode)
            self.show(self.last)
            left = self.arguments.steps
            while left > 0 and rclpy.ok():
                self.wait()
                self.step()
                left = min(left - 1, AFTER) if self.last.is_done else left - 1
            done += self.last.is_done
            self.successes.publish(Bool(data=self.last.is_done))  # once, as the outcome of the episode
            for _ in range(PAUSE):
                self.wait()
        self.get_logger().info(f"the task was done in {done} of {self.arguments.episodes} episodes")

    def report(self):
        drops = {name: count for name, count in self.counts.items() if name.startswith("dropped")}
        status = DiagnosticStatus(name=self.get_name(), level=DiagnosticStatus.OK, message="running")
        if sum(drops.values()) > self.reported:
            status.level, status.message = DiagnosticStatus.WARN, ", ".join(drops)
        self.reported = sum(drops.values())
        status.values = [KeyValue(key=f"{name} [total]", value=str(count)) for name, count in drops.items()]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.get_clock().now().to_msg()
        self.diagnostics.publish(array)


def main():
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("world")
    options.add_argument("--drive", choices=("expert", "random", "mixed"))
    options.add_argument("--episodes", type=int, default=1)
    options.add_argument("--steps", type=int, default=50)
    options.add_argument("--space", metavar="FILE")
    arguments = options.parse_args(remove_ros_args()[1:])
    rclpy.init()
    try:
        node = GymNode(arguments)
        node.run()
    except (WorldError, ModuleNotFoundError) as error:
        sys.exit(f"gym_node: {error}")
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
