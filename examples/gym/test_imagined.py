"""gymnasium's own check of imagined.py: python examples/gym/test_imagined.py BAG   (ROS 2 sourced, `wm env` running)"""

import sys
import unittest

import numpy as np
from gymnasium.utils.env_checker import check_env
from imagined import ImaginedEnv

BAG = sys.argv.pop()


class TestImaginedEnv(unittest.TestCase):
    def test_gymnasium_accepts_it(self):
        env = ImaginedEnv(bag=BAG)
        check_env(env, skip_render_check=True)
        env.close()

    def test_an_episode_repeats_by_seed_and_ends(self):
        env = ImaginedEnv(bag=BAG, start={"max_steps": 3}, reward=lambda picture, info: (picture.mean(), False))
        runs = []
        for _ in range(2):
            pictures = [env.reset(seed=5)[0]]
            for index in range(3):
                picture, reward, terminated, truncated, info = env.step([0.02, 0.0, -0.01, 0.0, 0.0, 0.0, 1.0])
                self.assertEqual((reward, terminated, truncated, info["steps"]), (picture.mean(), False, index == 2, index + 1))
                pictures.append(picture)
            runs.append(pictures)
        np.testing.assert_array_equal(runs[0], runs[1])
        self.assertTrue((runs[0][0] != runs[0][3]).any())
        env.close()

    def test_bad_calls_are_refused_by_name(self):
        env = ImaginedEnv(bag=BAG)
        with self.assertRaisesRegex(RuntimeError, "expected a reset"):
            env.step(np.zeros(7))
        env.reset(seed=1)
        with self.assertRaisesRegex(ValueError, "7 finite values"):
            env.step([0.0] * 6)
        with self.assertRaisesRegex(RuntimeError, "env/reset"):
            env.reset(options={"bag": "no/such/bag"})
        env.close()


if __name__ == "__main__":
    unittest.main()
