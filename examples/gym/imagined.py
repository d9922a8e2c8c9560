"""The imagined environment, `wm env`, with gymnasium's interface, for libraries of reinforcement learning and planning.

    wm env --ros-args -p bag:=bags/tabletop -p episodes:=0      # in another terminal

    from imagined import ImaginedEnv
    env = ImaginedEnv(bag="bags/tabletop")
    image, info = env.reset(seed=1)                             # RGB, uint8 [height, width, 3]
    image, reward, terminated, truncated, info = env.step([0.01, 0, 0, 0, 0, 0, 1])

A step is one model step; the action is repeated at the camera's frame rate. The world model knows no reward and no end: pass
`reward(image, info)`, which returns the reward and whether the task is done.
"""

import io
import uuid

import gymnasium
import numpy as np
import rclpy
from PIL import Image
from rclpy.qos import QoSProfile
from wm_msgs.msg import Action, EnvObservation
from wm_msgs.srv import EnvReset, EnvStep

# Bridge V2's seven values: dx, dy, dz [m], droll, dpitch, dyaw [rad] in 0.2 s, and the gripper, 0 closed to 1 open
LOW = np.array([-0.05, -0.05, -0.05, -0.25, -0.25, -0.25, 0.0], np.float32)
HIGH = np.array([0.05, 0.05, 0.05, 0.25, 0.25, 0.25, 1.0], np.float32)


class ImaginedEnv(gymnasium.Env):
    """Episodes of `wm env`. Several environments may use one env; each has its own episodes.

    `bag`, `image` and `topic`: where episodes begin, at most one of them; `start` has further fields of EnvReset, such as
    bag_offset. `low` and `high` bound the values of an action. `size`: height and width of the model's pictures [px].
    Raises `RuntimeError` if the env refuses a call, and `TimeoutError` if it does not answer within `timeout` seconds.
    """

    metadata = {"render_modes": ["rgb_array"]}

    def __init__(self, bag="", image="", topic="", start=None, low=LOW, high=HIGH, size=(128, 128), reward=None, timeout=30.0):
        self.start = {"bag": bag, "image": image, "topic": topic, **(start or {})}
        self.reward, self.timeout, self.render_mode = reward, timeout, "rgb_array"
        self.action_space = gymnasium.spaces.Box(np.asarray(low, np.float32), np.asarray(high, np.float32))
        self.observation_space = gymnasium.spaces.Box(0, 255, (*size, 3), np.uint8)
        self.context = rclpy.Context()
        self.context.init()
        self.name = f"imagined_{uuid.uuid4().hex[:8]}"
        self.node = rclpy.create_node(self.name, namespace="wm", context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.observations = {}
        self.node.create_subscription(EnvObservation, "env/observation", self._observe, QoSProfile(depth=64))
        self.resets = self.node.create_client(EnvReset, "env/reset")
        self.steps = self.node.create_client(EnvStep, "env/step")
        self.episode, self.picture, self.count = None, None, 0

    def _observe(self, observation):
        if observation.episode_id == self.episode:
            self.observations[observation.step] = observation

    def _call(self, client, request):
        if not client.wait_for_service(self.timeout):
            raise TimeoutError(f"{client.srv_name}: no such service within {self.timeout} s; is `wm env` running?")
        future = client.call_async(request)
        self.executor.spin_until_future_complete(future, self.timeout)
        if not future.done():
            raise TimeoutError(f"{client.srv_name}: no answer within {self.timeout} s")
        if not future.result().success:
            raise RuntimeError(f"{client.srv_name}: {future.result().message}")
        return future.result()

    def _see(self, step):
        """The picture of a step, which arrives apart from the answer."""
        deadline = self.node.get_clock().now().nanoseconds + self.timeout * 1e9
        while step not in self.observations:
            if self.node.get_clock().now().nanoseconds > deadline:
                raise TimeoutError(f"env/observation: no picture of step {step} within {self.timeout} s")
            self.executor.spin_once(0.1)
        image = self.observations[step].image
        self.observations.clear()
        self.picture = np.asarray(Image.open(io.BytesIO(bytes(image.data))).convert("RGB"))
        if self.picture.shape != self.observation_space.shape:
            raise RuntimeError(f"expected pictures of {self.observation_space.shape}, found {self.picture.shape}: set size")
        return self.picture

    def _end(self):
        episode, self.episode = self.episode, None
        if episode is not None:
            self._call(self.steps, EnvStep.Request(episode_id=episode, close=True))

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self._end()
        self.count += 1
        # known before the call, so that no picture is missed
        self.episode = f"{self.name}_{self.count}"
        # an episode has its own noise, which the seed of the first reset decides
        noise = int(self.np_random.integers(1 << 63))
        request = EnvReset.Request(episode_id=self.episode, seed=noise, **{**self.start, **(options or {})})
        try:
            answer = self._call(self.resets, request)
        except Exception:
            self.episode = None
            raise
        self.held = max(answer.actions_per_step, 1)
        self.info = {"instruction": answer.instruction}
        return self._see(0), dict(self.info)

    def step(self, action):
        if self.episode is None:
            raise RuntimeError("expected a reset before the first step")
        values = np.asarray(action, dtype=np.float32)
        if values.shape != self.action_space.shape or not np.isfinite(values).all():
            raise ValueError(f"expected {self.action_space.shape[0]} finite values, found {values.tolist()}")
        actions = [Action(values=values.tolist()) for _ in range(self.held)]
        answer = self._call(self.steps, EnvStep.Request(episode_id=self.episode, actions=actions))
        picture = self._see(answer.steps)
        reward, is_done = self.reward(picture, self.info) if self.reward else (0.0, False)
        return picture, float(reward), bool(is_done), bool(answer.truncated), {**self.info, "steps": answer.steps}

    def render(self):
        return self.picture

    def close(self):
        if self.context.ok():
            self._end()
            self.executor.shutdown()
            self.node.destroy_node()
            self.context.shutdown()
