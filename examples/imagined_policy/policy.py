"""A policy for `wm eval policy`, which imagines the result of its actions: JSON lines in, JSON lines out, no ROS.

usage: wm eval policy --model tiny --bags bags/tabletop --policy-command 'python3 examples/imagined_policy/policy.py'

A demonstration, not a policy that solves anything: it does not look at the picture. It moves the gripper down, closes it
and moves up. Write your own `act`; the README beside this file shows OpenVLA's. It needs Python's standard library only.
"""

import argparse
import json
import sys

VERSION = 1  # of the protocol


def act(request, arguments):
    """The actions that lead to the next picture: a list for each, in the units of the action space.

    It depends on nothing but the request: requests of several trials alternate.
    """
    space = request["action_space"]
    is_down = request["step"] < arguments.down
    values = []
    for name, kind in zip(space["names"], space["kinds"]):
        if kind.startswith("gripper"):
            values.append(1.0 if is_down else 0.0)  # 1 is open, 0 is closed
        elif kind == "translation_delta" and name == "dz":
            values.append(-arguments.speed if is_down else arguments.speed)  # [m] per action
        elif kind.endswith("_delta"):
            values.append(0.0)
        else:
            raise ValueError(f"this demonstration moves by differences, but {name} is a {kind}")
    # A picture comes once in so many actions. A policy may give more actions: all are executed,
    # then the next request follows.
    return [values] * space["actions_per_step"]


def answer(line, arguments):
    """The answer to a request."""
    try:
        request = json.loads(line)
        if request["version"] != VERSION:
            raise ValueError(f"protocol {request['version']}, expected {VERSION}")
        # The picture is base64.b64decode(request["image"]), a PNG; what to do is request["instruction"].
        return {"actions": act(request, arguments)}
    except (KeyError, TypeError, ValueError) as error:
        return {"error": f"{type(error).__name__}: {error}"}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--down", type=int, default=6, help="model steps before the gripper closes")
    parser.add_argument("--speed", type=float, default=0.02, help="metres per action")
    arguments = parser.parse_args()
    for line in sys.stdin:
        # Standard output has answers only: print messages to sys.stderr.
        print(json.dumps(answer(line, arguments)), flush=True)


if __name__ == "__main__":
    main()
