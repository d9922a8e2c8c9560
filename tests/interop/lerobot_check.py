"""Checks a LeRobot v3.0 dataset against the format's definition with pyarrow and FFmpeg (PyAV), and prints its contents.

    python lerobot_check.py DATASET

What is checked is what the Python package lerobot 0.4.4 relies on (lerobot/datasets/utils.py, lerobot_dataset.py):
every key of info.json, the columns and types that get_hf_features_from_features asks for, the places of each episode, the
tasks as a pandas index, statistics of every feature (min, max, mean, std and count recomputed here), and that each
row's `from_timestamp + timestamp` has a video frame within its tolerance_s.

Prints JSON: {"info": {...}, "tasks": [...], "episodes": [{"length", "tasks", "columns": {name: [...]}, "videos":
{key: [sha256 of each frame's RGB]}}]}.
"""

import hashlib
import json
import sys
from pathlib import Path

import av
import numpy
import pyarrow
import pyarrow.compute
import pyarrow.parquet

TOLERANCE_S = 1e-4
QUANTILES = ["q01", "q10", "q50", "q90", "q99"]
INFO = {
    "codebase_version": str,
    "robot_type": (str, type(None)),
    "total_episodes": int,
    "total_frames": int,
    "total_tasks": int,
    "chunks_size": int,
    "data_files_size_in_mb": int,
    "video_files_size_in_mb": int,
    "fps": int,
    "splits": dict,
    "data_path": str,
    "video_path": str,
    "features": dict,
}
DEFAULT_FEATURES = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}


def check_type(name, feature, field):
    """Checks that `datasets` casts the column's type to the feature's without loss."""
    value = {"float32": pyarrow.float32(), "int64": pyarrow.int64(), "bool": pyarrow.bool_()}[feature["dtype"]]
    if feature["shape"] == [1]:
        assert field.type == value, (name, field.type)
    else:
        assert pyarrow.types.is_list(field.type) and field.type.value_type == value, (name, field.type)


def frames(path):
    """Times in s and SHA-256 of RGB of each frame."""
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.pix_fmt == "yuv420p", stream.codec_context.pix_fmt
        shown = []
        for frame in container.decode(stream):
            rgb = frame.to_ndarray(format="rgb24")
            shown.append((float(frame.pts * frame.time_base), hashlib.sha256(rgb.tobytes()).hexdigest(), rgb.shape))
        return shown, stream.average_rate


def close(name, got, expected):
    assert numpy.allclose(got, expected, rtol=1e-5, atol=1e-6), (name, got, expected)


def main(root):
    root = Path(root)
    info = json.loads((root / "meta/info.json").read_text())
    for key, kind in INFO.items():
        assert isinstance(info[key], kind), (key, info[key])
    assert info["codebase_version"] == "v3.0" and info["splits"] == {"train": f"0:{info['total_episodes']}"}
    features = info["features"]
    for name, dtype in DEFAULT_FEATURES.items():
        assert features[name] == {"dtype": dtype, "shape": [1], "names": None}, (name, features[name])
    assert not [name for name in features if "/" in name]
    columns = {name: feature for name, feature in features.items() if feature["dtype"] != "video"}
    videos = {name: feature for name, feature in features.items() if feature["dtype"] == "video"}

    # Restored from the table's metadata, as in pandas.
    tasks = pyarrow.parquet.read_table(root / "meta/tasks.parquet")
    pandas = json.loads(tasks.schema.metadata[b"pandas"])
    (index,) = pandas["index_columns"]
    assert tasks.column("task_index").to_pylist() == list(range(info["total_tasks"]))
    tasks = tasks.column(index).to_pylist()

    rows = []
    for path in sorted((root / "meta/episodes").glob("*/*.parquet")):
        rows += pyarrow.parquet.read_table(path).to_pylist()
    assert [row["episode_index"] for row in rows] == list(range(info["total_episodes"]))
    stats = json.loads((root / "meta/stats.json").read_text())
    assert set(stats) == set(features), set(stats) ^ set(features)

    seen, decoded, tables = [], {}, {}
    position = 0
    for row in rows:
        assert row["dataset_from_index"] == position, row
        position += row["length"]
        assert row["dataset_to_index"] == position, row
        place = {"chunk_index": row["data/chunk_index"], "file_index": row["data/file_index"]}
        path = root / info["data_path"].format(**place)
        if path not in tables:
            tables[path] = pyarrow.parquet.read_table(path)
            for name, feature in columns.items():
                check_type(name, feature, tables[path].schema.field(name))
            assert set(tables[path].schema.names) == set(columns), tables[path].schema.names
        table = tables[path].filter(pyarrow.compute.equal(tables[path]["episode_index"], row["episode_index"]))
        assert table.num_rows == row["length"]
        assert table["index"].to_pylist() == list(range(row["dataset_from_index"], row["dataset_to_index"]))
        assert table["frame_index"].to_pylist() == list(range(row["length"]))
        expected = numpy.arange(row["length"]) / info["fps"]
        assert numpy.array_equal(table["timestamp"].to_numpy(), expected.astype(numpy.float32))
        assert {tasks[number] for number in table["task_index"].to_pylist()} == set(row["tasks"])
        for name, feature in columns.items():
            values = numpy.array(table[name].to_pylist(), dtype=float).reshape(row["length"], -1)
            assert values.shape[1] == feature["shape"][0], (name, values.shape)
            close(name, row[f"stats/{name}/min"], values.min(axis=0))
            close(name, row[f"stats/{name}/max"], values.max(axis=0))
            close(name, row[f"stats/{name}/mean"], values.mean(axis=0))
            close(name, row[f"stats/{name}/std"], values.std(axis=0))
            for quantile in QUANTILES:
                close(name, row[f"stats/{name}/{quantile}"], numpy.quantile(values, int(quantile[1:]) / 100, axis=0))
            assert row[f"stats/{name}/count"] == [row["length"]]
        shown = {}
        for name, feature in videos.items():
            place = {key: row[f"videos/{name}/{key}"] for key in ("chunk_index", "file_index")}
            path = root / info["video_path"].format(video_key=name, **place)
            if path not in decoded:
                decoded[path] = frames(path)
            all_frames, rate = decoded[path]
            assert rate == info["fps"], (path, rate)
            times = numpy.array([time for time, _, _ in all_frames])
            begin, end = row[f"videos/{name}/from_timestamp"], row[f"videos/{name}/to_timestamp"]
            assert abs(end - begin - row["length"] / info["fps"]) < TOLERANCE_S
            hashes = []
            for timestamp in table["timestamp"].to_pylist():
                distance = numpy.abs(times - (begin + timestamp))
                assert distance.min() < TOLERANCE_S, (path, begin + timestamp, distance.min())
                _, digest, shape = all_frames[int(distance.argmin())]
                assert list(shape) == feature["shape"], (shape, feature)
                hashes.append(digest)
            shown[name] = hashes
            # lerobot's _validate_stat_value: pictures have statistics of shape (3, 1, 1), between 0 and 1.
            for stat in ["min", "max", "mean", "std", *QUANTILES]:
                value = numpy.array(row[f"stats/{name}/{stat}"])
                assert value.shape == (3, 1, 1) and (value >= 0).all() and (value <= 1).all(), (name, stat, value)
        seen.append(
            {
                "length": row["length"],
                "tasks": row["tasks"],
                "columns": {name: table[name].to_pylist() for name in columns},
                "videos": shown,
            }
        )
    assert position == info["total_frames"]
    for path, (all_frames, _) in decoded.items():
        in_file = sum(
            row["length"]
            for row in rows
            for name in videos
            if path
            == root
            / info["video_path"].format(
                video_key=name,
                chunk_index=row[f"videos/{name}/chunk_index"],
                file_index=row[f"videos/{name}/file_index"],
            )
        )
        assert len(all_frames) == in_file, (path, len(all_frames), in_file)
    for name, of_all in stats.items():
        assert set(of_all) == {"min", "max", "mean", "std", "count", *QUANTILES}, (name, of_all)
        assert of_all["count"] == [info["total_frames"]], (name, of_all["count"])
        if name in columns:
            values = numpy.concatenate([numpy.array(episode["columns"][name], dtype=float) for episode in seen])
            values = values.reshape(info["total_frames"], -1)
            for stat, value in [("min", values.min(axis=0)), ("max", values.max(axis=0))]:
                close(name, of_all[stat], value)
            close(name, of_all["mean"], values.mean(axis=0))
            close(name, of_all["std"], values.std(axis=0))
        else:
            assert numpy.array(of_all["mean"]).shape == (3, 1, 1), name
    print(json.dumps({"info": info, "tasks": tasks, "episodes": seen}))


if __name__ == "__main__":
    main(sys.argv[1])
