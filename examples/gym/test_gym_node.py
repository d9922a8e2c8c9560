"""Tests of gym_node.py and worlds.py that need neither ROS topics nor Meta-World: python examples/gym/test_gym_node.py

ROS 2 is sourced, and gymnasium with pygame installed.
"""

import json
import os
import tempfile
import unittest

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")

import numpy as np
from geometry_msgs.msg import TwistStamped
from gym_node import STEP_S, Commands, Drive, write_space
from std_msgs.msg import Float64, Float64MultiArray
from wm_msgs.msg import Action
from worlds import SIZE, WorldError, hand_space, open_world, square

SPACE = hand_space("hand", 0.05, with_gripper=True)


def twist(x, frame="base_link"):
    message = TwistStamped()
    message.header.frame_id, message.twist.linear.x = frame, x
    return message


class TestCommands(unittest.TestCase):
    def setUp(self):
        self.commands = Commands(0.5, "base_link")

    def test_a_command_holds_until_its_timeout(self):
        self.commands.twist(twist(0.2), 0)
        np.testing.assert_array_equal(self.commands.take_step(500_000_000)[0], [0.2, 0.0, 0.0])
        np.testing.assert_array_equal(self.commands.take_step(500_000_001)[0], np.zeros(3))

    def test_the_motions_of_a_step_add_up_and_are_done_once(self):
        for _ in range(2):
            self.commands.action(Action(values=[0.01, 0.0, -0.02, 0.25]), SPACE)
        velocity, opening, _ = self.commands.take_step(1)
        np.testing.assert_allclose(velocity * STEP_S, [0.02, 0.0, -0.04], rtol=1e-6)
        self.assertEqual(opening, 0.25)
        np.testing.assert_array_equal(self.commands.take_step(2)[0], np.zeros(3))

    def test_a_raw_action_is_done_once(self):
        space = {"dimensions": [{"name": "action_0"}]}
        self.commands.action(Action(values=[1.5]), space)
        self.assertEqual(self.commands.take_step(1)[2], [1.5])
        self.assertIsNone(self.commands.take_step(2)[2])

    def test_bad_commands_change_nothing(self):
        self.commands.twist(twist(0.1), 0)
        bad = [
            ("wrong_frame", lambda: self.commands.twist(twist(0.3, "camera"), 1)),
            ("not_finite", lambda: self.commands.twist(twist(float("nan")), 1)),
            ("wrong_length", lambda: self.commands.velocities(Float64MultiArray(data=[0.1] * 5), 1)),
            ("wrong_length", lambda: self.commands.action(Action(values=[0.0] * 7), SPACE)),
            ("not_finite", lambda: self.commands.action(Action(values=[0.0, 0.0, 0.0, float("inf")]), SPACE)),
            ("not_finite", lambda: self.commands.gripper(Float64(data=float("nan")))),
        ]
        for reason, command in bad:
            with self.assertRaisesRegex(WorldError, f"^{reason}: "):
                command()
        velocity, opening, _ = self.commands.take_step(2)
        np.testing.assert_array_equal(velocity, [0.1, 0.0, 0.0])
        self.assertEqual(opening, 1.0)


class TestWorlds(unittest.TestCase):
    def test_unknown_worlds_are_refused(self):
        for name in ("", "pusht:x", "metaworld", "gym:", "gym:CartPole-v1"):
            with self.assertRaises(WorldError, msg=name):
                open_world(name)

    def test_an_environment_repeats_by_seed(self):
        world = open_world("gym:Pendulum-v1")
        json.dumps(world.space)
        runs = []
        for _ in range(2):
            first = world.reset(7).picture
            runs.append([first, *(world.raw_step([torque]).picture for torque in (2.0, 5.0, -1.0))])
        self.assertEqual(runs[0][0].shape, (SIZE, SIZE, 3))
        np.testing.assert_array_equal(runs[0], runs[1])
        self.assertTrue((runs[0][0] != runs[0][3]).any())
        with self.assertRaisesRegex(WorldError, "expected 1 finite values"):
            world.raw_step([0.0, 0.0])
        world.close()

    def test_pictures_are_the_middle_of_the_view(self):
        view = np.zeros((SIZE, 3 * SIZE, 3), np.uint8)
        view[:, SIZE : 2 * SIZE] = 200
        self.assertEqual(square(view).min(), 200)
        self.assertEqual(square(np.repeat(view, 2, axis=0)).shape, (SIZE, SIZE, 3))


class TestDrive(unittest.TestCase):
    def test_mixed_episodes_are_of_growing_disorder(self):
        drive, noises, are_random = Drive("mixed"), [], []
        for episode in range(10):
            drive.begin(episode, seed=episode)
            noises.append(drive.noise)
            are_random.append(drive.is_random)
        self.assertEqual(noises, sorted(noises))
        self.assertEqual((noises[0], sum(are_random)), (0.0, 2))


class TestSpace(unittest.TestCase):
    def test_a_file_with_other_contents_is_kept(self):
        with tempfile.TemporaryDirectory() as folder:
            path = os.path.join(folder, "space.json")
            for _ in range(2):
                write_space(path, SPACE)
            with self.assertRaisesRegex(WorldError, "exists"):
                write_space(path, {})
            with open(path, encoding="utf-8") as file:
                self.assertEqual(json.load(file), SPACE)


if __name__ == "__main__":
    unittest.main()
