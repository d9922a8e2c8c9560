#!/usr/bin/env python3
"""The transition model against PyTorch on the same machine: one velocity of a new frame after nine cached ones, and a
predicted frame, ten Euler steps in a full window of ten, ours with its exact cache against the reference's loop, which
computes the window in every step.

usage: benches/transition.py [--rounds N] [--runs N] [--presets P ...] [--frames P ...]

Runs both in turns, round by round, on all threads of each, and prints a Markdown table: medians over all runs, and the
ratio of ours to PyTorch's, the median over rounds (below 1: ours is faster). Needs torch (the pinned version is in
world-model/tests/fixtures/generate_transition.py) and `cargo build --release -p wm_model --examples`.
"""

import argparse
import datetime
import importlib.util
import os
import pathlib
import statistics
import subprocess
import time

import torch
import torch.nn.functional as F

ROOT = pathlib.Path(__file__).resolve().parent.parent
CACHED = 9
EULER_STEPS = 10
# preset, hidden, depth, heads; latents of SD3's encoder
LATENT, PATCH = (32, 32, 16), 2
SIZES = {"dit-s": (384, 12, 6), "dit-b": (768, 12, 12), "dit-l": (1024, 24, 16)}


def reference():
    source = ROOT / "world-model/tests/fixtures/generate_transition.py"
    spec = importlib.util.spec_from_file_location("generate_transition", source)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Cached:
    """The reference's layers, run for one new frame whose temporal attention sees cached keys and values."""

    def __init__(self, preset, dtype):
        self.module = reference()
        hidden, depth, self.heads = SIZES[preset]
        height, width, channels = LATENT
        model = self.module.Transition(hidden, depth, self.heads, PATCH, channels, None).to(dtype).eval()
        self.model, self.dtype, self.dim = model, dtype, hidden // self.heads
        tokens = height * width // PATCH**2
        shape = (depth, tokens, self.heads, CACHED, self.dim)
        self.keys, self.values = torch.randn(shape).to(dtype), torch.randn(shape).to(dtype)
        self.x = torch.randn(1, height, width, channels).to(dtype)
        rows, columns = height // PATCH, width // PATCH
        row, column = torch.arange(rows).repeat_interleave(columns), torch.arange(columns).repeat(rows)
        axis = self.module.axis_angles
        space = torch.cat((axis(row, self.dim // 2), axis(column, self.dim // 2)), -1)
        position = axis(torch.tensor([CACHED]), self.dim)
        # as a careful user would: what does not change is computed once
        self.space, self.position = [(a.cos().to(dtype), a.sin().to(dtype)) for a in (space, position)]

    def turned(self, x, angles):
        x = F.rms_norm(x, (self.dim,), eps=1e-6)
        a, b = x[..., 0::2], x[..., 1::2]
        cos, sin = angles
        return torch.stack((a * cos - b * sin, a * sin + b * cos), -1).flatten(-2)

    def sub_block(self, block, x, condition, attend):
        m = block.adaLN_modulation(condition)
        shift1, scale1, gate1, shift2, scale2, gate2 = m.chunk(6, -1)
        modulated = self.module.modulated
        x = x + gate1 * block.attn.out_proj(attend(block.attn.qkv_proj(modulated(x, shift1, scale1))))
        return x + gate2 * block.ffwd(modulated(x, shift2, scale2))

    @torch.inference_mode()
    def step(self):
        model, heads, dim = self.model, self.heads, self.dim
        tokens = model.x_proj(self.x.permute(0, 3, 1, 2)).flatten(2).transpose(1, 2)[0]
        n = tokens.shape[0]
        waves = torch.full((1, 256), 0.5, dtype=self.dtype)
        condition = model.timestep_mlp(waves) + model.action_embedder(torch.full((1, 10), 0.1, dtype=self.dtype))

        def in_space(qkv):
            q, k, v = qkv.view(n, 3, heads, dim).permute(1, 2, 0, 3)
            out = F.scaled_dot_product_attention(
                self.turned(q, self.space)[None], self.turned(k, self.space)[None], v[None]
            )
            return out[0].transpose(0, 1).reshape(n, -1)

        for index, block in enumerate(model.blocks):

            def over_time(qkv):
                q, k, v = qkv.view(n, 3, heads, 1, dim).unbind(1)
                k = torch.cat((self.keys[index], self.turned(k, self.position)), 2)
                v = torch.cat((self.values[index], v), 2)
                return F.scaled_dot_product_attention(self.turned(q, self.position), k, v).reshape(n, -1)

            tokens = self.sub_block(block.s_block, tokens, condition, in_space)
            tokens = self.sub_block(block.t_block, tokens, condition, over_time)
        head = model.final_layer
        shift, scale = head.adaLN_modulation(condition).chunk(2, -1)
        return head.linear(self.module.modulated(tokens, shift, scale))


class Loop:
    """The reference's frame: every Euler step computes the whole window."""

    def __init__(self, preset, dtype):
        hidden, depth, heads = SIZES[preset]
        height, width, channels = LATENT
        self.model = reference().Transition(hidden, depth, heads, PATCH, channels, None).to(dtype).eval()
        self.window = torch.randn(1, CACHED + 1, height, width, channels).to(dtype)
        self.action = torch.randn(1, CACHED + 1, 10).to(dtype)

    @torch.inference_mode()
    def step(self):
        window = self.window.clone()
        for step in range(EULER_STEPS):
            tau = torch.full((1, CACHED + 1), 0.01)
            tau[:, -1] = 1 - step / EULER_STEPS
            velocity = self.model(window, tau.to(window.dtype), self.action)
            window[:, -1] -= velocity[:, -1] / EULER_STEPS


def theirs(model, runs):
    model.step()
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        model.step()
        times.append((time.perf_counter() - start) * 1e3)
    return times


def ours(what, preset, number_format, runs):
    binary = ROOT / "target/release/examples/transition_speed"
    arguments = [what, preset, *LATENT, PATCH, number_format, runs + 1]
    result = subprocess.run([binary, *map(str, arguments)], check=True, capture_output=True, text=True)
    return [float(line) for line in result.stdout.split()][1:]


def processor():
    for line in pathlib.Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return "unknown processor"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--runs", type=int, default=6)
    parser.add_argument("--presets", nargs="+", default=["dit-s", "dit-b"], choices=SIZES)
    parser.add_argument("--frames", nargs="*", default=["dit-s"], choices=SIZES, help="presets of predicted frames")
    arguments = parser.parse_args()
    cores = len(os.sched_getaffinity(0))
    torch.set_num_threads(cores)
    print(f"{processor()}, {cores} cores, {datetime.date.today()}, torch {torch.__version__},")
    print(f"{arguments.rounds} rounds of {arguments.runs} runs\n")
    print("| what | model | format | ours p50 ms | PyTorch p50 ms | ratio (least to most of the rounds) |")
    print("|---|---|---|---|---|---|")
    formats = [("f32", torch.float32), ("bf16", torch.bfloat16)]
    cases = [("velocity", preset, *of, Cached) for preset in arguments.presets for of in formats]
    cases += [("frame", preset, *formats[0], Loop) for preset in arguments.frames]
    for what, preset, name, dtype, peer in cases:
        model = peer(preset, dtype)
        # A frame of the reference takes a hundred times as long as a velocity.
        rounds, runs = (arguments.rounds, arguments.runs) if what == "velocity" else (2, 1)
        ours_all, theirs_all, ratios = [], [], []
        for _ in range(rounds):
            a, b = ours(what, preset, name, runs), theirs(model, runs)
            ours_all += a
            theirs_all += b
            ratios.append(statistics.median(a) / statistics.median(b))
        print(
            f"| {what} | {preset} | {name} | {statistics.median(ours_all):.1f} | {statistics.median(theirs_all):.1f} | "
            f"{statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f}) |",
            flush=True,
        )


if __name__ == "__main__":
    main()
