"""Tests of lerobot_policy.py's reading of answers: python examples/test_lerobot_policy.py   (ROS 2 sourced)"""

import io
import os
import pickle
import tempfile
import unittest

import torch
from lerobot.async_inference.helpers import TimedAction
from lerobot_policy import actions_of
from policy_bridge import Refusal

RATE = 10.0


def timed(count=4, first=3, rate=RATE, start=1_700_000_000.0):
    rows = torch.arange(count * 2, dtype=torch.float32).reshape(count, 2)
    return [TimedAction(start + index / rate, first + index, row) for index, row in enumerate(rows)]


class Attack:
    """Runs a function when it is unpickled."""

    def __init__(self, function, *arguments):
        self.function, self.arguments = function, arguments

    def __reduce__(self):
        return self.function, self.arguments


class TestAnswer(unittest.TestCase):
    def refused(self, answer):
        with self.assertRaises(Refusal, msg=repr(answer)) as raised:
            actions_of(answer if isinstance(answer, bytes) else pickle.dumps(answer), 3, RATE)
        return raised.exception.reason

    def test_actions_of_every_protocol_and_type_are_read(self):
        for protocol in range(3, pickle.HIGHEST_PROTOCOL + 1):
            actions = actions_of(pickle.dumps(timed(), protocol), 3, RATE)
            self.assertEqual(actions.tolist(), [[0, 1], [2, 3], [4, 5], [6, 7]])
        for kind in (torch.bfloat16, torch.float64, torch.int32):
            answer = [TimedAction(0.0, 3, torch.ones(2, dtype=kind))]
            self.assertEqual(actions_of(pickle.dumps(answer), 3, RATE).tolist(), [[1, 1]])

    def test_code_in_an_answer_is_not_run(self):
        with tempfile.TemporaryDirectory() as folder:
            mark = os.path.join(folder, "mark")
            legacy, zipped = io.BytesIO(), io.BytesIO()
            torch.save(Attack(os.mkdir, mark), legacy, _use_new_zipfile_serialization=False)
            torch.save(Attack(os.mkdir, mark), zipped)
            for attack in (
                Attack(os.mkdir, mark),
                Attack(eval, f"__import__('os').mkdir({mark!r})"),
                Attack(getattr, "text", "encode"),
                Attack(torch.load, mark),
            ):
                self.assertEqual(self.refused(attack), "unsafe")
                self.assertEqual(self.refused([TimedAction(0.0, 3, attack)]), "unsafe")
            for data in (legacy.getvalue(), zipped.getvalue()):
                self.assertEqual(self.refused(Attack(torch.storage._load_from_bytes, data)), "shape")
            self.assertFalse(os.path.exists(mark))

    def test_malformed_answers_are_refused(self):
        for answer in (
            b"", b"no pickle", pickle.dumps(timed())[:-9], None, [], {}, timed()[0], [1.0, 2.0],
            [TimedAction(0.0, 3, [1.0, 2.0])],
            timed() + [TimedAction(0.4, 7, torch.ones(3))],
            [TimedAction("now", 3, torch.ones(2)), TimedAction(0.1, 4, torch.ones(2))],
        ):  # fmt: skip
            self.assertEqual(self.refused(answer), "shape", answer)

    def test_answers_to_other_observations_are_refused(self):
        for answer in (timed(first=2), timed(first=4), timed()[::-1], timed()[:2] + timed()[3:]):
            self.assertEqual(self.refused(answer), "old_answer")

    def test_actions_at_another_rate_are_refused(self):
        for rate in (RATE * 3, RATE * 1.05, RATE * 0.5, -RATE, float("inf")):
            self.assertEqual(self.refused(timed(rate=rate)), "period")
        broken = timed()
        broken[-1].timestamp = float("nan")
        self.assertEqual(self.refused(broken), "period")


if __name__ == "__main__":
    unittest.main()
