#!/usr/bin/env python3
"""Plans of CEM with the bundled default against those of LeWM by stable-worldmodel, on the same machine.

usage: benches/lewm.py [--plans N] [--population N] [--iterations N] [HORIZON ...]

Builds world-model/planner/examples/plan_speed.rs, and times plans of both in turns, on all threads of each. LeWM has the
sizes that its authors publish (ViT-tiny with patches of 14 of a picture of 224, a predictor of six blocks with a history
of three) and random weights: times do not depend on them. Its plans contain the encoding of the picture and the goal,
ours do not: in our suite another node does that, once per frame. A candidate step is the prediction of one latent for
one candidate.

Needs cargo and the packages of benches/lewm.txt.
"""

import argparse
import contextlib
import datetime
import io
import json
import pathlib
import statistics
import subprocess
import time
import types

import gymnasium
import numpy as np
import torch
from machine import processor
from stable_worldmodel.solver import CEMSolver
from stable_worldmodel.wm.lewm import LeWM
from stable_worldmodel.wm.lewm.module import MLP, Embedder, Predictor
from transformers import ViTConfig, ViTModel

ROOT = pathlib.Path(__file__).resolve().parent.parent
WIDTH, SIDE, HISTORY = 192, 224, 3
ACTION = 7  # values of an action, as of the bundled default


def lewm(action, seed=0):
    """LeWM with the sizes of config/train/model/lewm.yaml of its repository."""
    torch.manual_seed(seed)
    vit = ViTConfig(
        hidden_size=WIDTH, num_hidden_layers=12, num_attention_heads=3, intermediate_size=4 * WIDTH, image_size=SIDE, patch_size=14
    )
    projector = {"input_dim": WIDTH, "output_dim": WIDTH, "hidden_dim": 2048, "norm_fn": torch.nn.BatchNorm1d}
    return LeWM(
        encoder=ViTModel(vit, add_pooling_layer=False),
        predictor=Predictor(
            num_frames=HISTORY, input_dim=WIDTH, hidden_dim=WIDTH, output_dim=WIDTH, depth=6, heads=16, mlp_dim=2048, dim_head=64, dropout=0.1
        ),
        action_encoder=Embedder(input_dim=action, smoothed_dim=10, emb_dim=WIDTH),
        projector=MLP(**projector),
        pred_proj=MLP(**projector),
    )


class Theirs:
    def __init__(self, arguments, horizon):
        self.solver = CEMSolver(lewm(ACTION).eval(), num_samples=arguments.population, n_steps=arguments.iterations, topk=30)
        space = gymnasium.spaces.Box(-1.0, 1.0, (1, ACTION), np.float32)
        self.solver.configure(action_space=space, n_envs=1, config=types.SimpleNamespace(horizon=horizon, action_block=1))
        self.picture = torch.randn(1, 1, 3, SIDE, SIDE)

    def plan(self):
        """Milliseconds of a plan."""
        given = {"pixels": self.picture, "goal": self.picture.flip(-1), "action": torch.zeros(1, 1, ACTION)}
        started = time.perf_counter()
        with contextlib.redirect_stdout(io.StringIO()):
            self.solver(given)
        return 1e3 * (time.perf_counter() - started)


def ours(arguments, horizon):
    sizes = map(str, [1, arguments.population, arguments.iterations, horizon])
    done = subprocess.run([ROOT / "target/release/examples/plan_speed", *sizes], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)[0]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("horizons", nargs="*", type=int, default=[1, 5, 10])
    parser.add_argument("--plans", type=int, default=5)
    parser.add_argument("--population", type=int, default=300)
    parser.add_argument("--iterations", type=int, default=10)
    arguments = parser.parse_args()
    build = ["cargo", "build", "--release", "-q", "-p", "wm_planner", "--example", "plan_speed"]
    subprocess.run(build, cwd=ROOT, check=True)
    print(f"{processor()}, {torch.get_num_threads()} threads, {datetime.date.today()}, torch {torch.__version__}")
    print(f"{arguments.population} candidates, {arguments.iterations} iterations, {arguments.plans} plans of each in turns; medians")
    print("horizon    ours [ms]    LeWM [ms]   candidate steps/s: ours, LeWM   ours / LeWM [min, max]")
    for horizon in arguments.horizons:
        theirs = Theirs(arguments, horizon)
        theirs.plan()
        pairs = [(ours(arguments, horizon), theirs.plan()) for _ in range(arguments.plans)]
        own, other = (statistics.median(column) for column in zip(*pairs))
        ratios = [first / second for first, second in pairs]
        steps = 1e3 * arguments.population * arguments.iterations * horizon
        print(
            f"{horizon:7}{own:13.0f}{other:13.0f}{steps / own:19.0f}{steps / other:14.0f}"
            f"{statistics.median(ratios):16.2f} [{min(ratios):.2f}, {max(ratios):.2f}]",
            flush=True,
        )


if __name__ == "__main__":
    main()
