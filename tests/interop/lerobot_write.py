"""Writes LeRobot datasets like other programs, with pyarrow and FFmpeg (PyAV): v2.1 and v3.0, AV1 and h264.

    python lerobot_write.py DIR        makes DIR/v21 and DIR/v30

The layouts are those of lerobot 0.4.4 and of its converter from v2.1: lists of fixed size, tasks as an unnamed pandas
index, in v3.0 several episodes in a file (the tables in one row group) and the second file of a camera begun anew. The camera
`front` is AV1 with LeRobot's own settings, `wrist.left` is h264 with pictures that depend on later ones, `still` is PNG,
in v2.1 in the table, in v3.0 by path. As in filtered datasets, v3.0 has another order of columns in its second table, whose
number and first row `meta/episodes` gets wrong. Prints JSON: [{"action", "state", "task", "cameras": {name: [[mean R, G, B of each quarter] of each
frame]}}] of each episode.
"""

import io
import json
import os
import sys
from pathlib import Path

# The AV1 encoder logs errors only.
os.environ["SVT_LOG"] = "1"

import av
import numpy
import pyarrow
import pyarrow.parquet

FPS = 10
LENGTHS = [6, 9, 5]
TASKS = ["lift the lid", "fold the towel ☕"]
WIDTH, HEIGHT = 64, 48
NAMES = ["shoulder.pos", "elbow.pos", "gripper.pos"]


def picture(camera, episode, frame):
    """Quarters of flat colour that differ in each picture."""
    rgb = numpy.empty((HEIGHT, WIDTH, 3), dtype=numpy.uint8)
    for quarter in range(4):
        colour = [40 + 20 * frame, 60 + 50 * episode, 50 + 40 * quarter + 30 * camera]
        rows = slice(0, HEIGHT // 2) if quarter < 2 else slice(HEIGHT // 2, HEIGHT)
        columns = slice(0, WIDTH // 2) if quarter % 2 == 0 else slice(WIDTH // 2, WIDTH)
        rgb[rows, columns] = numpy.clip(colour, 0, 250)
    return rgb


def encode(path, codec, pictures):
    path.parent.mkdir(parents=True, exist_ok=True)
    options = {"g": "2", "crf": "30", "preset": "12"} if codec == "libsvtav1" else {"crf": "18", "bf": "2", "g": "12"}
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, FPS, options=options)
        stream.pix_fmt, stream.width, stream.height = "yuv420p", WIDTH, HEIGHT
        for rgb in pictures:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")))
        container.mux(stream.encode())


def means(rgb):
    half = (rgb.shape[0] // 2, rgb.shape[1] // 2)
    quarters = [rgb[: half[0], : half[1]], rgb[: half[0], half[1] :], rgb[half[0] :, : half[1]], rgb[half[0] :, half[1] :]]
    return [quarter.reshape(-1, 3).mean(axis=0).tolist() for quarter in quarters]


def decode(path):
    with av.open(str(path)) as container:
        return [means(frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)]


def png(rgb):
    with io.BytesIO() as buffer:
        with av.open(buffer, "w", format="image2pipe") as container:
            stream = container.add_stream("png", 1)
            stream.pix_fmt, stream.width, stream.height = "rgb24", WIDTH, HEIGHT
            container.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, format="rgb24")))
            container.mux(stream.encode())
        return buffer.getvalue()


def table(episode, index):
    length = LENGTHS[episode]
    random = numpy.random.default_rng(episode)
    action = random.normal(size=(length, 7)).astype(numpy.float32)
    state = random.normal(size=(length, 3)).astype(numpy.float32)
    task = episode % len(TASKS)

    def vectors(values):
        return pyarrow.FixedSizeListArray.from_arrays(pyarrow.array(values.reshape(-1)), values.shape[1])

    stills = [{"bytes": png(picture(2, episode, frame)), "path": f"frame-{frame:06d}.png"} for frame in range(length)]
    columns = {
        "action": vectors(action),
        "observation.state": vectors(state),
        "observation.images.still": pyarrow.array(
            stills, type=pyarrow.struct([("bytes", pyarrow.binary()), ("path", pyarrow.string())])
        ),
        "next.reward": pyarrow.array(numpy.zeros(length, dtype=numpy.float32)),
        "timestamp": pyarrow.array((numpy.arange(length) / FPS).astype(numpy.float32)),
        "frame_index": pyarrow.array(range(length), type=pyarrow.int64()),
        "episode_index": pyarrow.array([episode] * length, type=pyarrow.int64()),
        "index": pyarrow.array(range(index, index + length), type=pyarrow.int64()),
        "task_index": pyarrow.array([task] * length, type=pyarrow.int64()),
    }
    return pyarrow.table(columns), {"action": action.tolist(), "state": state.tolist(), "task": TASKS[task]}


def by_path(rows, episode, root):
    """The same rows, with pictures as files of the dataset."""
    name = "observation.images.still"
    paths = []
    for frame, still in enumerate(rows.column(name).to_pylist()):
        paths.append(f"images/{name}/episode_{episode:06d}/frame_{frame:06d}.png")
        path = root / paths[-1]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(still["bytes"])
    column = pyarrow.array([{"bytes": None, "path": path} for path in paths], type=rows.column(name).type)
    return rows.set_column(rows.column_names.index(name), name, column)


def info(version, **more):
    column = {"shape": [1], "names": None}
    video = {"dtype": "video", "shape": [HEIGHT, WIDTH, 3], "names": ["height", "width", "channels"]}
    return {
        "codebase_version": version,
        "robot_type": "so100",
        "total_episodes": len(LENGTHS),
        "total_frames": sum(LENGTHS),
        "total_tasks": len(TASKS),
        "chunks_size": 1000,
        "fps": FPS,
        "splits": {"train": f"0:{len(LENGTHS)}"},
        "features": {
            "action": {"dtype": "float32", "shape": [7], "names": None},
            "observation.state": {"dtype": "float32", "shape": [3], "names": {"motors": NAMES}},
            "observation.images.front": video,
            "observation.images.wrist.left": video,
            "observation.images.still": {**video, "dtype": "image"},
            "next.reward": {"dtype": "float32", **column},
            "timestamp": {"dtype": "float32", **column},
            **{name: {"dtype": "int64", **column} for name in ["frame_index", "episode_index", "index", "task_index"]},
        },
        **more,
    }


def write_json(path, value):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value, indent=4, ensure_ascii=False))


def main(root):
    root = Path(root)
    cameras = {"observation.images.front": (0, "libsvtav1"), "observation.images.wrist.left": (1, "libx264")}
    pictures = {
        key: [[picture(number, episode, frame) for frame in range(length)] for episode, length in enumerate(LENGTHS)]
        for key, (number, _) in cameras.items()
    }
    starts = [sum(LENGTHS[:episode]) for episode in range(len(LENGTHS))]
    tables, expected = zip(*[table(episode, start) for episode, start in enumerate(starts)])

    v21 = root / "v21"
    data_path = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
    video_path = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
    more = {"total_videos": 6, "total_chunks": 1, "data_path": data_path, "video_path": video_path}
    write_json(v21 / "meta/info.json", info("v2.1", **more))
    for episode in range(len(LENGTHS)):
        place = {"episode_chunk": 0, "episode_index": episode}
        path = v21 / data_path.format(**place)
        path.parent.mkdir(parents=True, exist_ok=True)
        pyarrow.parquet.write_table(tables[episode], path)
        seen = {}
        for key, (_, codec) in cameras.items():
            path = v21 / video_path.format(video_key=key, **place)
            encode(path, codec, pictures[key][episode])
            seen[key] = decode(path)
        seen["observation.images.still"] = [means(picture(2, episode, frame)) for frame in range(LENGTHS[episode])]
        expected[episode]["cameras"] = seen
    lines = [{"task_index": number, "task": task} for number, task in enumerate(TASKS)]
    (v21 / "meta/tasks.jsonl").write_text("".join(json.dumps(line, ensure_ascii=False) + "\n" for line in lines))
    lines = [
        {"episode_index": episode, "tasks": [expected[episode]["task"]], "length": length}
        for episode, length in enumerate(LENGTHS)
    ]
    (v21 / "meta/episodes.jsonl").write_text("".join(json.dumps(line, ensure_ascii=False) + "\n" for line in lines))

    v30 = root / "v30"
    data_path = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    video_path = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
    sizes = {"data_files_size_in_mb": 100, "video_files_size_in_mb": 200}
    write_json(v30 / "meta/info.json", info("v3.0", data_path=data_path, video_path=video_path, **sizes))
    # The files of each episode: two in the first table, the last in a separate one; likewise the videos of the wrist.
    data_files = [0, 0, 1]
    video_files = {"observation.images.front": [0, 0, 0], "observation.images.wrist.left": [0, 1, 1]}
    for file in set(data_files):
        path = v30 / data_path.format(chunk_index=0, file_index=file)
        path.parent.mkdir(parents=True, exist_ok=True)
        parts = [by_path(tables[episode], episode, v30) for episode in range(len(LENGTHS)) if data_files[episode] == file]
        whole = pyarrow.concat_tables(parts).combine_chunks()
        names = whole.column_names if file == 0 else whole.column_names[::-1]
        pyarrow.parquet.write_table(whole.select(names), path, compression="zstd")
    rows = []
    for episode, length in enumerate(LENGTHS):
        row = {
            "episode_index": episode,
            "tasks": [expected[episode]["task"]],
            "length": length,
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": starts[episode] + 500,
            "dataset_to_index": starts[episode] + 500 + length,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        for key, files in video_files.items():
            before = sum(LENGTHS[other] for other in range(episode) if files[other] == files[episode])
            row[f"videos/{key}/chunk_index"] = 0
            row[f"videos/{key}/file_index"] = files[episode]
            row[f"videos/{key}/from_timestamp"] = before / FPS
            row[f"videos/{key}/to_timestamp"] = (before + length) / FPS
        rows.append(row)
    for key, files in video_files.items():
        for file in set(files):
            path = v30 / video_path.format(video_key=key, chunk_index=0, file_index=file)
            parts = [shown for episode, shown in enumerate(pictures[key]) if files[episode] == file]
            encode(path, cameras[key][1], sum(parts, []))
    (v30 / "meta/episodes/chunk-000").mkdir(parents=True)
    pyarrow.parquet.write_table(pyarrow.Table.from_pylist(rows), v30 / "meta/episodes/chunk-000/file-000.parquet")
    tasks = pyarrow.table({"task_index": list(range(len(TASKS))), "__index_level_0__": TASKS})
    pyarrow.parquet.write_table(tasks, v30 / "meta/tasks.parquet")
    print(json.dumps(expected))


if __name__ == "__main__":
    main(sys.argv[1])
