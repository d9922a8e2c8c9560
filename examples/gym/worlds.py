"""Environments of gymnasium as worlds with an arm: positions in m, velocities in m/s, openings of the gripper from 0 to 1.

A world computes without ROS. `MetaWorld` has an arm, goal pictures and an expert; `PushT` is a pusher in a plane, with goal
pictures. `RawWorld` takes and gives the raw actions of any environment whose action space is a Box; it has neither.
"""

from dataclasses import dataclass

import gymnasium
import numpy as np

STEP_S = 0.2  # a step of a world: a frame of the suite
SIZE = 128  # height and width of the pictures [px]


class WorldError(Exception):
    """An environment, or a value for it, that cannot be used."""


@dataclass
class State:
    picture: np.ndarray  # RGB, uint8 [SIZE, SIZE, 3]
    is_done: bool  # whether the task is done
    position: np.ndarray | None = None  # of the tool [m], shape [3]
    opening: float | None = None  # of the gripper, 0 closed to 1 open
    commanded: float = 1.0  # the opening that was commanded last
    distance: float = float("nan")  # to the goal [m]


def dimension(name, unit, kind, scale, clip=1.5):
    return {"name": name, "unit": unit, "kind": kind, "scale": scale, "clip": clip}


def hand_space(name, largest, with_gripper):
    """The action space of a tool that translates, at most `largest` [m] along an axis in a step."""
    dimensions = [dimension(axis, "m", "translation_delta", 1.0 / largest) for axis in ("dx", "dy", "dz")]
    if with_gripper:
        dimensions.append(dimension("gripper", "1", "gripper_continuous", 1.0, 1.0))
    return {"name": name, "rate": 1.0 / STEP_S, "dimensions": dimensions}


def square(pixels):
    """The middle of a picture, SIZE x SIZE."""
    from PIL import Image

    height, width = pixels.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    middle = Image.fromarray(np.ascontiguousarray(pixels[top : top + side, left : left + side, :3]))
    return np.asarray(middle if side == SIZE else middle.resize((SIZE, SIZE), Image.Resampling.BOX))


def finite(values, count):
    values = np.asarray(values, dtype=np.float64)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise WorldError(f"expected {count} finite values, found {values.tolist()}")
    return values


class MetaWorld:
    """A task of Meta-World (https://meta-world.github.io): an arm that translates and grips."""

    CAMERA = "corner2"
    LARGEST = 0.01  # motion of the tool's target along an axis in one simulated step [m]
    # A simulated step counts as 0.04 s instead of 0.0125 s: the tool then moves at most 0.25 m/s, the executor's limit.
    SUBSTEPS = 5

    def __init__(self, task):
        from metaworld.env_dict import ALL_V3_ENVIRONMENTS
        from metaworld.policies import ENV_POLICY_MAP

        if task not in ALL_V3_ENVIRONMENTS:
            raise WorldError(f"expected a task of Meta-World ({', '.join(sorted(ALL_V3_ENVIRONMENTS))}), found {task!r}")
        self.task, self.make, self.policy = task, ALL_V3_ENVIRONMENTS[task], ENV_POLICY_MAP[task]
        self.instruction = task.removesuffix("-v3").replace("-", " ")
        self.environment, self.expert = self._environment(), self.policy()
        self.space = hand_space("metaworld", self.SUBSTEPS * self.LARGEST, with_gripper=True)

    def _environment(self):
        environment = self.make(render_mode="rgb_array", camera_name=self.CAMERA, width=SIZE, height=SIZE)
        environment._partially_observable = False  # the expert sees the goal
        environment.__dict__.pop("sawyer_observation_space", None)  # cached, and without the goal
        environment._freeze_rand_vec = False  # objects and goal by the seed of reset
        environment._set_task_called = True
        environment.seeded_rand_vec = True
        environment.max_path_length = 1 << 40  # the node ends the episodes
        return environment

    def _begin(self, seed):
        import mujoco

        environment = self.environment
        mujoco.mj_resetData(environment.model, environment.data)  # nothing of the last episode is left
        environment.seed(seed)
        self.observation, self.info, self.commanded = environment.reset()[0], {}, 1.0

    def _advance(self, action):
        action = np.clip(action, -1.0, 1.0).astype(np.float32)
        self.observation, _, _, _, self.info = self.environment.step(action)

    def _solve(self, seed):
        """The picture of the task once the expert has done it; None if it fails."""
        self._begin(seed)
        for _ in range(500):
            self._advance(self.expert.get_action(self.observation))
            if self.info["success"]:
                return self._picture()
        return None

    def _picture(self):
        # of several environments, only the newest one's context of OpenGL is current
        self.environment.mujoco_renderer._get_viewer("rgb_array").make_context_current()
        return square(self.environment.render()[::-1])  # the camera is upside down

    def reset(self, seed):
        """Begins the task with objects and goal by `seed`."""
        self.goal = self._solve(seed)
        self._begin(seed)
        return self.state()

    def state(self):
        opening = float(np.clip(self.observation[3], 0.0, 1.0))
        is_done = bool(self.info.get("success", 0.0))
        distance = float(self.info.get("obj_to_target", "nan"))
        return State(self._picture(), is_done, self.observation[:3].copy(), opening, self.commanded, distance)

    def _motion(self, velocity):
        return finite(velocity, 3) * STEP_S / self.SUBSTEPS / self.LARGEST

    def step(self, velocity, opening):
        """Moves for STEP_S by `velocity` [m/s], with the gripper towards `opening`."""
        self.commanded = float(np.clip(finite([opening], 1)[0], 0.0, 1.0))
        action = np.append(self._motion(velocity), 1.0 - 2.0 * self.commanded)
        for _ in range(self.SUBSTEPS):
            self._advance(action)
        return self.state()

    def expert_step(self, disturbance):
        """Moves for STEP_S as the expert of Meta-World does, plus a velocity `disturbance` [m/s]."""
        disturbance = self._motion(disturbance)
        for _ in range(self.SUBSTEPS):
            action = np.clip(self.expert.get_action(self.observation), -1.0, 1.0)
            self.commanded = float(1.0 - action[3]) / 2.0
            action[:3] += disturbance
            self._advance(action)
        return self.state()

    def goal_picture(self):
        """What the expert reaches from this seed; None if it fails."""
        return self.goal

    def close(self):
        self.environment.close()


class PushT:
    """The environment gym-pusht: a disc pushes a T in a plane. One pixel of its 512 is a millimetre."""

    def __init__(self):
        import gym_pusht  # noqa: F401 registers the environment

        self.environment = gymnasium.make("gym_pusht/PushT-v0", render_mode="rgb_array", obs_type="state")
        self.environment = self.environment.unwrapped
        self.instruction = "push the T onto its place"
        self.substeps = round(STEP_S * self.environment.metadata["render_fps"])
        self.space = hand_space("pusht", 0.05, with_gripper=False)

    def reset(self, seed):
        self.observation, self.info = self.environment.reset(seed=seed)
        self.goal_pose = self.info["goal_pose"]
        return self.state()

    def state(self):
        place = np.array([self.observation[0], 512.0 - self.observation[1], 0.0]) / 1000.0
        is_done = bool(self.info.get("is_success", False))
        distance = 1.0 - float(self.info.get("coverage", 0.0))  # the uncovered share of the place, not a length
        return State(square(self.environment.render()), is_done, place, distance=distance)

    def step(self, velocity, opening):
        del opening
        motion = finite(velocity, 3)[:2] * [1000.0, -1000.0] * STEP_S / self.substeps
        target = np.array(self.observation[:2], dtype=np.float64)
        for _ in range(self.substeps):
            target = np.clip(target + motion, 0.0, 512.0)
            self.observation, _, _, _, self.info = self.environment.step(target)
        return self.state()

    def expert_step(self, disturbance):
        del disturbance
        raise WorldError("gym-pusht has no expert: use --drive random")

    def goal_picture(self):
        """The T on its place, and the disc below it."""
        other = type(self)()
        other.environment.reset(options={"reset_to_state": np.array([256.0, 480.0, *self.goal_pose])})
        # reset turns the T about another point than its place has
        other.environment.block.angle = float(self.goal_pose[2])
        other.environment.block.position = tuple(map(float, self.goal_pose[:2]))
        picture = square(other.environment.render())
        other.close()
        return picture

    def close(self):
        self.environment.close()


class RawWorld:
    """Any environment whose action space is a Box of up to 32 values and whose pictures are rgb_array."""

    MOST_VALUES = 32

    def __init__(self, name):
        self.environment = gymnasium.make(name, render_mode="rgb_array")
        box = self.environment.action_space
        if not isinstance(box, gymnasium.spaces.Box) or box.shape is None or len(box.shape) != 1:
            raise WorldError(f"{name}: expected an action space that is a Box of one axis, found {box}")
        if box.shape[0] > self.MOST_VALUES or not box.is_bounded():
            raise WorldError(f"{name}: expected at most {self.MOST_VALUES} bounded values of an action, found {box}")
        if (box.low >= box.high).any():
            raise WorldError(f"{name}: expected low bounds below the high ones, found {box}")
        self.low, self.high = box.low.astype(np.float64), box.high.astype(np.float64)
        self.instruction = name
        scales = (2.0 / (self.high - self.low)).tolist()
        values = [dimension(f"action_{index}", "1", "position", scale, 1.0) for index, scale in enumerate(scales)]
        for value, low, high in zip(values, self.low, self.high):
            value["offset"] = float(low + high) / 2.0
        self.space = {"name": name, "rate": 1.0 / STEP_S, "dimensions": values}

    def reset(self, seed):
        self.environment.reset(seed=seed)
        self.is_over, self.is_done = False, False
        return self.state()

    def state(self):
        return State(square(np.asarray(self.environment.render())), self.is_done)

    def raw_step(self, action):
        """One step of the environment. An episode that is over stays as it is until the next reset."""
        if not self.is_over:
            action = np.clip(finite(action, len(self.low)), self.low, self.high)
            dtype = self.environment.action_space.dtype
            _, _, terminated, truncated, info = self.environment.step(action.astype(dtype))
            self.is_over = terminated or truncated
            self.is_done = bool(info.get("success", info.get("is_success", False)))
        return self.state()

    def goal_picture(self):
        return None

    def close(self):
        self.environment.close()


def open_world(name):
    """The world of a name: metaworld:TASK, pusht, or gym:ENVIRONMENT."""
    kind, _, rest = name.partition(":")
    match kind:
        case "metaworld" if rest:
            return MetaWorld(rest)
        case "pusht" if not rest:
            return PushT()
        case "gym" if rest:
            return RawWorld(rest)
    raise WorldError(f"expected metaworld:TASK, pusht or gym:ENVIRONMENT, found {name!r}")
