#!/usr/bin/env python3
"""LeWM by stable-worldmodel on the data and in the worlds of examples/gym, beside our models.

usage: benches/lewm_world.py train DATA OUT.pt --minutes M      learns on a folder that `wm dataset` prepared
       benches/lewm_world.py measure DATA OUT.pt                error of its predictions over persistence, in its own latents
       benches/lewm_world.py act WORLD OUT.pt --episodes N      plans towards goal pictures, as plan.launch.yaml does

LeWM has the sizes, the loss and the optimiser that its authors publish (config/train of their repository), except the
batch: a processor does few steps in the minutes of --minutes, so `train` takes smaller ones. `act` uses their CEM, with
300 candidates and a horizon of five steps, and executes the first action of each plan. It acts without ROS, and the world
waits for each plan; our planner has to keep up with the world.

Needs the packages of benches/lewm.txt and of examples/gym/requirements.txt.
"""

import argparse
import contextlib
import datetime
import io
import json
import pathlib
import statistics
import sys
import time
import types

import gymnasium
import numpy as np
import torch
from machine import processor
from stable_worldmodel.solver import CEMSolver
from stable_worldmodel.wm.loss import SIGReg

from lewm import HISTORY, SIDE, lewm

ROOT = pathlib.Path(__file__).resolve().parent.parent
MEAN, DEVIATION = (torch.tensor(values).view(3, 1, 1) for values in ([0.485, 0.456, 0.406], [0.229, 0.224, 0.225]))
SIGREG_WEIGHT, LEARNING_RATE, WEIGHT_DECAY, CLIP_NORM = 0.09, 5e-5, 1e-3, 1.0
POPULATION, ITERATIONS, HORIZON, MOST_STEPS = 300, 10, 5, 50
FIRST_SEED = 5_000_000


class Data:
    """Frames and actions of a folder that `wm dataset` prepared."""

    def __init__(self, folder):
        folder = pathlib.Path(folder)
        about = json.loads((folder / "dataset.json").read_text())
        height, width = map(int, about["size"].split("x"))
        self.pictures = np.memmap(folder / "frames", np.uint8, "r").reshape(-1, height, width, 3)
        names = [dimension["name"] for dimension in about["action_space"]["dimensions"]]
        self.actions = np.memmap(folder / "actions", np.float32, "r").reshape(-1, len(names))
        self.spans = {"training": [], "validation": []}
        first = 0
        for episode in about["episodes"]:
            self.spans[episode["split"]].append((first, episode["frames"]))
            first += episode["frames"]
        if first != len(self.pictures) or first != len(self.actions):
            sys.exit(f"{folder}: {first} frames by dataset.json, {len(self.pictures)} pictures, {len(self.actions)} actions")

    def clips(self, split, frames):
        """First frames of all clips of `frames` frames."""
        return [first + at for first, count in self.spans[split] for at in range(count - frames + 1)]


def prepared(pictures):
    """Pictures (..., H, W, 3), uint8, as LeWM takes them: (..., 3, SIDE, SIDE)."""
    pictures = torch.from_numpy(np.ascontiguousarray(pictures)).float().div(255.0)
    leading = pictures.shape[:-3]
    pictures = pictures.reshape(-1, *pictures.shape[-3:]).permute(0, 3, 1, 2)
    pictures = torch.nn.functional.interpolate(pictures, (SIDE, SIDE), mode="bilinear", antialias=True)
    return ((pictures - MEAN) / DEVIATION).reshape(*leading, 3, SIDE, SIDE)


def train(arguments):
    data = Data(arguments.data)
    starts = data.clips("training", HISTORY + 1)
    frames = np.concatenate([data.actions[first : first + count] for first, count in data.spans["training"]])
    mean, deviation = frames.mean(0), frames.std(0).clip(1e-6)
    model, sigreg = lewm(data.actions.shape[1], arguments.seed), SIGReg()
    optimiser = torch.optim.AdamW(model.parameters(), LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    random = np.random.default_rng(arguments.seed)
    begun, cpu, steps, recent = time.monotonic(), time.process_time(), 0, []
    while time.monotonic() - begun < 60.0 * arguments.minutes:
        chosen = random.choice(starts, arguments.batch)
        index = chosen[:, None] + np.arange(HISTORY + 1)
        actions = torch.from_numpy((data.actions[index] - mean) / deviation)
        found = model.encode({"pixels": prepared(data.pictures[index]), "action": actions})
        latents, given = found["emb"], found["act_emb"]
        predicted = model.predict(latents[:, :HISTORY], given[:, :HISTORY])
        loss = (predicted - latents[:, 1:]).square().mean() + SIGREG_WEIGHT * sigreg(latents.transpose(0, 1))
        optimiser.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), CLIP_NORM)
        optimiser.step()
        steps += 1
        recent.append(loss.item())
        if steps % 20 == 0:
            print(f"step {steps}, loss {statistics.mean(recent[-20:]):.4f}", flush=True)
    stored = {"weights": model.state_dict(), "mean": torch.from_numpy(mean), "deviation": torch.from_numpy(deviation)}
    torch.save(stored, arguments.out)
    print(f"{steps} steps of {arguments.batch} clips in {arguments.minutes:g} minutes, {(time.process_time() - cpu) / 60.0:.1f} minutes of a core")


def load(path):
    stored = torch.load(path, weights_only=True)
    model = lewm(len(stored["mean"]))
    model.load_state_dict(stored["weights"])
    return model.eval().requires_grad_(False), stored["mean"].numpy(), stored["deviation"].numpy()


def measure(arguments):
    data = Data(arguments.data)
    model, mean, deviation = load(arguments.weights)
    length = HISTORY + max(arguments.steps)
    starts = data.clips("validation", length)
    starts = np.random.default_rng(arguments.seed).choice(starts, min(arguments.windows, len(starts)), replace=False)
    own, still = (np.zeros((len(starts), max(arguments.steps))) for _ in range(2))
    with torch.inference_mode():
        for number, start in enumerate(starts):
            actions = torch.from_numpy((data.actions[start : start + length] - mean) / deviation)[None]
            found = model.encode({"pixels": prepared(data.pictures[start : start + length])[None], "action": actions})
            latents, given = found["emb"], found["act_emb"]
            known = list(latents[:, :HISTORY].unbind(1))
            for step in range(max(arguments.steps)):
                past = torch.stack(known[-HISTORY:], 1)
                known.append(model.predict(past, given[:, step : step + HISTORY])[:, -1])
                truth = latents[:, HISTORY + step]
                own[number, step] = (known[-1] - truth).square().mean()
                still[number, step] = (latents[:, HISTORY - 1] - truth).square().mean()
    for step in arguments.steps:
        ratio = own[:, step - 1].sum() / still[:, step - 1].sum()
        print(f"k={step}: squared error over persistence {ratio:.3f} ({len(starts)} windows)")


def act(arguments):
    sys.path.insert(0, str(ROOT / "examples/gym"))
    import worlds

    model, mean, deviation = load(arguments.weights)
    world = worlds.MetaWorld(arguments.world.removeprefix("metaworld:"))
    solver = CEMSolver(model, num_samples=POPULATION, n_steps=ITERATIONS, topk=30, seed=arguments.seed)
    space = gymnasium.spaces.Box(-1.0, 1.0, (1, len(mean)), np.float32)
    solver.configure(action_space=space, n_envs=1, config=types.SimpleNamespace(horizon=HORIZON, action_block=1))
    done, times, episode, seed = [], [], 0, FIRST_SEED
    while episode < arguments.episodes:
        state, goal = world.reset(seed), world.goal_picture()
        seed += 1
        if goal is None:
            continue  # the expert fails from this seed
        goal = prepared(goal)[None, None]
        for _ in range(MOST_STEPS):
            given = {"pixels": prepared(state.picture)[None, None], "goal": goal, "action": torch.zeros(1, 1, len(mean))}
            started = time.perf_counter()
            with contextlib.redirect_stdout(io.StringIO()):
                plan = solver(given)["actions"]
            times.append(time.perf_counter() - started)
            action = plan[0, 0].numpy() * deviation + mean
            state = world.step(action[:3] / worlds.STEP_S, float(np.clip(action[3], 0.0, 1.0)))
            if state.is_done:
                break
        done.append(state.is_done)
        episode += 1
        print(f"seed {seed - 1}: {'done' if done[-1] else 'not done'}", flush=True)
    world.close()
    median = 1e3 * statistics.median(times)
    print(f"{arguments.world}: {sum(done)} of {len(done)} episodes; a plan takes {median:.0f} ms (median of {len(times)})")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    command = commands.add_parser("train")
    command.add_argument("data")
    command.add_argument("out", type=pathlib.Path)
    command.add_argument("--minutes", type=float, required=True)
    command.add_argument("--batch", type=int, default=16, help="clips of four frames")
    command.set_defaults(run=train)
    command = commands.add_parser("measure")
    command.add_argument("data")
    command.add_argument("weights")
    command.add_argument("--windows", type=int, default=80)
    command.add_argument("--steps", type=int, nargs="+", default=[1, 4, 8])
    command.set_defaults(run=measure)
    command = commands.add_parser("act")
    command.add_argument("world")
    command.add_argument("weights")
    command.add_argument("--episodes", type=int, default=20)
    command.set_defaults(run=act)
    for command in commands.choices.values():
        command.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    if getattr(arguments, "out", None) and arguments.out.exists():
        sys.exit(f"{arguments.out} exists already")
    print(f"{processor()}, {torch.get_num_threads()} threads, {datetime.date.today()}, torch {torch.__version__}", flush=True)
    arguments.run(arguments)


if __name__ == "__main__":
    main()
