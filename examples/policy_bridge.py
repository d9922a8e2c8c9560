"""The common part of openpi_policy.py and lerobot_policy.py: a node between a policy server and /wm/action_chunk.

For each picture of the first camera, the node sends the newest pictures, the robot's state and the instruction to the
server. It publishes the answer with the picture's stamp. Inputs that are missing or old, and answers that are malformed
or late, are dropped. /diagnostics counts the drops by reason.
"""

import argparse
import io
import re
import threading
import time
from collections import Counter
from dataclasses import dataclass
from functools import partial

import numpy as np
import rclpy
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import PoseStamped
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rclpy.utilities import remove_ros_args
from sensor_msgs.msg import CompressedImage, Image, JointState
from std_msgs.msg import Float64, String
from wm_msgs.msg import Action, ActionChunk

MOST_ACTIONS = 1024  # per chunk: the nodes refuse longer chunks
LATEST_NS = 2**31 * 10**9  # the seconds of a stamp have 31 bits
AHEAD_S = 0.1  # clocks of synchronised machines differ by less
RETRY_S = 1.0  # pause before the next connection after an error of the server
NUMBER = r"-?\d*\.?\d+(?:[eE][-+]?\d+)?"
# By encoding of sensor_msgs/Image: bytes per pixel, and the places of red, green and blue.
CHANNELS = {
    "rgb8": (3, [0, 1, 2]), "bgr8": (3, [2, 1, 0]), "mono8": (1, [0, 0, 0]),
    "rgba8": (4, [0, 1, 2]), "bgra8": (4, [2, 1, 0]),
}  # fmt: skip


class Refusal(Exception):
    """Why a picture gets no chunk; `reason` is the name of the counter."""

    def __init__(self, reason, text):
        super().__init__(text)
        self.reason = reason


class Values:
    """Names of values in order, with their conversion: "x,y*0.001,gripper*-1+1" is NAME[*SCALE][+OFFSET],..."""

    def __init__(self, text):
        pattern = rf"\s*([^*+,\s]+)(?:\*({NUMBER}))?(?:\+({NUMBER}))?\s*"
        parts = [re.fullmatch(pattern, part) for part in text.split(",")]
        if None in parts:
            raise argparse.ArgumentTypeError(f"expected NAME[*SCALE][+OFFSET],..., found {text!r}")
        self.names = [part[1] for part in parts]
        self.scale = np.array([float(part[2] or 1.0) for part in parts])
        self.offset = np.array([float(part[3] or 0.0) for part in parts])

    def convert(self, values):
        return values * self.scale + self.offset


@dataclass
class Observation:
    pictures: dict  # by key: RGB, uint8 [height, width, 3]
    states: dict  # by key: float32 [number of names]
    instruction: str


def stamp_of(message):
    """The stamp in nanoseconds. Raises `Refusal` if it is zero, negative or malformed."""
    stamp = message.header.stamp
    if stamp.nanosec >= 10**9 or stamp.sec < 0 or stamp.sec == stamp.nanosec == 0:
        raise Refusal("bad_stamp", f"expected a time after 1970, found {stamp.sec} s and {stamp.nanosec} ns")
    return stamp.sec * 10**9 + stamp.nanosec


def picture(image):
    """The pixels of a sensor_msgs Image or CompressedImage: RGB, uint8 [height, width, 3].

    Raises `Refusal` if the picture is damaged, or of an unknown encoding.
    """
    if isinstance(image, CompressedImage):
        from PIL import Image as Pillow

        try:
            return np.asarray(Pillow.open(io.BytesIO(bytes(image.data))).convert("RGB"))
        except Exception as error:  # pillow's decoders raise errors of many kinds
            raise Refusal("bad_image", f"a picture that pillow cannot decode: {error}") from error
    if image.encoding not in CHANNELS:
        raise Refusal("bad_image", f"expected a picture in {', '.join(CHANNELS)}, found {image.encoding!r}")
    size, places = CHANNELS[image.encoding]
    data, row = np.frombuffer(image.data, np.uint8), image.width * size
    if not row or image.step < row or data.size != image.height * image.step or not data.size:
        shape = f"{image.width}x{image.height} with step {image.step}"
        raise Refusal("bad_image", f"expected {image.height * image.step} bytes ({shape}), found {data.size}")
    pixels = data.reshape(image.height, image.step)[:, :row].reshape(image.height, image.width, size)
    return np.ascontiguousarray(pixels[..., places])


def checked(answer, values, most=MOST_ACTIONS):
    """The first `most` actions of a server's answer, converted by `values`: float32 [actions, values].

    Raises `Refusal` if they are not finite numbers of that shape.
    """
    try:
        actions = np.asarray(answer, dtype=np.float64)
    except Exception as error:  # numpy raises errors of many kinds
        raise Refusal("shape", f"expected numbers, found {type(answer).__name__}: {error}") from error
    count = len(values.names)
    if actions.ndim != 2 or actions.shape[1] != count or not 1 <= len(actions) <= MOST_ACTIONS:
        expected = f"[1 to {MOST_ACTIONS}, {count}] ({', '.join(values.names)})"
        raise Refusal("shape", f"expected actions of shape {expected}, found {list(actions.shape)}")
    with np.errstate(over="ignore", invalid="ignore"):  # found by the next check
        actions = values.convert(actions[:most]).astype(np.float32)
    if not np.isfinite(actions).all():
        raise Refusal("not_finite", f"expected finite actions, found {actions[~np.isfinite(actions).all(axis=1)][0]}")
    return actions


def pair(text):
    key, equals, value = text.partition("=")
    if not (key and equals and value):
        raise argparse.ArgumentTypeError(f"expected KEY=..., found {text!r}")
    return key, value


def state(text):
    key, values = pair(text)
    return key, Values(values)


def number(kind, least):
    def parse(text):
        value = kind(text)
        if not least <= value < float("inf"):
            raise argparse.ArgumentTypeError(f"expected a number of at least {least}, found {text}")
        return value

    return parse


def parser(about, server, image):
    """The common arguments; `image` is the default of --image."""
    options = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    add = options.add_argument
    add("--server", default=server, help="address (%(default)s)")
    add("--rate", type=number(float, 0.001), required=True, help="actions per second, as in the policy's training")
    add("--image", type=pair, action="append", metavar="KEY=TOPIC", help=f"a camera; again for others ({image})")
    add("--state", type=state, action="append", default=[], metavar="KEY=VALUES", help="joints, pose or gripper")
    add("--action", type=Values, default=Values("dx,dy,dz,droll,dpitch,dyaw,gripper"), metavar="VALUES",
        help="the values of an action (those of Bridge V2)")  # fmt: skip
    add("--actions", type=number(int, 1), default=MOST_ACTIONS, help="publish at most so many of each answer")
    add("--frame", default="base_link", help="frame of the actions (%(default)s)")
    add("--instruction", default="", help="in place of /task/instruction")
    add("--max-age", type=number(float, 0.0), default=1.0,
        help="greatest age of pictures and states [s] (%(default)s); 0: any, for wm env, whose time waits")  # fmt: skip
    options.set_defaults(default_image=image)
    return options


def parse(options):
    arguments = options.parse_args(remove_ros_args()[1:])
    arguments.image = dict(arguments.image or [pair(arguments.default_image)])
    arguments.state = dict(arguments.state)
    return arguments


class Bridge(Node):
    """`connect(observation)` returns a function from an observation to actions [actions, values]."""

    def __init__(self, name, arguments, connect):
        super().__init__(name)
        self.arguments, self.connect, self.infer = arguments, connect, None
        self.pictures, self.measured, self.instruction = {}, {}, arguments.instruction
        self.arrived, self.is_fresh, self.answered, self.busy_since = threading.Condition(), False, None, None
        self.counts, self.last_drop, self.logged, self.reported = Counter(), "", None, 0
        self.failure = None
        self.wanted = {name for values in arguments.state.values() for name in values.names}
        self.chunks = self.create_publisher(ActionChunk, "/wm/action_chunk", 10)
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for key, topic in arguments.image.items():
            kind = CompressedImage if topic.endswith("/compressed") else Image
            self.create_subscription(kind, topic, partial(self.see, key), newest)
        self.create_subscription(JointState, "/wm/joint_states", self.measure_joints, newest)
        self.create_subscription(PoseStamped, "/wm/ee_pose", self.measure_pose, newest)
        self.create_subscription(Float64, "/wm/gripper", self.measure_gripper, newest)
        self.create_subscription(String, "/task/instruction", self.instruct, latched)
        self.create_timer(1.0, self.report)

    def now(self):
        return self.get_clock().now()

    def see(self, key, image):
        with self.arrived:
            self.pictures[key] = image, self.now()
            if key == next(iter(self.arguments.image)):
                self.counts["skipped: pace"] += self.is_fresh
                self.is_fresh = True
                self.arrived.notify()

    def measure(self, names, values):
        now = self.now().nanoseconds
        self.measured.update((name, (value, now)) for name, value in zip(names, values) if name in self.wanted)

    def measure_joints(self, joints):
        self.measure(joints.name, joints.position)

    def measure_pose(self, pose):
        """x, y, z [m] and the rotation vector rx, ry, rz [rad] of the end effector."""
        place, turn = pose.pose.position, pose.pose.orientation
        sine = np.array([turn.x, turn.y, turn.z]) * (-1.0 if turn.w < 0.0 else 1.0)
        length = np.linalg.norm(sine)
        axis = sine * (2.0 * np.arctan2(length, abs(turn.w)) / length) if length > 0.0 else sine
        self.measure(("x", "y", "z", "rx", "ry", "rz"), (place.x, place.y, place.z, *axis))

    def measure_gripper(self, opening):
        self.measure(("gripper",), (opening.data,))

    def instruct(self, text):
        self.instruction = self.arguments.instruction or text.data

    def expect_recent(self, reason, name, time_ns):
        """Refuses an input of another time; 0 as --max-age accepts every time."""
        age, most = (self.now().nanoseconds - time_ns) / 1e9, self.arguments.max_age
        if most and not -AHEAD_S <= age <= most:
            raise Refusal(reason, f"{name}: expected an age of {-AHEAD_S} to {most} s, found {age:.3f} s")

    def state(self, values):
        for name in values.names:
            if name not in self.measured:
                raise Refusal("no_state", f"no {name!r} on /wm/joint_states, /wm/ee_pose or /wm/gripper")
            self.expect_recent("old_state", name, self.measured[name][1])
        state = values.convert(np.array([self.measured[name][0] for name in values.names])).astype(np.float32)
        if not np.isfinite(state).all():
            raise Refusal("bad_state", f"expected a finite state, found {dict(zip(values.names, state))}")
        return state

    def observe(self, images):
        for key, topic in self.arguments.image.items():
            if key not in images:
                raise Refusal("no_image", f"no picture on {topic}")
            self.expect_recent("old_image", topic, stamp_of(images[key][0]))
        instruction = self.instruction
        if not instruction:
            raise Refusal("no_instruction", "no instruction on /task/instruction: publish it, or use --instruction")
        states = {key: self.state(values) for key, values in self.arguments.state.items()}
        return Observation({key: picture(image) for key, (image, _) in images.items()}, states, instruction)

    def answer(self, images):
        """Publishes the server's chunk for these pictures, each with the time of its reception."""
        image, received = images[next(iter(self.arguments.image))]
        stamp_ns = stamp_of(image)
        if stamp_ns == self.answered:  # wm env repeats a picture until its answer arrives
            self.counts["skipped: duplicate"] += 1
            return
        observation, start = self.observe(images), self.now()
        try:
            self.infer = self.infer or self.connect(observation)
            answer = self.infer(observation)
        except Refusal:
            raise
        except Exception as error:  # every library has its own errors; the next picture gets a new connection
            self.infer = None
            text = " ".join(str(error).split())[:300]
            raise Refusal("server", f"{self.arguments.server}: {type(error).__name__}: {text}") from error
        actions, end = checked(answer, self.arguments.action, self.arguments.actions), self.now()
        period_ns = round(1e9 / self.arguments.rate)
        begins_ns = [stamp_ns + index * period_ns for index in range(len(actions) + 1)]
        if self.arguments.max_age and end.nanoseconds >= begins_ns[-1]:
            late_s = (end.nanoseconds - begins_ns[-1]) / 1e9
            raise Refusal("late", f"the chunk of {len(actions)} actions ended {late_s:.3f} s before its publication")
        if begins_ns[-1] >= LATEST_NS:
            raise Refusal("bad_stamp", f"the chunk ends at {begins_ns[-1]} ns, which is no stamp")
        if observation.instruction != self.instruction:
            raise Refusal("old_instruction", "the instruction changed during the inference")
        chunk = ActionChunk(period=Duration(sec=period_ns // 10**9, nanosec=period_ns % 10**9))
        chunk.header.stamp, chunk.header.frame_id = image.header.stamp, self.arguments.frame
        for begin_ns, values in zip(begins_ns, actions.tolist()):
            action = Action(values=values)
            action.header.stamp = Time(nanoseconds=begin_ns).to_msg()
            action.header.frame_id = self.arguments.frame
            chunk.actions.append(action)
        chunk.timing.capture, chunk.timing.receive = image.header.stamp, received.to_msg()
        chunk.timing.start, chunk.timing.end = start.to_msg(), end.to_msg()
        self.chunks.publish(chunk)
        self.answered, self.logged = stamp_ns, None
        self.counts["sent action_chunk"] += 1

    def work(self):
        """Answers pictures until the node ends. An error in this program ends the node."""
        try:
            while rclpy.ok():
                self.work_once()
        except Exception as error:
            if rclpy.ok():  # else publishing failed because the node ends
                self.failure = error
                rclpy.try_shutdown()

    def work_once(self):
        with self.arrived:
            self.arrived.wait_for(lambda: self.is_fresh)
            self.is_fresh, images = False, dict(self.pictures)
        self.busy_since, pause_s = time.monotonic(), 0.0
        try:
            self.answer(images)
        except Refusal as refusal:
            self.counts[f"dropped: {refusal.reason}"] += 1
            self.last_drop = f"{refusal.reason}: {refusal}"
            if refusal.reason != self.logged:  # once, until a chunk is published
                self.get_logger().warn(self.last_drop)
            self.logged = refusal.reason
            pause_s = RETRY_S if refusal.reason == "server" else 0.0
        self.busy_since = None
        time.sleep(pause_s)

    def report(self):
        counts = dict(self.counts)  # the other thread may add one
        drops = sum(count for name, count in counts.items() if name.startswith("dropped"))
        status = DiagnosticStatus(name=self.get_name(), level=DiagnosticStatus.OK, message="running")
        if drops > self.reported:
            status.level, status.message = DiagnosticStatus.WARN, self.last_drop
        busy_since = self.busy_since
        if busy_since is not None and (busy_s := time.monotonic() - busy_since) > 1.0:
            status.level, status.message = DiagnosticStatus.WARN, f"no answer of the server for {busy_s:.0f} s"
        self.reported = drops
        status.values = [KeyValue(key=f"{name} [total]", value=str(count)) for name, count in sorted(counts.items())]
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.now().to_msg()
        self.diagnostics.publish(array)


def run(name, arguments, connect):
    """Runs the node until a signal. A server that never answers does not delay the end."""
    rclpy.init()
    bridge = Bridge(name, arguments, connect)
    threading.Thread(target=bridge.work, daemon=True).start()
    try:
        rclpy.spin(bridge)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except Exception:
        if rclpy.ok():  # else a publication failed because the node ends
            raise
    rclpy.try_shutdown()
    if bridge.failure:
        raise bridge.failure
